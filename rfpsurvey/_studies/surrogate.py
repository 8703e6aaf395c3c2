"""Formulas for collision probabilities without errors, and a spline through the values for a grid of designs."""

from functools import cache
from importlib.resources import as_file, files
from typing import TYPE_CHECKING

import astropy.units as u
import numpy as np
from scipy.spatial import cKDTree

from rfpsurvey._common.units import to_mm
from rfpsurvey._instruments.focal_plane import FocalPlane
from rfpsurvey._instruments.positioner import Positioner
from rfpsurvey._kernels import queues as areas
from rfpsurvey._studies.quadrature import SCRAMBLES, Quadrature
from rfpsurvey.errors import InputError, check_choice

if TYPE_CHECKING:
    from scipy.interpolate import NdBSpline

VARIANTS = ("corrected", "pitch", "printed")
N_CIRCLES = 400


def overlap_ratio(plane: FocalPlane, variant: str) -> tuple[np.ndarray, dict]:
    """Return the fraction of each patrol area that at least one other positioner also reaches.

    The fraction describes independent targets and has no error estimate.
    """
    _check_margins(plane, "overlap_ratio", "broken")
    return _covered(plane, _overlapping(plane, both_ways=True)), {}


def closed_form(plane: FocalPlane, variant: str) -> tuple[np.ndarray, dict]:
    """Return the collision probability of each positioner by the closed form of Chen et al. (2024), arXiv:2409.07288.

    The closed form is Eq. 5 to 9 of the paper. The probability of a positioner is a sum over its neighbors. Each term
    of the sum is a product of two ratios of areas. The targets are independent, and there is no error estimate.
    """
    check_choice(variant, VARIANTS, "variant of the closed form")
    _check_arms(plane, "closed_form", "elbow_to_tip", "capsule")
    _check_margins(plane, "closed_form", "outer", "inner", "broken")
    d, l1, l2 = plane.arrays.clearance, plane.arrays.central_arm, plane.arrays.eccentric_arm
    outer, inner = l1 + l2 + d, np.maximum(0.0, np.abs(l2 - l1) - d)
    if variant == "printed":
        outer, inner = l2 - l1 + d, l2 - l1 - d
    cover = np.pi * (outer**2 - inner**2)
    if ((outer <= 0) | (cover <= 1e-9 * outer**2)).any():
        raise InputError(
            "the printed closed form has no coverage area if the arms have equal lengths: the outer radius l2 - l1 + d "
            "is a misprint for l1 + l2 + d; use variant='corrected'"
        )
    inner = np.maximum(inner, 0.0)
    pairs = _pairs_within(plane, outer)
    i, j = np.concatenate([pairs, pairs[:, ::-1]]).T
    distance = np.hypot(*(plane.arrays.xy[i] - plane.arrays.xy[j]).T)
    shared = (
        _lens(outer[i], outer[j], distance)
        - _lens(outer[i], inner[j], distance)
        - _lens(inner[i], outer[j], distance)
        + _lens(inner[i], inner[j], distance)
    )
    reach = distance if variant == "corrected" else _pitch(plane)
    swept = d * (l2[i] + d) * np.maximum(0.0, (l1[i] + l2[i] - reach / 2) / (l2[i] / 2))
    probability = np.zeros(len(plane))
    np.add.at(probability, i, shared / cover[i] * swept / cover[i])
    return probability, {"variant": variant}


def close_pair(plane: FocalPlane, variant: str) -> tuple[np.ndarray, dict]:
    """Return the probability that another observed target lies within the minimum separation of a positioner's target.

    Each positioner observes one target. Targets are assumed to be uniformly distributed in the area that the
    positioners reach. The number of targets near a given target therefore has a binomial distribution. The targets are
    independent, and there is no error estimate.
    """
    _check_arms(plane, "close_pair", "elbow_to_tip", "capsule", "fiber_tip")
    _check_margins(plane, "close_pair", "broken")
    inner, outer = plane.arrays.edges
    area = np.pi * (outer**2 - inner**2)
    # a point in several patrol areas is counted only once: for the last positioner (largest row) that reaches the point
    alone = 1 - _covered(plane, _overlapping(plane, both_ways=False))
    union = float((area * alone)[plane.arrays.usable].sum())
    near = min(1.0, np.pi * plane.arrays.separation**2 / union)
    n_others = np.count_nonzero(plane.arrays.usable) - 1
    return np.full(len(plane), 1 - (1 - near) ** max(n_others, 0)), {"reached_area_mm2": union}


