import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.table import QTable

import flat
import rfpsurvey as rs
from rfpsurvey.allocation import METHODS

MM = u.mm
CENTER = SkyCoord(150.1, 2.2, unit="deg")


@pytest.fixture(scope="module")
def crowded():
    return rs.synthetic_catalog("uniform", CENTER, 0.2 * u.deg, n_targets=1200, rng=1)


@pytest.fixture(scope="module")
def table(crowded):
    return rs.compare_allocators(crowded, "moons", CENTER)


def test_every_method_has_a_row_and_none_beats_the_optimum(table):
    assert table["allocator"].tolist() == list(METHODS)
    row = dict(zip(table["allocator"], table, strict=True))
    assert (row["optimal"]["gap"], row["optimal"]["usable"]) == (0, table["usable"].max())
    assert row["network_flow"]["science"] == table["science"].max() == table.meta["blind_science"]
    for name in ("optimal", "repair"):
        assert row[name]["colliding"] == row[name]["pairs"] == 0
        assert row[name]["usable"] == row[name]["science"]
    assert row["lamost_rule"]["colliding"] > 100
    assert row["optimal"]["loss"] < 0.05 < 0.2 < row["lamost_rule"]["loss"]
    np.testing.assert_allclose(table["loss"], 1 - table["usable"] / row["network_flow"]["science"])


def test_the_rows_say_what_the_tiles_say(table, crowded):
    tile = rs.plan_tile(crowded, "moons", CENTER, allocator="nearest")
    row = table[list(table["allocator"]).index("nearest")]
    assert (row["science"], row["colliding"]) == (tile.summary["n_assigned"], tile.summary["n_colliding"])
    assert row["pairs"] == tile.summary["n_colliding_pairs"]


def test_classes_and_requirements_have_columns(crowded):
    n = len(crowded)
    kind = np.where(np.arange(n) % 10 == 0, "sky", "science")
    catalog = rs.Catalog(crowded.coord, priority=np.arange(n) % 2 + 1.0, kind=kind)
    requirements = ["sky=30/spectrograph", "standard=4"]
    options = rs.AllocationOptions(requirements=requirements, time_limit=20 * u.s)
    with pytest.warns(rs.RfpsurveyWarning, match="no target of the catalog is 'standard'"):
        found = rs.compare_allocators(catalog, "moons", CENTER, options=options, allocators=["lamost_rule", "optimal"])
    assert (found["sky"] >= 60).all()
    assert found["missing"].tolist() == [4, 4]
    assert found.meta["unmet"]["optimal"] == ["standard targets: 0 of 4, 4 missing; none is in reach"]
    np.testing.assert_array_equal(found["priority_2"] + found["priority_1"], found["science"])


def test_bad_names_are_named(crowded):
    for allocators, message in (([], "at least one allocator"), (["best"], "unknown allocator 'best'")):
        with pytest.raises(rs.InputError, match=message):
            rs.compare_allocators(crowded, "moons", CENTER, allocators=allocators)


def test_no_arm_covers_a_guide_star(crowded):
    stars = SkyCoord([150.05, 150.12], [2.15, 2.25], unit="deg")
    options = {"keep_out": [rs.Region.cap(star, 20 * u.arcsec) for star in stars]}
    tile = flat.plan_tile(crowded, "moons", CENTER, allocator="optimal", **options)
    assert tile.summary["n_obstacle_collisions"] == 0
    xy = rs.Instrument.preset("moons").projection(CENTER).to_focal_plane(stars).value
    radius = 20 * 0.571
    t = tile.table
    elbow = np.column_stack([t["elbow_x"], t["elbow_y"]]).value
    tip = np.column_stack([t["tip_x"], t["tip_y"]]).value
    along = np.linspace(0, 1, 200)[:, None, None]
    points = elbow + along * (tip - elbow)
    for star in xy:
        assert np.nanmin(np.hypot(*(points - star).T)) > radius + 2 - 0.1
    blind = flat.plan_tile(crowded, "moons", CENTER, allocator="lamost_rule", **options)
    assert blind.summary["n_obstacle_collisions"] > 0
    assert len(tile.provenance["parameters"]["keep_out"]) == 2


def test_circles_that_no_arm_covers_have_radii_of_their_own(crowded):
    star = SkyCoord(150.05, 2.15, unit="deg")
    # the last circle has no position on the focal plane
    opposite = rs.Region.cap(SkyCoord(330, -2.15, unit="deg"), 1 * u.deg)
    circles = *(rs.Region.cap(star, r * u.arcsec) for r in (1, 100)), None, opposite
    tiles = [flat.plan_tile(crowded, "moons", CENTER, keep_out=circle) for circle in circles]
    n = [tile.summary["n_obstacle_collisions"] for tile in tiles]
    assert n[0] < n[1]
    assert n[2] == n[3]


