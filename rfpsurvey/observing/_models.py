"""Models of the projection, from the fastest to the most complete, and the displacements that each model neglects."""

from collections.abc import Iterable

import astropy.units as u
import numpy as np

from rfpsurvey.errors import InputError, check_choice
from rfpsurvey.observing._conditions import ObservingConditions
from rfpsurvey.observing._field import ObservedField
from rfpsurvey.projection import FieldProjection

__all__ = ["MODELS", "displacements", "drifts", "field_of_model", "model_of"]

MODELS = {
    "tangent": "tangent plane with one plate scale",
    "radial": "radial map of the instrument",
    "refraction": "refraction at the midpoint of the exposure, at the guide wavelength",
    "dispersion": "refraction at the midpoint of the exposure, at the wavelength of each fiber type",
    "full": "refraction averaged over the exposure, at the wavelength of each fiber type",
}
STATIC = ("tangent", "radial")


def model_of(model: str | None, conditions: ObservingConditions | None) -> str:
    """Return the name of a model; the default is ``full`` if there are conditions, and ``radial`` otherwise."""
    if model is None:
        return "radial" if conditions is None else "full"
    check_choice(model, MODELS, "projection")
    if conditions is None and model not in STATIC:
        raise InputError(f"the projection {model!r} must have conditions, got none; give the argument conditions")
    return model


def field_of_model(
    model: str, basis: np.ndarray, focal_length: float, distortion: object, conditions=None, radius: float = 0.0
) -> FieldProjection | ObservedField:
    """Return the projection of a field by a model; the parameters after ``model`` are those of `ObservedField`."""
    if model in STATIC:
        return FieldProjection(basis, focal_length, None if model == "tangent" else distortion)
    if model != "full":
        conditions = conditions.without_exposure
    if model == "refraction":
        conditions = conditions.at_guide_wavelength
    return ObservedField(basis, focal_length, distortion, conditions, radius)


def displacements(
    points: np.ndarray, fiber_types: Iterable[str], *field: object, names: Iterable[str] = MODELS
) -> dict[str, np.ndarray]:
    """Return, for each model, the distances (mm) between the images of targets in this model and in the model ``full``.

    ``points`` (n, 2) are positions of fibers (mm); ``field`` contains all arguments of `field_of_model`
    except the name of the model.
    """
    full = field_of_model("full", *field)
    out = {name: [] for name in names}
    for kind in fiber_types:
        vectors = full.unproject(points, kind)
        for name in names:
            image = field_of_model(name, *field).project(vectors, kind)
            out[name].append(np.hypot(*(image - points).T))
    return {name: np.concatenate(found) for name, found in out.items()}


def drifts(points: np.ndarray, fiber_types: Iterable[str], *field: object) -> np.ndarray:
    """Return the largest distance (mm) between the image of each target and its mean position during the exposure."""
    basis, focal_length, distortion, conditions, *radius = field
    half = conditions.exposure_time / 2
    if half == 0 * u.s:
        return np.zeros(len(points) * len(list(fiber_types)))
    full = field_of_model("full", *field)
    ends = [
        ObservedField(basis, focal_length, distortion, conditions.without_exposure.shifted(time), *radius)
        for time in (-half, half)
    ]
    found = []
    for kind in fiber_types:
        vectors = full.unproject(points, kind)
        found.append(np.max([np.hypot(*(end.project(vectors, kind) - points).T) for end in ends], axis=0))
    return np.concatenate(found)
