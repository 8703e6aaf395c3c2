"""Count the collisions of many configurations of one focal plane."""

from concurrent.futures import Executor
from dataclasses import dataclass
from functools import partial

import astropy.units as u
import numpy as np

from rfpsurvey._common.executors import map_in_order
from rfpsurvey._common.units import to_mm, to_spawner
from rfpsurvey._instruments.arms import check_plane, check_tips, joints_free, to_columns
from rfpsurvey._instruments.collision_methods import DEFAULT_METHOD, METHODS
from rfpsurvey._instruments.focal_plane import FocalPlane
from rfpsurvey._instruments.joints import to_sides
from rfpsurvey._kernels import arms, batch
from rfpsurvey._kernels.allocation import draw_places
from rfpsurvey.errors import InputError, check_choice, check_keywords, check_whole, number_of


@dataclass(frozen=True, eq=False)
class CollisionCounts:
    """Numbers of static collisions in each of m configurations.

    Parameters
    ----------
    n_pairs, n_obstacle_pairs : ndarray of int, shape (m,)
        Number of colliding pairs of two positioners, and number of colliding pairs of a positioner and an obstacle.
    n_in_collision, n_in_collision_assigned : ndarray of int, shape (m,)
        Number of counted positioners (see ``n_counted``) in collision, and number of assigned positioners in collision.
    n_counted, n_assigned : ndarray of int, shape (m,)
        Number of counted positioners (assigned positioners, and parked positioners with equal arms), and number of
        assigned positioners.
    n_borderline : ndarray of int, shape (m,)
        Number of pairs of arms whose distance is so close to the minimum separation that rounding errors could change
        the result. The computed distance determines whether such a pair is counted as a collision.
    per_positioner : ndarray of int, shape (n,)
        Number of configurations in which each positioner is in collision.

    Examples
    --------
    >>> import astropy.units as u
    >>> import rfpsurvey as rs
    >>> robot = rs.Positioner(8.25 * u.mm, 8.25 * u.mm, 2.25 * u.mm)
    >>> plane = rs.FocalPlane([[0, 0], [25.6, 0]] * u.mm, robot)
    >>> counts = rs.collision.count_collisions(plane, [[[12, 0], [14, 0]], [[-12, 0], [40, 0]]] * u.mm)
    >>> counts.rate, counts.per_positioner
    (array([1., 0.]), array([1, 1]))
    """

    n_pairs: np.ndarray
    n_obstacle_pairs: np.ndarray
    n_in_collision: np.ndarray
    n_in_collision_assigned: np.ndarray
    n_counted: np.ndarray
    n_assigned: np.ndarray
    n_borderline: np.ndarray
    per_positioner: np.ndarray

    @property
    def rate(self) -> np.ndarray:
        """Fraction of the counted positioners in collision, for each configuration; NaN if no positioner is counted."""
        return _ratio(self.n_in_collision, self.n_counted)

    @property
    def rate_assigned(self) -> np.ndarray:
        """Fraction of assigned positioners in collision, for each configuration; NaN if no positioner is assigned."""
        return _ratio(self.n_in_collision_assigned, self.n_assigned)

    def __len__(self):
        return len(self.n_pairs)

    def __repr__(self):
        return (
            f"<CollisionCounts: {number_of(len(self), 'configuration')}, {number_of(int(self.n_pairs.sum()), 'pair')}>"
        )


