"""Wavelengths and bands that lack a fiber type of the instrument, and objects of light that are not valid."""

from dataclasses import replace

import astropy.units as u
import pytest
from astropy.coordinates import SkyCoord
from astropy.table import QTable
from raising import refused

import rfpsurvey as rs
from rfpsurvey.instrument import compare_projections
from rfpsurvey.observing import FiberLight, Light, ObservedPlane

CENTER = SkyCoord("6h20m +23d")
LACKS_B = "wavelength must have a value for the fiber type 'B', got values for A"
OWN = """
name = "own"
inherits = "lamost"
status = "assumed"
source = "test"
[layout]
fiber_types = { value = ["A", "B"] }
[light]
band = { value = { A = [0.4, 0.6] }, unit = "um" }
wavelength = { value = { A = 0.5 }, unit = "um" }
"""


def conditions(**given):
    return rs.ObservingConditions("xinglong", hour_angle=1 * u.hourangle, **given)


@pytest.fixture(scope="module")
def own(tmp_path_factory):
    path = tmp_path_factory.mktemp("own") / "own.toml"
    path.write_text(OWN)
    return rs.Instrument.read(path)


@pytest.fixture(scope="module")
def stars():
    return rs.Catalog(CENTER.directional_offset_by([0, 90, 180] * u.deg, 0.5 * u.deg))


def test_each_fiber_type_must_have_a_wavelength_in_all_models(own, stars):
    """Regression: fields for which the model ``refraction`` was chosen were planned, and other fields were errors."""
    tiling = rs.Tiling.from_table(QTable({"ra": [95.0] * u.deg, "dec": [23.0] * u.deg}))
    for given in ({}, {"wavelength": {"A": 0.55 * u.um}}):
        for tolerance in (0.001, 1):
            used = conditions(tolerance=tolerance * u.mm, **given)
            refused(LACKS_B, lambda used=used: rs.plan_tile(stars, own, CENTER, conditions=used))
            refused(LACKS_B, lambda used=used: rs.plan_survey(stars, own, tiling.with_conditions(used)))
    rs.plan_tile(stars, own, CENTER, conditions=conditions(compensator="ideal"))
    rs.plan_tile(stars, own, CENTER, conditions=conditions(wavelength={"A": 0.5 * u.um, "B": 0.6 * u.um}))
    rs.plan_tile(stars, "lamost", CENTER, conditions=conditions(wavelength={"A": 0.5 * u.um}))


def test_light_of_fibers_needs_a_band_and_a_wavelength_of_each_type(own):
    """Regression: a type without a band or a wavelength caused a KeyError."""
    message = "wavelengths must be given for the fiber type 'B', because own states only the band of A, got None"
    for given in ({"compensator": "ideal"}, {"wavelength": {"A": 0.5 * u.um, "B": 0.6 * u.um}}):
        refused(message, lambda given=given: FiberLight(own, CENTER, conditions(**given), 1 * u.arcsec))
    boss = conditions(wavelength={"BOSS": 0.5 * u.um})
    assert FiberLight("lamost", CENTER, boss, 1 * u.arcsec).wavelengths[""].value.tolist() == [0.37, 0.5, 0.9]
    refused("must have a value for the fiber type 'APOGEE'", lambda: FiberLight("sdss_apo", CENTER, boss, 1 * u.arcsec))


WRONG = [
    ({"guider_removes": "scale"}, "guider_removes must be a list of names, got 'scale'"),
    ({"guider_removes": 3}, "guider_removes must be a list of names, got 3"),
    ({"band": {}}, "band must be a Quantity"),
    ({"band": {"A": {"B": [1, 2] * u.um}}}, "band must be a Quantity"),
    ({"band": {1: [1, 2] * u.um}}, "band must have one value, or one for each fiber type"),
    ({"wavelength": {}}, "wavelength must have one value, or one for each fiber type, got {}"),
]


