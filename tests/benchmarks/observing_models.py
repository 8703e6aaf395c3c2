"""Displacements and times of the models of the projection: ``python tests/benchmarks/observing_models.py``.

It prints the table of the page on observing conditions, and the times in ``docs/figures/observing_models.py``. Fields
pass through the zenith, and are west of the meridian.
"""

import astropy.units as u
import numpy as np
from astropy.coordinates import SkyCoord
from measure import smallest

import rfpsurvey as rs
from rfpsurvey._sky.conditions import MODELS
from rfpsurvey._sky.models import field_of_model

BOTH = {"BOSS": 0.54 * u.um, "APOGEE": 1.6 * u.um}
# Site, and wavelength of the fibers; compensators of MOONS, DESI and PFS remove the dispersion.
CASES = {
    "lamost": ("xinglong", 0.5 * u.um),
    "sdss_apo": ("apache point", BOTH),
    "moons": ("paranal", 0.6231 * u.um),
    "desi": ("kitt peak", 0.6231 * u.um),
    "pfs": ("mauna kea", 0.6231 * u.um),
}
ALTITUDES = (85, 75, 60, 45, 30, 20)
N_TARGETS, REPEATS = 10_000, 20


def conditions_at(name, altitude):
    """Return conditions with a field at an altitude (deg), and the center of the field."""
    site, wavelength = CASES[name]
    given = {"wavelength": wavelength, "guide_wavelength": 0.6231 * u.um, "exposure_time": 15 * u.min}
    latitude = rs.ObservingConditions(site, hour_angle=0 * u.deg).site.lat.rad
    # with declination = latitude: sin(altitude) = sin(lat)^2 + cos(lat)^2 cos(hour angle)
    cosine = (np.sin(np.deg2rad(altitude)) - np.sin(latitude) ** 2) / np.cos(latitude) ** 2
    conditions = rs.ObservingConditions(site, hour_angle=np.arccos(cosine) * u.rad, **given)
    return conditions, SkyCoord(0 * u.deg, latitude * u.rad)


def seconds(name):
    """Return the time of each model for the projection of targets, with the preparation of the field."""
    instrument = rs.Instrument.preset(name)
    conditions, center = conditions_at(name, 45)
    plane, radius = instrument.projection(center), instrument.field_radius
    coord = rs.synthetic_catalog("uniform", center, 0.98 * radius, n_targets=N_TARGETS, rng=1).coord
    vectors = coord.cartesian.xyz.value.T.copy()
    kinds = np.resize(instrument.focal_plane.fiber_types, N_TARGETS)
    found = {}
    for model in MODELS:

        def project(model=model):
            field_of_model(model, plane.plain.basis, instrument.optics, conditions).project(vectors, kinds)

        found[model] = smallest(project, REPEATS)
    return found


if __name__ == "__main__":
    for name in CASES:
        for altitude in ALTITUDES:
            conditions, center = conditions_at(name, altitude)
            result = rs.instrument.compare_projections(name, center, conditions)
            moved = [f"{1e3 * value:9.2f}" for value in result.table["max"].to_value(u.mm)]
            drift, limit = (1e3 * value.to_value(u.mm) for value in (result.drift, result.tolerance))
            print(
                f"{name:<9} altitude {altitude} deg, um:",
                *moved,
                f"drift {drift:.2f}, tolerance {limit:.1f}: {result.sufficient}",
            )
    for name in CASES:
        print(f"{name:<9} ms per {N_TARGETS} targets:", {k: round(1e3 * t, 2) for k, t in seconds(name).items()})
