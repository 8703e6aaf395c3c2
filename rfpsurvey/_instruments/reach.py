"""Find which positioners reach which targets within the joint limits, pairs of neighbors, and fractions of coverage.

The tests at the edges of patrol areas are exact.
"""

from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property

import numpy as np
import scipy  # its subpackages are imported on first use

from rfpsurvey._common.units import locked, to_generator, to_plain
from rfpsurvey._instruments.joints import edges_exactly
from rfpsurvey._kernels import arms as reach
from rfpsurvey.errors import InputError, check_whole

# Number of targets that are tested together. A small number limits the memory for temporary arrays.
BLOCK = 1 << 18


@dataclass(frozen=True, eq=False)
class Reach:
    """Pairs of targets and positioners within reach, as read-only arrays (CSR with one row per target).

    Parameters
    ----------
    indptr : ndarray of int, shape (n_targets + 1,)
        Index of the first pair of each target, followed by the total number of pairs.
    owner : ndarray of int, shape (n_pairs,)
        Row number of the positioner of each pair; the row numbers for one target are in ascending order.
    r2 : ndarray of float, shape (n_pairs,)
        Squared distance between target and center of the positioner, mm^2.
    n_positioners : int
        Number of positioners.

    Examples
    --------
    >>> import astropy.units as u
    >>> import numpy as np
    >>> import rfpsurvey as rs
    >>> robot = rs.Positioner(8.25 * u.mm, 8.25 * u.mm, 2.25 * u.mm)
    >>> plane = rs.FocalPlane([[0, 0], [25.6, 0]] * u.mm, robot)
    >>> pairs = plane.arrays.reach(np.array([[13.0, 0.0], [20.0, 10.0], [99.0, 0.0]]))
    >>> pairs.owner, pairs.target, pairs.covered
    (array([0, 1, 1]), array([0, 0, 1]), array([ True,  True, False]))
    """

    indptr: np.ndarray
    owner: np.ndarray
    r2: np.ndarray
    n_positioners: int

    def __post_init__(self):
        for name in ("indptr", "owner", "r2"):
            object.__setattr__(self, name, locked(getattr(self, name)))

    @cached_property
    def target(self) -> np.ndarray:
        """Row number of the target of each pair."""
        return locked(np.repeat(np.arange(len(self.indptr) - 1), np.diff(self.indptr)))

    @cached_property
    def covered(self) -> np.ndarray:
        """Whether at least one positioner reaches each target."""
        return locked(np.diff(self.indptr) > 0)

    @property
    def matrix(self) -> "scipy.sparse.csr_array":
        """The pairs as a sparse matrix with a row for each positioner and a column for each target."""
        indptr, target, _ = self.by_positioner
        if len(target) < 2**31:  # graph routines of older versions of SciPy accept 32-bit indices only
            indptr, target = indptr.astype(np.int32), target.astype(np.int32)
        data = np.ones(len(target), bool)
        return scipy.sparse.csr_array((data, target, indptr), shape=(self.n_positioners, len(self.indptr) - 1))

    def where(self, keep: np.ndarray) -> "Reach":
        """Return the pairs marked in ``keep``.

        Parameters
        ----------
        keep : ndarray of bool, shape (n_pairs,)
            Whether each pair is kept.

        Returns
        -------
        Reach
            The marked pairs.
        """
        n = int(np.count_nonzero(keep))
        indptr, owner, r2 = np.empty_like(self.indptr), np.empty(n, dtype=np.int64), np.empty(n)
        reach.take_pairs(self.indptr, self.owner, self.r2, keep, indptr, owner, r2)
        return Reach(indptr, owner, r2, self.n_positioners)

    @cached_property
    def by_positioner(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The pairs sorted by positioner, as the arrays indptr, target and r2 (CSR)."""
        indptr = np.empty(self.n_positioners + 1, dtype=np.int64)
        target, source = np.empty_like(self.owner), np.empty_like(self.owner)
        reach.transpose(self.indptr, self.owner, self.n_positioners, indptr, target, source)
        return locked(indptr), locked(target), locked(self.r2[source])


def make_grid(xy, outer):
    """Return a grid of square cells and the positioners that reach each cell: (x0, y0, size, nx, ny, start, order)."""
    reaches = outer * (1 + 1e-6)
    low, high = (xy - reaches[:, None]).min(axis=0), (xy + reaches[:, None]).max(axis=0)
    # limit the grid to a few cells per positioner, however far apart the positioners are
    size = max(outer.max(), np.sqrt(np.prod(high - low) / (16 * len(xy))), (high - low).max() / 4096)
    nx, ny = (int(n) for n in (high - low) // size + 1)
    # few cells and small integers, because the grid must be read from memory for each field
    grid = float(low[0]), float(low[1]), float(size), nx, ny, np.zeros(nx * ny + 1, dtype=np.int32)
    x, y = xy.T.copy()
    reach.fill_grid(x, y, reaches, *grid, np.empty(0, dtype=np.int32))
    order = np.empty(grid[-1][-1], dtype=np.int32)
    reach.fill_grid(x, y, reaches, *grid, order)
    return *grid, order


def accepted_types(plane, fiber_type, n) -> np.ndarray:
    """Return the bit mask of the fiber types that may observe each of ``n`` targets."""
    if fiber_type is None or plane.fiber_types == ("",):
        return np.broadcast_to(np.int64(-1), n)
    types = to_plain(fiber_type, "fiber_type").astype(str)
    if types.shape != (n,):
        raise InputError(f"fiber_type must have the shape ({n},), got {types.shape}")
    names, inverse = np.unique(types, return_inverse=True)
    unknown = [str(t) for t in names if t and t not in plane.fiber_types]
    if unknown:
        raise InputError(f"fiber_type must be one of {', '.join(plane.fiber_types)} or empty, got {', '.join(unknown)}")
    masks = [1 << plane.fiber_types.index(t) if t else -1 for t in names]
    return np.array(masks, dtype=np.int64)[inverse.reshape(-1)]


def find_reach(plane, points, accepts) -> Reach:
    """Return the pairs of targets at ``points`` (mm) and positioners in reach.

    The argument ``accepts`` is the bit mask of fiber types of each target, as `accepted_types` returns it.
    """
    kinds = np.unique(accepts) if plane.arrays.fibers is not None and len(points) else np.array([-1])
    parts = []
    for kind in kinds.tolist():
        # a target that requires no fiber type is observed with the first fiber of the positioner
        fiber = None if kind == -1 else np.full(len(plane), kind.bit_length() - 1)
        rows = np.flatnonzero(accepts == kind) if len(kinds) > 1 else slice(None)
        parts.append((rows, _find_pairs(plane.arrays.using(fiber), points[rows], accepts[rows])))
    return parts[0][1] if len(parts) == 1 else _merge(parts, len(points))


def _merge(parts, n) -> Reach:
    """Combine the reachable pairs of groups of targets; each item of ``parts`` is (rows of the targets, pairs)."""
    size = np.zeros(n, dtype=np.int64)
    for rows, pairs in parts:
        size[rows] = np.diff(pairs.indptr)
    indptr = np.concatenate([[0], np.cumsum(size)])
    owner, r2 = np.empty(indptr[-1], dtype=np.int64), np.empty(indptr[-1])
    for rows, pairs in parts:
        place = np.repeat(indptr[rows] - pairs.indptr[:-1], size[rows]) + np.arange(len(pairs.owner))
        owner[place], r2[place] = pairs.owner, pairs.r2
    return Reach(indptr, owner, r2, parts[0][1].n_positioners)


def _find_pairs(columns, points, accepts) -> Reach:
    """Return the reachable pairs of targets and positioners for the fiber types in use."""
    plane, positioners = columns.plane, (columns.annuli, columns.offers)
    indptr, n = np.zeros(len(points) + 1, dtype=np.int64), 0
    # If an array is too short for the pairs, a longer array is made and the search is repeated.
    *_, start, order = columns.grid
    expected = max(2.0, len(order) / (len(start) - 1))
    owner, r2 = (np.empty(int(expected * len(points)) + 1024, dtype) for dtype in (np.int64, np.float64))
    code, edges = np.empty(min(len(owner), int(expected * BLOCK)), dtype=np.int8), []
    for begin in range(0, len(points), BLOCK):
        x, y = points[begin : begin + BLOCK].T.copy()
        rows, types = indptr[begin : begin + len(x) + 1], np.ascontiguousarray(accepts[begin : begin + BLOCK])
        while True:
            size = min(len(owner) - n, len(code))
            out = owner[n : n + size], r2[n : n + size], code[:size]
            m = reach.reachable_pairs(x, y, types, *positioners, *columns.grid, rows, *out)
            if m <= size:
                break
            code = np.empty(m, dtype=np.int8)
            if n + m > len(owner):
                owner, r2 = (np.concatenate([values[:n], np.empty(m + n, values.dtype)]) for values in (owner, r2))
        edges.append(n + np.flatnonzero(code[:m] == reach.BORDERLINE))
        rows += n
        n += m
    pairs = Reach(indptr, owner[:n], r2[:n], len(plane))
    edge = np.concatenate([*edges, np.empty(0, dtype=np.int64)])
    if len(edge):
        keep = np.ones(n, dtype=bool)
        target = np.searchsorted(indptr, edge, side="right") - 1
        keep[edge] = [_in_annulus_exactly(columns, owner[k], points[t]) for k, t in zip(edge, target, strict=True)]
        pairs = pairs.where(keep)
    if not columns.poses_free:
        allowed, fiber = np.zeros(len(pairs.owner), dtype=bool), None
        # the arm model can depend on the fiber type, even if the patrol area does not
        if columns.fibers is None and len(plane.arrays.broken_pairs):
            kind = accepts[pairs.target]
            fiber = np.where(kind < 0, columns.first_index[pairs.owner], np.log2(np.maximum(kind, 1)).astype(int))
        for side in {"right": (1.0,), "left": (-1.0,), "both": (1.0, -1.0)}[plane.positioner.handedness]:
            allowed |= columns.poses_allowed(pairs.owner, points[pairs.target], side, fiber)
        pairs = pairs.where(allowed)
    return pairs


def elbow_names(side: np.ndarray) -> np.ndarray:
    """Return the handedness of arms as text: ``right`` for +1, ``left`` for -1."""
    return np.where(side < 0, "left", "right")


def _in_annulus_exactly(columns, i, point):
    """Return whether a point may be a target of positioner i, if joint limits allow; the test is exact."""
    r2 = sum((Fraction(a) - Fraction(b)) ** 2 for a, b in zip(point, columns.xy[i], strict=True))
    inner, outer = edges_exactly(columns, i)
    return inner**2 <= r2 <= outer**2


def pairs_within(xy: np.ndarray, limit: float) -> np.ndarray:
    """Return the pairs (i, j) of centers whose distance is at most ``limit``, with i < j, sorted."""
    x0, y0, size, nx, ny, start, order = make_grid(xy, np.full(len(xy), limit))
    column, row = np.floor((xy - (x0, y0)) / size).astype(np.int64).clip(0, (nx - 1, ny - 1)).T
    cell = row * nx + column
    n_near = np.diff(start)[cell]
    i = np.repeat(np.arange(len(xy)), n_near)
    j = order[np.arange(len(i)) + np.repeat(start[cell] - (np.cumsum(n_near) - n_near), n_near)]
    near = (i < j) & (((xy[i] - xy[j]) ** 2).sum(axis=1) <= limit**2)
    return np.column_stack([i[near], j[near]])


def nearest_within(xy: np.ndarray, limit: float) -> np.ndarray:
    """Return the distance from each center to the nearest other center; infinity if no center is within ``limit``."""
    pairs = pairs_within(xy, limit)
    distance = np.hypot(*(xy[pairs[:, 0]] - xy[pairs[:, 1]]).T)
    nearest = np.full(len(xy), np.inf)
    for rows in pairs.T:
        np.minimum.at(nearest, rows, distance)
    return nearest


class Neighbors:
    """Properties that `FocalPlaneArrays` inherits: the pairs of positioners whose arms may collide."""

    @cached_property
    def neighbors(self) -> np.ndarray:
        pairs = pairs_within(self.xy, 2 * self.arm_reach.max() + self.separation + self.touch_slack)
        return locked(pairs[self.can_touch(pairs, self.touch_slack)] if np.ptp(self.arm_reach) else pairs)

    def can_touch(self, pairs: np.ndarray, slack: float = 0.0) -> np.ndarray:
        """Return whether the arms of each pair can come closer than the minimum separation plus ``slack`` (mm)."""
        distance = np.hypot(*(self.xy[pairs[:, 0]] - self.xy[pairs[:, 1]]).T)
        return distance < self.arm_reach[pairs].sum(axis=1) + self.separation + slack

    @cached_property
    def n_sharing(self) -> np.ndarray:
        reach = self.largest_radius * (1 + 1e-6)
        pairs = pairs_within(self.xy, 2 * reach.max())
        distance = np.hypot(*(self.xy[pairs[:, 0]] - self.xy[pairs[:, 1]]).T)
        near = [column[distance <= reach[column] + reach.max()] for column in pairs.T]
        return locked(sum(np.bincount(rows, minlength=len(reach)) for rows in near))

    @cached_property
    def runs(self) -> np.ndarray:
        """Neighbors as sorted entries (i, j, n), each of which stands for n pairs: (i, j), (i + 1, j + 1), ...

        If positioners are numbered along the rows of a lattice, a few entries (i, j, n) represent thousands of pairs.
        """
        pairs = self.neighbors
        if len(pairs) == 0:
            return np.empty((0, 3), dtype=np.int64)
        pairs = pairs[np.lexsort((pairs[:, 0], pairs[:, 1] - pairs[:, 0]))]
        first = np.append(True, (np.diff(pairs, axis=0) != 1).any(axis=1))
        rows = np.flatnonzero(first)
        runs = np.column_stack([pairs[rows], np.diff(np.append(rows, len(pairs)))])
        return runs[np.lexsort((runs[:, 1], runs[:, 0]))]

    @cached_property
    def both_ways(self) -> tuple[np.ndarray, np.ndarray]:
        """All neighbors of each positioner in compressed rows (CSR): the start of each row, and the neighbors.

        The array of neighbors is never empty, because arrays on a GPU must not be empty.
        """
        pairs = np.vstack([self.neighbors, self.neighbors[:, ::-1]])
        pairs = pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))]
        return np.searchsorted(pairs[:, 0], np.arange(len(self.plane) + 1)), np.append(pairs[:, 1], 0)


def footprint_of(plane) -> "scipy.spatial.ConvexHull":
    """Return the footprint of a focal plane in mm, the convex hull of the centers of the positioners."""
    try:
        return scipy.spatial.ConvexHull(plane.arrays.xy)
    except (scipy.spatial.QhullError, ValueError):
        raise InputError(
            f"the footprint must have at least three centers that are not on a line, got {len(plane)} centers"
        ) from None


def on_footprint(plane, points: np.ndarray) -> np.ndarray:
    """Return whether points (mm) are inside the footprint; points with NaN are outside."""
    hull = footprint_of(plane)
    inside = np.isfinite(points).all(axis=1)
    inside[inside] = scipy.spatial.Delaunay(hull.points[hull.vertices]).find_simplex(points[inside]) >= 0
    return inside


def find_coverage(plane, n_points, rng) -> np.ndarray:
    """Return the fractions of the footprint that exactly 0, 1, 2, ... positioners reach.

    One random point is drawn in each cell of a square grid. If the points were on a regular grid, the result would
    depend on the alignment of the grid with the lattice of the positioners.
    """
    check_whole(n_points, "n_points", 1, 2**26)
    hull = footprint_of(plane)
    corners = hull.points[hull.vertices]
    n = int(np.ceil(np.sqrt(n_points)))
    cells = np.stack(np.meshgrid(np.arange(n), np.arange(n)), axis=-1).reshape(-1, 2)
    points = corners.min(axis=0) + (cells + to_generator(rng).random((n * n, 2))) / n * np.ptp(corners, axis=0)
    inside = points[on_footprint(plane, points)]
    if len(inside) == 0:
        raise InputError(f"n_points must be so large that at least one point is in the footprint, got {n_points}")
    return np.bincount(np.diff(plane.arrays.reach(inside).indptr)) / len(inside)
