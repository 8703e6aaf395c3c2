"""Stuck fibers that observe sky, also if stars move between the dates of the tiles, and the counts of tiles."""

import hashlib
import warnings
from dataclasses import replace

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.table import QTable
from astropy.time import Time

import rfpsurvey as rs

CENTER = SkyCoord(95, 23, unit="deg", frame="icrs")
TIMES = Time(["2022-01-15T06:00:00", "2024-01-15T06:00:00", "2026-01-15T06:00:00"], scale="utc")
STUCK, SEPARATION = 5, 20 * u.arcsec


@pytest.fixture(scope="module")
def worn(small):
    """Return an instrument with a stuck positioner."""
    pose = np.where(np.arange(37)[:, None] == STUCK, [20, 90], np.nan) * u.deg
    return replace(small, focal_plane=replace(small.focal_plane, stuck=pose))


@pytest.fixture(scope="module")
def sky(worn):
    """Return targets, the first of which is in front of the stuck fiber at the second time only."""
    conditions = rs.ObservingConditions("kitt peak", time=TIMES[1])
    image = worn.field_projection(CENTER.ra.rad, CENTER.dec.rad, 0.0, conditions)
    tip = worn.focal_plane.arrays.idle(False).segments[2:, STUCK][None]
    x, y, z = image.unproject(tip)[0]
    place = SkyCoord(x=x, y=y, z=z, representation_type="cartesian").represent_as("spherical")
    pm = 15 * u.arcsec / u.yr
    star = SkyCoord(place.lon, place.lat - pm * (TIMES[1].jyear - 2016) * u.yr)
    others = rs.synthetic_catalog("uniform", CENTER, worn.field_radius, n_targets=25, rng=3).coord
    far = others.separation(SkyCoord(place.lon, place.lat)) > 0.05 * u.deg
    ra, dec = np.append(star.ra.deg, others.ra.deg[far]), np.append(star.dec.deg, others.dec.deg[far])
    motion = np.where(np.arange(len(ra)) == 0, pm.to_value(u.mas / u.yr), 0.0) * u.mas / u.yr
    epoch = Time(2016.0, format="jyear")
    return SkyCoord(ra, dec, unit="deg", pm_ra_cosdec=0 * motion, pm_dec=motion, obstime=epoch)


@pytest.mark.parametrize(("way", "visits"), [("memory", 0), ("folder", 1), ("partitioned", 3)])
def test_a_stuck_fiber_is_on_sky_at_the_dates_at_which_no_star_is_in_front_of_it(worn, sky, visits, way, tmp_path):
    """Also stars without remaining or without requested visits count."""
    n = np.where(np.arange(len(sky)) == 0, visits, 3)
    catalog = rs.Catalog(sky, visits=n)
    if way == "partitioned":
        catalog = rs.catalog.partition_catalog(catalog, tmp_path / "parts", order=3)
    table = QTable({"ra": [95.0] * 3 * u.deg, "dec": [23.0] * 3 * u.deg, "pass": [1, 2, 3]})
    table["time"] = TIMES.isot
    tiles = rs.Tiling.from_table(table).with_conditions(rs.ObservingConditions("kitt peak", time=TIMES[0]))
    allocator = rs.AllocationOptions("network_flow", requirements="sky=30", sky_separation=SEPARATION)
    folder = tmp_path / "survey" if way == "folder" else None
    survey = rs.plan_survey(catalog, worn, tiles, allocator=allocator, folder=folder)
    on_sky = [bool((rows["positioner"] == worn.focal_plane.id[STUCK]).any()) for rows in survey]
    assert on_sky == [True, False, True]
    for time, expected in zip(TIMES, on_sky, strict=True):
        conditions = rs.ObservingConditions("kitt peak", time=time)
        tile = rs.plan_tile(rs.Catalog(sky, visits=n), worn, CENTER, conditions=conditions, allocator=allocator)
        assert (tile.table["kind"][STUCK] == "sky") == expected


