"""The order in which tiles are planned: one after the other if they share targets, otherwise at the same time.

The tiles that can be planned at the same time form a *round*.
"""

import numpy as np

from rfpsurvey._kernels import zones
from rfpsurvey.catalog import SkyIndex, half_chord_squared


def _number(index: SkyIndex, reach_rad: float, group: np.ndarray, *, smallest: bool) -> np.ndarray:
    """Return a number for each tile such that neighboring tiles have different numbers.

    Two tiles are neighbors if their centers are closer than ``reach_rad``. If ``smallest`` is true, neighbors must also
    have the same value in ``group`` (the pass), and each number is as small as possible. Otherwise, the number of a
    tile is larger than the numbers of all its neighbors in earlier rows.
    """
    number = np.empty(len(index), dtype=np.int64)
    zones.number_circles(
        index.vectors,
        index.key,
        index.n_zones,
        index.order.astype(np.int64),
        reach_rad,
        half_chord_squared(reach_rad),
        np.asarray(group, dtype=np.int64),
        smallest,
        number,
    )
    return number


def _by_color(index, reach_rad, passes):
    """Return the round of each tile.

    The tiles of each pass are numbered such that tiles with the same number do not overlap. All tiles of a pass with
    the same number are planned in the same round.
    """
    color = _number(index, reach_rad, passes, smallest=True)
    return np.unique(np.column_stack([passes, color]), axis=0, return_inverse=True)[1].reshape(-1)


def _as_given(index, reach_rad, passes):
    """Return the round of each tile; a tile is planned after all overlapping tiles that are earlier in the list."""
    return _number(index, reach_rad, passes, smallest=False)


ORDERS = {"color": _by_color, "given": _as_given}
"""Dict from the name of an order to the function that returns the round of each tile.

The arguments of these functions are the spatial index of the tiles, the largest distance (rad) between the
centers of overlapping tiles, and the pass of each tile.
"""


def make_rounds(vectors: np.ndarray, reach_rad: float, passes: np.ndarray, order: str) -> list[np.ndarray]:
    """Return, for each round, the rows of its tiles.

    The centers of two tiles of the same round are at least ``reach_rad`` apart.
    """
    if len(vectors) == 0:
        return []
    index = SkyIndex(vectors)
    round_of = ORDERS[order](index, reach_rad, passes)
    # tiles that are close on the sky are planned in succession, because they use the same partitions of the catalog
    along = index.order[np.argsort(round_of[index.order], kind="stable")]
    return np.split(along, np.cumsum(np.bincount(round_of))[:-1])