def _check_arms(plane, method, *models):
    """Raise an error if a formula does not describe the arm model, such as an outline, whose clearance can be 0."""
    arm_model = plane.positioner.arm_model
    if arm_model not in models:
        raise InputError(
            f"the arm model must be {' or '.join(models)} for the method {method!r}, got {arm_model!r}; use the method "
            "quadrature, which supports all arm models, or another arm model of the instrument (with_arm_model)"
        )


def _check_margins(plane, method, *names):
    """Raise an error if a focal plane has a margin that a formula does not contain."""
    given = [name for name in names if plane.margins.numbers[name]]
    if given:
        raise InputError(
            f"the margins {', '.join(given)} must be 0 for the method {method!r}, got {plane.margins}; use the method "
            "quadrature, which supports all margins"
        )


def _pairs_within(plane, radius):
    """Return the pairs of usable positioners for which circles with the given radii around the centers overlap."""
    pairs = cKDTree(plane.arrays.xy).query_pairs(2 * radius.max(), output_type="ndarray")
    distance = np.hypot(*(plane.arrays.xy[pairs[:, 0]] - plane.arrays.xy[pairs[:, 1]]).T)
    return pairs[(distance < radius[pairs].sum(axis=1)) & plane.arrays.usable[pairs].all(axis=1)]


def _overlapping(plane, *, both_ways):
    """Return, for each positioner, the rows of the positioners whose patrol areas may overlap its own patrol area.

    The result contains two arrays. The second array lists these rows for all positioners, one positioner after another.
    The first array contains the index at which the rows of each positioner begin. If ``both_ways`` is false, only rows
    that are larger than the positioner's own row are listed, so that each pair of positioners occurs once.
    """
    pairs = np.sort(_pairs_within(plane, plane.arrays.edges[1]), axis=1)
    pairs = np.concatenate([pairs, pairs[:, ::-1]]) if both_ways else pairs
    pairs = pairs[np.argsort(pairs[:, 0], kind="stable")]
    return np.searchsorted(pairs[:, 0], np.arange(len(plane) + 1)), np.append(pairs[:, 1], 0).astype(np.int64)


def _covered(plane, rows):
    out, geometry = np.empty(len(plane)), plane.arrays.geometry
    areas.covered_parts(*rows, geometry.cx, geometry.cy, *plane.arrays.edges, N_CIRCLES, out)
    return np.minimum(out, 1.0)


def _pitch(plane):
    """Return the median distance between a positioner and its nearest neighbor."""
    return float(np.median(cKDTree(plane.arrays.xy).query(plane.arrays.xy, k=2)[0][:, 1])) if len(plane) > 1 else np.inf


def _lens(a, b, d):
    """Return the area common to two circles with the radii a and b whose centers are a distance d apart."""
    small, large = np.minimum(a, b), np.maximum(a, b)
    apart, within = d >= a + b, d <= large - small
    partly = ~apart & ~within
    area = np.where(within, np.pi * small**2, 0.0)
    a, b, d = a[partly], b[partly], d[partly]
    # two circular sectors, minus the kite between the centers and the intersections, which both sectors contain
    first_sector = a**2 * np.arccos(np.clip((d**2 + a**2 - b**2) / (2 * d * a), -1, 1))
    second_sector = b**2 * np.arccos(np.clip((d**2 + b**2 - a**2) / (2 * d * b), -1, 1))
    kite = 0.5 * np.sqrt(np.maximum((-d + a + b) * (d + a - b) * (d - a + b) * (d + a + b), 0.0))
    area[partly] = first_sector + second_sector - kite
    return area


AXES = {
    "central arm over pitch": np.linspace(0.20, 0.60, 21),
    "eccentric over central arm": np.linspace(1.0, 3.0, 21),
    "minimum separation over pitch": np.linspace(0.02, 0.30, 9),
}
"""Nodes of the grid of designs, by axis; the range of the grid contains the designs of Chen et al. (2024)."""
PITCH = 25.0
FILE = "surrogate.npz"


