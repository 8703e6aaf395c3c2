"""What the kernels of simulation and quadrature read, and the memory that they write to."""

import numpy as np

from rfpsurvey._kernels import arms, batch, queues, simulate
from rfpsurvey.focal_plane import FocalPlane

__all__ = ["make_array", "make_hall", "make_room"]


def make_array(plane: FocalPlane, stage: batch.Stage) -> simulate.Array:
    """Return what reach and poses depend on, for joints that leave the whole patrol areas in reach."""
    idle = stage.idle.copy()
    arms.shape(idle, stage.model, stage.length, stage.cosine, stage.sine)
    side = plane.arrays.sides(np.full((len(plane), 2), np.nan))
    columns = (plane.arrays.inner_radius, plane.arrays.outer_radius, plane.arrays.offers)
    return simulate.Array(plane.arrays.geometry, side, *columns, plane.arrays.grid, idle)


def make_room(plane: FocalPlane, number: int, cells: int) -> simulate.Room:
    """Return room for so many targets, and for the cells of the grid that keeps them apart."""
    n, pairs = len(plane), number * int(np.diff(plane.arrays.grid[5]).max())

    def integers(size):
        return np.empty(size, dtype=np.int64)

    return simulate.Room(
        x=np.empty(number),
        y=np.empty(number),
        accepts=np.full(number, -1),
        indptr=integers(number + 1),
        owner=integers(pairs),
        r2=np.empty(pairs),
        code=integers(pairs),
        owner_of=integers(number),
        length=integers(n),
        queues=integers(n + 1),
        queue=integers(number),
        uniform=np.empty(n),
        target_of=integers(n),
        tips=np.empty((n, 2)),
        cells=np.empty((2, cells)),
    )


def make_hall(n: int, number: int) -> queues.Hall:
    """Return room for so many entries in the queues of n positioners, all of weight 1."""
    size, buffer = number + n, number + n + queues.BATCH + 1
    return queues.Hall(
        start=np.empty(n, dtype=np.int64),
        stop=np.empty(n, dtype=np.int64),
        segments=np.empty((4, size)),
        halves=np.empty((4, size)),
        weight=np.ones(size),
        total=np.empty(n),
        free=np.empty(size),
        hit=np.zeros(size),
        ahead=np.empty(size),
        near=np.empty(size, dtype=np.int64),
        marks=np.empty(size, dtype=np.bool_),
        middle_x=np.empty(size),
        middle_y=np.empty(size),
        back=np.empty(size),
        first=np.empty(buffer, dtype=np.int64),
        second=np.empty(buffer, dtype=np.int64),
    )
