"""Reports of collisions, and the arms that collide while they unfold, which cannot move by this simple motion."""

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import astropy.units as u
import numpy as np

from rfpsurvey._common.descriptions import to_html
from rfpsurvey._instruments import moves as _moves
from rfpsurvey._instruments.arms import Arms, check_arms, check_plane, place_arms
from rfpsurvey._instruments.focal_plane import FocalPlane
from rfpsurvey._kernels.motion import Moves
from rfpsurvey.errors import check_choice, check_keywords, check_switch, number_of

if TYPE_CHECKING:
    from rfpsurvey._instruments.path_report import PathReport

SAME_FOLD = 1e-6
"""Largest difference (rad) of equal angles of folded arms."""
LAWS = ("same_duration", "same_speed")
"""Laws of time by which arms unfold."""


@dataclass(frozen=True, eq=False)
class MotionReport:
    """Collisions of arms that fold, turn and unfold.

    Parameters
    ----------
    pairs : ndarray of int, shape (k, 2)
        Pairs of positioners i < j whose arms collide at some time while all arms unfold (or fold), sorted. Pairs that
        collide at their targets are among them.
    obstacle_pairs : ndarray of int, shape (m, 2)
        Pairs of a positioner and an obstacle (row numbers) that collide while the arm unfolds (or folds).
    blocked : ndarray of bool, shape (n,)
        Whether the folded arm of each positioner cannot turn to its direction without touching a broken arm or an
        obstacle, or is folded to the other side of the range of phi than before, because its elbow changes.
    touching : ndarray of int, shape (l, 2)
        Pairs of positioners whose folded arms can touch each other when they turn.
    theta : Quantity, shape (n,)
        Joint angle theta of each positioner while arms unfold. Idle arms that remain folded turn to this angle. The
        angle is NaN for arms that are ignored.
    law : str
        Law of time by which the arms unfold.

    Examples
    --------
    >>> import astropy.units as u
    >>> import rfpsurvey as rs
    >>> robot = rs.Positioner(8 * u.mm, 17 * u.mm, 2 * u.mm)
    >>> plane = rs.FocalPlane([[0, 0], [25, 0]] * u.mm, robot)
    >>> found = rs.collision.find_motion(plane, [[16, -12], [14, 12]] * u.mm)
    >>> found.pairs.tolist(), found.n_planner
    ([[0, 1]], 2)
    """

    pairs: np.ndarray
    obstacle_pairs: np.ndarray
    blocked: np.ndarray
    touching: np.ndarray
    theta: u.Quantity
    law: str

    @property
    def needs_planner(self) -> np.ndarray:
        """Whether each positioner can reach its target only on a path that a path planner finds, if at all."""
        needs = self.blocked.copy()
        needs[self.pairs] = needs[self.touching] = needs[self.obstacle_pairs[:, 0]] = True
        return needs

    @property
    def n_planner(self) -> int:
        """Number of positioners that need a path planner."""
        return int(self.needs_planner.sum())

    n_failing = n_planner  # the name that `PathReport` also has

    @property
    def counts(self) -> dict[str, int]:
        """Numbers of colliding pairs of arms, of collisions with obstacles, and of positioners, for summaries."""
        return {
            "n_unfolding_pairs": len(self.pairs),
            "n_unfolding_obstacle_collisions": len(self.obstacle_pairs),
            "n_needs_planner": self.n_planner,
        }

    def __repr__(self):
        pairs = f"{number_of(len(self.pairs), 'pair')} of arms, {len(self.obstacle_pairs)} with obstacles"
        return f"<MotionReport: {pairs}, {number_of(self.n_planner, 'positioner')} to plan paths for>"


