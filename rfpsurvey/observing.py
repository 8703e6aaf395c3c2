"""Observing conditions: refraction, dispersion and field rotation in the projection of a field."""

from rfpsurvey._sky.conditions import ObservingConditions
from rfpsurvey._sky.observed_field import ObservedField
from rfpsurvey._sky.observed_plane import ObservedPlane
from rfpsurvey._sky.wavelengths import Light

__all__ = ["Light", "ObservedField", "ObservedPlane", "ObservingConditions"]
