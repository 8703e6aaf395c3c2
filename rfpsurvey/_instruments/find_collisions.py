"""Find the arms of one configuration that are closer than the minimum separation (static collisions)."""

import astropy.units as u
import numpy as np

from rfpsurvey._common.descriptions import describe_methods
from rfpsurvey._instruments.arms import (
    Arms,
    capsule_angles,
    check_arms,
    check_plane,
    check_tips,
    place_arms,
    pose_tips,
    to_columns,
    to_tips,
)
from rfpsurvey._instruments.collision_methods import DEFAULT_METHOD, METHODS, Configuration, Found, touches_exactly
from rfpsurvey._instruments.focal_plane import FocalPlane
from rfpsurvey._instruments.joints import to_sides
from rfpsurvey._instruments.motion import CollisionReport
from rfpsurvey._kernels import arms, collisions
from rfpsurvey.errors import InputError, check_choice, check_keywords, check_switch, check_whole

MOST_POINTS = 10_000
NO_GAPS = np.empty(0) << u.mm
NOTHING = Found(np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int64), np.empty(0), 0)


@check_keywords
@describe_methods(METHODS)
def find_collisions(
    focal_plane: FocalPlane,
    tips: object = None,
    *,
    theta: u.Quantity | None = None,
    phi: u.Quantity | None = None,
    handedness: str | np.ndarray | None = None,
    fiber_type: np.ndarray | None = None,
    parked_obstacles: bool = True,
    method: str = DEFAULT_METHOD,
    n_points: int = 65,
) -> CollisionReport:
    """Find the pairs of arms that are closer to each other than the minimum separation D.

    The arm model of the positioners (see `~rfpsurvey.Positioner`) states which part of an arm can collide. Two
    positioners collide if and only if the distance between these parts of their arms is strictly less than D; parts
    that cross have the distance 0. If D is 0, parts that touch or cross collide (method ``exact`` and ``cuda``). An arm
    collides with an obstacle if the distance from the arm to the edge of the obstacle is less than the clearance d of
    the arm.

    Parameters
    ----------
    focal_plane : FocalPlane
        The positioners.
    tips : Quantity, shape (n, 2), or Allocation, or Arms, optional
        Position of the fiber of each positioner, NaN for positioners without a target. An allocation also determines
        ``handedness``, ``fiber_type`` and ``parked_obstacles``. Poses that are already known can be given as ``Arms``.
    theta, phi : Quantity, shape (n,), optional
        Joint angles, instead of ``tips``; NaN for positioners without a target. The angles may exceed the joint limits.
    handedness : {"right", "left"} or array_like of str, shape (n,), optional
        Handedness of each arm; by default, the handedness of the positioner. This parameter must not be given with
        ``theta`` and ``phi``.
    fiber_type : array_like of str, shape (n,), optional
        Fiber type that each positioner uses; by default, the first type of the positioner. The fiber type matters if
        it determines the position of the fiber or the direction of the segment that can collide.
    parked_obstacles : bool, optional
        Whether positioners that have no target and arms of equal length are parked and count as obstacles. Positioners
        that have no target and arms of unequal length avoid all other arms and are ignored.
    method : str, optional
        Method that finds the pairs whose distance is smaller than the minimum separation D.
        {methods}
    n_points : int, optional
        Number of points on each arm (``sampled``), or number of poses of each arm on its path (``sweep``), from 2 to
        10,000.

    Returns
    -------
    CollisionReport
        Colliding pairs with their distances, flags of the positioners in collision, and collision rates.

    Raises
    ------
    InputError
        If a tip lies outside its patrol area or beyond the joint limits, if an allocation or arms belong to another
        focal plane, if arguments exclude each other, if the method cannot run on this computer, or if an array has a
        wrong shape.

    See Also
    --------
    rfpsurvey.collision.count_collisions : Count the collisions of many configurations.

    References
    ----------
    Chen et al. (2024), arXiv:2409.07288, "General Methods for Evaluating Collision Probability of Different Types of
    Theta-phi Positioners", Eq. 1, and Section 4.1 (sampled, sweep and scipy).

    Examples
    --------
    >>> import astropy.units as u
    >>> import rfpsurvey as rs
    >>> robot = rs.Positioner(8.25 * u.mm, 8.25 * u.mm, 2.25 * u.mm)
    >>> plane = rs.FocalPlane([[0, 0], [25.6, 0]] * u.mm, robot)
    >>> rs.find_collisions(plane, [[12, 0], [14, 0]] * u.mm)
    <CollisionReport: 1 pair of arms, 0 with obstacles, 2 of 2 positioners in collision>
    """
    chosen = METHODS[check_choice(method, METHODS, "collision method")]
    check_plane(focal_plane)
    if focal_plane.positioner.outline is not None and not chosen.supports_outlines:
        able = " or ".join(repr(name) for name, method in METHODS.items() if method.supports_outlines)
        raise InputError(f"the method for arms with an outline must be {able}, got {method!r}")
    check_whole(n_points, "n_points", 2, MOST_POINTS)
    given = {"theta": theta, "phi": phi, "handedness": handedness, "fiber_type": fiber_type}
    is_allocation = hasattr(tips, "target_of_positioner")
    if (is_allocation or isinstance(tips, Arms)) and any(value is not None for value in given.values()):
        raise InputError(f"an Allocation or Arms already determines the poses; do not give {', '.join(given)}")
    if is_allocation:
        given.update(handedness=tips.handedness, fiber_type=tips.fiber_type)
        parked_obstacles = tips.parked_obstacles
    check_switch(parked_obstacles, "parked_obstacles")
    if isinstance(tips, Arms):
        check_arms(focal_plane, tips)
    return collisions_of(focal_plane, *_posed_segments(focal_plane, tips, given, parked_obstacles), chosen, n_points)


