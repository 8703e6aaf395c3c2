"""Observing conditions: refraction, dispersion and field rotation, and the light that enters fibers."""

from rfpsurvey._instruments.light import FiberLight
from rfpsurvey._sky.conditions import ObservingConditions
from rfpsurvey._sky.light import fiber_fraction, seeing_fwhm
from rfpsurvey._sky.observed_field import ObservedField
from rfpsurvey._sky.observed_plane import ObservedPlane
from rfpsurvey._sky.wavelengths import Light

__all__ = [
    "FiberLight",
    "Light",
    "ObservedField",
    "ObservedPlane",
    "ObservingConditions",
    "fiber_fraction",
    "seeing_fwhm",
]
