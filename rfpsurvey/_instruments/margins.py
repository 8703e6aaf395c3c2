"""Margins that plans keep, fixed obstacles, the minimum separation of arms, and limits of rounding errors.

Margins are distances from the edges of patrol areas, between arms, and from broken positioners. Obstacles are circles
and convex polygons.
"""

from collections.abc import Callable
from copy import copy
from dataclasses import dataclass
from functools import cached_property

import astropy.units as u
import numpy as np
import scipy  # its subpackages are imported on first use

from rfpsurvey._common.settings import Settings, option, options_of
from rfpsurvey._common.units import locked
from rfpsurvey._instruments.outline import make_outline, to_part, with_normals
from rfpsurvey._kernels import arms, collisions
from rfpsurvey._kernels.outlines import NO_POLYGONS, OUTLINE_ERROR, Polygons
from rfpsurvey.errors import InputError, InputTypeError, check_choice, check_keywords, listed, short

LENGTH = {"low": 0, "below": 1e6, "sparse": True}


@check_keywords
@dataclass(frozen=True, eq=False)
class Margins(Settings):
    """Distances that plans keep from mechanical limits and from broken positioners.

    A positioner is broken if it is disabled or stuck. All margins except ``arms`` state which targets a positioner may
    have in a plan. They do not change the minimum separation, the poses that a positioner can reach, or the collisions
    of given poses. ``arms`` increases the clearance of all arms and therefore also changes their collisions.

    Parameters
    ----------
    outer : Quantity, optional
        Smallest distance of a target from the outer edge of the patrol area. The edges are the two radii, including
        limits of phi that shorten a whole edge. Targets at this distance are in reach.
    inner : Quantity, optional
        Smallest distance of a target from the inner edge of the patrol area or, if the inner radius is 0, from the
        center. Targets at this distance are in reach.
    arms : Quantity, optional
        Length that is added to the clearance d of each arm. The minimum separation increases by twice this length.
    broken : Quantity, optional
        Length by which the distance of a planned arm from the arm of a broken positioner must exceed the minimum
        separation.
    broken_factor : float, optional
        Radius of a circle around the center of each broken positioner that contains no targets, as a fraction of the
        outer radius of the patrol area of this positioner; by default 0.
    hidden_factor : float, optional
        Factor, at least 1, by which the radii of the circles in which no target can be observed (``hidden``) are
        multiplied.

    Raises
    ------
    InputError
        If a length or a factor is out of range or has the wrong unit.

    Examples
    --------
    >>> import astropy.units as u
    >>> import rfpsurvey as rs
    >>> margins = rs.Margins(outer=0.2 * u.mm, inner=0.1 * u.mm)
    >>> print(margins)
    outer 0.2 mm, inner 0.1 mm
    >>> robot = rs.Positioner(8.25 * u.mm, 8.25 * u.mm, 2.25 * u.mm)
    >>> plane = rs.FocalPlane([[0, 0]] * u.mm, robot, margins=margins)
    >>> plane.multiplicity([[16.3, 0], [16.4, 0]] * u.mm)
    array([1, 0])
    """

    outer: u.Quantity[u.mm] = option(0 * u.mm, **LENGTH, text="{:g} mm from the outer edges of patrol areas")
    inner: u.Quantity[u.mm] = option(0 * u.mm, **LENGTH, text="{:g} mm from the inner edges of patrol areas")
    arms: u.Quantity[u.mm] = option(0 * u.mm, **LENGTH, text="{:g} mm around each arm")
    broken: u.Quantity[u.mm] = option(
        0 * u.mm, **LENGTH, text="{:g} mm more than the minimum separation from arms of broken positioners"
    )
    broken_factor: float = option(
        0.0,
        low=0,
        below=1e6,
        sparse=True,
        to_record=float,
        text="{:g} patrol radii from the centers of broken positioners",
    )
    hidden_factor: float = option(
        1.0, low=1, below=1e6, sparse=True, to_record=float, text="{:g} times the radii of hidden circles"
    )

    _what = "the margin {}"

    @classmethod
    def from_numbers(cls, numbers: dict[str, float]) -> "Margins":
        """Return margins for numbers by name.

        Parameters
        ----------
        numbers : dict of str to float
            Names and values of margins; lengths are in mm.

        Returns
        -------
        Margins
            The margins.

        Raises
        ------
        InputError
            If a name is unknown, or if a value is not a number or is out of range.
        """
        if not isinstance(numbers, dict):
            raise InputTypeError(f"margins must be numbers by name, got {short(numbers)}")
        known = {field.name: field for field in options_of(cls)}
        for name in numbers:
            check_choice(name, known, "margin")
        return cls(**{name: known[name].restored(value) for name, value in numbers.items()})

    @property
    def numbers(self) -> dict[str, float]:
        """All margins by name, lengths in mm."""
        return {field.name: float(field.plain(getattr(self, field.name))) for field in options_of(Margins)}

    def __bool__(self):
        return bool(self.record)

    def __str__(self):
        return self._texts(lambda f, number: f"{f.name} {number:g}{f' {f.units[0]}' if f.units else ''}")

    @property
    def description(self) -> str:
        """The margins that have an effect as text for readers who do not know their names."""
        return self._texts(lambda f, number: f.option.text.format(number))

    def _texts(self, text: Callable) -> str:
        """Return the texts of the margins that have an effect; ``text`` makes a text of an option and its value."""
        known = [field for field in options_of(Margins) if not field.is_default(self)]
        return listed(text(field, self.numbers[field.name]) for field in known)