def collisions_of(
    plane: FocalPlane, segments, assigned, parked, poses=None, method=METHODS[DEFAULT_METHOD], n_points=0
):
    """Find the collisions of arms that were placed for this focal plane; nothing is checked.

    ``segments`` contains the segments that can collide, in mm and with the shape (4, n); they are NaN for arms that are
    absent. ``assigned`` and ``parked`` are those of `Arms`. The function ``poses`` and the number ``n_points`` are used
    only by some methods.
    """
    n, nothing_can_touch = len(plane), len(plane.arrays.runs) == 0
    first, second, distances, n_borderline = (
        NOTHING if nothing_can_touch else method.function(Configuration(plane, segments, int(n_points), poses))
    )
    # a stable sort takes less time, because the pairs consist of sorted parts
    order, pairs = np.argsort(first * n + second, kind="stable"), np.empty((len(first), 2), dtype=np.int64)
    pairs[:, 0], pairs[:, 1] = first[order], second[order]
    hits, gaps, n_edge = touching(plane, segments, plane.arrays.obstacle_pairs)
    if n_borderline is not None:
        n_borderline += n_edge
    colliding = np.zeros(n, dtype=bool)
    colliding[first] = colliding[second] = colliding[hits[:, 0]] = True
    distances = distances[order] << u.mm
    gaps = gaps << u.mm if len(gaps) else NO_GAPS
    return CollisionReport(pairs, distances, hits, gaps, colliding, assigned, assigned | parked, n_borderline)


def _posed_segments(plane, tips, given, parked_obstacles):
    """Return segments that can collide (4, n), flags of assigned and parked arms, and a function that finds all poses.

    Only a few methods need all poses and call the returned function.
    """

    def poses():
        return place_arms(plane, tips, **given, parked_obstacles=parked_obstacles)

    if isinstance(tips, Arms) or tips is None or given["theta"] is not None or given["phi"] is not None:
        posed = tips if isinstance(tips, Arms) else poses()
        return np.ascontiguousarray(posed.segments.T), posed.assigned, posed.parked, lambda: posed
    columns = to_columns(plane, given["fiber_type"])
    points = to_tips(tips, len(plane))
    side = to_sides(columns, points, given["handedness"])
    if len(columns.runs) or len(columns.obstacle_pairs):
        segments, assigned, _ = pose_tips(columns, points, side, columns.idle(parked_obstacles))
        arms.shape(segments, columns.model, columns.length, *capsule_angles(columns, assigned))
    else:  # no arm can collide with another arm or with an obstacle
        segments, (assigned, _) = None, check_tips(columns, points, side)
    return segments, assigned, columns.idle(parked_obstacles).parked & ~assigned, poses


def obstacle_tests(pairs: np.ndarray, owner: np.ndarray) -> np.ndarray:
    """Return all pairs (arm, obstacle) that can collide, sorted by arm, shape (k, 2).

    ``pairs`` contains the pairs (positioner, obstacle) that can collide, sorted by positioner; ``owner`` is the
    positioner of each arm.
    """
    if len(pairs) == 0:
        return np.empty((0, 2), dtype=np.int64)
    first = np.searchsorted(pairs[:, 0], np.arange(owner.max(initial=-1) + 2))
    size = first[owner + 1] - first[owner]
    arm = np.repeat(np.arange(len(owner)), size)
    # place of each pair among the pairs of its arm
    offset = np.arange(len(arm)) - np.repeat(np.cumsum(size) - size, size)
    return np.column_stack([arm, pairs[np.repeat(first[owner], size) + offset, 1]])


def touching(plane, segments, pairs, owner=None):
    """Return the pairs (segment, obstacle) that collide, their distances, and the number of borderline pairs.

    ``owner`` contains the positioner of each segment; it is None if there is one segment for each positioner.
    """
    circles, clearance, limits = plane.arrays.obstacles, plane.arrays.clearance, plane.arrays.limits
    hits, distances = np.empty_like(pairs), np.empty(len(pairs))
    if len(pairs) == 0:
        return hits, distances, 0
    slack, owner = plane.arrays.obstacle_slack, np.arange(segments.shape[1]) if owner is None else owner
    n = collisions.colliding_obstacles(segments, owner, limits, pairs, circles, clearance, slack, hits, distances)
    hits, distances = hits[:n], distances[:n]
    radius = np.append(circles[:, 2], np.zeros(len(plane.arrays.obstacle_polygons)))[hits[:, 1]]
    # rounding could change the result for these pairs
    edge = np.flatnonzero(distances >= radius + clearance - slack)
    keep = np.ones(n, dtype=bool)
    for k in edge:
        i, j = hits[k]
        keep[k] = touches_exactly(plane.arrays, owner[i], segments[:, i].tolist(), j)
    return hits[keep], np.maximum(distances - radius, 0.0)[keep], len(edge)