def test_what_no_arm_covers_is_a_list_of_circles():
    words = "keep_out must be one or more circles made by Region.cap, got"
    for keep_out, kind, message in (
        (SkyCoord([150], [2], unit="deg"), TypeError, f"{words} SkyCoord"),
        (["star"], TypeError, f"{words} str in the list"),
        (rs.Region.parse("box 1 2 3 4"), ValueError, "made by Region.cap, got <Region box of "),
    ):
        with pytest.raises(rs.InputError, match=message) as told:
            rs.AllocationOptions(keep_out=keep_out)
        assert isinstance(told.value, kind)


@pytest.mark.exhaustive
def test_required_targets_are_found_by_their_ids(crowded):
    named = rs.Catalog(crowded.coord, id=[f"g{k}" for k in range(len(crowded))])
    plain = rs.plan_tile(named, "moons", CENTER, allocator="optimal")
    left = sorted(set(named.id) - set(plain.table["target_id"].filled("")))[:20]
    tile = flat.plan_tile(named, "moons", CENTER, allocator="optimal", required=left)
    assert set(left) <= set(tile.table["target_id"].filled(""))
    assert tile.summary["unmet"] == []
    with pytest.raises(rs.InputError, match="required must hold ids of the catalog, got nobody"):
        flat.plan_tile(named, "moons", CENTER, allocator="optimal", required=["nobody"])
    wide = rs.synthetic_catalog("uniform", CENTER, 2 * u.deg, n_targets=20000, rng=1)
    far = int(np.argmax(wide.coord.separation(CENTER)))
    tile = flat.plan_tile(wide, "moons", CENTER, allocator="optimal", required=[far])
    assert tile.summary["unmet"] == [f"required targets outside the field: {far} (1 in all)"]


def test_the_clock_stops_the_search_but_not_the_plan(crowded):
    plane = rs.Instrument.preset("moons").focal_plane
    xy = rs.Instrument.preset("moons").projection(CENTER).to_focal_plane(crowded)
    full = rs.allocate(plane, xy, allocator="optimal")
    short = rs.allocate(plane, xy, allocator=rs.AllocationOptions("optimal", time_limit=1e-3 * u.s))
    assert len(rs.find_collisions(plane, short).pairs) == 0
    assert short.bound >= full.objective >= short.objective
    assert short.gap > 0
    most = [rs.Requirement("science", maximum=400)]
    short = rs.allocate(plane, xy, allocator=rs.AllocationOptions("optimal", requirements=most, time_limit=1e-3 * u.s))
    assert 300 < short.n_assigned <= 400
    assert len(rs.find_collisions(plane, short).pairs) == 0


def test_commands(run, tmp_path, crowded):
    path, out = tmp_path / "sky.ecsv", tmp_path / "table.ecsv"
    crowded[::3].write(path)
    words = "--instrument moons --allocator optimal --allocator repair --constraint sky=20/spectrograph".split()
    code, said, err = run("compare-allocators", path, *words, "--set", "options.sky_separation=2", "--output", out)
    assert (code, err) == (0, "")
    table = QTable.read(out)
    assert table["allocator"].tolist() == ["optimal", "repair"]
    assert (table["sky"] >= 40).all()
    assert "not met" not in said
    words = "--instrument moons --allocator optimal --set options.requirements=instrument".split()
    code, said, err = run("plan", path, *words)
    assert code == 0
    assert "gap to the best plan                  0.0000" in said
    code, said, err = run("plan", path, "--instrument", "moons", "--constraint", "skies")
    assert code == 2
    assert "unknown constraint 'skies'" in err


def test_fields_without_science_and_misspelled_names(crowded):
    sky = rs.Catalog(crowded.coord, kind=np.full(len(crowded), "sky"), category=np.full(len(crowded), "sky_faint"))
    needs = rs.AllocationOptions(requirements="sky=20")
    table = rs.compare_allocators(sky, "moons", CENTER, options=needs)
    assert table["sky"].tolist() == [0, 0, 20, table["sky"][3], table["sky"][4], table["sky"][5]]
    words = "none of the 1[12].. targets in the field is a science target; requirements such as"
    with pytest.raises(rs.InputError, match=words):
        rs.plan_tile(sky, "moons", CENTER)
    options, words = rs.AllocationOptions("optimal", requirements=["sky_fiant=20"]), "did you mean 'sky_faint'"
    with pytest.warns(rs.RfpsurveyWarning, match=f"no target of the catalog is 'sky_fiant', .* {words}"):
        tile = rs.plan_tile(sky, "moons", CENTER, allocator=options)
    assert tile.summary["unmet"] == [f"sky_fiant targets: 0 of 20, 20 missing; none is in reach; {words}?"]
    with pytest.raises(rs.InputError, match="sky_separation must be one finite value above 0 arcsec"):
        rs.AllocationOptions(requirements="sky=20", sky_separation=0 * u.arcsec)
