"""A design (equal positioners on an infinite hexagonal lattice) and the values that follow from its geometry."""

from dataclasses import dataclass
from functools import cache, cached_property

import astropy.units as u
import numpy as np

from rfpsurvey.errors import InputError
from rfpsurvey.positioner import Positioner

MOST_REACH = 4.0
"""Largest reach of arms, in units of the pitch.

If the reach is larger, a positioner has hundreds of neighbors; such designs are not computed.
"""
N_LINES = 256
DEPTHS = 4
"""Number of classes of points: within reach of 0, 1, 2, and at least 3 positioners."""


@dataclass(frozen=True)
class Lattice:
    """Equal positioners at all points of a hexagonal lattice; the pitch is in mm."""

    unit: Positioner
    pitch: float

    @property
    def cell(self) -> float:
        """Area of the lattice cell of a positioner, mm^2."""
        return float(np.sqrt(3) / 2 * self.pitch**2)

    @cached_property
    def radii(self) -> tuple[float, float]:
        """Inner and outer radius of a patrol area in mm."""
        return float(self.unit.inner_radius.to_value(u.mm)), float(self.unit.outer_radius.to_value(u.mm))

    @property
    def shape(self) -> tuple[float, float, float]:
        """Ratios on which the collision probability depends: central arm / pitch, arm ratio, separation D / pitch."""
        unit = self.unit.numbers
        return unit.central_arm / self.pitch, unit.eccentric_arm / unit.central_arm, unit.separation / self.pitch

    @property
    def multiplicity(self) -> float:
        """Mean number of positioners that reach a point (patrol area divided by the area of a lattice cell)."""
        inner, outer = self.radii
        return float(np.pi * (outer**2 - inner**2) / self.cell)

    @property
    def sight(self) -> float:
        """Smallest distance (mm) between the centers of two positioners at which the positioners cannot collide."""
        return 2 * self.radii[1] + self.unit.numbers.separation

    @property
    def collision_type(self) -> int:
        """Collision type: 1 if no arms can touch, 2 if only arms of nearest neighbors can touch, 3 otherwise."""
        return 1 if self.sight <= self.pitch else 2 if self.sight <= np.sqrt(3) * self.pitch else 3

    def coverage(self, n_lines: int = N_LINES) -> np.ndarray:
        """Return the fractions of the plane within reach of exactly 0, 1, 2, and at least 3 positioners.

        A cell consists of twelve equal triangles. The areas in a triangle are integrated along 256 lines. On each line,
        the lengths of the segments between the edges of patrol areas are exact. Errors of the fractions are typically
        1e-4, and at most 4e-4.
        """
        inner, outer = (r / self.pitch for r in self.radii)
        x = (np.arange(n_lines) + 0.5) / (2 * n_lines)
        top = x / np.sqrt(3)
        centers = _centers(int(np.ceil(outer)))
        centers = centers[np.hypot(*centers.T) < outer + 1 / np.sqrt(3)]  # other positioners do not reach the triangle
        away = x[:, None] - centers[:, 0]
        edges, steps = [], []
        for r, sign in ((outer, 1), (inner, -1)):
            half = np.sqrt(np.maximum(r * r - away**2, 0.0))
            edges += [centers[:, 1] - half, centers[:, 1] + half]
            steps += [np.full(half.shape, sign), np.full(half.shape, -sign)]
        edges = np.clip(np.concatenate(edges, axis=1), 0.0, top[:, None])
        # along each line, the number of positioners in reach changes by 1 at each edge of a patrol area
        order = np.argsort(edges, axis=1)
        depth = np.cumsum(np.take_along_axis(np.concatenate(steps, axis=1), order, axis=1), axis=1)
        edges = np.take_along_axis(edges, order, axis=1)
        pieces = np.diff(edges, axis=1, append=top[:, None])
        parts = np.bincount(np.clip(depth, 0, DEPTHS - 1).ravel(), pieces.ravel(), minlength=DEPTHS)
        parts[0] += edges[:, 0].sum()  # no positioner reaches the points before the first edge
        return np.round(parts / top.sum(), 9)  # without rounding errors, full coverage is exactly 1


@cache
def _centers(reach: int) -> np.ndarray:
    """Return the points of a lattice of pitch 1 at distances of at most ``reach`` + 1 from the origin."""
    k, q = (a.ravel() for a in np.mgrid[-2 * reach : 2 * reach + 1, -2 * reach : 2 * reach + 1])
    xy = np.column_stack([q + k / 2, np.sqrt(3) / 2 * k])
    return xy[np.hypot(*xy.T) <= reach + 1]


def make_lattice(
    central_arm: float, ratio: float, pitch: float, clearance: float, step: float
) -> tuple[Lattice | None, str]:
    """Return a design and an empty text, or None and the reason why the design is impossible; lengths are in mm."""
    try:
        unit = Positioner(central_arm * u.mm, central_arm * ratio * u.mm, clearance * u.mm, step=step * u.rad)
    except InputError as error:
        return None, str(error)
    lattice = Lattice(unit, pitch)
    if pitch <= unit.numbers.separation:
        return None, "the centers of neighboring positioners are closer than the minimum separation"
    if lattice.radii[1] > MOST_REACH * pitch:
        return None, f"the reach of the arms exceeds {MOST_REACH:g} times the pitch"
    return lattice, ""
