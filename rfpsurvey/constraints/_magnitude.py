"""The rule `MagnitudeLimits`: the brightest and the faintest allowed magnitude of targets in one band."""

from dataclasses import dataclass

import numpy as np

from rfpsurvey.constraints._constraint import ConstraintField
from rfpsurvey.constraints._requirement import hint_of_name
from rfpsurvey.constraints._rule import Rule, check_limits, check_text
from rfpsurvey.constraints._verdict import FAIL, PASS, Verdict
from rfpsurvey.errors import check_choice, check_keywords, number_of

NONE = "no fiber has such a target"
MISSING = ("allowed", "refused")


@check_keywords
@dataclass(frozen=True)
class MagnitudeLimits(Rule):
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

    column: str
    brightest: float
    faintest: float
    what: str = ""
    fiber_type: str = ""
    missing: str = "allowed"

    name = "magnitude"
    uses_targets = False

    def __post_init__(self):
        check_text(self.column, "the column of magnitude limits")
        for name in ("what", "fiber_type"):
            check_text(getattr(self, name), f"{name} of magnitude limits", empty=True)
        check_limits(self.column, self.brightest, self.faintest)
        check_choice(self.missing, MISSING, "treatment of missing magnitudes")

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
        found = self._concerns(field, self.what)
        return found if self.what else found & (field.kind != "sky")

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
