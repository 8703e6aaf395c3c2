"""Ranges and speeds of the joints, on which static plans do not depend."""

from dataclasses import replace

import astropy.units as u
import numpy as np
import pytest
from raising import refused

import rfpsurvey as rs
from rfpsurvey.positioner import JointMotion

LAMOST = JointMotion([0, 360] * u.deg, [0, 180] * u.deg)
SDSS = JointMotion([-90, 270] * u.deg, [0, 180] * u.deg, 11.71875 * u.deg / u.s, 11.71875 * u.deg / u.s)
MOONS = JointMotion([-180, 180] * u.deg, [0, 330] * u.deg, 16.68 * u.deg / u.s, 22.5 * u.deg / u.s)
DESI = JointMotion(theta_speed=176.07 * u.deg / u.s, phi_speed=176.07 * u.deg / u.s)
PUBLISHED = {"lamost": LAMOST, "sdss_apo": SDSS, "sdss_lco": SDSS, "moons": MOONS, "desi": DESI}
PUBLISHED |= {"pfs": JointMotion(phi_range=[-180, 5.9] * u.deg), "must": JointMotion(), "spec_s5": JointMotion()}


@pytest.mark.parametrize("name", PUBLISHED)
def test_presets(presets, name, tmp_path):
    model = presets[name]
    assert model.motion == PUBLISHED[name]
    model.write(tmp_path / "same.ecsv")
    assert rs.Instrument.read(tmp_path / "same.ecsv").motion == model.motion
    parked, ranges = model.focal_plane.positioner.numbers.home, (model.motion.theta_range, model.motion.phi_range)
    for angle, ends in zip(parked, ranges, strict=True):  # the parked pose is within the ranges, modulo 360 deg
        low, high = (-np.inf, np.inf) if ends is None else ends.to_value(u.rad)
        assert any(low <= angle + turn <= high for turn in (0, -2 * np.pi, 2 * np.pi))


@pytest.mark.parametrize("name", PUBLISHED)
def test_plans_do_not_depend_on_the_motion(presets, name):
    model = presets[name]
    values = {key: entry for key, entry in model.values.items() if not key.startswith("motion.")}
    assert replace(model, values=values).provenance == model.provenance
    assert not any(key.startswith("motion.") for key in model.provenance["values"])


def test_instruments_as_built_keep_the_speeds(real_data):
    built = rs.Instrument.read(real_data("desi/fp-metrology.csv.gz"))
    assert built.motion == DESI
    built = rs.Instrument.from_sdssv(real_data("sdssv_apo_2021"))
    assert built.motion == SDSS


def test_the_stops_and_the_parked_pose_of_sdss_are_those_of_the_real_instrument(presets, real_data):
    plane = rs.Instrument.from_sdssv(real_data("sdssv_apo_2021")).focal_plane
    zero = np.median(plane.zero_points[:, 0].to_value(u.deg))
    stops, home = presets["sdss_apo"].motion.theta_range, presets["sdss_apo"].focal_plane.positioner.home
    assert np.abs(plane.positioner.theta_range.value + zero - stops.value).max() < 1
    assert abs(plane.positioner.home[0].value + zero - home[0].value) < 1


def test_a_description_with_a_motion(tmp_path):
    text = 'name = "own"\ninherits = "lamost"\nstatus = "assumed"\nsource = "s"\n[motion]\n'
    (tmp_path / "own.toml").write_text(f'{text}theta_speed = {{ value = 0.5, unit = "rad / s" }}\n')
    assert rs.Instrument.read(tmp_path / "own.toml").motion == replace(LAMOST, theta_speed=0.5 * u.rad / u.s)


WRONG = [
    ({"theta_range": [10, 0] * u.deg}, r"theta_range must be \(low, high\) with low < high, got \[10"),
    ({"phi_range": [0, np.nan] * u.deg}, "phi_range must be two finite angles"),
    ({"phi_range": [0, 1] * u.mm}, "phi_range must have a unit convertible to rad, got mm"),
    ({"theta_speed": 0 * u.deg / u.s}, "theta_speed must be one finite value above 0 deg / s"),
    ({"theta_speed": -1 * u.deg / u.s}, "theta_speed must be one finite value above 0 deg / s"),
    ({"phi_speed": np.nan * u.deg / u.s}, "phi_speed must be one finite value above 0 deg / s"),
    ({"phi_speed": 1 * u.deg}, "phi_speed must have a unit convertible to deg / s, got deg"),
    ({"phi_speed": 12}, "phi_speed must"),
]


@pytest.mark.parametrize(("given", "message"), WRONG)
def test_wrong_values_are_refused(given, message):
    refused(message, JointMotion, **given)
