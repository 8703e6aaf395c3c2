"""Models of the projection, from the fastest to the most complete, and the displacements that each model neglects."""

from collections.abc import Sequence

import numpy as np

from rfpsurvey.errors import InputError, check_choice
from rfpsurvey.observing._conditions import ObservingConditions
from rfpsurvey.observing._field import ObservedField
from rfpsurvey.projection import FieldProjection

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
    targets = [(full.unproject(own, kind), own, kind) for own, kind in zip(points, fiber_types, strict=True)]
    moved = {
        name: np.array([np.hypot(*(one.project(vectors, kind) - own).T) for vectors, own, kind in targets])
        for name, one in fields.items()
    }
    moved["full"] = np.zeros(points.shape[:2])
    return moved, np.array([full.drift(vectors, kind) for vectors, _, kind in targets])
