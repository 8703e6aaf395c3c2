"""The field that constraints receive, and the verdicts that they return: numbers, limits, and violating fibers."""

from collections.abc import Iterable
from dataclasses import dataclass, field, fields, replace
from math import isfinite
from typing import TYPE_CHECKING

import numpy as np
from astropy.table import Table

from rfpsurvey._common.units import values_at
from rfpsurvey._sky.projection import FieldProjection
from rfpsurvey.errors import InputError, brief, listed

if TYPE_CHECKING:
    from rfpsurvey._instruments.instrument import Instrument

PASS, FAIL, NOT_CHECKABLE = "pass", "fail", "not checkable"


@dataclass(frozen=True, eq=False)
class ConstraintField:
    """The targets in a field and near its edge, as constraints receive them; arrays have one element per target.

    Parameters
    ----------
    instrument : Instrument
        The instrument.
    projection : FieldProjection or None
        Projection of the sky onto the focal plane; None if only positions on the focal plane are known.
    vectors : ndarray of float, shape (n, 3)
        Directions of the targets as ICRS unit vectors; NaN if they are not known.
    xy : ndarray of float, shape (n, 2)
        Positions of the targets on the focal plane in mm; NaN for targets outside the image.
    id : ndarray
        Identifiers of the targets (integers or text).
    is_available : ndarray of bool
        Whether each target can be observed in this field. The other targets are outside the field, or have no
        remaining visits; a constraint can exclude targets that are close to them.
    kind : ndarray of str
        Kind of each target: ``science``, ``standard`` or ``sky``.
    category : ndarray of str
        Category of each target; empty text if it has none.
    priority : ndarray of float
        Priority of each target.
    extra : dict
        Further columns of the catalog, by name.
    is_complete : bool, optional
        Whether the field contains all targets of the catalog in the field; False if only the targets are known that
        have a fiber, as in the plan of another program.
    has_kinds : bool, optional
        Whether the kinds of the targets are known; False for the plan of another program that does not contain them.
    fiber_type : ndarray of str, optional
        Fiber type that each target requires, or has in a finished plan; empty text if it is not known. By default, it
        is not known.
    is_added : ndarray of bool, optional
        Whether each target is a sky position that is not in the catalog; its identifier has no meaning.
    """

    instrument: "Instrument"
    projection: FieldProjection | None
    vectors: np.ndarray
    xy: np.ndarray
    id: np.ndarray
    is_available: np.ndarray
    kind: np.ndarray
    category: np.ndarray
    priority: np.ndarray
    extra: dict
    is_complete: bool = True
    has_kinds: bool = True
    fiber_type: np.ndarray | None = None
    is_added: np.ndarray | None = None

    def __post_init__(self):
        for name, usual in (("fiber_type", ""), ("is_added", False)):
            if getattr(self, name) is None:
                object.__setattr__(self, name, np.broadcast_to(usual, len(self.id)))

    def column(self, name: str) -> np.ndarray:
        """Return a further column of the catalog, such as a magnitude.

        Parameters
        ----------
        name : str
            Name of the column.

        Returns
        -------
        ndarray
            One value per target; NaN, empty text, False or -1 for a sky position that rfpsurvey adds.

        Raises
        ------
        InputError
            If the catalog has no column of this name.
        """
        if name not in self.extra:
            known = f"{listed(self.extra, 8)} (further columns are read by keep= or --set catalog.keep=NAME)"
            raise InputError(f"the catalog must have the column {name!r}, but its further columns are: {known}")
        return self.extra[name]

    def is_near(self, centers: np.ndarray, radius_rad: float) -> np.ndarray:
        """Return whether each target is within an angle of at least one of several directions.

        Parameters
        ----------
        centers : ndarray of float, shape (k, 3)
            Unit vectors.
        radius_rad : float
            The angle in radians.

        Returns
        -------
        ndarray of bool
            One value per target.
        """
        from scipy.spatial import cKDTree

        near, there = np.zeros(len(self.vectors), dtype=bool), np.isfinite(self.vectors).all(axis=1)
        centers = centers[np.isfinite(centers).all(axis=1)]
        if len(centers) and there.any():
            near[there] = cKDTree(centers).query(self.vectors[there])[0] <= 2 * np.sin(min(radius_rad, np.pi) / 2)
        return near

    def with_blank_sky(
        self, vectors: np.ndarray, xy: np.ndarray, fiber_type: np.ndarray | None = None
    ) -> "ConstraintField":
        """Return the field with additional available targets of the kind ``sky``, which have no other properties.

        Parameters
        ----------
        vectors : ndarray of float, shape (k, 3)
            Directions of the sky positions.
        xy : ndarray of float, shape (k, 2)
            Positions on the focal plane in mm.
        fiber_type : ndarray of str, shape (k,), optional
            Fiber type that each sky position requires; by default, it is not known.

        Returns
        -------
        ConstraintField
            The field, whose last k targets are the sky positions.
        """
        rows = np.append(np.arange(len(self.id)), np.full(len(xy), -1))
        columns = {name: values_at(getattr(self, name), rows) for name in ("id", "category", "priority")}
        columns["extra"] = {name: values_at(values, rows) for name, values in self.extra.items()}
        more = {"vectors": vectors, "xy": xy, "is_available": np.ones(len(xy), bool), "kind": np.full(len(xy), "sky")}
        more["is_added"] = np.ones(len(xy), dtype=bool)
        more["fiber_type"] = np.full(len(xy), "") if fiber_type is None else fiber_type
        columns.update((name, np.concatenate([getattr(self, name), values])) for name, values in more.items())
        return replace(self, **columns)


