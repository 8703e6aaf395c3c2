"""The rule `Contrast`: the largest difference of magnitude between fibers that are neighbors on the detector."""

from dataclasses import dataclass

import numpy as np

from rfpsurvey.constraints._constraint import ConstraintField
from rfpsurvey.constraints._rule import Rule, check_number, check_text
from rfpsurvey.constraints._verdict import FAIL, PASS, Verdict
from rfpsurvey.errors import check_keywords, number_of


@check_keywords
@dataclass(frozen=True)
class Contrast(Rule):
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

    column: str
    largest: float
    fiber_type: str = ""
    order: str = "fiberId"

    name = "contrast"
    uses_targets = False

    def __post_init__(self):
        check_text(self.column, "the column of the contrast")
        check_text(self.fiber_type, "fiber_type of the contrast", empty=True)
        check_text(self.order, "the column with the order on the slit")
        check_number(self.largest, "the largest contrast", 0, 1e3)

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
