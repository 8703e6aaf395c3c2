"""Poses that plans record are scored as recorded."""

from dataclasses import replace

import astropy.units as u
import desi_files
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.table import QTable
from numpy.testing import assert_array_equal

import rfpsurvey as rs
from rfpsurvey import plans

CENTER = SkyCoord(95, 23, unit="deg")


@pytest.fixture
def configuration(real_data):
    """Return a plan with 202 robots without a target, and the instrument for which it was made."""
    pytest.importorskip("pydl", reason="pydl is not installed")
    plan = plans.read_plan(real_data("sdssv_apo_2021/confSummary-998.par.gz"))
    return plan, rs.Instrument.read(real_data("sdssv_apo_2021"))


def angles_of(plan, plane):
    rows = plan[plan["fiber_type"] == "APOGEE"]
    rows = rows[[rows["positioner"].tolist().index(hole) for hole in plane.id.tolist()]]
    return rows["theta"], rows["phi"]


@pytest.mark.few(1)
@pytest.mark.parametrize("moved", [False, True])
def test_robots_without_a_target_are_at_their_recorded_joint_angles(configuration, moved):
    """They were ignored, and one disabled robot was placed in its parked pose, where it collided with a neighbor."""
    plan, built = configuration
    plane, holes = built.focal_plane, np.asarray(plan["positioner"])
    idle = ~np.isin(plane.id, holes[plan["assigned"]])
    assert idle.sum() == 202
    if moved:
        turned = np.random.default_rng(1).uniform([0, 0], [360, 180], (500, 2))
        for k in np.flatnonzero(idle):
            plan["theta"][holes == plane.id[k]], plan["phi"][holes == plane.id[k]] = turned[k] * u.deg
    tile = rs.score_tile(plan, built)
    theta, phi = angles_of(plan, plane)
    alone = rs.find_collisions(replace(plane, disabled=np.zeros(500, dtype=bool)), theta=theta, phi=phi)
    assert (tile.summary["n_colliding_pairs"], len(alone.pairs) > 50) == (len(alone.pairs), moved)
    assert_array_equal(tile.table["in_collision"], alone.in_collision)
    assert (tile.summary["n_recorded"], set(tile.table["status"][idle])) == (201, {"recorded", "disabled"})
    assert np.abs(tile.table["phi"] - phi)[idle].max() < 1e-9 * u.deg
    expected = "202 positioners without a target: 202 at the recorded joint angles"
    assert tile.summary["poses_without_target"] == expected
    again = rs.score_tile(tile.table, built)
    assert_array_equal(tile.table["status"], again.table["status"])
    assert_array_equal(tile.table["colliding_with"], again.table["colliding_with"])


def test_robots_that_are_no_obstacles_are_ignored_at_recorded_angles(configuration):
    tile = rs.score_tile(*configuration, parked_obstacles=False)
    words = "1 at the recorded joint angles, 201 assumed to avoid all other arms"
    assert tile.summary["poses_without_target"].endswith(words)


def test_joint_angles_of_another_calibration_are_not_used(configuration, real_data, presets):
    plan, built = configuration
    with pytest.warns(
        rs.RfpsurveyWarning, match=r"298 positioners .* \(median 0.193 mm\); the recorded angles are not"
    ):
        tile = rs.score_tile(plan, rs.Instrument.read(real_data("sdssv_apo_2024")))
    assert "at the recorded positions" in tile.summary["poses_without_target"]
    with pytest.warns(rs.RfpsurveyWarning, match="the arms are nominal: score the plan with the instrument as built"):
        nominal = rs.score_tile(plan, presets["sdss_apo"])  # real joint angles never apply to nominal arms
    assert "at the recorded positions" in nominal.summary["poses_without_target"]
    few = np.isin(plan["positioner"], plan["positioner"][plan["assigned"]][:3])
    plan["theta"][few] += 5 * u.deg
    with pytest.warns(rs.RfpsurveyWarning, match="3 of 298 positioners .* positions determine the poses of these arms"):
        tile = rs.score_tile(plan, built)
    assert tile.summary["n_recorded"] == 201


def test_left_handed_arms_of_a_tile_remain_left_handed(presets):
    """Scored tiles had right-handed arms only, so that a plan without collisions had two arms in collision."""
    plane = presets["lamost"].focal_plane
    both = replace(
        presets["lamost"], focal_plane=replace(plane, positioner=replace(plane.positioner, handedness="both"))
    )
    sky = rs.synthetic_catalog("uniform", CENTER, both.field_radius, n_targets=9000, rng=1)
    tile = rs.plan_tile(sky, both, CENTER, allocator="repair")
    assert tile.summary["n_colliding"] == 0
    assert (tile.table["phi"] < 0).any()
    for table in (tile.table, plans.as_plan(tile)):
        again = rs.score_tile(table, both)
        assert again.summary["n_colliding"] == 0
        assert np.nanmax(np.abs(again.table["elbow_x"] - tile.table["elbow_x"])) < 1e-9 * u.mm