def surrogate_probability(
    central_arm: u.Quantity, eccentric_arm: u.Quantity, pitch: u.Quantity, min_separation: u.Quantity
) -> np.ndarray:
    """Return the collision probability of positioners on an infinite hexagonal lattice, by interpolation.

    The result approximates the result of the method ``quadrature`` of `~rfpsurvey.collision_probability` for a
    positioner far from the edge. Targets are independent and uniform over each patrol area; arms are right-handed, and
    only the segment from elbow to fiber can collide. The interpolation is a cubic spline through the probabilities of
    3969 designs; the documentation states the errors of the interpolation.

    Parameters
    ----------
    central_arm, eccentric_arm : Quantity
        Arm lengths; all arguments are broadcast against each other.
    pitch : Quantity
        Distance between the centers of adjacent positioners.
    min_separation : Quantity
        Minimum separation of two arms.

    Returns
    -------
    ndarray of float
        Collision probability of each design.

    Raises
    ------
    InputError
        If a design is outside these limits: central arm 0.2 to 0.6 times the pitch, eccentric arm 1 to 3 times the
        central arm, minimum separation 0.02 to 0.3 times the pitch. The surrogate does not extrapolate beyond these
        limits.

    Examples
    --------
    >>> import astropy.units as u
    >>> import rfpsurvey as rs
    >>> rs.probability.surrogate_probability(8.25 * u.mm, [8.25, 10] * u.mm, 25.6 * u.mm, 4.5 * u.mm).round(2)
    array([0.11, 0.17])
    """
    values = {"central_arm": central_arm, "eccentric_arm": eccentric_arm, "pitch": pitch}
    values["min_separation"] = min_separation
    try:
        l1, l2, step, distance = np.broadcast_arrays(*(to_mm(v, name) for name, v in values.items()))
    except ValueError as error:
        raise InputError(f"the arguments must have shapes that can be broadcast together: {error}") from None
    if not ((l1 > 0) & (step > 0)).all():
        raise InputError("central_arm and pitch must be positive lengths, without NaN")
    shape = l1 / step, l2 / l1, distance / step
    for (name, nodes), value in zip(AXES.items(), shape, strict=True):
        outside = outside_box(name, value)
        if outside.any():
            raise InputError(
                f"{name} must be from {nodes[0]:g} to {nodes[-1]:g}, got {float(value[outside].flat[0]):.6g}: the "
                "surrogate does not extrapolate; use collision_probability(method='quadrature')"
            )
    points = np.stack([np.clip(v, n[0], n[-1]) for v, n in zip(shape, AXES.values(), strict=True)], axis=-1)
    interpolated = surrogate_spline()(points.reshape(-1, 3)).reshape(l1.shape)
    cannot_touch = step > 2 * (l1 + l2) + distance
    return np.where(cannot_touch, 0.0, np.clip(interpolated, 0.0, 1.0))


def outside_box(name: str, value: np.ndarray) -> np.ndarray:
    """Return whether each value is outside the grid of the surrogate; ``name`` is the name of an axis of `AXES`."""
    nodes = AXES[name]
    slack = 1e-9 * nodes[-1]
    return ~((value >= nodes[0] - slack) & (value <= nodes[-1] + slack))


def interior_probability(
    shape: tuple[float, float, float], n_points: int, rng: np.random.Generator
) -> tuple[float, float]:
    """Return the collision probability of the central positioner of a lattice, and the standard error of this value.

    ``shape`` contains the coordinates of the design on the axes of `AXES`.
    """
    l1, l2, distance = shape[0] * PITCH, shape[0] * shape[1] * PITCH, shape[2] * PITCH
    unit = Positioner(l1 * u.mm, l2 * u.mm, distance / 2 * u.mm)
    rings = int((2 * (l1 + l2) + distance) / (PITCH * np.sqrt(3) / 2)) + 1
    plane = FocalPlane.hexagonal(unit, pitch=PITCH * u.mm, rings=rings)
    task = Quadrature(plane, "uniform")
    values = [task(len(plane) // 2, n_points, source)[0] for source in rng.spawn(SCRAMBLES)]
    return float(np.mean(values)), float(np.std(values, ddof=1) / np.sqrt(SCRAMBLES))


@cache
def surrogate_spline() -> "NdBSpline":
    """Return the cubic spline that `~rfpsurvey.probability.surrogate_probability` uses.

    The variables of the spline are the ratio of the central arm to the pitch, the ratio of the eccentric to the central
    arm, and the ratio of the minimum separation to the pitch. The probability is 0 if two arms cannot touch; otherwise,
    it is the value of the spline, clipped to the range from 0 to 1.

    Returns
    -------
    scipy.interpolate.NdBSpline
        The spline.

    Examples
    --------
    >>> import rfpsurvey as rs
    >>> rs.probability.surrogate_spline().c.shape
    (21, 21, 9)
    """
    from scipy.interpolate import NdBSpline, make_interp_spline

    with as_file(files("rfpsurvey._studies") / FILE) as path, np.load(path) as data:
        coefficients = data["risk"].astype(float)
    knots = []
    for axis, nodes in enumerate(AXES.values()):
        spline = make_interp_spline(nodes, coefficients, k=3, axis=axis)
        knots.append(spline.t)
        coefficients = np.moveaxis(spline.c, 0, axis)
    return NdBSpline(tuple(knots), coefficients, 3)