@dataclass(frozen=True)
class Verdict:
    """Whether a plan complies with a rule.

    Parameters
    ----------
    rule : str
        Text of the constraint.
    number : float
        The number that is compared with the limit; NaN if the plan lacks the data from which it is computed.
    limit : str
        Text of the limit, such as ``at least 50``.
    verdict : {"pass", "fail", "not checkable"}
        The verdict. A rule whose number cannot be computed is not checkable.
    note : str, optional
        Further numbers, or the reason why the rule is not checkable.
    fibers : tuple of str, optional
        Identifiers of the positioners whose fibers violate the rule.
    rows : ndarray of int, optional
        Rows of the targets of the field that violate the rule.

    Examples
    --------
    >>> import rfpsurvey as rs
    >>> print(rs.constraints.Verdict("sky=20", 18, "at least 20", "fail"))
    sky=20: 18 (at least 20)
    """

    rule: str
    number: float
    limit: str
    verdict: str
    note: str = ""
    fibers: tuple[str, ...] = ()
    rows: np.ndarray = field(default_factory=lambda: np.empty(0, dtype=int), repr=False, compare=False)

    def __str__(self):
        number = f"{self.number:.6g} ({self.limit})" if isfinite(self.number) else self.limit
        note = f"; {self.note}" if self.note else ""
        fibers = f"; positioners {brief(self.fibers)}" if self.fibers else ""
        return f"{self.rule}: {number}{note}{fibers}"

    def unknown(self, why: str) -> "Verdict":
        """Return the verdict that the rule is not checkable.

        Parameters
        ----------
        why : str
            The reason.

        Returns
        -------
        Verdict
            The verdict, without a number.
        """
        return replace(self, number=float("nan"), verdict=NOT_CHECKABLE, note=why, fibers=(), rows=self.rows[:0])

    @property
    def record(self) -> dict:
        """The verdict as numbers and text, in the form in which results store it."""
        content = {field.name: getattr(self, field.name) for field in fields(self) if field.name != "rows"}
        number = float(self.number)
        return {**content, "number": number if isfinite(number) else None, "fibers": list(self.fibers)}


def verdict_table(records: Iterable[dict]) -> Table:
    """Return a table with a row for each verdict.

    Parameters
    ----------
    records : iterable of dict
        Verdicts in the form of `Verdict.record`.

    Returns
    -------
    Table
        Table with the columns rule, number (NaN if the rule is not checkable), limit, verdict, fibers and note.
    """
    names = ("rule", "number", "limit", "verdict", "fibers", "note")
    rows = [[record[name] for name in names] for record in records]
    for row in rows:
        row[1], row[4] = np.nan if row[1] is None else row[1], " ".join(row[4])
    return Table(rows=rows or None, names=names, dtype=[str, float, str, str, str, str])
