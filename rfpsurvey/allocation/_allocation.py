"""What an allocation is."""

from dataclasses import dataclass

import astropy.units as u
import numpy as np

from rfpsurvey._display import to_html
from rfpsurvey.allocation._problem import Level
from rfpsurvey.allocation._requirements import Shortfall
from rfpsurvey.collision import Arms, place_arms
from rfpsurvey.errors import number_of
from rfpsurvey.focal_plane import FocalPlane

__all__ = ["Allocation"]


@dataclass(frozen=True, eq=False)
class Allocation:
    """Which positioner observes which target.

    Parameters
    ----------
    allocator : str
        Name of the allocator that made it.
    target_of_positioner : ndarray of int, shape (n_positioners,)
        Target of each positioner, -1 for none. Rows behind those that were given are sky positions found in gaps.
    positioner_of_target : ndarray of int, shape (n_targets,)
        Positioner of each target, -1 for none.
    handedness : ndarray of str, shape (n_positioners,)
        Elbow of each arm, "right" or "left".
    tips : Quantity, shape (n_positioners, 2)
        Where each fiber is; NaN without a target.
    fiber_type : ndarray of str, shape (n_positioners,)
        Fiber in use.
    in_reach : ndarray of bool, shape (n_given,)
        Which targets at least one positioner reaches.
    parked_obstacles : bool
        Do idle equal-arm positioners count as obstacles?
    seconds : dict of str to float
        Time of each stage.
    xy : Quantity, shape (n_targets, 2)
        The targets on the focal plane, those given and then sky positions in use that were found in gaps.
    n_given : int
        Number of the former.
    target_fiber_type : ndarray of str, shape (n_targets,), or None
        Fiber type that each target needs, ``""`` for any.
    queues : tuple of ndarray or None
        For ``balanced``: indptr and targets of all queues, of which the configuration is one draw.
    levels : tuple of Level
        What the plan objectives at, the first objective before all others: name, value and bound, which is what no plan
        exceeds given the values before; NaN where nothing is proven.
    unmet : tuple of Shortfall
        Requirements that are not met; as text each is a sentence.
    meta : dict
        How the solution was found.

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
    tips: u.Quantity
    fiber_type: np.ndarray
    in_reach: np.ndarray
    parked_obstacles: bool
    seconds: dict
    xy: u.Quantity
    n_given: int
    target_fiber_type: np.ndarray | None
    queues: tuple[np.ndarray, np.ndarray] | None
    levels: tuple[Level, ...]
    unmet: tuple[Shortfall, ...]
    meta: dict

    @property
    def n_reachable(self) -> int:
        """Number of targets that at least one positioner reaches."""
        return int(np.count_nonzero(self.in_reach))

    @property
    def n_assigned(self) -> int:
        """Number of positioners with a target."""
        return int(np.count_nonzero(self.target_of_positioner >= 0))

    @property
    def objective(self) -> float:
        """Targets observed, less what the requirements lack."""
        lack = sum(level.value for level in self.levels if level.name == "requirements")
        return float(self.n_assigned + lack)

    @property
    def bound(self) -> float:
        """What no plan exceeds that is as good in all objectives that are proven; NaN where nothing is proven."""
        # classes that are not proven have bounds on all classes up to them: the largest gap counts, not their sum
        return self.objective + float(np.max([level.bound - level.value for level in self.levels], initial=0.0))

    @property
    def gap(self) -> float:
        """Relative difference of bound and objective: 0 for a proven optimum, NaN where nothing is proven.

        The bound of ``repair`` is what arms could reach that pass through each other: it lost at most so much.
        """
        missing = self.bound - self.objective
        return missing / max(abs(self.bound), 1.0) if missing else 0.0

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

        Raises
        ------
        InputError
            If this is no focal plane, or one of other positioners.
        """
        return place_arms(
            focal_plane,
            self.tips,
            handedness=self.handedness,
            fiber_type=self.fiber_type,
            parked_obstacles=self.parked_obstacles,
        )

    def _repr_html_(self) -> str:
        facts = {level.name: f"{level.value:g}, at most {level.bound:g}" for level in self.levels}
        return to_html(self, {**facts, "gap": self.gap, "requirements that are not met": len(self.unmet)})

    def __repr__(self):
        n, m = len(self.target_of_positioner), len(self.positioner_of_target)
        return f"<Allocation by {self.allocator!r}: {self.n_assigned} of {n} positioners, {number_of(m, 'target')}>"
