import pickle
import re
from dataclasses import replace

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import FK5, SkyCoord
from astropy.table import MaskedColumn, QTable
from astropy.time import Time
from astropy.utils.masked import Masked

import flat
import rfpsurvey as rs
from oracles import segment_distances
from rfpsurvey._field.table import TableOfTile

MM = u.mm
CENTER = SkyCoord(95, 23, unit="deg")
COLUMNS = (
    "id spectrograph x y status target_id ra dec {}theta phi elbow_x elbow_y tip_x tip_y in_collision "
    "colliding_with clearance arm_x arm_y kind"
)


@pytest.fixture(scope="module")
def sky():
    return rs.synthetic_catalog("poisson", CENTER, 1.6 * u.deg, density=250 / u.deg**2, rng=3)


def at(ra, dec):
    return SkyCoord([ra], [dec], unit="deg")


@pytest.mark.parametrize(
    ("name", "allocator"), [("sdss_apo", "lamost_rule"), ("lamost", "balanced"), ("desi", "balanced")]
)
def test_the_table_is_consistent(presets, sky, name, allocator):
    instrument = presets[name]
    tile = rs.plan_tile(sky, instrument, CENTER, allocator=allocator, position_angle=33 * u.deg)
    t, s = tile.table, tile.summary
    assert t.colnames == COLUMNS.format("fiber_type " if name == "sdss_apo" else "").split()
    assert len(t) == s["n_positioners"] == len(instrument.focal_plane)
    assigned = t["status"] == "assigned"
    assert assigned.sum() == s["n_assigned"] > 100
    np.testing.assert_array_equal(np.asarray(t["target_id"].mask), ~assigned)
    for column in ("ra", "dec"):
        np.testing.assert_array_equal(np.isfinite(t[column].value), assigned)
    ids = t["target_id"][assigned]
    assert len(np.unique(ids)) == len(ids)
    # the fibers are at their targets, according to a projection with astropy's offset frame
    plane = instrument.projection(CENTER, 33 * u.deg)
    tips = np.column_stack([t["tip_x"], t["tip_y"]])[assigned]
    target = SkyCoord(t["ra"][assigned], t["dec"][assigned])
    assert plane.to_sky(tips).separation(target).to_value(u.arcsec).max() < 1e-6
    np.testing.assert_array_equal(target.ra.deg, sky.coord.ra.deg[ids.data])
    # the distances equal the arm lengths, and phi is the angle between the arms
    unit = instrument.focal_plane.positioner
    there = np.isfinite(t["tip_x"].value)
    assert there.sum() == s["n_assigned"] + s["n_parked"]
    elbow = np.hypot(t["elbow_x"] - t["x"], t["elbow_y"] - t["y"])[there]
    np.testing.assert_allclose(elbow.value, unit.central_arm.value, atol=1e-9)
    offset = np.column_stack([t["tip_x"] - t["x"], t["tip_y"] - t["y"]])[there]
    np.testing.assert_allclose(unit.forward(t["theta"][there], t["phi"][there]).value, offset.value, atol=1e-8)


def test_collisions_and_clearances_are_those_of_brute_force(presets, sky):
    """The arms of LAMOST end at the fiber, so that the columns of the table determine the collisions."""
    tile = rs.plan_tile(sky, presets["lamost"], CENTER, allocator="balanced")
    t = tile.table
    arms = np.column_stack([t[c].value for c in ("elbow_x", "elbow_y", "tip_x", "tip_y")])
    i, j = np.triu_indices(len(t), 1)
    near = np.hypot(*(arms[i, :2] - arms[j, :2]).T) < 60
    pairs = np.column_stack([i[near], j[near]])
    distance = segment_distances(arms, pairs)
    close = pairs[distance < 4.5]
    assert tile.summary["n_colliding_pairs"] == len(close) > 3
    np.testing.assert_array_equal(np.flatnonzero(t["in_collision"]), np.unique(close))
    partners = {k: [] for k in range(len(t))}
    for a, b in close:
        partners[a].append(b)
        partners[b].append(a)
    found = [sorted(int(v) for v in text.split()) for text in t["colliding_with"]]
    assert found == [sorted(partners[k]) for k in range(len(t))]
    nearest = np.full(len(t), np.inf)
    np.minimum.at(nearest, pairs.ravel(), np.repeat(distance, 2))
    np.testing.assert_allclose(t["clearance"].value, nearest - 4.5, atol=1e-11)
    assert tile.summary["collision_rate"] == len(np.unique(close)) / len(t)


