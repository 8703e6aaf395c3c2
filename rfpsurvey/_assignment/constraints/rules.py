"""The rules `MagnitudeLimits` and `Contrast` on magnitudes, and the rule `Distribution` on the positions of fibers."""

from dataclasses import dataclass

import numpy as np

from rfpsurvey._assignment.constraints.counts import hint_of_name
from rfpsurvey._assignment.constraints.field import FAIL, PASS, ConstraintField, Verdict
from rfpsurvey._assignment.constraints.rule import Rule, check_limits, limit_option
from rfpsurvey._common.settings import Checked, option
from rfpsurvey.errors import InputError, check_keywords, number_of

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


@check_keywords
@dataclass(frozen=True)
class Distribution(Checked, Rule):
    """A smallest percentage of the science fibers that have sky fibers (or standards) within a distance.

    ``optimal`` and ``repair`` follow the rule as a goal; other allocators only check it. SDSS-V compares the percentile
    of the distances with its limit; the public check of SDSS-V (mugatu) computes it for all fibers that are not of the
    kind, and takes the second neighbor if ``k`` exceeds 1.

    Parameters
    ----------
    what : str
        Kind or category of the neighbors, such as ``sky`` or ``standard``.
    k : int
        Number of neighbors that each science fiber must have.
    percent : float
        Percentage of the science fibers.
    distance_mm : float
        Largest distance on the focal plane in mm.
    fiber_type : str, optional
        Fiber type of the science fibers and of the neighbors; by default, any.

    Raises
    ------
    InputError
        If an argument is not valid.

    Examples
    --------
    >>> import rfpsurvey as rs
    >>> str(rs.constraints.Distribution("sky", 1, 95, 75, "BOSS"))
    'distribution sky 1 95 75 BOSS'
    """

    what: str = option(what="the kind of fibers of a distribution")
    k: int = option(what="k of a distribution")
    percent: float = option(low=0, high=100, what="percent of a distribution")
    distance_mm: float = option(low=0, high=1e6, what="distance_mm of a distribution")
    fiber_type: str = option("", what="fiber_type of a distribution")

    name = "distribution"

    def _check(self) -> None:
        if self.what == "science":
            raise InputError("the kind of fibers of a distribution must not be 'science', whose neighbors are counted")

    @property
    def distributions(self) -> tuple["Distribution"]:
        """The rule itself."""
        return (self,)

    def least(self, n: int) -> int:
        """Return how many science fibers of a plan must have neighbors.

        Parameters
        ----------
        n : int
            Number of science fibers.

        Returns
        -------
        int
            The percentage of ``n``, rounded up; whole numbers avoid rounding errors in comparisons.
        """
        # a product that rounding makes slightly larger than a whole number does not count as the next number
        return int(np.ceil(self.percent * n / 100 - 1e-9))

    def verdict(self, field: ConstraintField, has_fiber: np.ndarray, n_covering: int = 0) -> Verdict:
        """Return the percentage of the science fibers that have ``k`` neighbors within the distance.

        Parameters
        ----------
        field : ConstraintField
            The field.
        has_fiber : ndarray of bool
            Whether each target of the field has a fiber.
        n_covering : int, optional
            Number of arms that cover obstacles; not used.

        Returns
        -------
        Verdict
            The verdict; its note contains the percentiles of the distances (mm).
        """
        if why := self._lacks(field, self.what):
            return self._not_checkable(why)
        science = np.flatnonzero(has_fiber & self._concerns(field, "science"))
        near = np.flatnonzero(has_fiber & self._concerns(field, self.what))
        not_near = np.setdiff1d(np.flatnonzero(has_fiber & self._concerns(field, "")), near)
        if len(science) == 0:
            return self._not_checkable("the plan does not have a science fiber of this type")
        distance = self.distances(field.xy[science], field.xy[near], self.k)
        percent = 100 * np.mean(distance <= self.distance_mm)
        public = self.distances(field.xy[not_near], field.xy[near], min(self.k, 2))
        rank = "second-nearest" if self.k > 1 else "nearest"
        nth = {1: "nearest", 2: "second-nearest"}.get(self.k, f"neighbor {self.k}")
        note = (
            f"percentile {self.percent:g} of the distance to {nth}: {self._percentile(distance)}; public check of "
            f"SDSS-V (all fibers that are not {self.what}, {rank}): {self._percentile(public)}"
        )
        limit = f"at least {self.percent:g} % of {len(science)} fibers with {self.k} {self.what} within "
        limit += f"{self.distance_mm:g} mm"
        passes = np.sum(distance <= self.distance_mm) >= self.least(len(science))
        rows = np.empty(0, dtype=int) if passes else science[distance > self.distance_mm]
        return Verdict(str(self), percent, limit, PASS if passes else FAIL, note, rows=rows)

    @staticmethod
    def distances(points: np.ndarray, near: np.ndarray, k: int) -> np.ndarray:
        """Return the distances of points from their k-th neighbors.

        Parameters
        ----------
        points : ndarray of float, shape (n, 2)
            Positions in mm.
        near : ndarray of float, shape (m, 2)
            Positions of the neighbors in mm.
        k : int
            Number of the neighbor; 1 is the nearest.

        Returns
        -------
        ndarray of float, shape (n,)
            Distances in mm; infinite if there are fewer than k neighbors.
        """
        from scipy.spatial import cKDTree

        if len(near) < k or len(points) == 0:
            return np.full(len(points), np.inf)
        return cKDTree(near).query(points, k=[k])[0][:, 0]

    def _percentile(self, distances: np.ndarray) -> str:
        """Return the interpolated percentile of distances as text."""
        known = len(distances) and np.isfinite(distances).all()
        return f"{np.percentile(distances, self.percent):.3f} mm" if known else "too few fibers"
