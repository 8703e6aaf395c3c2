"""Observing conditions: refraction, dispersion and field rotation in the projection of a field."""

from rfpsurvey._sky.conditions import ObservingConditions
from rfpsurvey._sky.observed_field import ObservedField
from rfpsurvey._sky.observed_plane import ObservedPlane

__all__ = ["ObservedField", "ObservedPlane", "ObservingConditions"]