@pytest.mark.parametrize(
    ("suffix", "ids"),
    [(".fits", None), (".ecsv", [999999, -1, 2**62]), (".fits.gz", ["a b", "", "-1"]), (".ecsv.gz", None)],
)
def test_written_and_read_back_equal(small, tmp_path, suffix, ids):
    coord = CENTER.directional_offset_by([0, 90, 200] * u.deg, [0.05, 0.2, 0.3] * u.deg)
    catalog = rs.Catalog(coord, id=ids, meta={"note": "a value with 'quotes', \"more\" and spaces    " * 5})
    tile = rs.plan_tile(catalog, small, CENTER, rng=5)
    path = tmp_path / f"tile{suffix}"
    tile.write(path)
    back = rs.Tile.read(path)
    assert (back, back.summary["n_assigned"], set(back.table["target_id"].compressed())) == (tile, 3, set(catalog.id))
    if not suffix.endswith("ecsv.gz"):
        plain = QTable.read(path, **({"hdu": "TILE"} if ".fits" in suffix else {}))
        assert (plain["x"].unit, len(plain)) == (MM, len(tile.table))
    assert rs.Tile.read(path).provenance["parameters"]["rng"] == 5


def test_tiles_that_differ_are_not_equal(small):
    coord = CENTER.directional_offset_by([0, 90] * u.deg, [0.05, 0.2] * u.deg)
    first = rs.plan_tile(coord, small, CENTER)
    second = rs.Tile(first.table.copy())
    assert second == first
    second.table["tip_x"][18] += 1e-12 * MM
    assert second != first
    assert first != "a tile"
    second = rs.Tile(first.table.copy())
    second.table["tip_x"] = second.table["tip_x"].value * u.cm
    assert second != first
    second = rs.Tile(first.table.copy())
    ids = second.table["target_id"]
    ids[np.flatnonzero(ids.mask)[0]] = ids.fill_value  # differs only in the mask
    assert second != first


def test_provenance_says_how_to_make_it_again(small, sky):
    tile = rs.plan_tile(sky, small, CENTER, position_angle=10 * u.deg, allocator="balanced", rng=42)
    p = tile.provenance
    assert (p["parameters"]["rng"], p["parameters"]["position_angle_deg"]) == (42, 10)
    assert (p["parameters"]["allocator"], p["instrument"]["name"]) == ("balanced", "small")
    assert {"rfpsurvey", "astropy", "numpy", "numba"} <= set(p["software"])
    assert "no refraction" in p["model"]
    again = rs.plan_tile(sky, small, CENTER, position_angle=10 * u.deg, allocator="balanced", rng=42)
    np.testing.assert_array_equal(np.ma.filled(again.table["target_id"], -1), np.ma.filled(tile.table["target_id"], -1))
    fresh = rs.plan_tile(sky, small, CENTER, allocator="balanced", rng=None).provenance["parameters"]["rng"]
    seeds = fresh, np.random.default_rng(fresh)
    twice = [rs.plan_tile(sky, small, CENTER, allocator="balanced", rng=seed).table for seed in seeds]
    np.testing.assert_array_equal(*(np.ma.filled(t["target_id"], -1) for t in twice))


def test_proper_motion_moves_the_fibers(small):
    coord = SkyCoord([95] * u.deg, [23] * u.deg, pm_ra_cosdec=[3600e3] * u.mas / u.yr, pm_dec=[0] * u.mas / u.yr)
    catalog = rs.Catalog(coord, epoch=Time(2016, format="jyear", scale="tcb"))
    still, moved = (rs.plan_tile(catalog, small, CENTER, epoch=e) for e in (None, 2016.05))
    row = np.flatnonzero(still.table["status"] == "assigned")[0]
    # 180 arcsec toward the east, along +x, at 200 mm / deg
    shift = moved.table["tip_x"][row] - still.table["tip_x"][row]
    assert (shift.to_value(MM), moved.provenance["parameters"]["epoch"]) == (pytest.approx(10, rel=1e-4), "J2016.050")


def test_north_of_date_turns_the_field(small, sky):
    today = CENTER.transform_to(FK5(equinox="J2026"))
    tile = rs.plan_tile(sky, small, today)
    assert tile.provenance["parameters"]["north_of"] == "fk5 J2026.000"


def test_priorities_decide(small):
    coord = CENTER.directional_offset_by([0, 0] * u.deg, [0.01, 0.02] * u.deg)
    tile = rs.plan_tile(rs.Catalog(coord, id=["near", "far"], priority=[1, 2]), small, CENTER)
    assert tile.table["target_id"].compressed().tolist() == ["far"]


