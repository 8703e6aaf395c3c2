"""The planned paths of the arms of a plan, and the positioners of the plan whose arms have no path."""

from dataclasses import dataclass, replace
from typing import ClassVar

import astropy.units as u
import numpy as np

from rfpsurvey._instruments.arms import Arms, place_arms
from rfpsurvey._instruments.find_paths import find_paths
from rfpsurvey._instruments.focal_plane import FocalPlane
from rfpsurvey._instruments.joint_motion import JointMotion
from rfpsurvey._instruments.path_arms import CollidingPosesError
from rfpsurvey._instruments.paths import Paths
from rfpsurvey.errors import number_of


@dataclass(frozen=True, eq=False)
class PathReport:
    """Planned paths of the arms of a plan.

    Parameters
    ----------
    paths : Paths
        The proven paths. Arms that collide in the poses of the plan are treated as arms without a target.
    without_path : ndarray of bool, shape (n,)
        Whether each positioner has a target that its arm does not reach on a proven path.

    Examples
    --------
    >>> import astropy.units as u
    >>> import rfpsurvey as rs
    >>> robot = rs.Positioner(8 * u.mm, 17 * u.mm, 2 * u.mm)
    >>> plane = rs.FocalPlane([[0, 0], [25, 0]] * u.mm, robot)
    >>> options = rs.AllocationOptions("optimal", constraints="motion paths")
    >>> plan = rs.allocate(plane, [[16, -12], [14, 12]] * u.mm, allocator=options)
    >>> plan.paths, plan.paths.counts
    (<PathReport: 0 positioners without a path>, {'n_without_path': 0})
    """

    paths: Paths
    without_path: np.ndarray
    law: ClassVar[str] = "paths"
    """Text that stands for planned paths in place of a law of time."""

    @property
    def n_failing(self) -> int:
        """Number of positioners with a target and without a path."""
        return int(self.without_path.sum())

    @property
    def counts(self) -> dict[str, int]:
        """The number of positioners without a path, for summaries."""
        return {"n_without_path": self.n_failing}

    def __repr__(self):
        return f"<PathReport: {number_of(self.n_failing, 'positioner')} without a path>"


def report_paths(plane: FocalPlane, arms: Arms, motion: JointMotion | None) -> PathReport:
    """Plan paths to the poses of a plan, which may contain collisions.

    The angles are rounded as in the table of a tile, which contains them in degrees, so that `Tile.paths` returns the
    same paths: in crowded planes, rounding errors change which arms arrive.
    """
    angles = np.array([(np.rad2deg(angle) << u.deg).to_value(u.rad) for angle in (arms.theta, arms.phi)])
    paths = paths_to(plane, replace(arms, find_angles=angles.copy), motion)
    return PathReport(paths, arms.assigned & ~(paths.assigned & paths.arrives))


def paths_to(
    plane: FocalPlane, arms: Arms, motion: JointMotion | None, *, refuse: bool = False, **options: object
) -> Paths:
    """Plan paths to the poses of a plan, which may contain collisions.

    If an arm without a target collides, its pose is left out, so that the planner chooses another one. If arms with
    targets collide, they are left out, or, with ``refuse``, an error is raised.
    """
    left_out, types = np.zeros(len(plane), dtype=bool), None
    if arms.fiber is not None:
        types = np.asarray(plane.fiber_types)[arms.fiber]
    while True:
        angles = np.where(left_out, np.nan, (arms.theta, arms.phi))
        given = (np.where(arms.assigned, angle, np.nan) << u.rad for angle in angles)
        names, idle = {"fiber_type": types} if types is not None else {}, np.where(arms.assigned, np.nan, angles)
        posed = place_arms(plane, **dict(zip(("theta", "phi"), given, strict=True)), **names, idle_angles=idle)
        try:
            return find_paths(plane, posed, motion=motion, **options)
        except CollidingPosesError as error:
            can_move = np.isin(np.arange(len(plane)), error.rows) & plane.arrays.usable & ~left_out
            new = can_move & ~arms.assigned
            if not new.any():
                new = can_move
                if refuse or not new.any():
                    raise
            left_out |= new