@check_keywords
def count_collisions(
    focal_plane: FocalPlane,
    tips: object,
    *,
    n_configurations: int | None = None,
    handedness: str | np.ndarray | None = None,
    fiber_type: np.ndarray | None = None,
    parked_obstacles: bool = True,
    method: str = DEFAULT_METHOD,
    executor: Executor | None = None,
    rng: int | np.random.Generator | None = 0,
) -> CollisionCounts:
    """Count the collisions of many configurations of one focal plane.

    The counts are the same as the counts of `~rfpsurvey.find_collisions`, but compiled code processes all
    configurations in one call. In addition to the input and the counts, the function uses memory for a few
    configurations only.

    Parameters
    ----------
    focal_plane : FocalPlane
        The positioners.
    tips : Quantity, shape (m, n, 2), or Allocation
        Positions of the fibers in each of m configurations, NaN for positioners without a target. An allocation
        by ``balanced`` contains a queue of targets for each positioner; each configuration then contains one random
        target of each queue.
    n_configurations : int, optional
        Number of configurations to draw from an allocation.
    handedness : {"right", "left"} or array_like of str, shape (n,), optional
        Handedness of each arm in all configurations; by default, the handedness of the positioner.
    fiber_type : array_like of str, shape (n,), optional
        Fiber type that each positioner uses in all configurations, as in `~rfpsurvey.find_collisions`.
    parked_obstacles : bool, optional
        Whether parked positioners count as obstacles, as in `~rfpsurvey.find_collisions`.
    method : {"exact", "cuda"}, optional
        ``exact`` runs on the CPU, and ``cuda`` on a GPU (requires ``rfpsurvey[cuda]``).
    executor : concurrent.futures.Executor, optional
        Executor that processes chunks of configurations. The compiled code releases the GIL, so threads run in
        parallel. With None, chunks are processed one after the other.
    rng : int, Generator or None, optional
        Seed or generator of the random draws, which do not depend on the executor.

    Returns
    -------
    CollisionCounts
        Counts for each configuration and for each positioner.

    Raises
    ------
    InputError
        If a tip is outside its patrol area or beyond the joint limits, if the allocation is for another focal plane or
        has no queues, if arguments that exclude each other are given, if the method cannot run on this computer, or if
        an array has a wrong shape.

    See Also
    --------
    rfpsurvey.find_collisions : Find the colliding pairs of one configuration, with their distances.

    Examples
    --------
    >>> import astropy.units as u
    >>> import numpy as np
    >>> import rfpsurvey as rs
    >>> robot = rs.Positioner(8.25 * u.mm, 8.25 * u.mm, 2.25 * u.mm)
    >>> plane = rs.FocalPlane([[0, 0], [25.6, 0]] * u.mm, robot)
    >>> rs.collision.count_collisions(plane, [[[12, 0], [14, 0]], [[-12, 0], [40, 0]]] * u.mm).n_pairs
    array([1, 0])
    """
    check_plane(focal_plane)
    able = [name for name, method in METHODS.items() if method.chunk]
    chosen = METHODS[check_choice(method, able, "method of counting collisions")]
    if hasattr(tips, "target_of_positioner"):
        if not (handedness is fiber_type is None):
            raise InputError("handedness and fiber_type must be None for an Allocation, which determines the poses")
        score, chunks = _of_draws(focal_plane, tips, n_configurations, chosen, rng)
    else:
        if n_configurations is not None:
            raise InputError(
                "n_configurations can be given only with an Allocation; tips have one configuration in each row"
            )
        score, chunks = _of_tips(focal_plane, tips, handedness, fiber_type, parked_obstacles, chosen)
    parts, times = [np.empty((0, batch.N_COUNTS), dtype=np.int64)], np.zeros(len(focal_plane), dtype=np.int64)
    for part, hits in map_in_order(executor, score, *chunks):
        parts.append(part)
        times += hits
    return CollisionCounts(*np.concatenate(parts).T, times)


def _of_tips(plane, tips, handedness, fiber_type, parked_obstacles, method):
    """Return a function that counts the collisions of given configurations, and the arguments of its calls."""
    shape = getattr(tips, "shape", ())
    if not isinstance(tips, u.Quantity) or len(shape) != 3 or shape[1:] != (len(plane), 2):
        kind = f"the shape {shape}" if isinstance(tips, u.Quantity) else type(tips).__name__
        raise InputError(f"tips must be an Allocation or a Quantity of shape (m, {len(plane)}, 2), got {kind}")
    columns = to_columns(plane, fiber_type)
    setup = make_setup(columns, parked_obstacles)
    side = None
    if handedness is not None or columns.joints_free:
        side = to_sides(columns, np.full((len(plane), 2), np.nan), handedness)[None, :]
    scorer = _device_scorer(columns, setup) if method.device == "GPU" else partial(count_tips, columns, setup)
    starts = range(0, len(tips), method.chunk)
    return partial(_score_tips, columns, side, scorer), ((tips[k : k + method.chunk] for k in starts), starts)