@check_keywords
def find_motion(
    focal_plane: FocalPlane,
    arms: object,
    *,
    before: object = None,
    law: str = "same_duration",
    parked_obstacles: bool = True,
) -> MotionReport:
    """Find the arms that collide if all arms fold, folded arms turn, and all arms then unfold.

    The motion needs no path planner: all arms fold at the same time, until each eccentric arm lies over its central arm
    (or as close to it as the joint limits allow). The folded arms turn to the directions of their new targets, in any
    order. All arms then unfold at the same time; folding is the exact time reversal of unfolding. Arms that come closer
    to each other than the minimum separation plus 1e-6 mm at some time collide; the other arms are certainly never
    closer than the minimum separation. Broken arms do not move. An idle arm goes to its parked pose if this pose is an
    obstacle in static tests. Otherwise it remains folded, and turns out of the way of the other arms if there is no
    collision in one of 24 directions.

    Parameters
    ----------
    focal_plane : FocalPlane
        The positioners.
    arms : Arms, Allocation or Quantity, shape (n, 2)
        The poses at the end of the motion, as in `~rfpsurvey.find_collisions`.
    before : Arms, Allocation or Quantity, optional
        The poses at its begin; the collisions on the way back from these poses are also found. By default, the arms are
        folded at the begin, and can be turned to any direction in the arc of the parked pose.
    law : {"same_duration", "same_speed"}, optional
        Law of time. With ``same_duration``, all arms unfold in the same time, each at a constant rate; with
        ``same_speed``, they begin at the same time and unfold with the same angular speed.
    parked_obstacles : bool, optional
        Whether idle positioners are obstacles, as in `~rfpsurvey.find_collisions`; folded idle arms count as well.

    Returns
    -------
    MotionReport
        The pairs that collide, and the positioners that need a path planner.

    Raises
    ------
    InputError
        If the law of time is unknown, or if poses or an allocation belong to another focal plane.

    See Also
    --------
    rfpsurvey.constraints.Motion : The constraint that no arms collide during this motion.

    Examples
    --------
    >>> import astropy.units as u
    >>> import rfpsurvey as rs
    >>> robot = rs.Positioner(8 * u.mm, 17 * u.mm, 2 * u.mm)
    >>> plane = rs.FocalPlane([[0, 0], [25, 0]] * u.mm, robot)
    >>> rs.collision.find_motion(plane, [[-16, -12], [40, 12]] * u.mm)
    <MotionReport: 0 pairs of arms, 0 with obstacles, 0 positioners to plan paths for>
    """
    check_plane(focal_plane)
    check_choice(law, LAWS, "law of time")
    check_switch(parked_obstacles, "parked_obstacles")
    columns = focal_plane.arrays
    idle = _moves.idle_moves(columns, parked_obstacles)
    turning = _moves.Turning(columns, idle)
    given = [arms] if before is None else [arms, before]
    parts = [_motion_of(focal_plane, configuration, idle, turning, law == "same_speed") for configuration in given]
    pairs = [_moves.unfolding_pairs(focal_plane, moves, law == "same_speed") for moves, *_ in parts]
    owner, near = np.arange(len(focal_plane)), columns.obstacle_pairs
    hits = [near[_moves.unfolding_obstacles(focal_plane, moves, owner, near)] for moves, *_ in parts]
    theta, moved = parts[0][1], np.any([part[2] for part in parts], axis=0)
    free = turning.allows(owner, theta, None if before is None else parts[1][1])
    if before is not None:  # an arm with limits of phi that changes its elbow would have to pass its stretched pose
        free &= ~(parts[0][2] & parts[1][2] & (np.abs(parts[0][3] - parts[1][3]) > SAME_FOLD))
    touching = turning.folded.touching
    touching = touching[moved[touching].any(axis=1)]
    unique = (np.unique(np.vstack(rows), axis=0) for rows in (pairs, hits))
    joint = columns.to_joints(np.where(np.isnan(parts[0][0].x), np.nan, theta), np.zeros(len(theta)))[0]
    return MotionReport(*unique, moved & ~free & columns.usable, touching, np.rad2deg(joint) << u.deg, law)


def plan_moves(plane: FocalPlane, arms: object, law: str, parked_obstacles: bool) -> Moves:
    """Return the motion of all arms of a plan; folded idle arms are turned out of the way."""
    columns, idle = plane.arrays, _moves.idle_moves(plane.arrays, parked_obstacles)
    return _motion_of(plane, arms, idle, _moves.Turning(columns, idle), law == "same_speed")[0]


def _motion_of(plane, given, idle, turning, same_speed):
    """Return the motion of all arms, their directions theta, which arms have targets or recorded poses, and the folds.

    The folds are the joint angles phi of the folded arms.
    """
    if hasattr(given, "place_arms"):
        given = given.place_arms(plane)
    posed = given if isinstance(given, Arms) else place_arms(plane, given)
    check_arms(plane, posed)
    columns = plane.arrays.using(posed.fiber)
    owner, fiber = np.arange(len(plane)), columns.fiber_index
    theta, phi = (np.array(value, dtype=float) for value in columns.from_joints(posed.theta, posed.phi))
    moved = posed.assigned | (False if posed.recorded is None else posed.recorded)
    moves = _moves.find_moves(columns, owner, fiber, theta, _moves.split_phi(columns, phi), moving=columns.usable)
    fold = _moves.fold_of(columns, owner, fiber, _moves.split_phi(columns, phi), moves.turn)
    rows = np.flatnonzero(~moved)
    idle_moves = _moves.joined(moves, rows, idle, rows)
    # folded idle arms are no obstacles for each other
    idle_moves = idle_moves._replace(x=np.where(moved | ~_moves.stays_folded(columns, True), idle_moves.x, np.nan))
    if np.isfinite(idle.x[columns.usable]).any():
        idle = _moves.turn_idle_arms(columns, idle, turning, np.arange(len(plane) + 1), idle_moves, same_speed)
    moves = _moves.joined(moves, rows, idle, rows)
    center = plane.arrays.xy
    direction = np.arctan2(moves.y - center[:, 1], moves.x - center[:, 0])
    return moves, np.where(moved, theta, direction), moved, fold


