"""The constraint that arms reach their targets without collisions, by a simple motion or on planned paths."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from rfpsurvey._assignment.constraints.constraint import Constraint
from rfpsurvey._assignment.constraints.field import FAIL, PASS, ConstraintField, Verdict
from rfpsurvey._common.settings import Checked, option
from rfpsurvey._instruments.motion import LAWS
from rfpsurvey._instruments.moves import Folded
from rfpsurvey.errors import InputError, check_keywords, listed, number_of, warn

PATHS = "paths"
MOTIONS = ("fold", PATHS)
MOST_LISTED = 5


def law_of(constraints: Iterable[Constraint]) -> str:
    """Return the law of time by which arms must unfold, or ``"paths"``; empty text if no constraint requires it."""
    laws = list(dict.fromkeys(constraint.motion_law for constraint in constraints if constraint.motion_law))
    if len(laws) > 1:
        raise InputError(f"all constraints on the motion must have the same kind and law of time, got {listed(laws)}")
    return laws[0] if laws else ""


@check_keywords
@dataclass(frozen=True)
class Motion(Checked, Constraint):
    """Arms reach their targets without collisions, by a simple motion or on planned paths.

    The text form is ``motion fold``, ``motion fold same_speed`` or ``motion paths``. With ``fold``, all arms fold, turn
    and unfold (`~rfpsurvey.collision.find_motion`): ``optimal`` and ``repair``, and joint plans of surveys, assign
    targets such that no arms collide while they unfold; the proofs of ``optimal`` refer to such plans. With ``paths``,
    the same allocators plan the paths of all arms (`~rfpsurvey.collision.find_paths`). Where no path is found, they
    change the assignment of the arms nearby, in up to 10 rounds; arms that still have no path lose their targets. The
    bounds of ``optimal`` then refer to plans without the constraint. With other allocators, plans are only checked.

    Parameters
    ----------
    motion : {"fold", "paths"}
        Kind of the motion.
    law : {"same_duration", "same_speed"}, optional
        Law of time by which the arms unfold; only with ``fold``.

    Raises
    ------
    InputError
        If the kind of the motion or the law is unknown, or if a law is given with ``paths``.

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

    def _check(self):
        if self.motion == PATHS and self.law != LAWS[0]:
            raise InputError(f"a law of time can be given only with the motion fold, got {self.law!r} with {PATHS}")

    def __str__(self):
        return f"{self.name} {PATHS}" if self.motion == PATHS else super().__str__()

    @property
    def motion_law(self) -> str:
        """Law of time by which arms unfold, or ``"paths"``."""
        return PATHS if self.motion == PATHS else self.law

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
        if instrument is not None and self.motion != PATHS:
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
        """Return a sentence if positioners of a finished plan need a path planner, or have no planned path.

        Parameters
        ----------
        field : ConstraintField
            The field.
        has_fiber : ndarray of bool
            Whether each target of the field has a fiber.
        n_covering : int
            Number of these positioners.

        Returns
        -------
        list of str
            The sentence; an empty list if there are no such positioners.
        """
        if self.motion == PATHS:
            text = f"{number_of(n_covering, 'positioner has', 'positioners have')} no planned path"
        else:
            text = f"{number_of(n_covering, 'positioner needs', 'positioners need')} a path planner"
        return [f"{self}: {text}"] if n_covering else []

    def verdict(self, field: ConstraintField, has_fiber: np.ndarray, n_covering: int) -> Verdict:
        """Return the verdict on a finished plan: the number of positioners whose arms do not move in this way.

        Parameters
        ----------
        field : ConstraintField
            The field.
        has_fiber : ndarray of bool
            Whether each target of the field has a fiber.
        n_covering : int
            Number of these positioners.

        Returns
        -------
        Verdict
            The verdict.
        """
        what = "without a planned path" if self.motion == PATHS else "that needs a path planner"
        return Verdict(str(self), n_covering, f"no positioner {what}", FAIL if n_covering else PASS)