def _score_tips(columns, side, scorer, tips, start):
    """Return the counts of each configuration of a chunk, and the number of collisions of each positioner.

    ``side`` contains the sides of the elbows (+1 or -1), as a single row; None if they depend on the joint limits.
    ``start`` is the number of the first configuration.
    """
    points = to_mm(tips, "tips")
    is_free = side is not None and joints_free(columns, side)
    if not is_free:
        side = np.array([columns.sides(row) if side is None else side[0] for row in points])
    counts, times, far = scorer(points, side)
    # compiled code only counts the tips out of reach; the message names the first of them
    for c, row in enumerate(points if far or not is_free else ()):
        try:
            check_tips(columns, row, side[min(c, len(side) - 1)])
        except InputError as error:
            raise InputError(f"configuration {start + c}: {error}") from None
    return counts, times


def count_tips(columns, setup: batch.CollisionSetup, points: np.ndarray, side: np.ndarray) -> tuple:
    """Return the counts of each configuration of a chunk, and sums over the configurations.

    ``points`` are the positions of the tips (mm), and ``side`` contains the sides of the elbows (+1 or -1). The sums
    are the number of configurations in which each positioner is in collision, and the number of tips out of reach.
    """
    plane, bounds = columns.plane, columns.bounds
    counts, times = np.empty((len(points), batch.N_COUNTS), dtype=np.int64), np.zeros(len(plane), dtype=np.int64)
    if columns.joints is not None:  # an elbow on the other side has other joint limits
        usual = -1.0 if plane.positioner.handedness == "left" else 1.0
        bounds = columns.bounds_of(None, None, np.where((side == usual).all(axis=0), usual, -usual))
    far = batch.count_tips(points, columns.geometry, bounds, side, setup, _workspace(plane), counts, times)
    return counts, times, far


def count_poses(plane, setup: batch.CollisionSetup, chosen: np.ndarray, segments, idle, times, slack=0.0) -> np.ndarray:
    """Return the counts of each configuration, and add the collisions of each positioner to ``times``.

    ``chosen`` contains the index in ``segments`` of the pose of each positioner, shape (m, n), or -1 for positioners
    whose arms are those in ``idle``. The shape of ``times`` is (1, n) for sums over the configurations, or (m, n).
    Distances from obstacles are uncertain by ``slack`` (mm).
    """
    counts = np.empty((len(chosen), batch.N_COUNTS), dtype=np.int64)
    batch.count_poses(chosen, segments, idle, setup, slack, _workspace(plane), counts, times)
    return counts


def _device_scorer(columns, setup):
    """Return a function that does the same as `count_tips` on a GPU."""
    if columns.plane.positioner.outline is not None or columns.obstacle_polygons:
        raise InputError("the method must be 'exact' if arms have outlines or obstacles are polygons, got 'cuda'")
    from rfpsurvey._instruments import gpu as _gpu

    return _gpu.make_scorer(columns, setup)