def test_fibers_without_a_target_are_at_their_recorded_positions(tmp_path):
    """Files of fiberassign contain the positions of parked and stuck positioners; they were replaced by guesses."""
    desi_files.metrology(tmp_path / "fp.csv")
    built = rs.Instrument.from_desi(tmp_path / "fp.csv")
    desi_files.tile(tmp_path / "tile.fits")
    plan = plans.read_plan(tmp_path / "tile.fits")
    plane = built.focal_plane
    first, second = plane.neighbor_pairs()[0]
    middle = (plane.xy[first] + plane.xy[second]) / 2
    rows = [np.asarray(plan["positioner"]).tolist().index(plane.id[k]) for k in (first, second)]
    plan["assigned"][rows] = [True, False]
    plan["x"][rows], plan["y"][rows] = middle
    tile = rs.score_tile(plan, built)
    assert str(plane.id[second]) in tile.table["colliding_with"][first].split()
    assert tile.table["status"][second] == "recorded"
    assert "at the recorded positions" in tile.summary["poses_without_target"]
    plan["x"][rows[1]], plan["y"][rows[1]] = plane.xy[second]  # the position of a folded arm has no direction
    assert rs.score_tile(plan, built).table["status"][second] == "parked"


def test_without_recorded_poses_the_assumed_poses_are_stated(presets):
    x, y = presets["lamost"].focal_plane.xy[:2].T
    plan = QTable({"positioner": [0, 1], "x": x, "y": y})
    tile = rs.score_tile(plan, presets["lamost"])
    expected = "3998 positioners without a target: 3998 assumed to be parked"
    assert tile.summary["poses_without_target"] == expected
    tile = rs.score_tile(plan, presets["lamost"], parked_obstacles=False)
    assert tile.summary["poses_without_target"].endswith(": 3998 assumed to avoid all other arms")


def test_angles_that_are_no_joint_angles_are_ignored(presets):
    x, y = presets["lamost"].focal_plane.xy[:2].T
    plan = QTable({"positioner": [0, 1], "x": x + 5 * u.mm, "y": y, "theta": [1, 2], "phi": [3.0, 4.0]})
    assert rs.score_tile(plan, presets["lamost"]).summary["n_recorded"] == 0


def test_a_plan_of_another_instrument_is_named(real_data, presets):
    """A quarter of the targets was out of reach without a warning."""
    plan = plans.read_plan(real_data("pfs/pfsDesign-0x2a3e0e7f53f47587.fits.gz"))
    with pytest.warns(rs.RfpsurveyWarning, match="514 of 2082 targets .* plan and instrument do not match"):
        rs.score_tile(plan, rs.Instrument.read(real_data("pfs")))
    x, y = presets["lamost"].focal_plane.xy[:10].T
    few = QTable({"positioner": np.arange(10), "x": x + np.where(np.arange(10), 3, 20) * u.mm, "y": y})
    assert rs.score_tile(few, presets["lamost"]).summary["n_out_of_reach"] == 1


def test_sky_positions_of_a_configuration_are_at_the_epoch_and_the_north_of_its_observation(tmp_path, real_data):
    """Both were neglected without a warning, which displaced fibers by 0.3 mm."""
    pytest.importorskip("pydl", reason="pydl is not installed")
    plan = plans.read_plan(real_data("sdssv_apo_2024/confSummary-test.par.gz"))
    built = rs.Instrument.read(real_data("sdssv_apo_2024"))
    assert plan.meta["epoch"] == "J2024.317591"
    with pytest.warns(rs.RfpsurveyWarning, match="measured from the north of ICRS, because .*: give equinox"):
        icrs = rs.score_tile(plan, built, positions="sky")
    of_date = rs.score_tile(plan, built, positions="sky", equinox="J2022")
    assert icrs.provenance["parameters"]["epoch"] == of_date.provenance["parameters"]["epoch"] == "J2024.318"
    given = rs.score_tile(plan, built)
    apart = [np.nanmedian(np.abs(tile.table["tip_x"] - given.table["tip_x"])) for tile in (icrs, of_date)]
    assert apart[0] > 2 * apart[1]
    plan["delta_ra"][np.flatnonzero(plan["assigned"])[:3]] = 0.5
    with pytest.warns(rs.RfpsurveyWarning, match="delta_ra and delta_dec of 3 targets are neglected"):
        rs.score_tile(plan, built, positions="sky", equinox="J2022")


def test_targets_on_broken_fibers_of_a_design_are_counted_in_a_warning(real_data):
    plan = plans.read_plan(real_data("pfs/pfsDesign-0x2a3e0e7f53f47587.fits.gz"))
    plan["fiberStatus"][np.flatnonzero(plan["assigned"])[:2]] = 2
    with pytest.warns(rs.RfpsurveyWarning) as caught:
        rs.score_tile(plan, "pfs")
    assert any("2 fibers with a target have a fiberStatus other than 1" in str(one.message) for one in caught)
