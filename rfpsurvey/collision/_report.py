"""The static collisions of one configuration."""

from dataclasses import dataclass
from functools import cached_property

import astropy.units as u
import numpy as np

from rfpsurvey._display import to_html
from rfpsurvey.collision._motion import MotionReport
from rfpsurvey.errors import number_of


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
    motion : MotionReport, optional
        Collisions while the arms move, if a constraint of the plan refers to the motion.

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
    motion: MotionReport | None = None

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
