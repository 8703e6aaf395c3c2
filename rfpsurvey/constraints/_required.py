"""The constraint `Required`: targets that take precedence over all other targets."""

import shlex
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from rfpsurvey._units import to_labels, to_plain
from rfpsurvey.constraints._constraint import Constraint
from rfpsurvey.constraints._field import FAIL, PASS, ConstraintField, Verdict
from rfpsurvey.errors import InputError, InputTypeError, brief, check_keywords, short


@check_keywords
@dataclass(frozen=True)
class Required(Constraint):
    """Targets, of any kind, that take precedence over all other targets.

    ``nearest`` and ``lamost_rule`` assign required targets as a class before all other classes; ``network_flow`` and
    ``optimal`` assign as many of them as possible; ``repair`` assigns the required targets for which its local moves
    find a positioner; ``balanced`` does not use this constraint. Required targets without a fiber are reported.

    Parameters
    ----------
    ids : array_like of int or str
        Identifiers of the targets.

    Raises
    ------
    InputError
        If there are no identifiers, or if they are neither integers nor text.

    Examples
    --------
    >>> import rfpsurvey as rs
    >>> str(rs.Required(["star 7", "star 8"]))
    "required 'star 7' 'star 8'"
    """

    ids: tuple[int, ...] | tuple[str, ...] | list | np.ndarray | int | str

    name = "required"
    uses_targets = False

    def __post_init__(self):
        ids = as_required(self.ids)
        if not ids:
            raise InputError(f"required targets must have at least one identifier, got {short(self.ids)}")
        object.__setattr__(self, "ids", ids)

    @classmethod
    def parse(cls, arguments: str) -> "Required":
        """Make the constraint from text.

        Parameters
        ----------
        arguments : str
            Identifiers, separated by spaces; quotes surround identifiers that contain spaces.

        Returns
        -------
        Required
            The constraint.

        Raises
        ------
        InputError
            If the text contains no identifier, or if a quote is not closed.
        """
        try:
            names = shlex.split(arguments)
        except ValueError as error:
            raise InputError(f"required must have the form 'required ID ...', got {arguments!r}: {error}") from None
        if not names:
            raise InputError(f"required must have the form 'required ID ...', got {arguments!r}")
        return cls(names)

    def __str__(self):
        return " ".join([self.name, *(shlex.quote(str(name)) for name in self.ids)])

    @property
    def required_ids(self) -> tuple:
        """Identifiers of targets that take precedence over all other targets."""
        return self.ids

    def _refuse_focal_plane(self) -> None:
        raise InputError(
            f"ids of required targets can be used only with a catalog, got {brief(self.ids)}; use "
            "plan_tile, or pass rows of targets as the argument required of allocate"
        )

    def check(self, field: ConstraintField, has_fiber: np.ndarray, n_covering: int) -> list[str]:
        """Return a sentence on the required targets outside the field.

        Parameters
        ----------
        field : ConstraintField
            The field.
        has_fiber : ndarray of bool
            Whether each target of the field has a fiber.
        n_covering : int
            Number of arms that cover obstacles of the constraint.

        Returns
        -------
        list of str
            The sentence; an empty list if all required targets are in the field.
        """
        there = are_among(self.ids, field.id[field.is_available]).tolist()
        outside = tuple(name for name, is_there in zip(self.ids, there, strict=True) if not is_there)
        where = "outside the field" if field.is_complete else "without a fiber"
        return [f"required targets {where}: {brief(outside)}"] if outside else []

    def verdict(self, field: ConstraintField, has_fiber: np.ndarray, n_covering: int) -> Verdict:
        """Return the verdict on a finished plan, which fails unless all required targets have a fiber.

        Parameters
        ----------
        field : ConstraintField
            The field.
        has_fiber : ndarray of bool
            Whether each target of the field has a fiber.
        n_covering : int
            Number of arms that cover obstacles of the constraint.

        Returns
        -------
        Verdict
            The verdict, with the number of required targets without a fiber.
        """
        given = ~field.is_added
        observed = are_among(self.ids, field.id[given & has_fiber])
        observed &= ~are_among(self.ids, field.id[given & field.is_available & ~has_fiber])  # ids can be repeated
        without = tuple(name for name, is_observed in zip(self.ids, observed.tolist(), strict=True) if not is_observed)
        note = f"without a fiber: {brief(without)}" if without else ""
        return Verdict(str(self), len(without), "no target without a fiber", FAIL if without else PASS, note)


def as_required(required: object) -> tuple[int, ...] | tuple[str, ...]:
    """Return the distinct identifiers of required targets in the given order; all are integers or all are text."""
    given = np.atleast_1d(to_plain([] if required is None else required, "required", "ids of targets"))
    if given.size == 0:
        return ()
    names = to_labels(given, "required")
    if given.dtype.kind == "b":
        raise InputTypeError("required must contain ids of targets (integers or text), got booleans")
    if names.ndim != 1:
        raise InputError(f"required must be a one-dimensional list of target ids, got the shape {names.shape}")
    if "" in names.tolist():
        raise InputError("required must contain ids of targets that are not empty, got ''")
    return tuple(dict.fromkeys(names.tolist()))


def mark_required(required: tuple, parts: Iterable[np.ndarray]) -> np.ndarray | None:
    """Return whether each target of a catalog is required, or None if no targets are required.

    The catalog may consist of several parts; ``parts`` contains an array with the identifiers of each part.
    """
    if not required:
        return None
    marked, known = [], np.zeros(len(required), dtype=bool)
    names = np.array(required)
    for ids in parts:
        wanted, comparable = _alike(names, ids)
        marked.append(np.isin(ids, wanted[comparable]))
        known |= comparable & np.isin(wanted, ids[marked[-1]])
    if not known.all():
        strange = names[~known]
        raise InputError(
            f"required must hold ids of the catalog, got {strange[0]} ({len(strange)} of {len(names)} unknown)"
        )
    return np.concatenate(marked)


def are_among(required: tuple, ids: np.ndarray) -> np.ndarray:
    """Return whether each required identifier is one of ``ids``."""
    wanted, comparable = _alike(np.array(required), ids)
    return comparable & np.isin(wanted, ids)


def _alike(names: np.ndarray, ids: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return names with the type of ``ids`` (integers or text), and a mask of the names that can be converted."""
    if names.dtype.kind == ids.dtype.kind:
        return names, np.ones(len(names), dtype=bool)
    if ids.dtype.kind == "U":
        return names.astype(str), np.ones(len(names), dtype=bool)
    # Names from the command line are text, but identifiers of a catalog can be integers.
    numbers = np.zeros(len(names), dtype=np.int64)
    comparable = np.zeros(len(names), dtype=bool)
    for k, name in enumerate(names.tolist()):
        try:
            numbers[k] = int(name)
        except (ValueError, OverflowError):
            continue
        comparable[k] = str(numbers[k]) == name
    return numbers, comparable
