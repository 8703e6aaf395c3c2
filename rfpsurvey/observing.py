"""Observing conditions: refraction, dispersion and field rotation, and the light that enters fibers."""

from rfpsurvey._instruments.light import FiberLight
from rfpsurvey._sky.conditions import ObservingConditions
from rfpsurvey._sky.light import fiber_fraction, seeing_fwhm
from rfpsurvey._sky.observed_field import ObservedField
from rfpsurvey._sky.observed_plane import ObservedPlane

__all__ = ["FiberLight", "ObservedField", "ObservedPlane", "ObservingConditions", "fiber_fraction", "seeing_fwhm"]
