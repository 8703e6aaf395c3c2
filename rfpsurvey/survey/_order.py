"""The order in which tiles are planned: one after the other if they share targets, otherwise at the same time.

The tiles that can be planned at the same time form a *round*.
"""

import numpy as np

from rfpsurvey._kernels import zones
from rfpsurvey.catalog import SkyIndex, half_chord_squared

ORDERS = ("color", "given")


def make_rounds(vectors: np.ndarray, reach_rad: float, passes: np.ndarray, order: str) -> list[np.ndarray]:
    """Return, for each round, the rows of its tiles.

    The centers of two tiles of the same round are at least ``reach_rad`` apart. If the order is ``color``, the tiles of
    each pass are numbered such that tiles with the same number do not overlap, and each number is as small as possible.
    All tiles of a pass with the same number are planned in the same round. If the order is ``given``, the number of a
    tile, which is its round, is larger than the numbers of all overlapping tiles that are earlier in the list.
    """
    if len(vectors) == 0:
        return []
    index, by_color, round_of = SkyIndex(vectors), order == "color", np.empty(len(vectors), dtype=np.int64)
    circles = index.vectors, index.key, index.n_zones, index.order.astype(np.int64)
    limits, group = (reach_rad, half_chord_squared(reach_rad)), np.asarray(passes, dtype=np.int64)
    zones.number_circles(*circles, *limits, group, by_color, round_of)
    if by_color:
        round_of = np.unique(np.column_stack([passes, round_of]), axis=0, return_inverse=True)[1].reshape(-1)
    # tiles that are close on the sky are planned in succession, because they use the same partitions of the catalog
    along = index.order[np.argsort(round_of[index.order], kind="stable")]
    return np.split(along, np.cumsum(np.bincount(round_of))[:-1])
