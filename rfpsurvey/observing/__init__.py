"""Observing conditions: refraction, dispersion and field rotation in the projection of a field."""

from rfpsurvey.observing._conditions import ObservingConditions, as_hour_angle, check_conditions
from rfpsurvey.observing._field import MODELS, ObservedField, displacements, field_of_model, model_of
from rfpsurvey.observing._plane import ObservedPlane
from rfpsurvey.observing._sites import SITES, location

__all__ = [
    "MODELS",
    "SITES",
    "ObservedField",
    "ObservedPlane",
    "ObservingConditions",
    "as_hour_angle",
    "check_conditions",
    "displacements",
    "field_of_model",
    "location",
    "model_of",
]
