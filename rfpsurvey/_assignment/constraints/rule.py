"""The base classes of the rules of observatories: a rule has a number and a limit, and can refer to stars."""

from dataclasses import MISSING, fields, replace
from functools import cached_property
from hashlib import sha256
from shlex import quote
from typing import Any, ClassVar

import astropy.units as u
import numpy as np

from rfpsurvey._assignment.constraints.constraint import Constraint
from rfpsurvey._assignment.constraints.field import FAIL, NOT_CHECKABLE, ConstraintField, Verdict
from rfpsurvey._common.plugins import name_of
from rfpsurvey._common.settings import Checked, option
from rfpsurvey._sky.arrays import has_role
from rfpsurvey._sky.catalog import Catalog
from rfpsurvey.errors import InputError, check_fiber_type, listed, refusal

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
        if fiber := getattr(self, "fiber_type", ""):
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
        mask = has_role(field.kind, what) | (field.category == what) if what else np.ones(len(field.id), dtype=bool)
        fiber = getattr(self, "fiber_type", "")
        # a target without a fiber type can have a fiber of any type
        return mask & np.isin(field.fiber_type, ["", fiber]) if fiber else mask

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


def check_limits(rule: Rule) -> None:
    """Raise an error if the limits of magnitudes of a rule are not numbers, which can be infinite, or are reversed."""
    for name in ("brightest", "faintest"):
        value = getattr(rule, name)
        if not isinstance(value, int | float | np.number) or isinstance(value, bool) or np.isnan(value):
            raise refusal(f"the {name} magnitude of {rule.column!r} must be a number", value, int, float)
    if not rule.brightest < rule.faintest:
        raise InputError(
            f"the brightest magnitude of {rule.column!r} must be smaller than the faintest magnitude "
            f"{rule.faintest:g}, got {rule.brightest:g}"
        )


def limit_option(default: object = MISSING) -> Any:
    """Return a field of a rule for a number that can be infinite, which `_check` of the rule checks."""
    return option(default, convert=lambda value: value)


class StarRule(Checked, Rule):
    """A rule with the fields ``column``, the magnitude of stars, and ``stars``, their catalog, its path or None."""

    def _check(self) -> None:
        """Raise an error if the stars are not a catalog with the column; an empty path stands for no catalog."""
        if self.stars == "":
            object.__setattr__(self, "stars", None)
        if self.stars is not None and self.column not in self._catalog.arrays.extra:
            known = listed(self._catalog.arrays.extra, 8)
            raise InputError(f"the catalog of stars must have the column {self.column!r}, but its columns are: {known}")
        if self.stars is not None:
            check_unit(self.column, self._catalog.arrays.extra_units[self.column])

    def __str__(self):
        values = [(getattr(self, field.name), field.default) for field in fields(self)]
        while values and values[-1][0] == values[-1][1]:
            values.pop()
        words = [self._digest if isinstance(value, Catalog) else value for value, _ in values]
        words = [name_of(word) if callable(word) else "" if word is None else str(word) for word in words]
        return " ".join([self.name, *map(quote, words)])

    @cached_property
    def _catalog(self) -> Catalog:
        """The catalog with the stars."""
        return Catalog.read(self.stars, keep=[self.column]) if isinstance(self.stars, str) else self.stars

    @cached_property
    def _digest(self) -> str:
        arrays = self._catalog.arrays
        digest = sha256(arrays.vectors.tobytes() + np.asarray(arrays.extra[self.column]).tobytes()).hexdigest()
        return f"{len(self._catalog)} stars, digest {digest[:16]}"

    @property
    def content(self) -> str:
        """The number and a digest of the stars of a second catalog; empty text if the stars are targets."""
        return "" if self.stars is None else self._digest

    @property
    def columns(self) -> tuple[str, ...]:
        """Columns of the catalog that the rule uses; none if the stars are those of a second catalog."""
        return super().columns if self.stars is None else ()

    @property
    def uses_targets(self) -> bool:
        """Whether the stars are targets of the catalog, also outside the field."""
        return self.stars is None

    def _stars(self, field: ConstraintField) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
        """Return magnitudes and directions of all stars with both, and their identifiers if they are targets."""
        if self.stars is None:
            m, vectors, ids = np.where(field.kind == "sky", np.nan, self._magnitudes(field)), field.vectors, field.id
        else:
            arrays = self._catalog.arrays
            m, vectors, ids = to_magnitudes(arrays.extra[self.column], self.column), arrays.vectors, None
        rows = np.flatnonzero(np.isfinite(m) & np.isfinite(vectors).all(axis=1))
        return m[rows], vectors[rows], None if ids is None else ids[rows]
