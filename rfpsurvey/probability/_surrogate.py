"""Interpolate the collision probability of a design with a spline through the values for a grid of designs."""

from functools import cache
from importlib.resources import as_file, files
from typing import TYPE_CHECKING

import astropy.units as u
import numpy as np

from rfpsurvey._units import to_mm
from rfpsurvey.errors import InputError
from rfpsurvey.focal_plane import FocalPlane
from rfpsurvey.positioner import Positioner
from rfpsurvey.probability._quadrature import SCRAMBLES, Quadrature

if TYPE_CHECKING:
    from scipy.interpolate import NdBSpline

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

    with as_file(files("rfpsurvey.probability") / FILE) as path, np.load(path) as data:
        coefficients = data["risk"].astype(float)
    knots = []
    for axis, nodes in enumerate(AXES.values()):
        spline = make_interp_spline(nodes, coefficients, k=3, axis=axis)
        knots.append(spline.t)
        coefficients = np.moveaxis(spline.c, 0, axis)
    return NdBSpline(tuple(knots), coefficients, 3)
