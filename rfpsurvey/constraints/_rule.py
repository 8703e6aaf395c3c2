"""The base class of the rules of observatories, whose verdict on a plan is a number and a limit."""

from dataclasses import replace
from typing import ClassVar

import astropy.units as u
import numpy as np

from rfpsurvey._roles import has_role
from rfpsurvey.constraints._constraint import Constraint, ConstraintField
from rfpsurvey.constraints._verdict import FAIL, NOT_CHECKABLE, Verdict
from rfpsurvey.errors import InputError, check_fiber_type, refusal

LARGEST = 90.0
"""Largest absolute value of a magnitude; larger values are codes for missing magnitudes, such as -999 and 99.9."""


class Rule(Constraint):
    """A constraint with a number and a limit, which are computed from the fibers of a finished plan.

    A subclass overrides ``verdict``. The fields ``column`` and ``fiber_type`` are optional.
    """

    states_note: ClassVar[bool] = False
    """Whether the sentence of ``check`` contains the note of the verdict."""
    with_idle = False
    """Whether the field of ``verdict`` contains the fibers of positioners without a target, as sky positions."""

    @property
    def columns(self) -> tuple[str, ...]:
        """Columns of the catalog that the rule uses, apart from kind, category and fiber type."""
        column = getattr(self, "column", "")
        return (column,) if column else ()

    def for_instrument(self, instrument: object) -> "Rule":
        """Return the rule; raise an error if the instrument does not have its fiber type.

        Parameters
        ----------
        instrument : Instrument or None
            The instrument; None if only positions on the focal plane are known.

        Returns
        -------
        Rule
            The rule.

        Raises
        ------
        InputError
            If the instrument does not have the fiber type, or if there is no instrument.
        """
        if instrument is None:
            self._refuse_focal_plane()
        fiber = getattr(self, "fiber_type", "")
        if fiber:
            check_fiber_type(fiber, instrument.focal_plane.fiber_types, f"fiber type of the rule '{self}'")
        return self

    def verdict(self, field: ConstraintField, has_fiber: np.ndarray, n_covering: int = 0) -> Verdict:
        """Return the verdict on a finished plan.

        Parameters
        ----------
        field : ConstraintField
            The field.
        has_fiber : ndarray of bool
            Whether each target of the field has a fiber.
        n_covering : int, optional
            Number of arms that cover obstacles of the rule.

        Returns
        -------
        Verdict
            The verdict.
        """
        return self._verdict(field, has_fiber)

    def _verdict(self, field: ConstraintField, has_fiber: np.ndarray) -> Verdict:
        """Return the verdict; built-in rules override this method instead of ``verdict``."""
        raise NotImplementedError

    def check(self, field: ConstraintField, has_fiber: np.ndarray, n_covering: int) -> list[str]:
        """Return a sentence that states how a finished plan violates the rule.

        Parameters
        ----------
        field : ConstraintField
            The field.
        has_fiber : ndarray of bool
            Whether each target of the field has a fiber.
        n_covering : int
            Number of arms that cover obstacles of the rule.

        Returns
        -------
        list of str
            The sentence; an empty list if the plan does not violate the rule, or if the rule is not checkable.
        """
        return self.sentences(self.verdict(field, has_fiber, n_covering))

    def sentences(self, verdict: Verdict) -> list[str]:
        """Return the sentence of ``check`` for a verdict.

        Parameters
        ----------
        verdict : Verdict
            The verdict on a plan.

        Returns
        -------
        list of str
            The sentence; an empty list if the plan does not violate the rule, or if the rule is not checkable.
        """
        note = verdict.note if self.states_note else ""
        return [str(replace(verdict, note=note, fibers=()))] if verdict.verdict == FAIL else []

    def _not_checkable(self, why: str) -> Verdict:
        """Return the verdict that a plan lacks the data of the rule."""
        return Verdict(str(self), np.nan, NOT_CHECKABLE, NOT_CHECKABLE, why)

    def _lacks(self, field: ConstraintField, what: str) -> str:
        """Return the reason why targets of a kind or category are unknown in a plan; empty text if they are known."""
        for column in () if field.is_complete else self.columns:
            if column not in field.extra:
                return f"the plan does not have the column {column!r}"
        return "" if field.has_kinds or not what else "the plan does not have the kinds of its targets"

    def _concerns(self, field: ConstraintField, what: str) -> np.ndarray:
        """Return which targets are of a kind or category (any, if it is empty) and of the fiber type of the rule."""
        found = has_role(field.kind, what) | (field.category == what) if what else np.ones(len(field.id), dtype=bool)
        fiber = getattr(self, "fiber_type", "")
        # a target without a fiber type can have a fiber of any type
        return found & np.isin(field.fiber_type, ["", fiber]) if fiber else found

    def _magnitudes(self, field: ConstraintField) -> np.ndarray:
        """Return the magnitude of each target in the column of the rule; missing magnitudes are NaN."""
        return to_magnitudes(field.column(self.column), self.column)


def to_magnitudes(values: np.ndarray, name: str) -> np.ndarray:
    """Return the magnitudes in a column; missing magnitudes, such as -999 and 99.9, are NaN."""
    values = np.asarray(values)
    if values.dtype.kind not in "fiu":
        raise InputError(f"the column {name!r} must contain magnitudes, got values of the type {values.dtype.name}")
    with np.errstate(invalid="ignore"):
        return np.where((np.abs(values) < LARGEST) & (values != 0), values.astype(float), np.nan)


def check_unit(column: str, unit: str) -> None:
    """Raise an error if a column of magnitudes has a unit of another quantity; a unit is not required."""
    parsed = u.Unit(unit, parse_strict="silent")
    is_magnitude = parsed == u.mag or isinstance(parsed, u.MagUnit | u.UnrecognizedUnit)
    if unit and not is_magnitude:
        raise InputError(f"the column {column!r} must contain magnitudes, got values with the unit {unit}")


def check_number(value: object, name: str, low: float = -np.inf, high: float = np.inf) -> None:
    """Raise an error if the value of a rule is not a number between two limits; without limits, it can be infinite."""
    is_number = isinstance(value, int | float | np.number) and not isinstance(value, bool)
    if not (is_number and low <= value <= high):
        limits = f" from {low:g} to {high:g}" if np.isfinite(low) else ""
        raise refusal(f"{name} must be a number{limits}", value, int, float)


def check_limits(column: str, brightest: object, faintest: object) -> None:
    """Raise an error if the limits of the magnitude in a column are not numbers, or are reversed."""
    check_number(brightest, f"the brightest magnitude of {column!r}")
    check_number(faintest, f"the faintest magnitude of {column!r}")
    if not brightest < faintest:
        raise InputError(
            f"the brightest magnitude of {column!r} must be smaller than the faintest magnitude {faintest:g}, got "
            f"{brightest:g}"
        )


def check_text(value: object, name: str, *, empty: bool = False) -> None:
    """Raise an error if the value of a rule is not text."""
    if not isinstance(value, str) or not (value.strip() or empty):
        raise refusal(f"{name} must be text", value, str)
