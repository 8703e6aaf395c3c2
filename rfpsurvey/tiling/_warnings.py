"""Warnings for tables of targets that are given instead of tables of tiles, and for tiles of several programs."""

import re

import numpy as np

from rfpsurvey._units import to_labels
from rfpsurvey.errors import listed, number_of, warn
from rfpsurvey.tiling._columns import COLUMNS
from rfpsurvey.tiling._tiling import Tiling

OF_TILES = re.compile(
    r".*(tile|plate|field|center|racen|ra_cen|dece?cen|dec_cen|pass|layer|pos_?ang|position_?angle).*|pa|program"
)
OF_TARGETS = re.compile(
    r"(.*_)?(mag|magnitude)s?|.*[a-z0-9]_?mag|mag_.*|(e_)?pm(_?(ra|de).*)?|parallax|plx"
    r"|(source|target|obj|object|gaia|tyc|tycho)\d?_?(id|source_id)|kind|fiber_?type"
)
MANY = 1000


def warn_of_targets(tiling: Tiling, n_targets: int) -> None:
    """Warn if the table of a tiling seems to be a table of targets; ``n_targets`` is the number of targets.

    There is no warning if the table has a column that occurs only in lists of tiles. Otherwise there is a warning if
    the table has a column that is typical of targets, such as a magnitude, or if it has more than ``MANY`` rows and
    more rows than the survey has targets.
    """
    columns = list(tiling.table.meta["columns"].values())
    columns += [name for name in tiling.table.colnames if name not in COLUMNS]
    if any(OF_TILES.fullmatch(name.lower()) for name in columns):
        return
    found = [name for name in columns if OF_TARGETS.fullmatch(name.lower())]
    if found or len(tiling) > max(MANY, n_targets):
        columns = ", ".join(found[:3] or columns[:5])
        warn(
            f"the {number_of(len(tiling), 'row')} of a table with the columns {columns} are taken as centers of tiles, "
            "one tile per row; if they are targets, give a list of tiles instead (see place_tiles or 'rfpsurvey tile')"
        )


def warn_of_programs(tiling: Tiling) -> None:
    """Warn if the tiles belong to several programs, such as DARK and BRIGHT of DESI, which the plan does not use."""
    name = next((name for name in tiling.table.colnames if name.lower() == "program"), None)
    found = [] if name is None else np.unique(to_labels(tiling.table[name], f"column {name!r}")).tolist()
    if len(found) > 1:
        warn(
            f"the tiles belong to {len(found)} programs ({name}: {listed(found)}), but every target can be observed on "
            "all tiles; to plan one program, select its tiles"
        )