@pytest.mark.parametrize(("given", "message"), WRONG)
def test_light_that_no_instrument_can_have_is_refused(given, message):
    """Regression: other objects than lists caused a TypeError, and an empty dict a StopIteration in projections."""
    refused(message, lambda: Light(**given))


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        (
            'wavelength = { value = 500, unit = "um" }',
            "wavelength must be one finite value above 0.1 um",
        ),
        ('guider_removes = { value = ["focus"] }', "unknown displacement that the guider removes 'focus'"),
        ('band = { value = [0, 0.5], unit = "um" }', "band must be two wavelengths"),
    ],
)
def test_wrong_light_is_refused_when_a_description_is_read(tmp_path, entry, message):
    """Regression: the error occurred only in plans with conditions, and did not contain the name of the file."""
    path = tmp_path / "own.toml"
    path.write_text(f"{OWN.partition('[layout]')[0]}[light]\n{entry}\n")
    refused(f"own.toml: {message}", lambda: rs.Instrument.read(path))


@pytest.mark.parametrize("compensator", ["none", "instrument"])
def test_surveys_are_not_resumed_with_other_light(presets, stars, tmp_path, compensator):
    """Regression: with the compensator ``none``, surveys did not record the wavelengths of the instrument."""
    tiling = rs.Tiling.from_table(QTable({"ra": [95.0] * u.deg, "dec": [23.0] * u.deg}))
    tiling = tiling.with_conditions(conditions(compensator=compensator, projection="full"))
    lamost = presets["lamost"]
    rs.plan_survey(stars, lamost, tiling, folder=tmp_path / "survey")
    for name, value in (("wavelength", 0.6), ("guider_removes", ["shift", "scale"])):
        entry = {"value": value, "status": "assumed", "source": "test"} | ({"unit": "um"} if value == 0.6 else {})
        other = replace(lamost, values={**lamost.values, f"light.{name}": entry})
        again = {"folder": tmp_path / "survey", "resume": True}
        refused("wavelengths differ", lambda other=other, again=again: rs.plan_survey(stars, other, tiling, **again))
    rs.plan_survey(stars, lamost, tiling, folder=tmp_path / "survey", resume=True)


@pytest.mark.parametrize(
    ("name", "given", "stated"),
    [
        ("must", {}, "dispersion (all fibers and the guide camera are assumed to observe at 0.54 um)"),
        ("must", {"guide_wavelength": 0.7 * u.um}, "dispersion (all fibers are assumed to observe at 0.54 um)"),
        ("must", {"compensator": "ideal"}, ""),
        ("spec_s5", {}, ""),
    ],
)
def test_comparisons_state_assumed_wavelengths_where_dispersion_matters(presets, name, given, stated):
    """Regression: fibers were said to observe at the guide wavelength, and compensated dispersion to be neglected."""
    used = conditions(date="2026-01-01", **given)
    assert " ".join(compare_projections(presets[name], CENTER, used).not_included) == stated


def test_the_light_of_a_projection_is_checked():
    scale = {"plate_scale": 20 * u.m / u.rad, "conditions": conditions()}
    refused("light must be a Light, got 3", lambda: ObservedPlane(CENTER, **scale, light=3))


def test_a_time_replaces_the_hour_angle_and_the_date(tmp_path):
    """Regression: a time in place of that of a file, or of a tile, was an error if the conditions had a date."""
    path = tmp_path / "conditions.toml"
    path.write_text('site = "xinglong"\nhour_angle = "1 hourangle"\ndate = 2026-01-01\n')
    time = "2026-01-15T15:00:00"
    assert rs.ObservingConditions.read(path, time=time) == rs.ObservingConditions("xinglong", time=time)
    changed = rs.ObservingConditions.read(path, hour_angle=2 * u.hourangle)
    assert changed == conditions(date="2026-01-01").at_hour_angle(2 * u.hourangle)
    tiling = rs.Tiling.from_table(QTable({"ra": [95.0] * u.deg, "dec": [23.0] * u.deg, "time": [time]}))
    survey = rs.plan_survey(SkyCoord([CENTER]), "lamost", tiling.with_conditions(conditions(date="2026-01-01")))
    assert str(survey.tiles["time"][0]).startswith(time)