@pytest.mark.parametrize("moving", [False, True])
@pytest.mark.parametrize("way", ["tile", "memory", "partitioned"])
def test_stars_beyond_the_edge_of_the_field_keep_sky_positions_away(small, way, moving, tmp_path):
    """Regression: only targets in the field were avoided, so that sky positions at its edge could be close to stars."""
    plane, separation = small.focal_plane, 300 * u.arcsec
    far = int(np.argmax(np.hypot(*plane.arrays.xy.T)))
    angle = np.arctan2(*plane.arrays.xy[far][::-1]) * u.rad
    pose = np.where(np.arange(37)[:, None] == far, u.Quantity([angle, 0 * u.deg]).to_value(u.deg), np.nan) * u.deg
    worn = replace(small, focal_plane=replace(plane, stuck=pose))
    turn = np.arange(0, 360, 3) * u.deg
    ring = CENTER.directional_offset_by(turn, 1.002 * worn.field_radius)
    ra, dec = np.append(ring.ra.deg, 95.0), np.append(ring.dec.deg, 23.0)
    years, motion = (TIMES[1].jyear - 2016) * u.yr, 10 * u.arcsec / u.yr
    if moving:  # the stars are at the ring at the second time
        dec = dec - (motion * years).to_value(u.deg)
    pm = {"pm_ra_cosdec": np.zeros(len(ra)) * motion, "pm_dec": np.full(len(ra), 1.0) * motion} if moving else {}
    time = {"obstime": Time(2016.0, format="jyear")} if moving else {}
    catalog = rs.Catalog(SkyCoord(ra, dec, unit="deg", **pm, **time))
    allocator = rs.AllocationOptions("network_flow", requirements="sky=40", sky_separation=separation)
    conditions = rs.ObservingConditions("kitt peak", time=TIMES[1]) if moving else None
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", rs.RfpsurveyWarning)  # there are too few positions
        if way == "tile":
            rows = rs.plan_tile(catalog, worn, CENTER, conditions=conditions, allocator=allocator).table
            stuck = rows["kind"][far] == "sky"
        else:
            given = rs.catalog.partition_catalog(catalog, tmp_path / "parts", order=6) if way != "memory" else catalog
            table = QTable({"ra": [95.0] * u.deg, "dec": [23.0] * u.deg})
            tiles = rs.Tiling.from_table(table).with_conditions(conditions)
            rows = rs.plan_survey(given, worn, tiles, allocator=allocator).tile(0)
            stuck = (rows["positioner"] == worn.focal_plane.id[far]).any()
    assert not stuck
    sky = rows[rows["kind"] == "sky"]
    apart = SkyCoord(sky["ra"], sky["dec"])[:, None].separation(ring[None])
    assert len(sky) > 20
    assert apart.min() > 0.99 * separation


@pytest.fixture(scope="module")
def pair():
    """Return an instrument with a stuck positioner and a movable positioner."""
    robot = rs.Positioner(8.25 * u.mm, 8.25 * u.mm, 2.25 * u.mm)
    plane = rs.FocalPlane([[0, 0], [25.6, 0]] * u.mm, robot, stuck=[[0, 90], [np.nan, np.nan]] * u.deg)
    return rs.Instrument("pair", plane, plate_scale=200 * u.mm / u.deg)


def at(*x):
    """Return targets at distances (mm) east of the center."""
    return rs.Catalog(CENTER.directional_offset_by(90 * u.deg, x * u.mm / (200 * u.mm / u.deg)))


