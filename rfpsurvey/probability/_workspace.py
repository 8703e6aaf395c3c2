"""Input arrays and output arrays of the kernels for simulation and quadrature."""

import numpy as np

from rfpsurvey._kernels import arms, batch, queues, simulate
from rfpsurvey.focal_plane import FocalPlane


def make_positioners(plane: FocalPlane, setup: batch.CollisionSetup) -> simulate.Positioners:
    """Return the data that determine which targets each positioner reaches, and which poses its arms have.

    Kernels that draw targets assume that joint limits do not restrict the patrol areas.
    """
    idle = setup.idle.copy()
    arms.shape(idle, setup.model, setup.length, setup.cosine, setup.sine)
    side = plane.arrays.sides(np.full((len(plane), 2), np.nan))
    columns = (plane.arrays.annuli, plane.arrays.offers)
    return simulate.Positioners(plane.arrays.geometry, side, *columns, plane.arrays.grid, idle)


def make_realization(plane: FocalPlane, number: int, cells: int) -> simulate.Realization:
    """Return the arrays to which kernels write one realization of at most ``number`` targets.

    ``cells`` is the number of cells of the grid that `scatter_apart` uses.
    """
    n, pairs = len(plane), number * int(np.diff(plane.arrays.grid[5]).max())

    def integers(size):
        return np.empty(size, dtype=np.int64)

    return simulate.Realization(
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
        cells=np.empty((2, cells)),
    )


def make_entries(n: int, number: int) -> queues.Entries:
    """Return arrays for the queues of n positioners with ``number`` targets in total; each target has the weight 1."""
    size = number + n
    return queues.Entries(
        start=np.empty(n, dtype=np.int64),
        stop=np.empty(n, dtype=np.int64),
        segments=np.empty((4, size)),
        halves=np.empty((4, size)),
        weight=np.ones(size),
        total=np.empty(n),
        free=np.empty(size),
        hit=np.zeros(size),
        ahead=np.empty(size),
    )


def make_expected(n: int, n_pairs: int) -> queues.Expected:
    """Return arrays for the probabilities of n positioners and of their pairs; the values of realizations are 0."""
    return queues.Expected(np.empty(n), np.empty(n_pairs), np.zeros(n), np.zeros(n, dtype=np.int64))
