"""The targets and fibers that count toward a requirement."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from rfpsurvey.constraints._requirement import Requirement


@dataclass(frozen=True, eq=False)
class Group:
    """The targets and fibers that count toward one requirement, of the whole tile or of a part of it.

    Parameters
    ----------
    requirement : Requirement
        The requirement.
    spectrograph : int or None
        Only fibers of this spectrograph count; None if the fibers of all spectrographs count.
    targets : ndarray of bool, shape (n_targets,)
        Whether each target counts toward the requirement.
    fibers : ndarray of bool, shape (n_positioners,), optional
        Whether the fiber of each positioner counts; by default, all fibers count.
    place : str, optional
        Name of the part of the focal plane that ``fibers`` marks, for messages.
    untyped : ndarray of bool, shape (n_targets,), optional
        Targets that count only on some positioners, because they require no fiber type.
    first : ndarray of bool, shape (n_positioners,), optional
        The positioners on which the targets in ``untyped`` count.

    Examples
    --------
    >>> import numpy as np
    >>> import rfpsurvey as rs
    >>> group = rs.constraints.Group(rs.Requirement("sky", 1), None, np.array([True, False]))
    >>> group.holds(np.array([0, 1, -1]), np.array([1, 1, 1]), np.array([0, 1, 2]))
    array([ True, False, False])
    """

    requirement: "Requirement"
    spectrograph: int | None
    targets: np.ndarray
    fibers: np.ndarray | None = None
    place: str = ""
    untyped: np.ndarray | None = None
    first: np.ndarray | None = None

    def holds(self, target: np.ndarray, spectrograph: np.ndarray, own: np.ndarray) -> np.ndarray:
        """Return whether assignments count toward the requirement.

        Parameters
        ----------
        target : ndarray of int
            Row of the target of each assignment, or -1 for no target.
        spectrograph : ndarray of int
            Spectrograph that receives the light of each target.
        own : ndarray of int
            Row of the positioner of each assignment.

        Returns
        -------
        ndarray of bool
            One value per assignment.
        """
        inside = self.holds_target(target, own)
        inside = inside if self.spectrograph is None else inside & (spectrograph == self.spectrograph)
        return inside if self.fibers is None else inside & self.fibers[own]

    def holds_target(self, target: np.ndarray, own: np.ndarray) -> np.ndarray:
        """Return whether assignments count, in whichever part of the tile the positioners are.

        Parameters
        ----------
        target : ndarray of int
            Row of the target of each assignment, or -1 for no target.
        own : ndarray of int
            Row of the positioner of each assignment.

        Returns
        -------
        ndarray of bool
            One value per assignment.
        """
        inside = np.append(self.targets, False)[target]
        return inside if self.untyped is None else inside & (~np.append(self.untyped, False)[target] | self.first[own])
