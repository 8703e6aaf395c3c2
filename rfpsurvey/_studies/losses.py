"""Methods that compute the fraction of fibers lost to collisions (the loss) of equal positioners on a lattice."""

from dataclasses import dataclass
from functools import cache, cached_property
from typing import NamedTuple

import astropy.units as u
import numpy as np

from rfpsurvey._assignment.allocate import allocate
from rfpsurvey._assignment.methods import name_of_best
from rfpsurvey._assignment.options import AllocationOptions
from rfpsurvey._common.descriptions import Method, table_of
from rfpsurvey._instruments.focal_plane import FocalPlane
from rfpsurvey._instruments.positioner import Positioner
from rfpsurvey._studies.collision_probability import collision_probability
from rfpsurvey._studies.simulate import QUEUEING
from rfpsurvey._studies.surrogate import AXES, interior_probability, outside_box, surrogate_probability
from rfpsurvey._studies.targets import Source
from rfpsurvey.errors import InputError, used_elsewhere

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


N_POINTS = 256
"""Number of points of a quadrature; with this number, the relative error of the loss is about 0.002."""
SURROGATE_ERROR = 5e-4
"""Upper limit of the root-mean-square error of the method ``surrogate``; see ``tests/benchmarks/design_figures.py``."""
SURE = 0.01
"""Smallest loss for which the relative error of the method ``surrogate`` is acceptable."""
CORE = 5.0
"""Radius, in units of the pitch, of the central region of a simulated patch of positioners.

Only the 91 positioners in this region are counted.
"""


@dataclass(frozen=True)
class LossMethod(Method):
    """A method that computes the loss of a design; the function takes a `Lattice` and `Skies`."""

    estimand: str = "independent"
    """The definition of the loss."""
    limited: bool = False
    """Whether the parameters of a design must be within the range of the surrogate."""
    automatic: bool = False
    """Whether the method ``auto`` can select this method."""


class Loss(NamedTuple):
    """The fraction of fibers that a design loses to collisions, with its error."""

    assigned: float
    """Number of fibers per positioner that would have a target if arms could pass through each other."""
    loss: float
    """Fraction of the assigned fibers that is lost."""
    error: float
    n_unproven: int = 0
    """Number of realizations of the targets in which the search for a plan ended at the time limit."""
    gap: float = 0.0
    """Upper limit of the amount by which searches without a time limit could decrease the loss; NaN if unknown."""


class Skies(NamedTuple):
    """Parameters of the random targets with which the loss of a design is computed."""

    each: float
    """Number of targets per positioner."""
    number: int
    """Number of realizations of the targets over which losses are averaged."""
    rng: np.random.Generator
    time_limit: float
    """Time limit of each search for a plan, in seconds."""


def surrogate(lattice: Lattice, skies: Skies | None = None) -> Loss:
    """Interpolation between precomputed values, for ``independent``."""
    central_arm, ratio, distance = lattice.shape
    value = surrogate_probability(central_arm * u.mm, central_arm * ratio * u.mm, 1 * u.mm, distance * u.mm)
    return Loss(1.0, float(value), 0.0 if lattice.collision_type == 1 else SURROGATE_ERROR)


def quadrature(lattice: Lattice, skies: Skies) -> Loss:
    """Integration over the targets of a positioner and its neighbors, for ``independent``."""
    return Loss(1.0, *interior_probability(lattice.shape, N_POINTS, skies.rng))


def conditional(lattice: Lattice, skies: Skies) -> Loss:
    """Exact average over all configurations that the queues allow, for each realization, for ``allocated``."""

    def look(points, plane, core):
        assigned = core & (allocate(plane, points, allocator=QUEUEING).target_of_positioner >= 0)
        if not assigned.any():
            return 0, 0, 0, 0
        probability = collision_probability(plane, targets=points, method="conditional").per_positioner
        return assigned.sum(), probability[assigned].sum(), 0, 0

    return _over_skies(lattice, skies, look)


def optimal(lattice: Lattice, skies: Skies) -> Loss:
    """Comparison of the best plan without collisions with the best that ignores them, for ``collision_free``."""
    return _compare(lattice, skies, "optimal")


def repair(lattice: Lattice, skies: Skies) -> Loss:
    """Comparison of a plan by ``repair`` with the best plan that ignores collisions, for ``collision_free``."""
    return _compare(lattice, skies, "repair")


