"""Refraction by the formula of ERFA, with explicit zenith distances."""

import erfa
import numpy as np


def refraction(wave, zenith, pressure=799.93, celsius=7.0, humidity=1.0):
    """Return the refraction of ERFA (arcsec); at 7 deg C, a vapor pressure of 8 mm Hg is saturated."""
    a, b = erfa.refco(pressure, celsius, humidity, wave)
    return np.rad2deg(a * np.tan(zenith) + b * np.tan(zenith) ** 3) * 3600
