from dataclasses import replace

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import FK5, SkyCoord
from astropy.table import QTable, vstack

import rfpsurvey as rs

MM = u.mm
CENTER = SkyCoord(95, 23, unit="deg")


@pytest.fixture(scope="module")
def tiles(presets):
    sky = rs.synthetic_catalog("poisson", CENTER, 1.5 * u.deg, density=150 / u.deg**2, rng=3)
    types = np.where(np.arange(len(sky)) % 3, "BOSS", "APOGEE")
    typed = rs.Catalog(sky.coord, id=sky.id, fiber_type=types)
    return {
        "lamost": rs.plan_tile(sky, presets["lamost"], CENTER, position_angle=20 * u.deg),
        "sdss_apo": rs.plan_tile(typed, presets["sdss_apo"], CENTER, position_angle=20 * u.deg),
    }


@pytest.mark.parametrize("name", ["lamost", "sdss_apo"])
@pytest.mark.parametrize("positions", [None, "focal_plane", "sky"])
def test_a_plan_of_ours_scores_as_it_was_planned(presets, tiles, name, positions):
    tile = tiles[name]
    field = {"center": CENTER, "position_angle": 20 * u.deg} if positions == "sky" else {}
    score = rs.score_tile(tile.table, presets[name], positions=positions, **field)
    names = ["status", "in_collision", "colliding_with", "spectrograph", *(["fiber_type"] * (name == "sdss_apo"))]
    for column in names:
        np.testing.assert_array_equal(score.table[column], tile.table[column])
    for column in ("theta", "phi", "tip_x", "clearance", "ra"):
        np.testing.assert_allclose(score.table[column].value, tile.table[column].value, atol=1e-5)
    np.testing.assert_array_equal(score.table["target_id"].compressed(), tile.table["target_id"].compressed())
    for key in ("n_assigned", "n_colliding", "n_colliding_pairs", "collision_rate", "n_parked"):
        assert score.summary[key] == tile.summary[key]
    assert score.summary["n_out_of_reach"] == 0


@pytest.mark.parametrize("name", ["lamost", "sdss_apo"])
def test_a_tile_knows_its_field(presets, tiles, name):
    tile, circle = tiles[name], "keep_out 95.2 23.1 0.05"
    score = rs.score_tile(tile, presets[name])
    assert (score.table["in_collision"] == tile.table["in_collision"]).all()
    assert score.summary["n_assigned"] == tile.summary["n_assigned"]
    options = {"center": CENTER, "position_angle": 20 * u.deg, "positions": "sky"}
    expected = rs.score_tile(tile.table, presets[name], constraints=circle, **options)
    assert rs.score_tile(tile, presets[name], constraints=circle).summary["unmet"] == expected.summary["unmet"]


@pytest.mark.parametrize("name", ["lamost", "sdss_apo"])
def test_a_tile_of_a_preset_needs_no_instrument(presets, tiles, name, tmp_path):
    expected = rs.score_tile(tiles[name], presets[name])
    tiles[name].write(tmp_path / "tile.fits")
    for tile in (tiles[name], rs.Tile.read(tmp_path / "tile.fits")):
        score = rs.score_tile(tile, parked_obstacles=True)
        assert score.provenance["instrument"] == expected.provenance["instrument"]
        assert (score.table["colliding_with"] == expected.table["colliding_with"]).all()


def test_instruments_that_are_not_presets_must_be_given(presets, tiles):
    table = tiles["lamost"].table.copy()
    table.meta.clear()
    with pytest.raises(rs.InputError, match="instrument must be given, because a table does not contain"):
        rs.score_tile(table)
    lamost = presets["lamost"]
    broken = replace(lamost.focal_plane, disabled=np.arange(len(lamost.focal_plane)) == 7)
    for instrument in (replace(lamost, focal_plane=broken), replace(lamost, name="other")):
        tile = rs.score_tile(tiles["lamost"].table, instrument)
        words = f"instrument must be given, because .* not made with an unchanged preset, .* '{instrument.name}'"
        with pytest.raises(rs.InputError, match=words):
            rs.score_tile(tile)


def test_hole_names_and_field_columns(presets, tiles):
    """The table has the format of SDSS-V designs."""
    t = tiles["sdss_apo"].table
    t = t[t["status"] == "assigned"]
    names = {"holeid": "id", "catalogid": "target_id", "ra": "ra", "dec": "dec", "instrument": "fiber_type"}
    other = QTable({name: t[own] for name, own in names.items()})
    other["racen"], other["deccen"], other["position_angle"] = 95 * u.deg, 23 * u.deg, 20 * u.deg
    score = rs.score_tile(other, presets["sdss_apo"])
    assert score.summary["n_colliding_pairs"] == tiles["sdss_apo"].summary["n_colliding_pairs"]
    assert score.provenance["parameters"]["position_angle_deg"] == 20
    two = vstack([other[:10], other[10:20]])
    two["racen"][10:] = 96 * u.deg
    with pytest.raises(rs.InputError, match="column 'racen' has 2 values, so the table holds several fields"):
        rs.score_tile(two, presets["sdss_apo"])


