"""Fibers of idle positioners near bright stars, which plans count on request."""

import warnings
from dataclasses import replace

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.table import QTable, Table
from configurations import places, rows_of, spot, stars_around

import rfpsurvey as rs
from rfpsurvey.constraints import BrightStars

CENTER = SkyCoord(95, 23, unit="deg")


def at(instrument, xy_mm):
    """Return the directions of points on the focal plane."""
    return instrument.projection(CENTER).to_sky(np.reshape(xy_mm, (-1, 2)) * u.mm)


@pytest.fixture(scope="module")
def case(small):
    """Return an instrument with a stuck and a broken positioner, two targets, and stars at five fibers.

    The stars are at the fibers of a parked, the stuck and the broken positioner, of a positioner with a target, and at
    the center of a positioner whose fiber is elsewhere.
    """
    n = len(small.focal_plane)
    plane = replace(
        small.focal_plane,
        stuck=np.where(np.arange(n)[:, None] == 5, [20, 90], np.nan) * u.deg,
        disabled=np.arange(n) == 7,
    )
    one, xy = replace(small, focal_plane=plane), plane.arrays.xy
    stuck = xy[5] + 8.25 * np.array([np.cos(np.deg2rad(20)) + np.cos(np.deg2rad(110)), 0])
    stuck[1] += 8.25 * (np.sin(np.deg2rad(20)) + np.sin(np.deg2rad(110)))
    targets = at(one, [xy[0] + [9, 0], xy[20] + [0, 9]])
    stars = at(one, [xy[3], stuck, xy[7], xy[0] + [9, 0.01], xy[20]])
    return one, rs.Catalog(targets), rs.Catalog(stars, extra=QTable({"mag": np.full(5, 8.0)}))


@pytest.mark.parametrize("allocator", ["nearest", "repair"])
def test_parked_stuck_and_broken_positioners_are_counted_on_request(case, allocator):
    one, targets, stars = case
    asked = rs.AllocationOptions(
        allocator,
        constraints=[BrightStars("mag", "9:1", stars=stars), BrightStars("mag", "9:1", stars=stars, idle="counted")],
    )
    tile = rs.plan_tile(targets, one, CENTER, allocator=asked)
    names = one.focal_plane.id[[3, 5, 7]].astype(str).tolist()
    assert (tile.table["status"] == "assigned").sum() == 1  # the other target is in the circle of a star
    assert (tile.rules["verdict"].tolist(), tile.rules["number"].tolist()) == (["pass", "fail"], [0, 3])
    assert (sorted(tile.rules["fibers"][1].split()), len(tile.summary["unmet"])) == (sorted(names), 1)


def test_an_idle_positioner_without_a_known_pose_is_not_checkable(presets):
    """The idle arms of positioners with arms of different lengths give way, so that their poses are not known."""
    apo, far = presets["sdss_apo"], CENTER.directional_offset_by(0 * u.deg, 1 * u.deg)
    target = at(apo, apo.focal_plane.arrays.xy[10] + [15, 0])
    stars = rs.Catalog(SkyCoord([far]), extra=QTable({"mag": [8.0]}))
    rules = [BrightStars("mag", "9:1", stars=stars), BrightStars("mag", "9:1", stars=stars, idle="counted")]
    tile = rs.plan_tile(rs.Catalog(target), apo, CENTER, allocator=rs.AllocationOptions(constraints=rules))
    assert tile.rules["verdict"].tolist() == ["pass", "not checkable"]
    idle = tile.table["status"] == "idle"
    n = sum(len(types.split("+")) for types in apo.focal_plane.fiber_type[idle].tolist())
    assert tile.rules["note"][1].startswith(f"{n} fibers of idle positioners without a known position")


@pytest.mark.parametrize("fiber", ["BOSS", "APOGEE"])
def test_idle_robots_of_a_recorded_configuration_equal_the_positions_in_its_file(fiber, real_data):
    """The file contains the position of each fiber, also of robots without a target; some targets are taken away."""
    path = real_data("sdssv_apo_2021/confSummary-998.par.gz")
    plan, apo = rs.plans.read_plan(path), rs.Instrument.read(path.parent)
    center, turn = SkyCoord(plan.meta["racen"], plan.meta["deccen"], unit="deg"), plan.meta["position_angle"]
    rows = rows_of(path, assigned=None)
    busy = {row["holeId"] for row in rows if row["assigned"] == "1"}
    freed = {row["holeId"] for row in rows if row["assigned"] == "1" and row["fiberType"] == "APOGEE"} - {""}
    freed = set(sorted(freed)[::3])
    plan["assigned"][np.isin(plan["positioner"], list(freed))] = False
    busy -= freed
    own = [row for row in rows if row["holeId"] not in busy and row["fiberType"] == fiber]
    own = [row for row in own if row["holeId"] in apo.focal_plane.id[~apo.focal_plane.disabled]]
    own = [row for row in own if fiber in str(apo.focal_plane.fiber_type[apo.focal_plane.id == row["holeId"]][0])]
    x, y = np.array([spot(row) for row in own]).T
    c, s = np.cos(np.deg2rad(turn)), np.sin(np.deg2rad(turn))
    fibers = np.column_stack([c * x - s * y, s * x + c * y])
    model = Table.read(path.parent / "focalPlaneModel.csv", format="ascii.csv", comment="#")
    stars = stars_around(center, 3000, 1.45, seed=5)
    star = np.column_stack(places(stars.coord, center, turn, model, fiber))
    apart = np.hypot(*(fibers[:, None] - star[None]).transpose(2, 0, 1))
    radius = 30 * 217.7358 / 3600
    clear = ~((apart > 0.9 * radius) & (apart < 1.1 * radius)).any(axis=0)  # the scale varies over the field
    near = (apart[:, clear] < radius).any(axis=1)
    assert near.sum() > 5
    rule = BrightStars("gaia_g", "30:30", fiber, stars=stars[clear], idle="counted")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", rs.RfpsurveyWarning)
        given = {"positions": "sky", "center": center, "position_angle": turn * u.deg}
        both = [replace(rule, idle="ignored"), rule]
        found = rs.score_tile(plan, apo, constraints=both, **given).rules
    assert set(found["fibers"][1].split()) - set(found["fibers"][0].split()) == {
        row["holeId"] for row, close in zip(own, near.tolist(), strict=True) if close
    }
    assert found["number"][1] - found["number"][0] == near.sum()


def test_a_wrong_word_gets_one_sentence(case):
    with pytest.raises(rs.InputError, match="unknown treatment of idle positioners 'all'; choose one of: counted, ig"):
        rs.AllocationOptions(constraints="bright_stars mag 9:1 '' '' all")
    (one,) = rs.constraints.as_constraints("bright_stars mag 9:1 '' '' counted")
    assert (one.stars, one.idle, str(one)) == (None, "counted", "bright_stars mag 9:1 '' '' counted")
