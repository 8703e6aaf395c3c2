"""The class `~rfpsurvey.allocation.Allocation`, the result of `allocate`."""

from dataclasses import dataclass, field

import astropy.units as u
import numpy as np

from rfpsurvey._display import to_html
from rfpsurvey.allocation._answer import SUBPRIORITIES, Level
from rfpsurvey.collision import Arms, place_arms
from rfpsurvey.constraints import Shortfall, Verdict
from rfpsurvey.errors import number_of
from rfpsurvey.focal_plane import FocalPlane


@dataclass(frozen=True, eq=False)
class Allocation:
    """An allocation: the target that each positioner observes.

    Parameters
    ----------
    allocator : str
        Name of the allocator that made the allocation.
    target_of_positioner : ndarray of int, shape (n_positioners,)
        Row of the target of each positioner, -1 if the positioner has no target. Rows from ``n_given`` on are sky
        positions that were found in gaps between the targets.
    positioner_of_target : ndarray of int, shape (n_targets,)
        Row of the positioner of each target, -1 if no positioner observes the target.
    handedness : ndarray of str, shape (n_positioners,)
        Handedness of each arm, "right" or "left".
    tips_mm : ndarray of float, shape (n_positioners, 2)
        Position of each fiber in mm; NaN for positioners without a target. The property ``tips`` has units.
    fiber_type : ndarray of str, shape (n_positioners,)
        Fiber type that each positioner uses.
    in_reach : ndarray of bool, shape (n_given,)
        Whether each target is in reach of at least one positioner.
    parked_obstacles : bool
        Whether idle positioners are obstacles; only positioners with two arms of equal length can be obstacles.
    seconds : dict of str to float
        Computing times in seconds: ``reach`` (finding the targets in reach) and ``allocation`` (all later steps).
    xy_mm : ndarray of float, shape (n_targets, 2)
        Positions on the focal plane in mm: first all given targets, then the observed sky positions in gaps between the
        targets. The property ``xy`` has units.
    n_given : int
        Number of given targets.
    target_fiber_type : ndarray of str, shape (n_targets,), or None
        Fiber type that each target requires; ``""`` means any type.
    queues : tuple of ndarray or None
        For ``balanced``: the queues from which the configuration was drawn, as two arrays ``indptr`` and ``targets``.
        The queue of positioner ``i`` is ``targets[indptr[i]:indptr[i + 1]]``.
    levels : tuple of Level
        Name, value and bound of each objective, in strict order of precedence. The bound is an upper limit of the value
        for all plans with the same values of the earlier objectives; it is NaN if no upper limit is known.
    unmet : tuple of Shortfall
        Requirements that are not met; ``str`` converts each element to a sentence.
    meta : dict
        Information from the allocator about its search, such as the number of moved positioners; may be empty.
    excluded : ndarray of bool, shape (n_given,), or None
        Whether constraints exclude each given target; None if no target is excluded.
    counts : tuple of Verdict
        The verdict on each requirement, in the tile or in each spectrograph.
    added : ndarray of int, shape (n_targets - n_given,)
        For each observed sky position in a gap, its number among all positions that were found.

    Examples
    --------
    >>> import astropy.units as u
    >>> import rfpsurvey as rs
    >>> robot = rs.Positioner(8.25 * u.mm, 8.25 * u.mm, 2.25 * u.mm)
    >>> plane = rs.FocalPlane([[0, 0], [25.6, 0]] * u.mm, robot)
    >>> plan = rs.allocate(plane, [[12, 0], [14, 0], [2, 5]] * u.mm, allocator="nearest")
    >>> plan.target_of_positioner, plan.positioner_of_target, plan.n_assigned
    (array([2, 1]), array([-1,  1,  0]), 2)
    """

    allocator: str
    target_of_positioner: np.ndarray
    positioner_of_target: np.ndarray
    handedness: np.ndarray
    tips_mm: np.ndarray
    fiber_type: np.ndarray
    in_reach: np.ndarray
    parked_obstacles: bool
    seconds: dict
    xy_mm: np.ndarray
    n_given: int
    target_fiber_type: np.ndarray | None
    queues: tuple[np.ndarray, np.ndarray] | None
    levels: tuple[Level, ...]
    unmet: tuple[Shortfall, ...]
    meta: dict
    excluded: np.ndarray | None = None
    counts: tuple[Verdict, ...] = ()
    added: np.ndarray = field(default_factory=lambda: np.empty(0, dtype=np.int64))

    @property
    def tips(self) -> u.Quantity:
        """Position of each fiber; NaN for positioners without a target."""
        return self.tips_mm << u.mm

    @property
    def xy(self) -> u.Quantity:
        """Positions of the targets on the focal plane."""
        return self.xy_mm << u.mm

    @property
    def n_reachable(self) -> int:
        """Number of targets that at least one positioner reaches."""
        return int(np.count_nonzero(self.in_reach))

    @property
    def n_assigned(self) -> int:
        """Number of positioners that have a target."""
        return int(np.count_nonzero(self.target_of_positioner >= 0))

    @property
    def objective(self) -> float:
        """Number of assigned targets minus the number of fibers missing for requirements."""
        lack = sum(level.value for level in self.levels if level.name == "requirements")
        return float(self.n_assigned + lack)

    @property
    def bound(self) -> float:
        """Upper bound of `objective`, a number of targets; NaN if it is unknown.

        Some objectives in ``levels`` have a proven optimum. The bound is valid for all plans that have the same values
        of these objectives.
        """
        # The bound of a class whose optimum is not proven also includes all earlier classes. The largest difference
        # between a bound and its value is therefore used, not the sum of the differences.
        slack = [level.bound - level.value for level in self.levels if level.name != SUBPRIORITIES]
        return self.objective + float(np.max(slack, initial=0.0))

    @property
    def gap(self) -> float:
        """Relative difference between `bound` and `objective`, at most 1: 0 for a proven optimum, NaN if unknown.

        If the sum of the subpriorities is an objective, the gap is at least the relative difference between the bound
        and the value of this sum. The upper bounds that ``repair`` uses ignore collisions. Without subpriorities, the
        gap of ``repair`` is therefore an upper limit of the fraction of targets that are lost to collisions.
        """
        missing = self.bound - self.objective
        gap = missing / max(abs(self.bound), missing, 1.0) if missing else 0.0
        sums = [level for level in self.levels if level.name == SUBPRIORITIES and level.bound > level.value]
        return max([gap, *((bound - value) / max(abs(bound), bound - value) for _, value, bound in sums)])

    def place_arms(self, focal_plane: FocalPlane) -> Arms:
        """Return the poses of the arms for this allocation.

        Parameters
        ----------
        focal_plane : FocalPlane
            The focal plane for which the allocation was made.

        Returns
        -------
        Arms
            Poses of all positioners.

        Raises
        ------
        InputError
            If ``focal_plane`` is not the focal plane for which the allocation was made.
        """
        return place_arms(
            focal_plane,
            self,
            handedness=self.handedness,
            fiber_type=self.fiber_type,
            parked_obstacles=self.parked_obstacles,
        )

    def _repr_html_(self) -> str:
        facts = {level.name: f"{level.value:g} (upper bound {level.bound:g})" for level in self.levels}
        return to_html(self, {**facts, "relative gap to bound": self.gap, "unmet requirements": len(self.unmet)})

    def __repr__(self):
        n, m = len(self.target_of_positioner), len(self.positioner_of_target)
        return f"<Allocation by {self.allocator!r}: {self.n_assigned} of {n} positioners, {number_of(m, 'target')}>"
