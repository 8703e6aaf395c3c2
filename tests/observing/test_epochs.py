"""The epoch of targets with proper motions: the requested epoch, the time of the observing conditions, or none."""

import warnings
from dataclasses import replace

import astropy.units as u
import erfa
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.table import QTable
from astropy.time import Time

import rfpsurvey as rs

CENTER = SkyCoord(95 * u.deg, 23 * u.deg)
TIMES = ("2024-11-20T08:00:00", "2026-01-15T06:30:00", "2026-02-20T04:00:00")


def conditions_at(time=TIMES[1]):
    return rs.ObservingConditions("apache point", time=Time(time))


@pytest.fixture(scope="module")
def table():
    """Return a table of stars at the epoch 2016 that move by 2 arcsec per year."""
    sky = rs.synthetic_catalog("uniform", CENTER, 1.5 * u.deg, n_targets=1500, rng=1)
    n = len(sky)
    motion = {"pmra": np.full(n, 1600.0) * u.mas / u.yr, "pmdec": np.full(n, -1200.0) * u.mas / u.yr}
    return QTable({"ra": sky.coord.ra, "dec": sky.coord.dec, **motion, "epoch": np.full(n, 2016.0)})


@pytest.fixture(scope="module")
def catalog(table):
    return rs.Catalog.from_table(table)