def _of_draws(plane, allocation, n_configurations, method, rng):
    """Return a function that draws configurations and counts their collisions, and the arguments of its calls."""
    if allocation.queues is None:
        raise InputError(
            "configurations can be drawn only from an allocation with queues, such as those by 'balanced', got an "
            f"allocation by {allocation.allocator!r}"
        )
    if len(allocation.target_of_positioner) != len(plane):
        raise InputError(
            f"the allocation must be for the {len(plane)} positioners of the focal plane, got "
            f"{len(allocation.target_of_positioner)} positioners"
        )
    n = n_configurations
    check_whole(n, "n_configurations", 0)
    if method.device == "GPU":
        raise InputError(f"the method must be 'exact' if configurations are drawn from queues, got {method.name!r}")
    indptr, entries = queue_segments(plane, allocation)
    setup = make_setup(plane.arrays, allocation.parked_obstacles)
    sizes = [min(method.chunk, n - k) for k in range(0, n, method.chunk)]
    idle = plane.arrays.idle_segments(allocation.parked_obstacles)
    return partial(_score_draws, plane, setup, idle, indptr, entries), (sizes, to_spawner(rng).spawn(len(sizes)))


def _score_draws(plane, setup, idle, indptr, entries, size, rng):
    times = np.zeros((1, len(plane)), dtype=np.int64)
    return count_poses(plane, setup, draw_poses(indptr, rng, size), entries, idle, times), times[0]


def draw_poses(indptr: np.ndarray, rng: np.random.Generator, size: int) -> np.ndarray:
    """Draw configurations with one random pose of each queue: its index, or -1 if the queue is empty.

    ``indptr`` contains the index of the first pose of each queue.
    """
    chosen = np.empty((size, len(indptr) - 1), dtype=np.int64)
    draw_places(indptr, rng.random(chosen.shape), chosen)
    return chosen


def queue_segments(plane, allocation):
    """Return the index of the first target of each queue, and a segment for each of all m targets, shape (4, m).

    The segment is the segment of the arm that can collide if the positioner of the queue observes the target.
    """
    indptr, target = allocation.queues
    owner = np.repeat(np.arange(len(plane)), np.diff(indptr))
    points = allocation.xy_mm[target]
    columns, fiber = plane.arrays, plane.arrays.first_index[owner]
    if allocation.target_fiber_type is not None:
        fiber = columns.index_of(allocation.target_fiber_type[target], owner)
    far = np.empty(len(owner), dtype=bool)
    geometry, bounds = columns.geometry_of(owner, fiber), columns.bounds_of(owner, fiber)
    if arms.check(points, geometry, bounds, np.empty_like(far), far):
        raise InputError(f"the allocation is for another focal plane: {int(far.sum())} of its targets are out of reach")
    return indptr, columns.segments_of(owner, fiber, points)


def make_setup(columns, parked_obstacles) -> batch.CollisionSetup:
    """Return the collision data that are the same for all configurations, from the arrays of a focal plane."""
    idle = columns.idle(parked_obstacles)
    segments = idle.segments
    if columns.fibers is not None and columns.model == arms.CAPSULE:
        segments = _turned(segments, columns.plane.arrays.angles, columns.angles)
    return batch.CollisionSetup(
        columns.runs,
        columns.limits,
        columns.model,
        columns.length,
        *columns.angles,
        segments,
        idle.parked,
        columns.obstacle_pairs,
        columns.obstacles,
        columns.clearance,
    )


def _turned(segments, first, used):
    """Rotate the capsules of idle arms, so that their angles refer to the fibers in use instead of the first fibers."""
    (c, s), (used_c, used_s) = first, used
    x, y = segments[2:] - segments[:2]
    x, y = c * x - s * y, s * x + c * y
    return np.vstack([segments[:2], segments[0] + used_c * x + used_s * y, segments[1] + used_c * y - used_s * x])


def _workspace(plane):
    """Return the work arrays for counting the collisions of one configuration."""
    n, size = len(plane), len(plane.arrays.neighbors)
    flags = (np.zeros(n, dtype=np.bool_) for _ in range(3))
    pairs = np.empty(size, dtype=np.int64), np.empty(size, dtype=np.int64), np.empty(size)
    return batch.Workspace(np.empty((4, n)), np.empty((4, n)), *flags, *pairs)


def _ratio(part, whole):
    with np.errstate(invalid="ignore"):
        return part / whole