def test_scores_count_stuck_fibers_on_sky_for_all_rules(pair, tmp_path):
    """Regression: rules on positions ignored these fibers, and plans in files lost them."""
    rules = ["sky=1", "distribution sky 1 100 40"]
    options = rs.AllocationOptions("optimal", constraints=rules, sky_separation=2 * u.mm)
    tile = rs.plan_tile(at(20, 30), pair, CENTER, allocator=options)
    assert tile.rules["verdict"].tolist() == ["pass", "pass"]
    tables = [tile.table]
    for name in ("plan.ecsv", "plan.fits"):
        rs.plans.write_plan(tile, tmp_path / name)
        tables.append(rs.plans.read_plan(tmp_path / name))
    for table in tables:
        for positions in ("focal_plane", "sky"):
            score = rs.score_tile(table, pair, constraints=rules, positions=positions)
            assert score.rules["number"].tolist() == tile.rules["number"].tolist() == [1, 100]
            assert score.summary["unmet"] == []


@pytest.mark.filterwarnings("ignore:constraint")
def test_stuck_fibers_on_sky_are_not_assigned_positioners(tmp_path):
    """Regression: they were counted as assigned, so that more fibers were used than there are."""
    robot = rs.Positioner(8.25 * u.mm, 8.25 * u.mm, 2.25 * u.mm)
    stuck = np.array([[0, 0], [np.nan, np.nan], [np.nan, np.nan]]) * u.deg
    plane = rs.FocalPlane([[0, 0], [25.6, 0], [80, 0]] * u.mm, robot, stuck=stuck)
    worn = rs.Instrument("worn", plane, plate_scale=200 * u.mm / u.deg)
    options = rs.AllocationOptions("lamost_rule", constraints=["sky=1"], sky_separation=2 * u.mm)
    tile = rs.plan_tile(at(12, 85), worn, CENTER, allocator=options)
    survey = rs.plan_survey(at(12, 85), worn, CENTER.reshape(1), allocator=options, folder=tmp_path / "survey")
    row = survey.tiles[0]
    assert row["n_sky"] == 1
    assert row["n_colliding_assigned"] == row["n_colliding"] == 1
    assert row["n_assigned"] == tile.summary["n_assigned"] == 2
    assert row["fiber_use"] == 1.0
    assert survey.summary["collision_rate_assigned"] == tile.summary["collision_rate_assigned"] == 0.5
    (tmp_path / "survey" / "tiles.fits").unlink()
    where = {"folder": tmp_path / "survey", "resume": True}
    again = rs.plan_survey(at(12, 85), worn, CENTER.reshape(1), allocator=options, **where)
    assert again.summary == survey.summary
    found = rs.selection_probabilities(at(12, 85), worn, CENTER.reshape(1), 2, allocator=options)
    assert (set(found.realizations["n_assigned"].tolist()), set(found.realizations["n_lost"].tolist())) == ({2}, {1})


def test_files_of_earlier_versions_are_read_without_the_number_of_lost_targets(presets, tmp_path):
    model = presets["moons"]
    sky = rs.synthetic_catalog("uniform", CENTER, model.field_radius, n_targets=3000, rng=3)
    options = {"allocator": "nearest", "folder": tmp_path / "survey"}
    survey = rs.plan_survey(sky, model, CENTER.reshape(1), **options)
    assert survey.summary["n_colliding_assigned"] > 0
    part, index = tmp_path / "survey" / "tiles" / "000" / "000000.fits", tmp_path / "survey" / "index.csv"
    before, content = part.read_bytes(), part.read_bytes().replace(b"NLOST   =", b"EARLIER =")
    assert content != before
    part.write_bytes(content)
    checksums = [hashlib.sha256(one).hexdigest() for one in (before, content)]
    index.write_text(index.read_text().replace(*checksums))
    (tmp_path / "survey" / "tiles.fits").unlink()
    resumed = rs.plan_survey(sky, model, CENTER.reshape(1), **options, resume=True)
    assert (resumed.summary, part.read_bytes()) == (survey.summary, content)
    resumed.record([{"tile": 0, "date": "2026-01-03"}])
    replanned = rs.plan_survey(sky, model, CENTER.reshape(1), **options, visits=resumed.state(sky), resume=True)
    assert replanned.tiles["n_colliding_assigned"].tolist() == survey.tiles["n_colliding_assigned"].tolist()