def test_the_north_of_a_date_is_that_of_the_center_or_of_the_equinox_of_the_table(presets, tiles):
    t = tiles["lamost"].table
    t = t[t["status"] == "assigned"]
    plan = QTable({"positioner": t["id"], "ra": t["ra"], "dec": t["dec"]})
    plan.meta.update(racen=95.0, deccen=23.0, position_angle=20.0)
    by_table = rs.score_tile(plan, presets["lamost"], equinox="J2028")
    center = CENTER.transform_to(FK5(equinox="J2028"))
    by_center = rs.score_tile(plan, presets["lamost"], center=center)
    assert by_table.provenance["parameters"]["north_of"] == "fk5 J2028.000"
    assert by_table.provenance["parameters"] == by_center.provenance["parameters"]
    assert by_table.summary["n_out_of_reach"] == by_center.summary["n_out_of_reach"]
    icrs = rs.score_tile(plan, presets["lamost"])
    assert not np.allclose(icrs.table["tip_x"].value, by_table.table["tip_x"].value, atol=1e-3, equal_nan=True)
    with pytest.raises(rs.InputError, match=r"give center.transform_to\(FK5\(equinox=\"J2028\"\)\)"):
        rs.score_tile(plan, presets["lamost"], center=CENTER, equinox="J2028")


def test_targets_out_of_reach_are_counted_and_their_arms_stretched(presets):
    plane = presets["lamost"].focal_plane
    x, y = plane.xy[:2].T
    plan = QTable({"positioner": [0, 1], "x": x + [20, 3] * MM, "y": y})
    with pytest.warns(rs.RfpsurveyWarning, match="1 of 2 targets are out of reach"):
        tile = rs.score_tile(plan, presets["lamost"])
    assert (tile.summary["n_out_of_reach"], tile.summary["n_assigned"]) == (1, 2)
    assert tile.table["status"][0] == "out_of_reach"
    np.testing.assert_allclose((tile.table["tip_x"][:2] - x).value, [16.5, 3], atol=1e-9)


def test_wrong_fibers_are_counted(presets):
    plane = presets["sdss_apo"].focal_plane
    boss_only = int(np.flatnonzero(plane.fiber_type == "BOSS")[0])
    xy = plane.xy[boss_only] + [15, 0] * MM
    plan = QTable({"hole_id": [plane.id[boss_only]], "x": xy[:1], "y": xy[1:], "fiber_type": ["APOGEE"]})
    assert rs.score_tile(plan, presets["sdss_apo"]).summary["n_wrong_fiber"] == 1


def test_positioners_may_have_leading_zeros(presets):
    x, y = presets["lamost"].focal_plane.xy[[7, 20]].T
    plan = QTable({"positioner": ["007", "0020"], "x": x + 5 * MM, "y": y})
    tile = rs.score_tile(plan, presets["lamost"])
    assert tile.table["id"][tile.table["status"] == "assigned"].tolist() == [7, 20]


def test_rows_without_a_positioner_are_ignored(presets):
    x, y = presets["lamost"].focal_plane.xy[:3].T
    plan = QTable({"robot_id": [-1, 1, 2], "x": x, "y": y, "assigned": [0, 1, 0]})
    tile = rs.score_tile(plan, "lamost")
    assert (tile.summary["n_rows_ignored"], tile.summary["n_assigned"]) == (2, 1)
    assert tile.center is None  # positions on the focal plane have no direction


def test_assigned_rows_without_coordinates_are_refused(presets):
    plan = QTable({"positioner": [0, 1], "ra": [np.nan, 95] * u.deg, "dec": [23, 23] * u.deg})
    with pytest.raises(rs.InputError, match=r"must have a finite position, but 1 of 2 rows .row 1. have none"):
        rs.score_tile(plan, presets["lamost"], center=CENTER, position_angle=0 * u.deg)
    with pytest.raises(rs.InputError, match="there is no column for x and y"):
        rs.score_tile(plan, presets["lamost"], positions="focal_plane")


ORIGIN = {"x": [0] * MM, "y": [0] * MM}
BAD = {
    "there is no column for positioner; the columns are: x, y": ORIGIN,
    "there is no column for ra and dec": {"positioner": [0], "z": [0] * MM},
    "column 'x' has no unit": {"positioner": [0], "x": [0.0], "y": [0.0]},
    "must have a unit convertible to mm, got deg": {"positioner": [0], "x": [0] * u.deg, "y": [0] * MM},
    "positioners that the instrument does not have: 9999": {"positioner": [9999], **ORIGIN},
    "positioner 1 is assigned more than once": {"positioner": [1, 1], "x": [0, 0] * MM, "y": [0, 0] * MM},
    "must assign at least one positioner": {"positioner": [-1], **ORIGIN},
    "at least one assigned row must have a finite pos": {"positioner": [0], "x": [np.nan] * MM, "y": [0] * MM},
    r"column 'positioner' must have one value per row": {"positioner": [[0, 1]], **ORIGIN},
    "the ra of the field must be given .--center.,": {"positioner": [0], "ra": [95] * u.deg, "dec": [23] * u.deg},
}


def test_bad_tables_are_named(presets):
    for message, plan in BAD.items():
        with pytest.raises(rs.InputError, match=message):
            rs.score_tile(QTable(plan), presets["lamost"])
    with pytest.raises(rs.InputError, match="table must be an astropy Table"):
        rs.score_tile([1], presets["lamost"])
