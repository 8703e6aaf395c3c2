"""The one door of target allocation."""

from dataclasses import dataclass
from time import perf_counter

import astropy.units as u
import numpy as np

from rfpsurvey._units import to_generator, to_plain, to_points_mm
from rfpsurvey.allocation._rules import balanced, lamost
from rfpsurvey.collision import Arms, place_arms
from rfpsurvey.errors import InputError, check_choice
from rfpsurvey.focal_plane import FocalPlane

__all__ = ["METHODS", "Allocation", "allocate"]

METHODS = {"balanced": balanced, "lamost": lamost}
"""Name to function (reach, priority classes, rng) -> (target_of_positioner, queues or None)."""


@dataclass(frozen=True, eq=False)
class Allocation:
    """Which positioner observes which target.

    Parameters
    ----------
    method : str
        The rule that made it.
    target_of_positioner : ndarray of int, shape (n_positioners,)
        Target of each positioner, -1 for none.
    positioner_of_target : ndarray of int, shape (n_targets,)
        Positioner of each target, -1 for none.
    handedness : ndarray of str, shape (n_positioners,)
        Elbow of each arm, "right" or "left".
    tips : Quantity, shape (n_positioners, 2)
        Where each fiber is; NaN without a target.
    fiber_type : ndarray of str, shape (n_positioners,)
        Fiber in use.
    n_reachable : int
        Targets that at least one positioner reaches.
    parked_obstacles : bool
        Do idle equal-arm positioners count as obstacles?
    seconds : dict of str to float
        Time of each stage.
    xy : Quantity, shape (n_targets, 2)
        The targets on the focal plane.
    wanted : ndarray of str, shape (n_targets,), or None
        Fiber type that each target needs, ``""`` for any.
    queues : tuple of ndarray or None
        For ``balanced``: indptr and targets of all queues, of which the configuration is one draw.
    """

    method: str
    target_of_positioner: np.ndarray
    positioner_of_target: np.ndarray
    handedness: np.ndarray
    tips: u.Quantity
    fiber_type: np.ndarray
    n_reachable: int
    parked_obstacles: bool
    seconds: dict
    xy: u.Quantity
    wanted: np.ndarray | None = None
    queues: tuple[np.ndarray, np.ndarray] | None = None

    @property
    def n_assigned(self) -> int:
        """Number of positioners with a target."""
        return int(np.count_nonzero(self.target_of_positioner >= 0))

    def place_arms(self, focal_plane: FocalPlane) -> Arms:
        """Return the poses that go with the allocation.

        Parameters
        ----------
        focal_plane : FocalPlane
            The focal plane that it was made for.

        Returns
        -------
        Arms
            Poses of all positioners.
        """
        return place_arms(
            focal_plane, self.tips, handedness=self.handedness, fiber_type=self.fiber_type,
            parked_obstacles=self.parked_obstacles,
        )  # fmt: skip

    def __repr__(self):
        n, m = len(self.target_of_positioner), len(self.positioner_of_target)
        return f"<Allocation by {self.method!r}: {self.n_assigned} of {n} positioners, {m} targets>"


