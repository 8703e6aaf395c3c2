"""Bounds of the errors of models: scales, guiders that remove the scale, maps without symmetry, and low fields."""

import json
from dataclasses import replace

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.table import QTable
from raising import refused

import rfpsurvey as rs
from rfpsurvey._sky.models import choose_model
from rfpsurvey.instrument import compare_projections

CENTER = SkyCoord("6h20m +23d")
KEEPS_SCALE = {"value": ["shift", "rotation", "scale"], "status": "assumed", "source": "test"}


def assert_bounded(instrument, conditions):
    """Compare the bound of each model with the positions of targets in all models."""
    compared = compare_projections(instrument, CENTER, conditions)
    choice = choose_model(instrument.optics, instrument.projection(CENTER).plain.basis, conditions)
    errors = dict(zip(compared.table["model"], compared.table["max"].to_value(u.mm), strict=True))
    assert np.isfinite(errors["full"])
    assert all(choice.largest[model] >= error - 1e-9 for model, error in errors.items() if np.isfinite(error))
    assert choice.drift >= compared.drift.to_value(u.mm) * (1 - 1e-6)
    return errors, choice


def with_map(desi):
    """Return DESI with a distortion map whose scale increases from the center to the edge by a tenth."""
    limit, length, cubic = 1.7 * u.deg, desi.plate_scale, 0.05
    edge = float(np.tan(limit)) * length.to_value(u.mm / u.rad)
    coefficients = np.array([0, 0, 1, cubic, 0, cubic, 1, cubic, 0, cubic]) * edge
    distortion = rs.projection.DistortionMap(coefficients, 3, 0, limit, mirrored=False)
    return replace(desi, plate_scale=None, distortion=distortion)


@pytest.mark.parametrize("scale", [0.9, 0.999, 1.1])
@pytest.mark.parametrize("name", ["lamost", "sdss_apo", "moons"])
def test_bounds_are_valid_for_all_scales(presets, name, scale):
    """Regression: bounds did not contain the factor ``scale``, and errors at the end of the radial map were NaN."""
    given = {"exposure_time": 1 * u.hour, "compensator": "none", "guide_wavelength": 0.8 * u.um, "scale": scale}
    errors, _ = assert_bounded(presets[name], rs.ObservingConditions("xinglong", hour_angle=4 * u.hourangle, **given))
    assert np.isfinite(errors["dispersion"])


def test_bounds_are_valid_for_distortion_maps(presets):
    """Regression: the scale of a distortion map at the edge, and the error of a tangent plane, were neglected."""
    instrument = with_map(presets["desi"])
    for given in ({"pressure": 0 * u.hPa}, {"exposure_time": 2 * u.hour, "compensator": "none"}):
        conditions = rs.ObservingConditions("kitt peak", hour_angle=3 * u.hourangle, **given)
        errors, choice = assert_bounded(instrument, conditions)
        assert errors["tangent"] > 10
        assert choice.model != "tangent"


def test_bounds_are_valid_for_guiders_that_remove_the_scale(presets):
    """Regression: without the scale, displacements by dispersion and by refraction no longer cancel each other."""
    values = presets["sdss_apo"].values
    instrument = replace(presets["sdss_apo"], values={**values, "light.guider_removes": KEEPS_SCALE})
    for hours in (0.5, 4):
        given = {"exposure_time": 1 * u.hour, "guide_wavelength": 1.3 * u.um, "pressure": 1000 * u.hPa}
        given["wavelength"] = {"BOSS": 1.56 * u.um, "APOGEE": 2.16 * u.um}
        conditions = rs.ObservingConditions("xinglong", hour_angle=hours * u.hourangle, **given)
        errors, choice = assert_bounded(instrument, conditions)
        assert choice.largest["radial"] < 1.2 * errors["radial"]


@pytest.mark.parametrize(("model", "hours"), [("tangent", 11), ("radial", 11), ("dispersion", 6.8), ("auto", 6.8)])
def test_fields_must_be_above_the_horizon_in_all_models(model, hours):
    """Regression: the altitude was not tested in models without refraction, nor at the end of the exposure."""
    given = {"exposure_time": 2 * u.hour, "projection": model}
    conditions = rs.ObservingConditions("xinglong", hour_angle=hours * u.hourangle, **given)
    stars = rs.Catalog(CENTER.directional_offset_by([0, 90, 180] * u.deg, 0.5 * u.deg))
    tiling = rs.Tiling.from_table(QTable({"ra": [95.0] * u.deg, "dec": [23.0] * u.deg})).with_conditions(conditions)
    message = "the whole field with its radius of 2.477 deg must be above the horizon"
    refused(message, rs.plan_tile, stars, "lamost", CENTER, conditions=conditions)
    refused(f"tile 0: {message}", rs.plan_survey, stars, "lamost", tiling)


@pytest.mark.parametrize(
    ("given", "sentence", "drift"),
    [
        ({}, "positions are those of the model full", 0.0),
        ({"exposure_time": 10 * u.min}, "; the motion of targets during the exposure is not known close to the", None),
        ({"projection": "dispersion"}, "the error of the model dispersion is not known close to the horizon", 0.0),
    ],
)
def test_errors_close_to_the_horizon_are_not_stated_as_infinite_numbers(presets, given, sentence, drift):
    """Regression: targets moved "by up to inf mm", also without an exposure, and records contained infinity."""
    conditions = rs.ObservingConditions("xinglong", hour_angle=6.5 * u.hourangle, **given)
    choice = presets["lamost"].model_choice(np.deg2rad([95, 23, 0]), conditions)
    assert sentence in str(choice)
    assert "inf mm" not in str(choice)
    assert "exceeded" not in str(choice)
    assert choice.record["drift_mm"] == drift
    json.dumps(choice.record, allow_nan=False)
