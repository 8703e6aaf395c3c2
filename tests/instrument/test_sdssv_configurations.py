"""SDSS-V as built, compared with real configurations of 2021 and 2024."""

import shutil
from dataclasses import replace

import astropy.units as u
import numpy as np
import pytest
from astropy.table import QTable
from numpy.testing import assert_array_equal
from raising import warned

import rfpsurvey as rs
from rfpsurvey.collision import place_arms


def positions_and_angles(plane, plan, fiber):
    """Return x, y, alpha and beta of a fiber in the order of the positioners."""
    rows = plan[plan["fiber_type"] == fiber]
    assert sorted(rows["positioner"]) == sorted(plane.id)
    rows = rows[[rows["positioner"].tolist().index(hole) for hole in plane.id.tolist()]]
    return np.column_stack([rows["x"].value, rows["y"].value]), rows["theta"], rows["phi"]


CONFIGURATIONS = [
    ("sdssv_apo_2024", "confSummary-test", 1e-5, 490, 2e-5, 1e-5),
    ("sdssv_apo_2021", "confSummary-998", 3e-4, 500, None, None),
    ("sdssv_apo_2021", "confSummaryF-998", 3e-4, 500, None, None),
]


@pytest.mark.few(1)
@pytest.mark.parametrize(("folder", "file", "within", "n", "alpha", "beta"), CONFIGURATIONS)
def test_positions_of_real_configurations_follow_from_their_joint_angles(
    real_data, folder, file, within, n, alpha, beta
):
    """All 1500 rows are compared, but for 10 robots without angles in 2024, and one fiber without a place in 2021."""
    plane = rs.Instrument.read(real_data(folder)).focal_plane
    plan = rs.plans.read_plan(real_data(f"{folder}/{file}.par.gz"))
    for fiber in ("BOSS", "APOGEE", "METROLOGY"):
        xy, theta, phi = positions_and_angles(plane, plan, fiber)
        apart = np.hypot(*(plane.forward(theta, phi, fiber).value - xy).T)
        compared = np.isfinite(apart)
        lacks = {"R+8C7"} if folder == "sdssv_apo_2021" and fiber == "BOSS" else set()
        assert compared.sum() == n - len(lacks)
        assert set(plane.id[~compared].tolist()) == (NO_ANGLES if n == 490 else lacks)
        assert apart[compared].max() < within
        # the joint angles of the positions reproduce the positions to the precision of the file
        again = plane.forward(*plane.inverse(xy * u.mm, fiber), fiber).value
        assert np.abs(again - xy)[compared & np.isfinite(again[:, 0])].max() < 1e-9
        if alpha is not None:
            back = plane.inverse(xy * u.mm, fiber)
            assert np.abs((back[0] - theta).value)[compared].max() < alpha
            assert np.abs((back[1] - phi).value)[compared].max() < beta


NO_ANGLES = {*("R-12C5", "R-10C5", "R-5C8", "R-2C17", "R0C1"), *("R+3C5", "R+9C5", "R+9C10", "R+13C1", "R+13C11")}


def test_robots_without_angles_are_those_whose_target_is_out_of_reach_as_built(real_data):
    plan = rs.plans.read_plan(real_data("sdssv_apo_2024/confSummary-test.par.gz"))
    tile = rs.score_tile(plan, rs.Instrument.read(real_data("sdssv_apo_2024")))
    assert (set(tile["id"][tile["status"] == "out_of_reach"]), tile.summary["n_assigned"]) == (NO_ANGLES, 500)
    nominal = warned("arms are nominal: score the plan with the instrument as built", rs.score_tile, plan, "sdss_apo")
    assert nominal.summary["n_out_of_reach"] == 2


def test_a_design_from_the_sky_has_the_same_targets_out_of_reach(real_data):
    """Design 21636 has the targets of the configuration; its positions on the sky are projected here."""
    designs = QTable.read(real_data("sdssv_eight_designs.ecsv"))
    built = rs.Instrument.read(real_data("sdssv_apo_2024"))
    tile = rs.score_tile(designs[designs["design_id"] == 21636], built, equinox="J2022.0")
    assert set(tile["id"][tile["status"] == "out_of_reach"]) == NO_ANGLES
    assert tile.summary["n_colliding_pairs"] <= 2


@pytest.mark.few(1)
@pytest.mark.parametrize("file", ["confSummary-998", "confSummaryF-998"])
def test_no_pair_of_a_real_configuration_collides_with_all_robots_as_they_stood(real_data, file):
    """Robots without a target are included; the fiber through which each is posed does not matter."""
    plane = rs.Instrument.read(real_data("sdssv_apo_2021")).focal_plane
    plan = rs.plans.read_plan(real_data(f"sdssv_apo_2021/{file}.par.gz"))
    _, theta, phi = positions_and_angles(plane, plan, "APOGEE")
    places = {"APOGEE": plane.fiber_xy["APOGEE"]}
    free = replace(plane, fiber_type=["APOGEE"] * 500, fiber_xy=places, disabled=None, spectrograph=None)
    posed = place_arms(free, free.forward(theta, phi))
    assert posed.assigned.all()
    report = rs.find_collisions(free, posed)
    assert len(report.pairs) == len(report.obstacle_pairs) == 0


def test_the_nominal_preset_misses_the_fibers_by_a_quarter_of_a_millimeter(real_data):
    """Nominal robots with the same joint angles: arms of 7.4 mm, no offsets, fibers at nominal places."""
    built = rs.Instrument.read(real_data("sdssv_apo_2024")).focal_plane
    nominal = rs.Instrument.preset("sdss_apo").focal_plane
    n = len(nominal)
    plane = rs.FocalPlane(
        nominal.xy,
        built.positioner,
        id=nominal.id,
        fiber_xy=np.tile([14.965, -0.376], (n, 1)) * u.mm,
        zero_points=np.tile([-90.0, 0.0], (n, 1)) * u.deg,
    )
    plan = rs.plans.read_plan(real_data("sdssv_apo_2024/confSummary-test.par.gz"))
    xy, theta, phi = positions_and_angles(built, plan, "BOSS")
    assert 0.24 < np.nanmedian(np.hypot(*(plane.forward(theta, phi).value - xy).T)) < 0.28


def test_a_real_calibration_survives_missing_files(real_data, tmp_path):
    source = real_data("sdssv_apo_2021")
    for name in ("positionerTable.csv", "wokCoords.csv"):
        shutil.copy(source / name, tmp_path / name)
    with_all, with_two = rs.Instrument.read(source), rs.Instrument.read(tmp_path)
    assert_array_equal(with_all.focal_plane.xy, with_two.focal_plane.xy)
    assert with_all.distortion == with_two.distortion
    assert with_all.focal_plane.id[with_all.focal_plane.disabled].tolist() == ["R+8C7"]
    assert len(with_all.focal_plane.obstacles) == 42
