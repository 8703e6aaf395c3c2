"""Rules on stars: `BrightStars`, which excludes fibers close to bright stars, and `GuideStars`, which counts stars."""

from collections.abc import Callable
from copy import copy
from dataclasses import dataclass
from functools import cached_property, partial
from typing import ClassVar

import astropy.units as u
import numpy as np

from rfpsurvey._assignment.constraints.field import FAIL, PASS, ConstraintField, Verdict
from rfpsurvey._assignment.constraints.rule import StarRule, check_limits, limit_option
from rfpsurvey._common.read_tables import parse_number
from rfpsurvey._common.settings import option
from rfpsurvey._common.units import exact_text
from rfpsurvey._sky.catalog import Catalog
from rfpsurvey.errors import InputError, check_choice, check_keywords, listed, number_of, refusal, refusing

CORE = {"sdssv_bright": (1.75, 0.6), "sdssv_dark": (1.5, 0.8)}
"""Factor (arcsec) and exponent of the core of a star in bright and in dark time, as in mugatu (BSD-3) of SDSS-V."""
MAGNITUDES = np.arange(-2, 30, 0.05)
"""Magnitudes from which the largest radius is computed; no star is brighter."""
ARCSEC = float(np.deg2rad(1 / 3600))
IDLE = ("ignored", "counted")
FORM = "a table such as '8:60,12:10' (magnitude:radius in arcsec), 'sdssv_dark:16', 'sdssv_bright:12.7' or a function"


@check_keywords
@dataclass(frozen=True)
class BrightStars(StarRule):
    """Circles around bright stars in which no fiber may be; the arms of positioners may be in the circles.

    Targets and added sky positions in the circles are excluded. A star of the catalog does not exclude itself.

    Parameters
    ----------
    column : str
        Column with the magnitude of the stars; stars with a missing magnitude have no circle.
    radius : str, list or callable
        Radius as a function of the magnitude. A list of pairs of a magnitude and a radius (arcsec), or text such as
        ``8:60,12:10``, is interpolated; stars that are brighter than the first magnitude have the first radius, and
        stars that are fainter than the last magnitude have no circle. ``sdssv_dark:16`` and ``sdssv_bright:12.7`` are
        the formulas of SDSS-V for dark and bright time, with the magnitude limit of the design mode; ``column`` is then
        the magnitude Gaia G (H for APOGEE). A function receives an array of magnitudes, and returns radii in arcsec.
    fiber_type : str, optional
        Fiber type of the targets that are excluded; by default, any.
    stars : Catalog or str, optional
        Catalog with the stars, or the path of its file. All of its stars have circles, even if they are targets; their
        proper motions are not applied (see `rfpsurvey.Catalog.at_epoch`). By default, the stars are all targets of the
        catalog that are not sky positions.
    idle : {"ignored", "counted"}, optional
        Whether the verdict counts fibers of positioners without a target, which allocators do not move. If the pose of
        such a positioner is not known, the rule does not pass.

    Raises
    ------
    InputError
        If an argument is not valid, or if the catalog with the stars does not have the column.

    Examples
    --------
    >>> import rfpsurvey as rs
    >>> str(rs.constraints.BrightStars("gaia_g", [(8, 60), (12, 10)], "BOSS"))
    'bright_stars gaia_g 8:60,12:10 BOSS'
    """

    column: str = option(what="the column of bright stars")
    radius: str | list | Callable = option(convert=lambda radius: radius if callable(radius) else _text_of(radius))
    fiber_type: str = option("", what="fiber_type of bright stars")
    stars: Catalog | str | None = option(None, words="a Catalog or the path of its file")
    idle: str = option("ignored", choices=IDLE, what="treatment of idle positioners")

    name = "bright_stars"

    @property
    def with_idle(self) -> bool:
        """Whether the verdict counts fibers of positioners without a target."""
        return self.idle == "counted"

    @cached_property
    def margin_rad(self) -> float:
        """Largest radius in radians, if the stars are targets of the catalog."""
        return 0.0 if self.stars is not None else float(min(self._radii(MAGNITUDES).max(), np.pi))

    def _radii(self, magnitudes: np.ndarray) -> np.ndarray:
        """Return the radius (radians) of the circle around each star."""
        function = self.radius if callable(self.radius) else _function_of(self.radius)
        given = function(magnitudes)
        radii = np.asarray(given.to_value(u.arcsec) if isinstance(given, u.Quantity) else given)
        fits = radii.shape == magnitudes.shape and radii.dtype.kind in "iuf"
        if not (fits and np.isfinite(radii).all() and (radii >= 0).all()):
            raise refusal("the radii around stars must be finite numbers (arcsec) of at least 0", given, np.ndarray)
        return radii * ARCSEC

    def _circles(self, field: ConstraintField) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
        """Return the directions and the radii of the circles, and the identifiers of the stars if they are targets."""
        m, vectors, ids = self._stars(field)
        radii = self._radii(m)
        rows = np.flatnonzero(radii > 0)
        return vectors[rows], radii[rows], None if ids is None else ids[rows]

    def excluded(self, field: ConstraintField) -> np.ndarray | None:
        """Return which targets are in the circle around a star.

        Parameters
        ----------
        field : ConstraintField
            The field.

        Returns
        -------
        ndarray of bool or None
            One value per target; None if a plan of another program lacks the data.
        """
        if self._lacks(field, ""):
            return None
        from scipy.spatial import cKDTree

        excluded = np.zeros(len(field.id), dtype=bool)
        targets = np.flatnonzero(self._concerns(field, "") & np.isfinite(field.vectors).all(axis=1))
        vectors, radii, ids = self._circles(field)
        if len(targets) == 0 or len(vectors) == 0:
            return excluded
        # the chords of the radii, because the tree contains unit vectors
        near = cKDTree(field.vectors[targets]).query_ball_point(vectors, 2 * np.sin(np.minimum(radii, np.pi) / 2))
        star = np.repeat(np.arange(len(near)), [len(indices) for indices in near])
        rows = targets[np.concatenate([*near, []]).astype(int)]
        excluded[rows if ids is None else rows[field.is_added[rows] | (field.id[rows] != ids[star])]] = True
        return excluded

    def _lacks(self, field: ConstraintField, what: str) -> str:
        """Return the reason why the stars are unknown in a plan of another program; empty text if they are known."""
        no_positions = len(field.id) and not np.isfinite(field.vectors).any()
        return "the plan does not have positions on the sky" if no_positions else super()._lacks(field, what)

    def _verdict(self, field: ConstraintField, has_fiber: np.ndarray) -> Verdict:
        """Return the number of fibers in circles; not checkable without fibers there if not all stars are known."""
        if why := self._lacks(field, ""):
            return self._not_checkable(why)
        rows = np.flatnonzero(self.excluded(field) & has_fiber)
        unknown = np.count_nonzero(has_fiber & ~np.isfinite(field.vectors).all(axis=1)) if self.with_idle else 0
        if len(rows) == 0 and unknown:
            what = number_of(unknown, "fiber of idle positioners", "fibers of idle positioners")
            return self._not_checkable(f"{what} without a known position on the sky")
        if len(rows) == 0 and self.stars is None and not field.is_complete:
            return self._not_checkable("the plan contains only stars that have a fiber; give a catalog of stars")
        note = number_of(len(self._circles(field)[1]), "star with a circle", "stars with a circle")
        verdict = FAIL if len(rows) else PASS
        return Verdict(str(self), len(rows), "no fiber in the circle of a star", verdict, note, rows=rows)


