"""Displacements and times of the models of the projection: ``python tests/benchmarks/observing_models.py``.

It prints the bounds of errors and the table of the page on observing conditions, the times in
``docs/figures/observing_models.py``, and the times of tiles with and without conditions, in alternating repeats. Fields
pass through the zenith, and are west of the meridian.
"""

from dataclasses import replace
from time import perf_counter

import astropy.units as u
import numpy as np
from astropy.coordinates import AltAz, SkyCoord
from measure import smallest

import rfpsurvey as rs
from rfpsurvey._sky.conditions import MODELS
from rfpsurvey._sky.models import choose_model, field_of_model

CASES = {
    "lamost": "xinglong",
    "sdss_apo": "apache point",
    "moons": "paranal",
    "desi": "kitt peak",
    "pfs": "mauna kea",
}
ALTITUDES = (85, 75, 60, 45, 30, 20)
N_TARGETS, REPEATS, N_FIELDS = 10_000, 20, 500
TIMES = {"lamost": "2026-01-15T16:00"}


def conditions_at(name, altitude):
    """Return conditions with a field at an altitude (deg), and the center of the field."""
    site, given = CASES[name], {"exposure_time": 15 * u.min}
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


def tiles(name):
    """Print the time of a tile with conditions divided by that without, and the time of the choice of the model.

    In the first case, a model with refraction suffices. The floor contains the projection by this model, but no choice.
    """
    instrument, (conditions, center) = rs.Instrument.preset(name), conditions_at(name, 60)
    density = min(instrument.target_density, 3e4 / u.deg**2)
    stars = rs.synthetic_catalog("poisson", center, instrument.field_radius, density=density, rng=1)
    ideal = replace(conditions, compensator="ideal")
    dated = rs.ObservingConditions(CASES[name], time=TIMES.get(name, "2026-01-15T06:00"), exposure_time=15 * u.min)
    overhead = SkyCoord(AltAz(az=0 * u.deg, alt=70 * u.deg, obstime=dated.time, location=dated.site)).icrs
    moved = rs.synthetic_catalog("poisson", overhead, instrument.field_radius, density=density, rng=1)
    cases = {
        "none": (stars, center, {}),
        "floor": (stars, center, {"conditions": replace(ideal, projection="refraction")}),
        "refraction": (stars, center, {"conditions": ideal}),
        "auto": (stars, center, {"conditions": conditions}),
        "none, dated": (moved, overhead, {}),
        "dated": (moved, overhead, {"conditions": dated}),
    }
    seconds = {case: [] for case in cases}
    for _ in range(REPEATS):
        for case, (sky, where, given) in cases.items():
            begin = perf_counter()
            rs.plan_tile(sky, instrument, where, **given)
            seconds[case].append(perf_counter() - begin)
    medians = {case: np.median(values[1:]) for case, values in seconds.items()}
    basis = instrument.projection(center).plain.basis
    choice = smallest(lambda: choose_model(instrument.optics, basis, conditions), 200)
    ratios = {case: round(medians[case] / medians["none"], 2) for case in ("floor", "refraction", "auto")}
    ratios["dated"] = round(medians["dated"] / medians["none, dated"], 2)
    print(f"{name:<9} {len(stars)} targets, {1e3 * medians['none']:.1f} ms per tile without conditions, {ratios},")
    print(f"          choice {1e6 * choice:.0f} us, {100 * choice / medians['none']:.2f} %")


def bounds():
    """Print, for random fields, the bounds of the errors of models divided by the errors, by altitude."""
    rng, ratios = np.random.default_rng(1), {"above": [], "below": []}
    for k in range(N_FIELDS):
        name = list(CASES)[k % len(CASES)]
        instrument, altitude = rs.Instrument.preset(name), rng.uniform(20, 89)
        conditions, center = conditions_at(name, altitude)
        waves = rng.uniform(0.36, 1.8, 2) * u.um
        conditions = replace(
            conditions, wavelength=waves[0], guide_wavelength=waves[1], compensator="none",
            pressure=rng.uniform(500, 1000) * u.hPa, exposure_time=rng.choice([300, 900, 3600]) * u.s,
        )  # fmt: skip
        errors = rs.instrument.compare_projections(instrument, center, conditions).table["max"].to_value(u.mm)[1:4]
        largest = choose_model(instrument.optics, instrument.projection(center).plain.basis, conditions).largest
        ratio = np.array([largest[model] for model in list(MODELS)[1:4]]) / errors
        ratios["above" if altitude > 30 else "below"].append(ratio)
    for where, values in ratios.items():
        least, median, most = np.min(values, axis=0), np.median(values, axis=0), np.max(values, axis=0)
        print(f"bound divided by error, {where} 30 deg: {least.round(3)}, {median.round(3)}, {most.round(3)}")


if __name__ == "__main__":
    bounds()
    for name in CASES:
        tiles(name)
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
