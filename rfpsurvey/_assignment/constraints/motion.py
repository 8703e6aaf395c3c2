"""The constraint that arms reach their targets by a simple motion, which needs no path planner."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from rfpsurvey._assignment.constraints.constraint import Constraint
from rfpsurvey._assignment.constraints.field import FAIL, PASS, ConstraintField, Verdict
from rfpsurvey._common.settings import Checked, option
from rfpsurvey._instruments.motion import LAWS
from rfpsurvey._instruments.moves import Folded
from rfpsurvey.errors import InputError, check_keywords, listed, number_of, warn

MOTIONS = ("fold",)
MOST_LISTED = 5


def law_of(constraints: Iterable[Constraint]) -> str:
    """Return the law of time by which arms must unfold without collisions; empty text if no constraint requires it."""
    laws = list(dict.fromkeys(constraint.motion_law for constraint in constraints if constraint.motion_law))
    if len(laws) > 1:
        raise InputError(f"all constraints on the motion must have the same law of time, got {listed(laws)}")
    return laws[0] if laws else ""


@check_keywords
@dataclass(frozen=True)
class Motion(Checked, Constraint):
    """Arms reach their targets by a simple motion without collisions: all arms fold, turn and unfold.

    The text form is ``motion fold`` or ``motion fold same_speed``. `~rfpsurvey.collision.find_motion` describes the
    motion. ``optimal`` and ``repair``, and joint plans of surveys, assign targets such that no arms collide while they
    unfold; the proofs of ``optimal`` refer to such plans. With other allocators, plans are only checked.

    Parameters
    ----------
    motion : {"fold"}
        Kind of the motion.
    law : {"same_duration", "same_speed"}, optional
        Law of time by which the arms unfold.

    Raises
    ------
    InputError
        If the kind of the motion or the law is unknown.

    Examples
    --------
    >>> import rfpsurvey as rs
    >>> rs.constraints.as_constraints("motion fold")
    (Motion(motion='fold', law='same_duration'),)
    """

    motion: str = option(choices=MOTIONS, what="kind of motion")
    law: str = option(LAWS[0], choices=LAWS, what="law of time")

    name = "motion"
    uses_targets = False

    @property
    def motion_law(self) -> str:
        """Law of time by which arms unfold."""
        return self.law

    def for_instrument(self, instrument: object) -> "Motion":
        """Return the constraint; issue a warning if folded arms of the instrument can touch each other.

        Parameters
        ----------
        instrument : Instrument or None
            The instrument; None if only a focal plane is known.

        Returns
        -------
        Motion
            The constraint.
        """
        if instrument is not None:
            plane = instrument.focal_plane
            pairs = Folded(plane.arrays).touching
            if len(pairs):
                names = ["-".join(row) for row in plane.id.astype(str)[pairs].tolist()]
                warn(
                    f"the constraint '{self}' does not prove that folded arms can turn: the folded arms of "
                    f"{number_of(len(pairs), 'pair')} of positioners can touch ({listed(names, MOST_LISTED)})"
                )
        return self

    def check(self, field: ConstraintField, has_fiber: np.ndarray, n_covering: int) -> list[str]:
        """Return a sentence if positioners of a finished plan need a path planner.

        Parameters
        ----------
        field : ConstraintField
            The field.
        has_fiber : ndarray of bool
            Whether each target of the field has a fiber.
        n_covering : int
            Number of positioners that need a path planner.

        Returns
        -------
        list of str
            The sentence; an empty list if no positioner needs a path planner.
        """
        who = number_of(n_covering, "positioner needs", "positioners need")
        return [f"{self}: {who} a path planner"] if n_covering else []

    def verdict(self, field: ConstraintField, has_fiber: np.ndarray, n_covering: int) -> Verdict:
        """Return the verdict on a finished plan: the number of positioners that need a path planner.

        Parameters
        ----------
        field : ConstraintField
            The field.
        has_fiber : ndarray of bool
            Whether each target of the field has a fiber.
        n_covering : int
            Number of positioners that need a path planner.

        Returns
        -------
        Verdict
            The verdict.
        """
        return Verdict(str(self), n_covering, "no positioner that needs a path planner", FAIL if n_covering else PASS)