def places(table, time):
    """Return the directions of all stars at a time, computed by astropy."""
    stars = SkyCoord(
        table["ra"],
        table["dec"],
        pm_ra_cosdec=table["pmra"],
        pm_dec=table["pmdec"],
        obstime=Time(2016.0, format="jyear"),
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", erfa.ErfaWarning)  # the distances are unknown
        return stars.apply_space_motion(new_obstime=Time(time))


def check_places(rows, targets, expected):
    """Check that planned positions agree with directions to 1 mas."""
    assert len(rows) > 10
    apart = SkyCoord(rows["ra"], rows["dec"], unit="deg").separation(expected[np.asarray(targets)])
    assert apart.max() < 1 * u.mas


def test_a_tile_is_planned_at_the_time_of_its_conditions(table, catalog, presets):
    """Regression: targets stayed at the epoch of the catalog, while the record promised an error of 0.012 mm."""
    tile = rs.plan_tile(catalog, presets["sdss_apo"], CENTER, conditions=conditions_at())
    rows = tile[tile["status"] == "assigned"]
    check_places(rows, rows["target_id"], places(table, TIMES[1]))
    assert tile.provenance["parameters"]["epoch"] == "J2026.039"
    assert tile.provenance["parameters"]["epoch_asked"] is None
    assert tile.summary["epoch"] == "the targets are moved to J2026.039, the time of the observing conditions"
    comparison, tiles = rs.compare_allocators(
        catalog, presets["sdss_apo"], CENTER, allocators=["lamost_rule"], conditions=conditions_at(), return_tiles=True
    )
    assert comparison.meta["parameters"]["epoch"] == "J2026.039"
    assert tiles["lamost_rule"].summary["epoch"] == tile.summary["epoch"]


EPOCHS = [
    ({}, 2016.0, "at the epoch of the catalog .J2016.000., although .* proper motions of up to 2000 mas / yr$"),
    (
        {"conditions": replace(conditions_at(), time=None, hour_angle=0 * u.deg)},
        2016.0,
        "at the epoch of the catalog .J2016.000.",
    ),
    ({"epoch": 2020.5}, 2020.5, "^the targets are moved to J2020.500, the requested epoch$"),
    ({"epoch": 2016, "conditions": conditions_at()}, 2016.0, "requested epoch; they move by up to 20 arcsec until"),
]


@pytest.mark.parametrize(("options", "epoch", "text"), EPOCHS)
def test_the_summary_states_the_epoch(table, catalog, presets, options, epoch, text):
    tile = rs.plan_tile(catalog, presets["sdss_apo"], CENTER, **options)
    rows = tile[tile["status"] == "assigned"]
    check_places(rows, rows["target_id"], places(table, Time(epoch, format="jyear")))
    with pytest.raises(AssertionError, match=text):
        raise AssertionError(tile.summary["epoch"])


def test_without_an_epoch_of_the_catalog_a_warning_states_the_proper_motions(table, catalog, presets):
    unknown = rs.Catalog.from_table(table["ra", "dec", "pmra", "pmdec"])
    with pytest.warns(rs.RfpsurveyWarning, match="without an epoch of the catalog, they cannot be moved"):
        tile = rs.plan_tile(unknown, presets["sdss_apo"], CENTER, conditions=conditions_at())
    assert tile.epoch is None
    still = rs.Catalog(SkyCoord(table["ra"], table["dec"]))
    assert rs.plan_tile(still, presets["sdss_apo"], CENTER, conditions=conditions_at()).summary["epoch"] is None


@pytest.fixture(scope="module")
def tiling():
    tiles = QTable({"ra": [94.6, 95.4, 95.0] * u.deg, "dec": [23.0, 23.2, 22.8] * u.deg, "time": list(TIMES)})
    return rs.Tiling.from_table(tiles).with_conditions(conditions_at())


@pytest.mark.few(1)
@pytest.mark.parametrize("partitioned", [False, True])
def test_each_tile_of_a_survey_is_planned_at_its_time(table, catalog, presets, tiling, partitioned, tmp_path):
    """Regression: all tiles were planned at the epoch of the catalog."""
    given = rs.catalog.partition_catalog(catalog, tmp_path / "parts", order=3) if partitioned else catalog
    options = rs.AllocationOptions("repair", requirements="sky=20", sky_separation=10 * u.arcsec)
    survey = rs.plan_survey(given, presets["sdss_apo"], tiling, visits=3, allocator=options)
    assert survey.summary["epoch"].startswith("the targets are moved to J2024.887 to J2026.137, the time")
    assert survey.provenance["parameters"]["epoch"] == "J2024.887 to J2026.137"
    for time, name in zip(TIMES, survey.tiles["tile"], strict=True):
        visits = survey.tile(name)
        visits = visits[visits["target_row"] >= 0]
        check_places(visits, np.asarray(visits["target_id"]).astype(int), places(table, time))


def test_joint_plans_and_probabilities_move_targets_to_the_times_of_the_tiles(table, catalog, tiling, small, tmp_path):
    joint = rs.plan_survey(catalog, small, tiling, allocator="joint")
    for time, name in zip(TIMES, joint.tiles["tile"], strict=True):
        visits = joint.tile(name)
        check_places(visits, visits["target_id"], places(table, time))
    found = rs.selection_probabilities(catalog, small, tiling, n_realizations=4)
    assert "J2024.887 to J2026.137" in found.summary["epoch"]
    still = rs.plan_survey(catalog, small, tiling.coord)
    assert "although they have proper motions of up to 2000 mas / yr" in still.summary["epoch"]


def test_positions_on_the_sky_are_scored_at_the_requested_epoch(table, catalog, presets):
    """Plans often contain positions at the time of the observation, so that only a requested epoch moves them."""
    sdss, conditions = presets["sdss_apo"], conditions_at()
    tile = rs.plan_tile(catalog, sdss, CENTER, conditions=conditions)
    chosen = tile["status"] == "assigned"
    given = {"center": CENTER, "position_angle": 0 * u.deg, "positions": "sky", "conditions": conditions}
    plan = table[np.asarray(tile[chosen]["target_id"])]
    plan["positioner"] = tile[chosen]["id"]
    scored = rs.score_tile(plan, sdss, epoch=conditions.time, **given)
    assert "moved to J2026.039" in scored.summary["epoch"]
    assert "proper motions of up to 2000 mas / yr" in rs.score_tile(plan, sdss, **given).summary["epoch"]
    # the table of a tile contains the positions at the epoch of the tile
    for one in (scored, rs.score_tile(tile.table, sdss, **given)):
        moved = (one[chosen]["tip_x"] - tile[chosen]["tip_x"]).to_value("mm")
        np.testing.assert_allclose(moved, 0, atol=1e-6)


def test_the_summary_of_a_tiling_states_the_epoch(catalog):
    assert "proper motions of up to 2000 mas / yr" in rs.place_tiles(catalog, "sdss_apo", n_tiles=1).summary["epoch"]
