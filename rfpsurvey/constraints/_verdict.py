"""The verdict on a finished plan: each rule with its number, its limit, and the fibers that violate it."""

from collections.abc import Iterable
from dataclasses import dataclass, field, fields, replace
from math import isfinite

import numpy as np
from astropy.table import Table

from rfpsurvey.constraints._group import Group
from rfpsurvey.errors import brief

PASS, FAIL, NOT_CHECKABLE = "pass", "fail", "not checkable"


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
        found = {one.name: getattr(self, one.name) for one in fields(self) if one.name != "rows"}
        number = float(self.number)
        return {**found, "number": number if isfinite(number) else None, "fibers": list(self.fibers)}


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
    rows = [[one[name] for name in names] for one in records]
    for row in rows:
        row[1], row[4] = np.nan if row[1] is None else row[1], " ".join(row[4])
    return Table(rows=rows or None, names=names, dtype=[str, float, str, str, str, str])


def count_verdicts(groups: Iterable[Group], numbers: Iterable[int]) -> list[Verdict]:
    """Return the verdict on each requirement for the number of fibers of each of its groups."""
    found = []
    for group, n in zip(groups, numbers, strict=True):
        one = group.requirement
        least, most = one.minimum, one.maximum
        limit = f"at least {least}" if most is None else f"{least} to {most}"
        place = group.place if group.spectrograph is None else f"spectrograph {group.spectrograph}"
        meets = least <= n and (most is None or n <= most)
        found.append(Verdict(str(one), n, limit, PASS if meets else FAIL, place))
    return found
