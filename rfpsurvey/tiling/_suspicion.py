"""A warning for tables of targets that are given instead of tables of tiles."""

import re

from rfpsurvey.errors import number_of, warn

__all__ = ["warn_of_targets"]

OF_TILES = re.compile(
    r".*(tile|plate|field|center|racen|ra_cen|dece?cen|dec_cen|pass|layer|pos_?ang|position_?angle).*|pa|program"
)
OF_TARGETS = re.compile(
    r"(.*_)?(mag|magnitude)s?|.*[a-z0-9]_?mag|mag_.*|(e_)?pm(_?(ra|de).*)?|parallax|plx"
    r"|(source|target|obj|object|gaia|tyc|tycho)\d?_?(id|source_id)|kind|fiber_?type"
)
MANY = 1000


def warn_of_targets(table, n_targets: int) -> None:
    """Warn if a table of tiles seems to be a table of targets; ``n_targets`` is the number of targets of the survey.

    There is no warning if the table has a column that occurs only in lists of tiles. Otherwise there is a warning if
    the table has a column that is typical of targets, such as a magnitude, or if it has more than ``MANY`` rows and
    more rows than the survey has targets.
    """
    names = [name.lower() for name in table.colnames]
    if any(map(OF_TILES.fullmatch, names)):
        return
    found = [name for name in table.colnames if OF_TARGETS.fullmatch(name.lower())]
    if found or len(table) > max(MANY, n_targets):
        columns = ", ".join(found[:3] or table.colnames[:5])
        warn(
            f"the {number_of(len(table), 'row')} of a table with the columns {columns} are taken as centers of tiles, "
            "one tile per row; if they are targets, give a list of tiles instead (see place_tiles or 'rfpsurvey tile')"
        )