def test_disabled_and_stuck_units_show(small):
    n = len(small.focal_plane)
    stuck = np.full((n, 2), np.nan)
    stuck[3] = [20, 120]
    plane = replace(small.focal_plane, disabled=np.arange(n) == 5, stuck=stuck * u.deg)
    coord = CENTER.directional_offset_by(np.linspace(0, 350, 90) * u.deg, np.linspace(0.01, 0.4, 90) * u.deg)
    tile = rs.plan_tile(coord, replace(small, focal_plane=plane), CENTER)
    assert (tile.table["status"][3], tile.table["status"][5]) == ("stuck", "disabled")
    assert tile.table["theta"][3] == 20 * u.deg
    assert tile.table["target_id"].mask[[3, 5]].all()


def test_fiber_types_and_spectrographs(presets):
    coord = CENTER.directional_offset_by(np.linspace(0, 357, 120) * u.deg, np.linspace(0.1, 1.3, 120) * u.deg)
    types = np.array(["BOSS", "APOGEE", ""] * 40)
    tile = rs.plan_tile(rs.Catalog(coord, fiber_type=types), presets["sdss_apo"], CENTER)
    t = tile.table[tile.table["status"] == "assigned"]
    wanted = types[np.asarray(t["target_id"])]
    assert (t["fiber_type"][wanted != ""] == wanted[wanted != ""]).all()
    assert (t["fiber_type"][wanted == ""] == "BOSS").all()
    np.testing.assert_array_equal(t["spectrograph"], (t["fiber_type"] == "APOGEE").astype(int))
    # an instrument without named fiber types observes all of them
    assert rs.plan_tile(rs.Catalog(coord, fiber_type=types), presets["lamost"], CENTER).summary["n_assigned"] > 80


def test_each_fiber_type_is_projected_by_its_map(presets):
    instrument = presets["sdss_apo"]
    coord = SkyCoord([CENTER.directional_offset_by(90 * u.deg, 1.0 * u.deg)])
    # 9208 sin(1.372...) and 8939 sin(1.413...), the two maps at 1 deg
    for name, expected in (("BOSS", 220.519), ("APOGEE", 220.528)):
        tile = rs.plan_tile(rs.Catalog(coord, fiber_type=[name]), instrument, CENTER, allocator="lamost_rule")
        tip = tile.table["tip_x"][tile.table["status"] == "assigned"]
        assert tip[0].value == pytest.approx(expected, abs=2e-3)


def test_bad_input_is_named(small, sky, presets, tmp_path):
    typed, aside = rs.Catalog(sky.coord, fiber_type=["HERMES"] * len(sky)), {"kind": ["sky"]}
    for message, given, options in (
        ("unknown allocator 'best'; choose one of: balanced, lamost", {}, {"allocator": "best"}),
        ("center must be a SkyCoord, got", {"center": (95, 23)}, {}),
        ("position_angle must be a Quantity", {}, {"position_angle": 5}),
        ("unknown fiber type 'HERMES'; choose one of: APOGEE, BOSS", {"catalog": typed}, {}),
        ("the catalog must have at least one target", {"catalog": CENTER.reshape(1)[:0]}, {}),
        ("no target lies within .* of the field center .*; the nearest is", {"catalog": at(200, -40)}, {}),
        ("reaches a science target; the field around the center .* contains 1 target", {"catalog": at(95, 23.46)}, {}),
        ("none of the 1 targets in the field is a science target", {"catalog": rs.Catalog(at(95, 23), **aside)}, {}),
        ("must be read first: Catalog.read", {"catalog": "stars"}, {}),
    ):
        model = presets["sdss_apo"] if given.get("catalog") is typed else small
        with pytest.raises(rs.InputError, match=message):
            rs.plan_tile(given.get("catalog", sky), model, given.get("center", CENTER), **options)
    tile, unicode_ids = (
        rs.plan_tile(catalog, small, CENTER)
        for catalog in (sky, rs.Catalog(sky.coord, id=[f"★{k}" for k in range(len(sky))]))
    )
    sky.write(tmp_path / "sky.ecsv")
    for message, call in {
        "the folder .* does not exist": lambda: tile.write(tmp_path / "no" / "tile.fits"),
        "must end in .fits or .ecsv": lambda: tile.write(tmp_path / "tile.txt"),
        "does not hold a tile: the column status is missing$": lambda: rs.Tile.read(tmp_path / "sky.ecsv"),
        "there is no such file": lambda: rs.Tile.read(tmp_path / "nothing.fits"),
        "FITS files can contain only ASCII text": lambda: unicode_ids.write(tmp_path / "star.fits"),
    }.items():
        with pytest.raises(rs.InputError, match=message):
            call()
    unicode_ids.write(tmp_path / "star.ecsv")
    assert rs.Tile.read(tmp_path / "star.ecsv") == unicode_ids
    assert sorted(p.name for p in tmp_path.iterdir()) == ["sky.ecsv", "star.ecsv"]


