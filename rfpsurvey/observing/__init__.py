"""Observing conditions: refraction, dispersion and field rotation in the projection of a field."""

from rfpsurvey.observing._conditions import ObservingConditions
from rfpsurvey.observing._field import ObservedField
from rfpsurvey.observing._plane import ObservedPlane
from rfpsurvey.observing._sites import SITES

__all__ = ["SITES", "ObservedField", "ObservedPlane", "ObservingConditions"]