def allocate(
    xy: u.Quantity,
    focal_plane: FocalPlane,
    *,
    method: str = "balanced",
    priority: np.ndarray | None = None,
    fiber_type: np.ndarray | None = None,
    parked_obstacles: bool = True,
    rng: int | np.random.Generator | None = 0,
) -> Allocation:
    """Assign targets to positioners: one target a positioner, one positioner a target.

    Parameters
    ----------
    xy : Quantity, shape (n_targets, 2)
        Targets on the focal plane, in catalog order; NaN is out of reach.
    focal_plane : FocalPlane
        The positioners.
    method : {"balanced", "lamost"}, optional
        ``balanced``: targets in catalog order, each to the positioner in reach with the shortest queue, then the
        nearest, then the lowest row; one target of each queue, drawn uniformly, is observed.
        ``lamost``: class after class from the top priority, every free positioner nominates its nearest
        unassigned target of the class until nobody nominates; a target nominated by several goes to the
        one with the fewest unassigned targets (of any class) in reach, then the nearest, then the lowest row.
    priority : array_like of float, shape (n_targets,), optional
        Larger is more important; targets of one value form a class. ``balanced`` does not look at it.
    fiber_type : array_like of str, shape (n_targets,), optional
        Fiber type that each target needs; ``""`` means any.
    parked_obstacles : bool, optional
        Carried along for the scoring of collisions.
    rng : int, Generator or None, optional
        Seed or source of the draw of ``balanced``; None draws anew each time.

    Returns
    -------
    Allocation
        The same input gives the same allocation.

    Raises
    ------
    InputError
        If the method is unknown or a shape does not fit.

    References
    ----------
    Chen et al., "General Methods for Evaluating Collision Probability of Different Types of Theta-phi
    Positioners", Section 4.2 (both rules).

    Examples
    --------
    >>> import astropy.units as u
    >>> import rfpsurvey as rs
    >>> robot = rs.Positioner(8.25 * u.mm, 8.25 * u.mm, 2.25 * u.mm)
    >>> plane = rs.FocalPlane([[0, 0], [25.6, 0]] * u.mm, robot)
    >>> rs.allocate([[12, 0], [14, 0], [99, 0]] * u.mm, plane, method="lamost").target_of_positioner
    array([0, 1])
    """
    rule = METHODS[check_choice(method, METHODS, "allocator")]
    points = to_points_mm(xy, "xy")
    classes = _classes(priority, len(points))
    start = perf_counter()
    reach = focal_plane._reach(points, fiber_type)
    middle = perf_counter()
    target_of, queues = rule(reach, classes, to_generator(rng))
    tips, hand, types = _at_tips(focal_plane, points, target_of, fiber_type)
    positioner_of = np.full(len(points), -1)
    used = np.flatnonzero(target_of >= 0)
    positioner_of[target_of[used]] = used
    wanted = None if fiber_type is None or focal_plane.fiber_types == ("",) else np.asarray(fiber_type, dtype=str)
    seconds = {"reach": middle - start, "allocation": perf_counter() - middle}
    return Allocation(
        method, target_of, positioner_of, hand, tips * u.mm, types, reach.n_reachable, parked_obstacles,
        seconds, points << u.mm, wanted, queues,
    )  # fmt: skip


def _classes(priority, n):
    """Rank of the priority class of each target, 0 the most important."""
    if priority is None:
        return np.zeros(n, dtype=np.int64)
    try:
        values = to_plain(priority).astype(float)
    except ValueError as error:
        raise InputError(f"priority must be numbers: {error}") from None
    if values.shape != (n,):
        raise InputError(f"priority must have one value a target, shape ({n},), got {values.shape}")
    if np.isnan(values).any():
        raise InputError(f"priority must be numbers, but {int(np.isnan(values).sum())} of {n} are NaN")
    return np.unique(-values, return_inverse=True)[1].reshape(-1).astype(np.int64)


def _at_tips(focal_plane, points, target_of, fiber_type):
    """Tip, elbow and fiber in use of each positioner."""
    n = len(focal_plane)
    used = np.flatnonzero(target_of >= 0)
    tips = np.full((n, 2), np.nan)
    tips[used] = points[target_of[used]]
    types = np.where(target_of >= 0, focal_plane._first_type, "")
    if fiber_type is not None and focal_plane.fiber_types != ("",):
        wanted = np.asarray(fiber_type, dtype=str)[target_of[used]]
        types = types.astype(f"U{max(len(t) for t in focal_plane.fiber_types)}")
        types[used] = np.where(wanted == "", types[used], wanted)
    hand = np.where(focal_plane._sides(tips) < 0, "left", "right")
    return tips, hand, types