@dataclass(frozen=True, eq=False)
class CollisionReport:
    """Static collisions of one configuration.

    Parameters
    ----------
    pairs : ndarray of int, shape (k, 2)
        Pairs of positioners i < j whose arms are closer than the minimum separation, sorted.
    distances : Quantity, shape (k,)
        Distances between the arms of these pairs.
    obstacle_pairs : ndarray of int, shape (m, 2)
        Pairs of a positioner and an obstacle (row numbers) whose distance is less than the clearance.
    obstacle_distances : Quantity, shape (m,)
        Distances from the arms to the edges of the obstacles.
    in_collision : ndarray of bool, shape (n,)
        Whether each positioner occurs in ``pairs`` or ``obstacle_pairs``.
    assigned : ndarray of bool, shape (n,)
        Whether each positioner has a target.
    counted : ndarray of bool, shape (n,)
        Whether each positioner is counted in the rate. Assigned positioners and parked positioners with equal arms are
        counted.
    n_borderline : int or None, optional
        Number of borderline pairs: the distance of two arms is so close to the minimum separation, or the distance of
        an arm from an obstacle is so close to the clearance, that rounding errors could change the result. Rational
        arithmetic decides the result for two arms if the method is ``exact`` or ``cuda``, and for an arm and an
        obstacle in all methods. The number is None if the method has no proven error limit. If no two arms can touch,
        the number is never None and includes only pairs with an obstacle.
    motion : MotionReport or PathReport, optional
        Collisions while the arms move, or their paths, if a constraint of the plan refers to the motion.

    Examples
    --------
    >>> import astropy.units as u
    >>> import rfpsurvey as rs
    >>> robot = rs.Positioner(8.25 * u.mm, 8.25 * u.mm, 2.25 * u.mm)
    >>> plane = rs.FocalPlane([[0, 0], [25.6, 0]] * u.mm, robot)
    >>> report = rs.find_collisions(plane, [[12, 0], [14, 0]] * u.mm)
    >>> report.distances, report.rate, report.colliding_with
    (<Quantity [2.] mm>, 1.0, [[1], [0]])
    """

    pairs: np.ndarray
    distances: u.Quantity
    obstacle_pairs: np.ndarray
    obstacle_distances: u.Quantity
    in_collision: np.ndarray
    assigned: np.ndarray
    counted: np.ndarray
    n_borderline: int | None = None
    motion: "MotionReport | PathReport | None" = None

    @property
    def rate(self) -> float:
        """Fraction of the counted positioners (assigned or parked) that collide; NaN if no positioner is counted."""
        return _ratio(self.in_collision, self.counted)

    @property
    def rate_assigned(self) -> float:
        """Fraction of the assigned positioners that collide; NaN if no positioner is assigned."""
        return _ratio(self.in_collision, self.assigned)

    @cached_property
    def colliding_with(self) -> list[list[int]]:
        """For each positioner, the positioners with which it collides, in ascending order."""
        partners: list[list[int]] = [[] for _ in self.in_collision]
        for i, j in self.pairs.tolist():
            partners[i].append(j)
            partners[j].append(i)
        return partners  # these are in ascending order, because the pairs are sorted

    def _repr_html_(self) -> str:
        facts = {
            "colliding pairs of positioners": len(self.pairs),
            "collisions with obstacles": len(self.obstacle_pairs),
            "collision rate (assigned and parked)": self.rate,
        }
        return to_html(self, {**facts, "collision rate (assigned only)": self.rate_assigned})

    def __repr__(self):
        n, m = int(self.in_collision.sum()), int(self.counted.sum())
        pairs = f"{number_of(len(self.pairs), 'pair')} of arms, {len(self.obstacle_pairs)} with obstacles"
        return f"<CollisionReport: {pairs}, {n} of {m} positioners in collision>"


def _ratio(flags, among):
    n = int(among.sum())
    return float((flags & among).sum() / n) if n else float("nan")
