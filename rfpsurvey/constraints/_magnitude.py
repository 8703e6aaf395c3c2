"""The rules `MagnitudeLimits` and `Contrast`, on the magnitudes of targets and of neighbors on the detector."""

from dataclasses import dataclass

import numpy as np

from rfpsurvey._settings import Checked, option
from rfpsurvey.constraints._counts import hint_of_name
from rfpsurvey.constraints._field import FAIL, PASS, ConstraintField, Verdict
from rfpsurvey.constraints._rule import Rule, check_limits, limit_option
from rfpsurvey.errors import check_keywords, number_of

NONE = "no fiber has such a target"
MISSING = ("allowed", "refused")


@check_keywords
@dataclass(frozen=True)
class MagnitudeLimits(Checked, Rule):
    """Limits of the magnitude of targets in one band; targets that are not between them are excluded.

    Magnitudes that equal a limit are outside the limits, as in the check of designs by SDSS-V. NaN, 0 and values of at
    least 90 or at most -90, such as -999 and 99.9, are missing magnitudes.

    Parameters
    ----------
    column : str
        Column of the catalog with the magnitude.
    brightest, faintest : float
        Limits of the magnitude; ``-inf`` and ``inf`` for no limit.
    what : str, optional
        Kind or category of the targets, such as ``standard``; by default, all targets.
    fiber_type : str, optional
        Fiber type that the targets require; by default, any.
    missing : {"allowed", "refused"}, optional
        Whether targets with a missing magnitude can be observed.

    Raises
    ------
    InputError
        If the limits are not numbers or are reversed, or if another argument is not valid.

    Examples
    --------
    >>> import rfpsurvey as rs
    >>> str(rs.constraints.MagnitudeLimits("h", 7, 13, "standard", "APOGEE"))
    'magnitude h 7 13 standard APOGEE allowed'
    """

    column: str = option(what="the column of magnitude limits")
    brightest: float = limit_option()
    faintest: float = limit_option()
    what: str = option("", what="what of magnitude limits")
    fiber_type: str = option("", what="fiber_type of magnitude limits")
    missing: str = option("allowed", choices=MISSING, what="treatment of missing magnitudes")

    name = "magnitude"
    uses_targets = False

    def _check(self) -> None:
        check_limits(self)

    def excluded(self, field: ConstraintField) -> np.ndarray | None:
        """Return which targets are outside the limits.

        Parameters
        ----------
        field : ConstraintField
            The field.

        Returns
        -------
        ndarray of bool or None
            One value per target; None if a plan of another program lacks the data.
        """
        if self._lacks(field, self.what):
            return None
        m = self._magnitudes(field)
        with np.errstate(invalid="ignore"):
            outside = np.isnan(m) if self.missing == "refused" else np.zeros(len(m), dtype=bool)
            outside |= (m <= self.brightest) | (m >= self.faintest)
        return outside & self._concerned(field)

    def _concerned(self, field: ConstraintField) -> np.ndarray:
        """Return which targets have limits; sky positions have no magnitude, and have limits only on request."""
        concerned = self._concerns(field, self.what)
        return concerned if self.what else concerned & (field.kind != "sky")

    def _verdict(self, field: ConstraintField, has_fiber: np.ndarray) -> Verdict:
        """Return the number of fibers whose targets are outside the limits; its note states the known magnitudes."""
        if why := self._lacks(field, self.what):
            return self._not_checkable(why)
        mine = has_fiber & self._concerned(field)
        n, known = int(mine.sum()), int((np.isfinite(self._magnitudes(field)) & mine).sum())
        if n == 0:
            hint = hint_of_name(self.what, np.unique(field.category).tolist()) if self.what else ""
            return self._not_checkable(f"{NONE}; {hint}" if hint else NONE)
        if known == 0 and self.missing == "allowed":
            return self._not_checkable(f"{number_of(n, 'such target')}, none of them with a magnitude")
        rows = np.flatnonzero(self.excluded(field) & has_fiber)
        limits = {f"at most {self.brightest:g}": self.brightest, f"at least {self.faintest:g}": self.faintest}
        words = [text for text, value in limits.items() if np.isfinite(value)]
        words += ["missing"] if self.missing == "refused" else []
        limit = f"no {self.column} of {' or '.join(words)}"
        note = f"{known} of {number_of(n, 'target')} with a magnitude"
        return Verdict(str(self), len(rows), limit, FAIL if len(rows) else PASS, note, rows=rows)


@check_keywords
@dataclass(frozen=True)
class Contrast(Checked, Rule):
    """The largest difference of magnitude between two fibers that are neighbors on the slit.

    The rule is only checked, and only in plans that contain the order on the slit: two fibers are neighbors if their
    numbers in the column ``order`` differ by 1. Fibers without a magnitude, such as sky fibers, are ignored.

    Parameters
    ----------
    column : str
        Column with the magnitude.
    largest : float
        Largest allowed difference of magnitude.
    fiber_type : str, optional
        Fiber type; by default, all fibers are on one slit.
    order : str, optional
        Column with the numbers of the fibers on the slit.

    Raises
    ------
    InputError
        If an argument is not valid.

    Examples
    --------
    >>> import rfpsurvey as rs
    >>> str(rs.constraints.Contrast("h", 5, "APOGEE"))
    'contrast h 5 APOGEE fiberId'
    """

    column: str = option(what="the column of the contrast")
    largest: float = option(low=0, high=1e3, what="the largest contrast")
    fiber_type: str = option("", what="fiber_type of the contrast")
    order: str = option("fiberId", what="the column with the order on the slit")

    name = "contrast"
    uses_targets = False

    def _verdict(self, field: ConstraintField, has_fiber: np.ndarray) -> Verdict:
        """Return the largest difference of magnitude between neighbors on the slit, and the number of pairs."""
        if why := self._lacks(field, ""):
            return self._not_checkable(why)
        if self.order not in field.extra or field.is_complete:  # the numbers in a catalog are not those of the fibers
            return self._not_checkable(f"the order on the slit (column {self.order!r}) is unknown")
        m, number = self._magnitudes(field), np.asarray(field.extra[self.order])
        rows = np.flatnonzero(has_fiber & self._concerns(field, "") & np.isfinite(m) & (number >= 0))
        rows = rows[np.argsort(number[rows], kind="stable")]
        first = np.flatnonzero(np.diff(number[rows]) == 1)
        if len(first) == 0:
            return self._not_checkable("the plan does not have neighbors on the slit with magnitudes")
        step = np.abs(np.diff(m[rows]))[first]
        wrong = first[step > self.largest]
        rows = np.unique(np.append(rows[wrong], rows[wrong + 1]))
        note = f"{number_of(len(first), 'pair')} of neighbors, {len(wrong)} of them above the limit"
        limit = f"difference of magnitude of at most {self.largest:g}"
        return Verdict(str(self), step.max(), limit, FAIL if len(wrong) else PASS, note, rows=rows)
