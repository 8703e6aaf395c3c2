"""In which order tiles are planned: those that share targets one after the other, all others at the same time."""

import numpy as np

from rfpsurvey.catalog import SkyIndex

__all__ = ["ORDERS", "make_rounds"]


def _neighbors(index: SkyIndex, reach_rad: float) -> list[np.ndarray]:
    """Return the tiles near each tile, itself among them, ascending."""
    near = [np.sort(index.order[index.near(vector, reach_rad)]) for vector in index.vectors]
    return [near[k] for k in np.argsort(index.order)]


def _by_color(neighbors, passes):
    """Pass after pass; within a pass tiles of one color do not overlap, and colors take turns."""
    color = np.full(len(neighbors), -1)
    for tile, others in enumerate(neighbors):
        rivals = others[(others < tile) & (passes[others] == passes[tile])]
        taken = np.bincount(color[rivals], minlength=1)
        free = np.flatnonzero(taken == 0)
        color[tile] = free[0] if len(free) else len(taken)
    return np.unique(np.column_stack([passes, color]), axis=0, return_inverse=True)[1].reshape(-1)


def _as_given(neighbors, passes):
    """In the order of the list: a tile waits for those before it that overlap it."""
    level = np.zeros(len(neighbors), dtype=np.int64)
    for tile, others in enumerate(neighbors):
        level[tile] = level[others[others < tile]].max(initial=-1) + 1
    return level


ORDERS = {"color": _by_color, "given": _as_given}
"""Name to function from the neighbors of each tile and its pass to its round."""


def make_rounds(vectors: np.ndarray, reach_rad: float, passes: np.ndarray, order: str) -> list[np.ndarray]:
    """Return the tiles (rows) of each round; tiles of a round are farther apart than ``reach_rad``."""
    index = SkyIndex(vectors)
    round_of = ORDERS[order](_neighbors(index, reach_rad), passes)
    # neighbors on the sky follow each other, so that what was just read serves again
    along = index.order[np.argsort(round_of[index.order], kind="stable")]
    return np.split(along, np.cumsum(np.bincount(round_of))[:-1]) if len(vectors) else []
