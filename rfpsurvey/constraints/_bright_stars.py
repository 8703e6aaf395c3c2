"""The rule `BrightStars`: no fiber close to a bright star, within a radius that depends on the magnitude."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial

import astropy.units as u
import numpy as np

from rfpsurvey._readers import parse_number
from rfpsurvey._settings import option
from rfpsurvey._units import exact_text
from rfpsurvey.catalog import Catalog
from rfpsurvey.constraints._field import FAIL, PASS, ConstraintField, Verdict
from rfpsurvey.constraints._rule import StarRule
from rfpsurvey.errors import InputError, check_keywords, number_of, refusal, refusing

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