def test_a_failed_write_leaves_the_old_file(small, sky, tmp_path, monkeypatch):
    path = tmp_path / "tile.ecsv"
    tile = rs.plan_tile(sky, small, CENTER)
    tile.write(path)
    before = path.read_bytes()
    monkeypatch.setattr(QTable, "write", lambda *_, **__: (_ for _ in ()).throw(OSError("disk full")))
    with pytest.raises(rs.InputError, match="cannot be written: disk full"):
        tile.write(path, overwrite=True)
    assert (path.read_bytes(), [p.name for p in tmp_path.iterdir()]) == (before, ["tile.ecsv"])


def test_targets_of_other_kinds_before_and_between(small):
    """Row numbers among science targets differ from row numbers of the catalog."""
    coord = CENTER.directional_offset_by([0, 90, 200, 300] * u.deg, [0.05, 0.2, 0.3, 5] * u.deg)
    catalog = rs.Catalog(coord, id=["sky", "star", "standard", "far"], kind=["sky", "science", "standard", "sky"])
    tile = rs.plan_tile(catalog, small, CENTER)
    row = tile.table[tile.table["status"] == "assigned"]
    assert (row["target_id"].tolist(), row["ra"][0], tile.summary["n_targets"]) == (["star"], coord.ra[1], 4)
    assert (tile.summary["n_in_field"], tile.summary["n_set_aside"]) == (3, 2)


def test_parked_positioners_can_be_left_out(small):
    coord = CENTER.directional_offset_by([0, 90] * u.deg, [0.05, 0.2] * u.deg)
    with_parked, without = (flat.plan_tile(coord, small, CENTER, parked_obstacles=p) for p in (True, False))
    assert (with_parked.summary["n_parked"], without.summary["n_parked"], without.summary["n_idle"]) == (35, 0, 35)
    for tile, parked in ((with_parked, True), (without, False)):
        score = rs.score_tile(tile.table, small, parked_obstacles=parked)
        assert score.summary["n_parked"] == tile.summary["n_parked"]


def test_fast_stars_from_outside_the_field_come_in(small):
    """A star half a degree outside the field, which moves 180 arcsec per year, is in the field after ten years."""
    start = CENTER.directional_offset_by(90 * u.deg, 0.5 * u.deg)
    coord = SkyCoord([start.ra], [start.dec], pm_ra_cosdec=[-180e3] * u.mas / u.yr, pm_dec=[0] * u.mas / u.yr)
    tile = rs.plan_tile(rs.Catalog(coord, epoch=2016.0), small, CENTER, epoch=2026.0)
    assert tile.summary["n_assigned"] == 1


def test_stuck_units_in_collision_are_not_counted_as_colliding(small):
    n = len(small.focal_plane)
    stuck = np.full((n, 2), np.nan)
    stuck[18] = [0, 0]  # the central arm is stretched toward +x
    plane = replace(small.focal_plane, stuck=stuck * u.deg)
    target = small.projection(CENTER).to_sky([[14, 1]] * MM)
    tile = flat.plan_tile(target, replace(small, focal_plane=plane), CENTER, parked_obstacles=False)
    assert (tile.table["in_collision"].sum(), tile.summary["n_colliding"], tile.summary["collision_rate"]) == (2, 1, 1)


def test_scores_follow_the_epoch(small):
    coord = SkyCoord([95] * u.deg, [23] * u.deg, pm_ra_cosdec=[360e3] * u.mas / u.yr, pm_dec=[0] * u.mas / u.yr)
    plan = rs.Catalog(coord, epoch=2016.0).to_table()
    plan["positioner"] = [18]
    field = {"center": CENTER, "position_angle": 0 * u.deg}
    still, moved = (rs.score_tile(plan, small, epoch=epoch, **field) for epoch in (None, 2016.1))
    assert (moved.table["tip_x"] - still.table["tip_x"])[18].to_value(MM) == pytest.approx(2, rel=1e-4)


