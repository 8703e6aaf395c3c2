"""Potential assignments, compared with all pairs of points and positioners in numpy and astropy."""

from concurrent.futures import ThreadPoolExecutor

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.table import QTable

import rfpsurvey as rs
from oracles import tangent_plane_mm
from rfpsurvey._common.read_tables import read_table
from rfpsurvey.selection import PotentialAssignments

CENTER = SkyCoord(200 * u.deg, 30 * u.deg)
SCALE = 200  # mm per deg


@pytest.fixture(scope="module")
def instrument():
    """Return an instrument with unequal arms and with disabled and stuck positioners."""
    unit = rs.Positioner(8 * u.mm, 12 * u.mm, 3 * u.mm)
    n = 37
    stuck = np.full((n, 2), np.nan)
    stuck[5] = 0.3, 1.0
    plane = rs.FocalPlane.hexagonal(unit, rings=3, pitch=25.6 * u.mm)
    plane = rs.FocalPlane(plane.xy, unit, id=1000 + np.arange(n), disabled=np.arange(n) % 11 == 3, stuck=stuck * u.rad)
    return rs.Instrument("toy", plane, plate_scale=SCALE * u.mm / u.deg)


@pytest.fixture(scope="module")
def points():
    return rs.synthetic_catalog("uniform", CENTER, 1 * u.deg, n_targets=3000, rng=4)


@pytest.fixture(scope="module")
def tiles():
    lon, lat = [0, 0.3, 0.1, 0], [0, 0, 0.4, 5]
    centers = SkyCoord(lon * u.deg, lat * u.deg, frame=CENTER.skyoffset_frame()).icrs
    table = QTable({"ra": centers.ra, "dec": centers.dec, "position_angle": [0, 10, 0, -40] * u.deg})
    table["tile"], table["pass"] = ["a", "b", "c", "far"], [1, 1, 2, 2]
    return rs.Tiling.from_table(table)


def brute(points, instrument, tiles):
    """Return all pairs in reach as a set of (tile, positioner, point)."""
    plane, found = instrument.focal_plane, set()
    usable = ~plane.disabled & ~np.isfinite(plane.stuck.value).all(axis=1)
    for row in tiles.table:
        near = np.flatnonzero(points.coord.separation(SkyCoord(row["ra"], row["dec"])) < 5 * u.deg)
        if len(near) == 0:
            continue
        center = SkyCoord(row["ra"], row["dec"])
        xy = tangent_plane_mm(points.coord[near], center, SCALE, row["position_angle"].to_value("deg"))
        far = np.hypot(*(xy[:, None] - plane.xy.to_value("mm")[None]).transpose(2, 0, 1))
        for p, i in np.argwhere((far >= 4) & (far <= 20) & usable):
            found.add((str(row["tile"]), int(plane.id[i]), int(near[p])))
    return found


def as_set(table):
    rows = zip(*(table[name].tolist() for name in ("tile", "positioner", "point")), strict=True)
    return set(rows)


def numbers_of_tiles(pairs, n=3000):
    return np.bincount([point for _, point in {(tile, point) for tile, _, point in pairs}], minlength=n)


def test_pairs_are_those_of_brute_force(points, instrument, tiles, tmp_path):
    found = rs.selection.potential_assignments(points, instrument, tiles)
    expected = brute(points, instrument, tiles)
    assert len(expected) > 1000
    table = found.table
    assert (len(table), as_set(table), [len(one) for one in found][-1]) == (len(expected), expected, 0)
    np.testing.assert_array_equal(found.n_tiles(), numbers_of_tiles(expected))
    assert found.write(tmp_path / "pairs.fits") == len(expected)
    written = QTable.read(tmp_path / "pairs.fits")
    assert (written.meta["NPOINTS"], as_set(written)) == (3000, expected)
    other = rs.selection.potential_assignments(points[:-1], instrument, tiles)
    other.write(tmp_path / "other.fits")
    requests = [read_table(tmp_path / f"{name}.fits").meta["request"] for name in ("pairs", "other")]
    assert {name for name in requests[0] if requests[0][name] != requests[1][name]} == {"catalog", "visits"}


def test_one_pass_and_workers(points, instrument, tiles):
    expected = {row for row in brute(points, instrument, tiles) if row[0] in "ab"}
    with ThreadPoolExecutor(2) as executor:
        found = rs.selection.potential_assignments(points, instrument, tiles, passes=[1], executor=executor)
        assert (as_set(found.table), found.n_tiles().max()) == (expected, 2)
    assert repr(found) == "<PotentialAssignments of 3000 points in 2 tiles>"
    assert isinstance(found, PotentialAssignments)


def test_positioners_that_collide_in_a_survey_reach_no_point(points, instrument, tiles):
    targets = rs.synthetic_catalog("uniform", CENTER, 1 * u.deg, n_targets=120, rng=5)
    survey = rs.plan_survey(targets, instrument, tiles, allocator="lamost_rule")
    lost = {(str(row["tile"]), int(row["positioner"])) for row in survey.targets if row["in_collision"]}
    assert len(lost) > 3
    found = rs.selection.potential_assignments(points, instrument, tiles, survey=survey)
    expected = {row for row in brute(points, instrument, tiles) if row[:2] not in lost}
    assert as_set(found.table) == expected
    np.testing.assert_array_equal(found.n_tiles(), numbers_of_tiles(expected))


def test_refusals(points, instrument, tiles):
    survey = rs.plan_survey(points[:20], instrument, tiles, passes=[1])
    for model, more, message in (
        (instrument, {}, "survey must contain all tiles, but it has no tile c"),
        ("moons", {"passes": [1]}, "survey must be a plan for moons, got one for toy"),
        (instrument, {"survey": "plan"}, "survey must be a Survey, got 'plan'"),
    ):
        with pytest.raises(rs.InputError, match=message) as told:
            rs.selection.potential_assignments(points, model, tiles, **{"survey": survey, **more})
        assert isinstance(told.value, TypeError) == ("survey" in more)


def test_a_survey_of_other_places_is_refused(points, instrument, tiles):
    """Regression: tiles were compared by identifiers only, so the collisions of rotated tiles were used."""
    survey = rs.plan_survey(points[:20], instrument, tiles, allocator="lamost_rule")
    for name, change in (("position_angle", 5 * u.deg), ("ra", 0.01 * u.deg)):
        table = tiles.table.copy()
        table[name] = table[name] + [0, 1, 0, 0] * change
        with pytest.raises(rs.InputError, match="same centers and position angles as the tiles, got .* for tile b"):
            rs.selection.potential_assignments(points, instrument, rs.Tiling(table), survey=survey)
    turned = tiles.table.copy()
    turned["position_angle"] = turned["position_angle"] + 360 * u.deg
    rs.selection.potential_assignments(points[:50], instrument, rs.Tiling(turned), survey=survey)