def _text_of(radius: object) -> str:
    """Return the text of a table or formula of radii; raise an error if it is not valid."""
    with refusing(f"the radius around bright stars must be {FORM}", radius, str, list):
        pairs = radius
        if not isinstance(radius, str):
            pairs = ",".join(f"{exact_text(float(m))}:{exact_text(float(r))}" for m, r in radius)
        _function_of(pairs)
    return pairs


def _function_of(text: str) -> Callable:
    """Return the function of the magnitudes for the text of a table or formula of radii."""
    name, _, limit = text.partition(":")
    if name in CORE:
        if not np.isfinite(parse_number(limit)):
            raise ValueError(limit)
        return partial(_sdssv, limit=parse_number(limit), core=CORE[name])
    m, radii = np.array([[parse_number(word) for word in pair.split(":")] for pair in text.split(",")]).reshape(-1, 2).T
    if not (np.isfinite(m).all() and np.isfinite(radii).all() and (radii >= 0).all() and (np.diff(m) > 0).all()):
        raise InputError(
            f"the radius around bright stars must have ascending magnitudes and radii of at least 0, got {text!r}"
        )
    return partial(np.interp, xp=m, fp=radii, right=0.0)


def _sdssv(m: np.ndarray, limit: float, core: tuple[float, float]) -> np.ndarray:
    """Return radii (arcsec) for magnitudes, with the formula of SDSS-V: wings, transition and core of the image."""
    depth = np.maximum(limit - m, 0)
    radii = np.maximum.reduce([(depth - 8.2) / 0.05, (depth - 4.5) / 0.25, core[0] * depth ** core[1]])
    return np.where(m <= limit, np.maximum(radii, 0), 0.0)


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