_SEARCH = ("n_skies", "time_limit", "rng")
METHODS = table_of(
    LossMethod("surrogate", surrogate, (), estimand="independent", limited=True, automatic=True),
    LossMethod("quadrature", quadrature, ("rng",), estimand="independent", automatic=True),
    LossMethod("conditional", conditional, ("n_skies", "rng"), estimand="allocated", automatic=True),
    LossMethod("optimal", optimal, _SEARCH, estimand="collision_free", automatic=True),
    LossMethod("repair", repair, _SEARCH, estimand="collision_free"),
)
"""Methods by name: functions that return the loss of a design with given random targets."""
ESTIMANDS = tuple(dict.fromkeys(method.estimand for method in METHODS.values()))


def automatic(estimand: str) -> list[LossMethod]:
    """Return the methods from which `cheapest` selects; the fastest method is the first."""
    return [method for method in METHODS.values() if method.automatic and method.estimand == estimand]


def cheapest(estimand: str, lattice: Lattice) -> str:
    """Return the fastest method that is accurate enough for a design."""

    def sure():
        return in_box(lattice) and (lattice.collision_type == 1 or surrogate(lattice).loss >= SURE)

    return next(method.name for method in automatic(estimand) if not method.limited or sure())


def in_box(lattice: Lattice) -> bool:
    """Return whether the parameters of a design are within the range of the method ``surrogate``."""
    return not any(outside_box(name, value) for name, value in zip(AXES, lattice.shape, strict=True))


def _compare(lattice, skies, method):
    """Compute the loss of the plans of the allocator ``method``, relative to the best plans that ignore collisions."""
    limit = skies.time_limit * u.s

    def look(points, plane, core):
        options = {name: AllocationOptions(name, time_limit=limit) for name in (name_of_best(), method)}
        with used_elsewhere():  # some allocators have no time limit
            plans = [allocate(plane, points, allocator=options_of_plan) for options_of_plan in options.values()]
        blind, collision_free = (int((plan.target_of_positioner[core] >= 0).sum()) for plan in plans)
        proves = [options_of_plan.method.searches for options_of_plan in options.values()]
        unproven = any(plan.gap > 0 for plan, proven in zip(plans, proves, strict=True) if proven)
        return blind, blind - collision_free, unproven, _gap(*plans) if all(proves) else np.nan

    return _over_skies(lattice, skies, look, whole=True)


def _gap(blind, plan):
    """Return a proven upper limit of the number of fibers that a better plan could add, per assigned fiber.

    The assigned fibers are the fibers with a target in ``blind``, a plan that ignores collisions.
    """
    most = min(blind.levels[0].bound, plan.levels[0].bound)
    return max(most - plan.levels[0].value, 0.0) / max(blind.levels[0].value, 1.0)


def _over_skies(lattice, skies, look, *, whole=False):
    """Return the loss in the central region of a patch, averaged over all realizations of the targets.

    For each realization, ``look`` returns the number of assigned fibers, the expected number of lost fibers, whether
    the time limit ended a search, and the gap (see `Loss`). Positioners near the edge of a patch have fewer neighbors
    and are not counted. If no fiber is lost, the error is as large as if one fiber were lost. If ``whole`` is true,
    the numbers of lost fibers are integers, and the error is never smaller than the error for one lost fiber.
    """
    plane, source = _patch(lattice, skies.each)
    core = np.hypot(*plane.arrays.xy.T) <= (CORE + 0.01) * lattice.pitch
    counts = []
    for _ in range(skies.number):
        points = source.draw(skies.rng)
        counts.append(look(points * u.mm, plane, core) if len(points) else (0, 0, 0, 0))
    assigned, lost, unproven, gaps = np.array(counts, dtype=float).T
    total, n = assigned.sum(), skies.number
    if total == 0:
        return Loss(0.0, np.nan, np.nan)
    loss = max(lost.sum() / total, 0.0)  # the plan that ignores collisions can have fewer fibers in the center
    # standard error of a ratio of two sums over realizations, to first order
    error = np.sqrt(n / (n - 1) * ((lost - loss * assigned) ** 2).sum()) / total
    if lattice.collision_type > 1 and (whole or loss == 0):
        error = max(error, 1 / total)
    return Loss(float(total / (n * core.sum())), float(loss), float(error), int(unproven.sum()), float(gaps.mean()))


def _patch(lattice, each):
    """Return a finite patch of the lattice, and a source of random targets for its positioners.

    The patch contains the counted positioners, their neighbors, and positioners that share targets with the neighbors.
    """
    edge = (CORE + 0.01) * lattice.pitch + 2 * lattice.sight
    plane = FocalPlane.hexagonal(lattice.unit, pitch=lattice.pitch * u.mm, radius=edge * u.mm)
    radius = float(np.hypot(*plane.arrays.xy.T).max()) + lattice.radii[1]
    return plane, Source("poisson", number=each * np.pi * radius**2 / lattice.cell, each=each, radius=radius)