def test_a_tile_says_which_model_was_used_and_why_it_suffices(presets, sky):
    said = {}
    for name in ("lamost", "sdss_apo"):
        tile = rs.plan_tile(sky, presets[name], CENTER, allocator="lamost_rule")
        said[name] = tile.summary["model"]
        plane = presets[name].focal_plane
        found = re.search(r"(\d+) pairs of arms can touch. In this plan, the arms of (\d+) of these pairs", said[name])
        tested, near = map(int, found.groups())
        assert tested == len(plane.neighbor_pairs())
        # all pairs with a distance less than the length of an arm are listed
        middle = np.column_stack([(tile.table[f"elbow_{k}"] + tile.table[f"arm_{k}"]) / 2 for k in "xy"])
        gap = np.hypot(*(middle[plane.neighbor_pairs()[:, 0]] - middle[plane.neighbor_pairs()[:, 1]]).T)
        assert tile.summary["n_colliding_pairs"] <= near <= (gap < 60 * u.mm).sum()
    assert "(collision type 2)" in said["lamost"]
    assert "one plate scale" in said["lamost"]
    assert "(collision type 3)" in said["sdss_apo"]
    assert "capsules" in said["sdss_apo"]
    assert "radial map, one for each fiber type" in said["sdss_apo"]
    far = rs.FocalPlane.hexagonal(rs.Positioner(4 * u.mm, 4 * u.mm, 1 * u.mm), rings=2, pitch=30 * u.mm)
    lonely = rs.Instrument("lonely", far, plate_scale=300 * u.mm / u.deg)
    few = rs.synthetic_catalog("uniform", CENTER, 0.2 * u.deg, n_targets=200, rng=1)
    tile = rs.plan_tile(few, lonely, CENTER, allocator="lamost_rule")
    assert "No two arms can touch (collision type 1), and no pair was tested" in tile.summary["model"]


def test_a_file_that_does_not_hold_a_tile_is_named(small, tmp_path):
    tile = rs.plan_tile(CENTER.directional_offset_by([0, 90] * u.deg, 0.1 * u.deg), small, CENTER)
    path, table = tmp_path / "tile.ecsv", tile.table.copy()
    table["phi"] = Masked(table["phi"], mask=np.arange(len(table)) == 3)
    table["in_collision"] = MaskedColumn(np.ones(len(table), dtype=bool), mask=np.arange(len(table)) == 3)
    table.write(path)
    back = rs.Tile.read(path).table  # without masks, as a tile has them
    assert np.isnan(back["phi"][3])
    assert back["in_collision"].tolist() == [k != 3 for k in range(len(table))]
    table.meta = {**table.meta, "provenance": {**tile.provenance, "instrument": {}}}
    table.write(path, overwrite=True)
    words = r"tile\.ecsv does not hold a tile: the meta of a tile must have the entry provenance\.instrument\.\w+, got"
    with pytest.raises(rs.InputError, match=words):
        rs.Tile.read(path)


def test_the_table_is_made_on_first_use(small, monkeypatch):
    targets = rs.synthetic_catalog("uniform", CENTER, 0.4 * u.deg, n_targets=300, rng=2)
    tile = rs.plan_tile(targets, small, CENTER)
    made = []
    make = TableOfTile.make
    monkeypatch.setattr(TableOfTile, "make", lambda self: made.append(1) or make(self))
    counts = tile.summary["n_assigned"], len(tile)
    _ = tile.instrument, repr(tile), len(tile.outcomes), len(tile.completeness)
    assert not made
    assert counts == ((tile.table["status"] == "assigned").sum(), len(tile.table))
    assert tile.table is tile.table
    assert (tile.table.meta["summary"], len(made)) == (tile.summary, 1)
    for copy in (pickle.loads(pickle.dumps(rs.plan_tile(targets, small, CENTER))), rs.Tile(tile.table, tile.outcomes)):
        assert len(copy) == len(tile)
        assert set(copy.table["target_id"].compressed()) == set(tile.table["target_id"].compressed())


def test_tiles_and_surveys_have_a_method_that_plots_them(small, sky):
    tile, survey = rs.plan_tile(sky, small, CENTER), rs.plan_survey(sky, small, CENTER.reshape(1))
    assert tile.targets is tile.outcomes
    ax = tile.plot(targets="outcome")
    assert tile.plot(ax=ax) is ax
    assert survey.plot(color="n_assigned") is not ax
