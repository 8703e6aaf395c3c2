"""The rule `GuideStars`: numbers of stars on the guide and focus cameras of an instrument."""

from copy import copy
from dataclasses import dataclass
from typing import ClassVar

import astropy.units as u
import numpy as np

from rfpsurvey._settings import option
from rfpsurvey.catalog import Catalog
from rfpsurvey.constraints._field import FAIL, PASS, ConstraintField, Verdict
from rfpsurvey.constraints._rule import StarRule, check_limits, limit_option
from rfpsurvey.errors import InputError, check_choice, check_keywords, listed, number_of, refusal

BEYOND = 1.1
"""Factor by which radial maps are continued beyond their largest field angle, because cameras can be there."""
MARGIN = 1.1
"""Factor for the field angle of cameras that allows for refraction, and for stars next to a camera."""
NEAR = 2.0
"""Field angle of the stars that are considered, divided by that of the farthest corner of a camera."""
MOST_CAMERAS = 3


@check_keywords
@dataclass(frozen=True)
class GuideStars(StarRule):
    """Numbers of stars between two magnitudes on each guide or focus camera, or on one camera.

    The rule depends on field center, position angle and stars only, so that plans state violations before fibers are
    assigned. Magnitudes that equal a limit are outside the limits. The images of stars are those of the first fiber
    type; radial maps are continued by 10 % beyond their largest field angle, because cameras can be there. Rows at the
    same position are one star.

    Parameters
    ----------
    column : str
        Column with the magnitude of the stars; stars with a missing magnitude do not count.
    brightest, faintest : float
        Limits of the magnitude; ``-inf`` and ``inf`` for no limit.
    minimum : int
        Smallest number of stars on each camera.
    maximum : int or float, optional
        Largest number of stars on each camera; with 0 and ``brightest`` of ``-inf``, no star is brighter than
        ``faintest``.
    camera : str, optional
        Name of a camera of the instrument; by default, the rule applies to each camera.
    stars : Catalog or str, optional
        Catalog with the stars, or the path of its file; its proper motions are not applied (see
        `rfpsurvey.Catalog.at_epoch`). By default, the stars are all targets that are not sky positions.

    Raises
    ------
    InputError
        If an argument is not valid, or if the catalog with the stars does not have the column.

    Examples
    --------
    >>> import rfpsurvey as rs
    >>> str(rs.constraints.GuideStars("gaia_g", 12, 19, 5))
    'guide_stars gaia_g 12 19 5'
    >>> str(rs.constraints.GuideStars("gaia_g", -np.inf, 8, 0, 0, camera="gfa3"))
    'guide_stars gaia_g -inf 8 0 0 gfa3'
    """

    column: str = option(what="the column of guide stars")
    brightest: float = limit_option()
    faintest: float = limit_option()
    minimum: int = option(low=0, what="the minimum of guide stars")
    maximum: float = limit_option(np.inf)
    camera: str = option("", what="the camera of guide stars")
    stars: Catalog | str | None = option(None, words="a Catalog or the path of its file")

    name = "guide_stars"
    before_fibers = True
    states_note = True
    _cameras: ClassVar[dict] = {}
    _farthest: ClassVar[float] = 0.0

    def _check(self) -> None:
        check_limits(self)
        maximum = self.maximum
        fits = isinstance(maximum, int | float | np.number) and maximum >= self.minimum
        if not fits or isinstance(maximum, bool) or (np.isfinite(maximum) and maximum % 1):
            what = f"the maximum of guide stars must be a whole number of at least {self.minimum}, or inf"
            raise refusal(what, maximum, int, float)
        object.__setattr__(self, "maximum", int(maximum) if np.isfinite(maximum) else np.inf)
        if self.minimum == 0 and self.maximum == np.inf:
            raise InputError("guide stars must have a minimum above 0 or a maximum, got neither")
        super()._check()

    def for_instrument(self, instrument: object) -> "GuideStars":
        """Return the rule with the cameras of an instrument.

        Parameters
        ----------
        instrument : Instrument or None
            The instrument; None if only positions on the focal plane are known.

        Returns
        -------
        GuideStars
            The rule.

        Raises
        ------
        InputError
            If the instrument does not have the camera or has no cameras, or if there is no instrument.
        """
        constraint = copy(super().for_instrument(instrument))
        cameras = instrument.cameras
        if not cameras:
            remedy = "describe them in the section [cameras] of its TOML file"
            raise InputError(f"the rule '{self}' needs cameras, but {instrument.name} has none; {remedy}")
        if self.camera:
            check_choice(self.camera, cameras, f"camera of {instrument.name}")
            cameras = {self.camera: cameras[self.camera]}
        image, corners = instrument.field_projection(0.0, 0.0, 0.0).beyond(BEYOND), np.vstack(list(cameras.values()))
        angle = np.arccos(np.clip(image.unproject(corners)[:, 0], -1, 1))
        angle = np.where(np.isnan(angle), np.hypot(*corners.T) / image.focal_length, angle).max()
        margin = MARGIN * angle - instrument.field_radius.to_value(u.rad) if self.stars is None else 0.0
        constraint.__dict__.update(_cameras=cameras, _farthest=angle, margin_rad=float(np.clip(margin, 0, np.pi)))
        return constraint

    def _verdict(self, field: ConstraintField, has_fiber: np.ndarray) -> Verdict:
        """Return the smallest (or, if there are too many stars, the largest) number of stars on a camera."""
        if self.stars is None and not field.is_complete:
            return self._not_checkable("the plan contains only stars that have a fiber; give a catalog of stars")
        if field.projection is None:
            return self._not_checkable("the field center is unknown; give positions='sky' (or --positions sky)")
        m, vectors, _ = self._stars(field)
        if len(m) == 0:
            return self._not_checkable(f"no star has a magnitude in the column {self.column!r}")
        near = vectors @ field.projection.basis[2] > np.cos(min(NEAR * self._farthest, np.pi / 2))
        m, xy = m[near], field.projection.beyond(BEYOND).project(vectors[near])
        apart = {name: distances(xy, corners) for name, corners in self._cameras.items()}
        fits = (m > self.brightest) & (m < self.faintest)
        # a star can have several rows, such as one for each fiber type
        counts = {name: len(np.unique(xy[fits & (d == 0)], axis=0)) for name, d in apart.items()}
        wrong = {name: n for name, n in counts.items() if not self.minimum <= n <= self.maximum}
        stars_of = wrong or counts
        largest, smallest = max(stars_of.values()), min(stars_of.values())
        number = largest if largest > self.maximum or self.minimum == 0 else smallest
        parts = [f"{name} has {n}" for name, n in counts.items()]
        if wrong:
            parts = [f"{name} has {n}{self._next(n, m, fits, apart[name])}" for name, n in wrong.items()]
        note = listed(parts, MOST_CAMERAS if wrong else None)
        return Verdict(str(self), number, self._limit(), FAIL if wrong else PASS, note)

    def _limit(self) -> str:
        """Return the text of the limit."""
        limits = {"brightest": self.brightest, "faintest": self.faintest}
        words = {"brightest": "fainter than", "faintest": "brighter than"}
        between = [f"{words[name]} {value:g}" for name, value in limits.items() if np.isfinite(value)]
        number = f"at least {number_of(self.minimum, 'star')}" if self.minimum else ""
        if np.isfinite(self.maximum):
            most = f"at most {number_of(self.maximum, 'star')}" if self.maximum else "no star"
            number += f" and {most}" if number else most
        where = f"camera {self.camera}" if self.camera else "each camera"
        return " ".join([number, *([" and ".join(between)] if between else []), "on", where])

    def _next(self, n: int, m: np.ndarray, fits: np.ndarray, apart: np.ndarray) -> str:
        """Return text on the star that is closest to the limits of a camera, from the distances of all stars in mm."""
        on = apart == 0
        if n > self.maximum:
            return f" (magnitudes {listed([f'{magnitude:.4g}' for magnitude in np.sort(m[fits & on])], 3)})"
        texts, outside = [], np.isfinite(apart) & fits & ~on
        if outside.any():
            texts.append(f"the next star is {apart[outside].min():.3g} mm away from it")
        magnitudes = m[on & ~fits]
        if len(magnitudes):
            gap = np.maximum(self.brightest - magnitudes, magnitudes - self.faintest)
            texts.append(f"the next star on it has magnitude {magnitudes[np.argmin(gap)]:.4g}")
        return f" ({' and '.join(texts) or 'no other star is known'})"


def distances(points: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Return the distance of points from a polygon, which is 0 for points inside, and infinite for NaN."""
    nearest, inside = np.full(len(points), np.inf), np.zeros(len(points), dtype=bool)
    rows = np.flatnonzero(np.isfinite(points).all(axis=1))
    x, y = points[rows].T
    for (x0, y0), (x1, y1) in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        squared = (x1 - x0) ** 2 + (y1 - y0) ** 2 or 1.0  # a corner can be repeated, as in a closed polygon
        along = np.clip(((x - x0) * (x1 - x0) + (y - y0) * (y1 - y0)) / squared, 0, 1)
        nearest[rows] = np.minimum(nearest[rows], np.hypot(x - x0 - along * (x1 - x0), y - y0 - along * (y1 - y0)))
        # even-odd rule: whether a ray along the x axis crosses the edge
        crosses = (y0 > y) != (y1 > y)
        if y1 != y0:
            inside[rows] ^= crosses & (x < x0 + (y - y0) * (x1 - x0) / (y1 - y0))
    return np.where(inside, 0.0, nearest)
