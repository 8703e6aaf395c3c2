"""Sources of targets: random targets, given points, or a user-defined function."""

from collections.abc import Callable
from dataclasses import dataclass

import astropy.units as u
import numpy as np
from astropy.coordinates import SkyCoord

from rfpsurvey._kernels import simulate
from rfpsurvey._roles import has_role
from rfpsurvey._units import to_points_mm, to_scalar
from rfpsurvey.catalog import Catalog
from rfpsurvey.errors import InputError, InputTypeError, short
from rfpsurvey.focal_plane import FocalPlane
from rfpsurvey.instrument import Instrument
from rfpsurvey.pipeline import project_field
from rfpsurvey.probability._options import KINDS, RandomTargets

PER_FIBER = 4.0
"""Default number of targets per positioner; Chen et al. (2024) use this number for LAMOST."""
FILLING = 0.5
"""Largest fraction of the circle of targets that the discs of ``poisson_disc`` targets may fill.

Discs that are added at random positions without overlap fill at most a fraction of 0.547 of the area. Near this limit,
adding discs is slow.
"""
FINEST = 700
"""Largest ratio of the radius of the circle of targets to the minimum separation of the targets.

Smaller separations have little effect, but require much memory.
"""


@dataclass(frozen=True, eq=False)
class Source:
    """A source of target positions in mm: given points, a user-defined function, or ``number`` random points."""

    kind: str
    number: float = 0.0
    each: float = 0.0
    """Number of targets per positioner."""
    center: tuple[float, float] = (0.0, 0.0)
    radius: float = 0.0
    separation: float = 0.0
    points: np.ndarray | None = None
    types: np.ndarray | None = None
    priority: np.ndarray | None = None
    sampler: Callable | None = None

    @property
    def compiled(self) -> bool:
        """Whether compiled kernels draw these targets."""
        return self.kind in KINDS

    @property
    def sky(self) -> simulate.TargetCircle:
        """The circle that contains the targets, and their minimum separation, as the kernels require them."""
        return simulate.TargetCircle(*self.center, self.radius, self.separation if self.kind == "poisson_disc" else 0.0)

    def numbers(self, size: int, rng: np.random.Generator) -> np.ndarray:
        """Return the number of targets in each of ``size`` realizations."""
        if self.kind == "poisson":
            return rng.poisson(self.number, size)
        return np.full(size, round(self.number))

    @property
    def grid_cells(self) -> int:
        """Number of grid cells that `scatter_apart` uses; each cell is so small that it contains at most one target."""
        if self.kind != "poisson_disc":
            return 0
        wide = self.radius + 2 * self.separation
        return int(np.ceil(2 * np.sqrt(2) * wide / self.separation)) ** 2

    def draw(self, rng: np.random.Generator) -> np.ndarray:
        """Return the positions (mm) of the targets of one realization, shape (n, 2)."""
        if self.kind == "given":
            return self.points
        if self.kind == "sampler":
            return to_points_mm(self.sampler(rng), "the result of the function given as targets")
        x, y = np.empty((2, int(self.numbers(1, rng)[0])))
        if self.kind == "poisson_disc":
            n_placed = simulate.scatter_apart(rng, self.sky, np.empty((2, self.grid_cells)), x, y)
            x, y = x[:n_placed], y[:n_placed]
        else:
            simulate.scatter(rng, self.sky, x, y)
        return np.column_stack([x, y])

    def describe(self) -> dict:
        """Return the entries of ``Estimate.meta`` that describe the targets."""
        if self.kind == "given":
            return {"targets": "given", "n_targets": len(self.points)}
        if self.kind == "sampler":
            return {"targets": "sampler"}
        separation = {"min_separation_mm": self.separation} if self.kind == "poisson_disc" else {}
        return {"targets": self.kind, "n_targets": self.number, "target_radius_mm": self.radius, **separation}


def make_source(
    plane: FocalPlane, instrument: Instrument | None, targets: object = "uniform", center: SkyCoord | None = None
) -> Source:
    """Return the source of targets that the arguments describe."""
    if isinstance(targets, str):
        targets = RandomTargets(targets)
    if isinstance(targets, RandomTargets):
        return _random(plane, instrument, targets)
    if isinstance(targets, Catalog):
        return _from_catalog(instrument, targets, center)
    if isinstance(targets, u.Quantity):
        return _given(to_points_mm(targets, "targets"))
    if callable(targets) and not isinstance(targets, type):
        return Source("sampler", sampler=targets)
    raise InputTypeError(
        f"targets must be RandomTargets or one of {', '.join(KINDS)}, a Catalog, a Quantity of shape (n, 2), or a "
        f"function of a Generator that returns such a Quantity, got {short(targets)}"
    )


def _random(plane, instrument, targets):
    cover = float((np.hypot(*(plane.arrays.xy - _center(plane)).T) + plane.arrays.outer_radius).max())
    radius = cover if targets.radius is None else to_scalar(targets.radius, u.mm, "radius")
    number, separation = targets.number, 0.0
    if number is None:
        number = (instrument.targets_per_fiber if instrument else PER_FIBER) * len(plane)
    if targets.kind == "poisson_disc":
        separation = to_scalar(targets.min_separation, u.mm, "min_separation", low=0, high=2 * radius)
        if round(number) * separation**2 > 4 * FILLING * radius**2:
            raise InputError(
                f"{round(number)} targets at least {separation:g} mm apart do not fit into a circle with the radius "
                f"{radius:g} mm: discs with a diameter of {separation:g} mm must fill at most the fraction {FILLING:g} "
                "of the circle"
            )
        if separation * FINEST < radius:
            raise InputError(
                f"min_separation must be at least {radius / FINEST:.3g} mm for targets in a circle with the radius "
                f"{radius:g} mm, got {targets.min_separation}"
            )
    return Source(targets.kind, float(number), number / len(plane), _center(plane), radius, separation)


def _center(plane):
    """Return the center (mm) of the circle of targets: the origin or, for a plane without the origin, its midpoint."""
    low, high = plane.arrays.xy.min(axis=0), plane.arrays.xy.max(axis=0)
    away = (low > 0).any() or (high < 0).any()
    return tuple((0.5 * (low + high)).tolist()) if away else (0.0, 0.0)


def _from_catalog(instrument, targets, center):
    if instrument is None:
        raise InputError("targets in a Catalog require an Instrument, since a FocalPlane has no plate scale")
    if center is None:
        if len(targets) == 0:
            raise InputError("targets must have at least one row, got an empty Catalog")
        center = targets.mean_direction
    wanted = np.ones(len(targets), dtype=bool) if targets.kind is None else has_role(targets.kind, "science")
    science = np.flatnonzero(wanted if targets.visits is None else wanted & (targets.visits > 0))
    types, priority = (None if c is None else c[science] for c in (targets.fiber_type, targets.priority))
    xy, types = project_field(instrument, instrument.projection(center).plain, targets.arrays.vectors[science], types)
    return _given(xy, types, priority)


def _given(points, types=None, priority=None):
    if len(points) == 0:
        raise InputError(
            "targets must have at least one row (a Catalog, one science target with requested visits), got none"
        )
    return Source("given", points=points, types=types, priority=priority)
