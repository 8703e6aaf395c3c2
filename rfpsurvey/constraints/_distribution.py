"""The rule `Distribution`: sky fibers or standards close to the science fibers, over the whole focal plane."""

from dataclasses import dataclass

import numpy as np

from rfpsurvey._settings import Checked, option
from rfpsurvey.constraints._field import FAIL, PASS, ConstraintField, Verdict
from rfpsurvey.constraints._rule import Rule
from rfpsurvey.errors import InputError, check_keywords


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
