"""Models of the projection of a field, and the choice of the fastest model that is accurate enough."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from rfpsurvey._kernels import refraction
from rfpsurvey._sky.conditions import MODELS, ObservingConditions
from rfpsurvey._sky.instants import coefficients, midpoint
from rfpsurvey._sky.observed_field import FEWEST, NO_LIGHT, ObservedField, moments_of_exposure
from rfpsurvey._sky.projection import FieldProjection
from rfpsurvey._sky.wavelengths import ASSUMED_UM, Light, ObservedLight, observed_light
from rfpsurvey.errors import InputError, check_choice

STATIC = ("tangent", "radial")
# Factor by which bounds of displacements are larger than their first-order values: the field is tested in 24
# directions, and the terms of second order in refraction are below 1 % above LOWEST (rad), the lowest altitude for
# which a model other than ``full`` is chosen. Near the horizon, the series does not converge.
MARGIN, LOWEST = 1.03, np.deg2rad(10)
# Largest speed of the Earth in units of the speed of light, and the direction of the pole of the ecliptic (J2000).
SPEED, ECLIPTIC = 1.011e-4, np.array([0.0, -0.39777716, 0.91748206])
LONG, MANY = 1800, 17  # s; half of an exposure above which more instants are used, and the number of these
N_RADII = 200


@dataclass(frozen=True, eq=False)
class FieldOptics:
    """Optics of an instrument without units.

    Parameters
    ----------
    focal_length : float
        Plate scale at the center, mm per radian, for a projection without a radial map.
    distortion : RadialMap, dict of str to RadialMap, or None
        Radial map, or a dict with one radial map for each fiber type.
    radius : float, optional
        Radius of the field (rad).
    light : Light, optional
        Wavelengths that the instrument observes.
    tolerance : float, optional
        Largest negligible position error (mm).
    fiber_types : tuple of str, optional
        Fiber types of the instrument.
    """

    focal_length: float
    distortion: object = None
    radius: float = 0.0
    light: Light = NO_LIGHT
    tolerance: float | None = None
    fiber_types: tuple[str, ...] = ()


@lru_cache(maxsize=16)
def profile(optics: FieldOptics, factor: float) -> tuple[float, float, float]:
    """Return the largest scale (mm) of the map from tangents, its radius (mm), and the error of a tangent plane (mm).

    The field contains all directions whose images, multiplied by ``factor``, are on the focal plane.
    """
    tangents = np.tan(np.linspace(0, optics.radius / min(factor, 1.0), N_RADII + 1))[1:, None]
    turn = 2 * np.pi * np.arange(refraction.N_TURNS) / refraction.N_TURNS
    plane = tangents * np.exp(1j * turn)
    vectors = np.dstack([plane.real, plane.imag, np.ones(plane.shape)]) / np.sqrt(1 + tangents**2)[..., None]
    field, values = FieldProjection(np.eye(3), optics.focal_length, optics.distortion), np.zeros(3)
    for kind in optics.distortion if isinstance(optics.distortion, dict) else [""]:
        image = (field.project(vectors.reshape(-1, 3), kind) @ [1, 1j]).reshape(plane.shape)
        along = np.diff(image, axis=0, prepend=0.0) / np.diff(tangents, axis=0, prepend=0.0)
        across = (np.roll(image, -1, 1) - np.roll(image, 1, 1)) / (2 * np.sin(turn[1]) * tangents)
        scale = np.abs(along - 1j * across) / 2 + np.abs(along + 1j * across) / 2  # largest singular value
        rows = scale, np.abs(image), np.abs(image - optics.focal_length * plane)
        values = np.fmax(values, [np.nanmax(row) for row in rows])
    return tuple(values.tolist())


@dataclass(frozen=True, eq=False)
class ModelChoice:
    """A model of the projection for a field, with bounds of what the models neglect.

    Parameters
    ----------
    model : str
        Name of the model.
    largest : dict of str to float
        Bounds (mm) of the largest errors of all models.
    drift : float
        Largest distance (mm) between a target and its mean position during the exposure.
    tolerance : float or None
        Largest negligible position error (mm).
    light : ObservedLight
        Wavelengths of the observation.
    aberration : float
        Largest displacement (mm) by differential aberration, if it is not known and not removed; otherwise 0.
    """

    model: str
    largest: dict[str, float]
    drift: float
    tolerance: float | None
    light: ObservedLight
    aberration: float

    def __str__(self):
        """Return a sentence on the accuracy of the model, and on wavelengths."""
        error, limit = self.largest[self.model], self.tolerance
        text = f"positions are {f'within {error:.2g} mm of ' if error else ''}those of the model full"
        if np.isinf(error):
            text = f"the error of the model {self.model} is not known close to the horizon"
        if limit is not None:
            text += f" (tolerance {limit:.3g} mm{', which is exceeded' if limit < error < np.inf else ''})"
        text += f"; {self.light}"
        if np.isinf(self.drift):
            text += "; the motion of targets during the exposure is not known close to the horizon"
        elif self.drift:
            text += f"; targets move by up to {self.drift:.2g} mm during the exposure"
        if self.aberration:
            size = "" if limit is None else f", {'more' if self.aberration > limit else 'less'} than the tolerance"
            text += f"; unknown without a date: differential aberration, up to {self.aberration:.2g} mm{size}"
        return text

    @property
    def record(self) -> dict:
        """The choice as plain numbers and text, for the records of results."""
        return {
            "sufficient": self.sufficient,
            "sentence": str(self),
            "tolerance_mm": self.tolerance,
            "drift_mm": None if np.isinf(self.drift) else round(self.drift, 6),
            "largest_mm": {name: None if np.isinf(value) else round(value, 6) for name, value in self.largest.items()},
            "wavelengths": self.light.record,
            "unknown_aberration_mm": round(self.aberration, 6),
        }

    @property
    def sufficient(self) -> str:
        """The fastest model whose error is at most the tolerance; ``full`` if the tolerance is unknown."""
        limit = 0.0 if self.tolerance is None else self.tolerance
        return next(name for name, value in self.largest.items() if value <= limit)


def choose_model(optics: FieldOptics, basis: np.ndarray, conditions: ObservingConditions) -> ModelChoice:
    """Return the fastest model that is accurate enough for a field; ``basis`` is that of `ObservedField`.

    Raise an error if the field is not above the horizon.
    """
    light, factor = observed_light(optics.light, conditions), conditions.scale
    (scale, edge, error), radius = profile(optics, factor), optics.radius / min(factor, 1.0)
    for fiber_type in optics.fiber_types:
        light.of(fiber_type)  # raises an error if the wavelength is not known
    half, seconds, weights = conditions.numbers.half_exposure, np.zeros(1), np.ones(1)
    if half:
        moments, weights, _ = moments_of_exposure(FEWEST if half <= LONG else MANY)
        seconds = half * moments
    sky = midpoint(conditions, float(np.arctan2(basis[2, 1], basis[2, 0])))
    zenith = sky.zeniths(seconds) @ basis.T
    parts = np.array([np.inf, np.inf, np.inf, np.inf if half else 0.0])
    if zenith[:, 2].min() > np.sin(LOWEST + radius):
        distinct = light.distinct
        waves = np.array([coefficients(*sky.weather, wave)[0] for wave in (distinct[0], distinct[-1])])
        guide = coefficients(*sky.weather, light.guide)[0]
        plane = np.ascontiguousarray(zenith[:, :2] / zenith[:, 2:])
        refraction.displacements(
            plane, weights, len(seconds) // 2, np.tan(radius), guide, waves, light.removes_scale, parts
        )
    else:
        field_of_model("full", basis, optics, conditions)  # raises an error if the field is not above the horizon
    static, instant, mean, drift = MARGIN * factor * scale * parts
    stretch = MARGIN * factor * scale * np.tan(radius)  # at the edge (mm), for a change of all field angles by a factor
    static += MARGIN * abs(factor - 1) * edge / max(factor, 1.0) + np.linalg.norm(sky.motion[0, :3]) * stretch
    bounds = static + error, static, instant, mean, 0.0
    largest = {name: float(value) for name, value in zip(MODELS, bounds, strict=True)}
    aberration = SPEED * stretch * np.sqrt(1 - (basis[2] @ ECLIPTIC) ** 2) * _lacks_aberration(optics.light, conditions)
    given = conditions.numbers.tolerance
    tolerance = optics.tolerance if given is None else given
    choice = ModelChoice(conditions.projection, largest, float(drift), tolerance, light, float(aberration))
    return replace(choice, model=choice.sufficient) if choice.model == "auto" else choice


def _lacks_aberration(light: Light, conditions: ObservingConditions) -> bool:
    return conditions.time is None and conditions.date is None and "scale" not in light.guider_removes


def not_included(light: Light, conditions: ObservingConditions) -> tuple[str, ...]:
    """Return the effects on positions that no model includes, each with the reason in parentheses."""
    used = observed_light(light, conditions)
    guided = " and the guide camera" if used.guide == used.fibers else ""
    dispersion = f"dispersion (all fibers{guided} are assumed to observe at {ASSUMED_UM:g} um)"
    aberration = "differential aberration (the conditions have an hour angle and no date)"
    return (dispersion,) * (used.assumed and not used.compensated) + (aberration,) * _lacks_aberration(
        light, conditions
    )


def check_model(model: str | None, conditions: ObservingConditions | None) -> None:
    """Raise an error if a model is unknown, or must have conditions."""
    if model is not None:
        check_choice(model, ("auto", *MODELS), "projection")
        if conditions is None and model not in ("auto", *STATIC):
            raise InputError(f"the projection {model!r} must have conditions, got none; give the argument conditions")


def field_of_model(
    model: str, basis: np.ndarray, optics: FieldOptics, conditions: ObservingConditions | None = None
) -> FieldProjection | ObservedField:
    """Return the projection of a field by a model; ``basis`` is that of `ObservedField`."""
    if model in STATIC:
        return FieldProjection(basis, optics.focal_length, None if model == "tangent" else optics.distortion)
    return ObservedField(basis, optics.focal_length, optics.distortion, conditions, optics.radius, optics.light, model)


def displacements(
    points: np.ndarray, fiber_types: Sequence[str | None], *field: object
) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Compare the images of targets in each model with their images in the model ``full``.

    Parameters
    ----------
    points : ndarray, shape (m, n, 2)
        Positions of the images in the model ``full``, in mm, for each fiber type.
    fiber_types : sequence of str or None
        The m fiber types of the targets.
    *field : object
        All arguments of `field_of_model` except the name of the model.

    Returns
    -------
    dict of str to ndarray, shape (m, n)
        For each model, the distances (mm) from the images in the model ``full``.
    ndarray, shape (m, n)
        The largest distance (mm) between the image and its mean position during the exposure.
    """
    fields = {name: field_of_model(name, *field) for name in MODELS}
    full = fields.pop("full")
    targets = [(full.unproject(xy, kind), xy, kind) for xy, kind in zip(points, fiber_types, strict=True)]
    moved = {
        name: np.array([np.hypot(*(field.project(vectors, kind) - xy).T) for vectors, xy, kind in targets])
        for name, field in fields.items()
    }
    moved["full"] = np.zeros(points.shape[:2])
    return moved, np.array([full.drift(vectors, kind) for vectors, _, kind in targets])