def check_margins(plane) -> None:
    """Check the margins of a focal plane; each usable positioner must keep a part of its patrol area."""
    margins = plane.margins
    if margins is None:
        object.__setattr__(plane, "margins", Margins())
        return
    if not isinstance(margins, Margins):
        raise InputTypeError(f"margins must be Margins, got {short(margins)}")
    if margins.outer > 0 or margins.inner > 0:
        inner, outer = plane.arrays.edges
        empty = np.flatnonzero((inner > outer) & plane.arrays.usable)
        for k in empty:
            raise InputError(
                f"the margins outer and inner must leave a part of the patrol area of each usable positioner; the area "
                f"of positioner {plane.id[k]} is from {plane.arrays.inner_radius[k]:.4g} to "
                f"{plane.arrays.outer_radius[k]:.4g} mm, got {margins}; {len(empty)} positioners have no "
                "area left; use smaller margins or disable these positioners"
            )


def to_polygons(given) -> tuple[np.ndarray, ...]:
    """Return the vertices of each polygon (mm) in counter-clockwise order."""
    return tuple(locked(to_part(polygon, f"obstacle_polygons[{k}]")[0]) for k, polygon in enumerate(given or ()))


def find_polygons(columns) -> Polygons:
    """Return the polygons of the obstacles in the form that the collision kernels require."""
    polygons, shape = columns.obstacle_polygons, columns.plane.positioner.outline
    if not polygons:
        return NO_POLYGONS
    first = np.empty((5, 0))
    if shape is not None:
        outline = make_outline(shape, columns.xy, columns.central_arm)
        first = outline.table[:, : outline.n_vertices]
    start = first.shape[1] + np.cumsum([0, *map(len, polygons)]).astype(np.int64)
    table = np.hstack([first, *(with_normals(polygon) for polygon in polygons)])
    return Polygons(locked(np.ascontiguousarray(table)), locked(start))


def with_circles(plane, circles: np.ndarray):
    """Return the focal plane with more circles (x, y, radius in mm) that no arm may touch.

    All arrays that do not depend on these circles are computed only once, for the original focal plane.
    """
    for name in ("joints", "grid", "runs", "limits", "annuli", "bounds", "angles", "offers", "n_sharing", "_idle"):
        getattr(plane.arrays, name)
    more, arrays = copy(plane), copy(plane.arrays)
    circles = locked(np.vstack([arrays.obstacles, circles]))
    for name in ("obstacle_pairs", "obstacle_slack"):
        arrays.__dict__.pop(name, None)
    arrays.__dict__.update(plane=more, obstacles=circles)
    more.__dict__.update(arrays=arrays, obstacles=circles << u.mm)
    return more


class FixedObstacles:
    """Properties that `FocalPlaneArrays` inherits: pairs of positioners and obstacles, and limits for collisions."""

    @cached_property
    def obstacle_pairs(self) -> np.ndarray:
        circles = self.obstacles
        if self.obstacle_polygons:
            around = [(*p.mean(axis=0), np.hypot(*(p - p.mean(axis=0)).T).max()) for p in self.obstacle_polygons]
            circles = np.vstack([circles, around])
        if len(circles) == 0:
            return locked(np.empty((0, 2), dtype=np.int64))
        most = (self.arm_reach.max() + circles[:, 2] + self.clearance) * 1.001 + 1
        near = scipy.spatial.cKDTree(self.xy).query_ball_point(circles[:, :2], most)
        owner = np.concatenate([np.array(rows, dtype=np.int64) for rows in near])
        obstacle = np.repeat(np.arange(len(circles)), list(map(len, near)))
        apart = np.hypot(*(self.xy[owner] - circles[obstacle, :2]).T)
        limit = self.arm_reach[owner] + circles[obstacle, 2] + self.clearance
        keep = apart < limit * (1 + 1e-12) + self.touch_slack
        pairs = np.column_stack([owner, obstacle])[keep]
        return locked(np.ascontiguousarray(pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))]))

    @cached_property
    def limits(self) -> collisions.Limits:
        """Minimum separation of arms and limits of rounding errors, in the form that the collision kernels require."""
        return self.limits_with()

    def limits_with(self, extra: float = 0.0) -> collisions.Limits:
        """Return `limits` for a minimum separation that is increased by ``extra`` (mm)."""
        separation = self.separation + extra
        extent = np.hypot(*self.xy.T) + self.arm_reach
        size = float(extent.max()) + self.reach_slack + arms.EQUAL_ARMS
        shape, polygons = self.plane.positioner.outline, find_polygons(self)
        if shape is None:
            return collisions.limits(separation, self.longest, size, polygons=polygons)
        outline = make_outline(shape, self.xy, self.central_arm)
        # ``largest`` is an upper limit of the distance between a point of one arm and a point of another arm, if the
        # two arms are at the minimum separation
        arms_apart = self.longest + outline.offset + float(self.central_arm.max())
        largest = separation + outline.offset + 2 * arms_apart
        error = 1.2 * OUTLINE_ERROR * (largest + outline.offset)
        return collisions.limits(separation + outline.offset, self.longest, size, outline, error, polygons)

    @cached_property
    def obstacle_slack(self) -> float:
        """Upper limit (mm) of the rounding error of the distance between an arm and an obstacle that it touches."""
        size = float(self.obstacles[:, 2].max(initial=0.0)) + self.clearance + self.longest
        for polygon in self.obstacle_polygons:  # the vertices of a polygon can be far from the arms
            size = max(size, 2 * float(np.hypot(*polygon.T).max()) + self.longest)
        outline = self.limits.outline
        if outline.start.size == 1:
            return 1.2 * collisions.DISTANCE_ERROR * size
        return 1.2 * OUTLINE_ERROR * (size + 2 * float(self.arm_reach.max()) + outline.offset)
