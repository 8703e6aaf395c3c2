"""Tiles that events add or move."""

from collections.abc import Collection

import astropy.units as u
import numpy as np
from astropy.table import vstack

from rfpsurvey.survey._history._events import DROPPED, TileEvent
from rfpsurvey.tiling import Tiling


def add_tiles(tiling: Tiling, added: dict[int, TileEvent], dropped: Collection[int]) -> Tiling:
    """Return a tiling with the tiles that events added or moved; ``added`` contains the event of each row.

    Another tile can have the position of a tile in one of the rows ``dropped``.
    """
    table, names = tiling.table.copy(), np.asarray(tiling.table["tile"])
    for row, event in sorted(added.items()):
        ra, dec, angle, number = event.place
        values = {"ra": ra * u.deg, "dec": dec * u.deg, "position_angle": angle * u.deg, "pass": number}
        if row < len(table):
            for name, value in values.items():
                table[name][row] = value
            continue
        one = table[:1].copy()
        one.replace_column("tile", np.array([event.tile if names.dtype.kind == "U" else int(event.tile)]))
        for name, value in values.items():
            one[name] = value
        table = vstack([table, one], metadata_conflicts="silent")
    table.meta.pop("summary", None)
    table["state"] = np.where(np.isin(np.arange(len(table)), [*dropped]), DROPPED, "")
    return Tiling(table)
