"""The outcome of every target of a field, and the columns of the catalog in the table of a tile."""

import pickle

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.io import fits
from astropy.table import Table

import rfpsurvey as rs
from rfpsurvey._field.facts import tile_objectives

CENTER = SkyCoord(95, 23, unit="deg")
N = 1500


@pytest.fixture(scope="module")
def sky():
    rng = np.random.default_rng(4)
    coord = rs.synthetic_catalog("uniform", CENTER, 1.7 * u.deg, n_targets=N, rng=1).coord
    return rs.Catalog(
        coord,
        id=np.arange(N) + 1000,
        kind=rng.choice(["science", "standard", "sky"], N, p=[0.8, 0.1, 0.1]),
        category=rng.choice(["qso", "lrg", ""], N),
        priority=rng.integers(1, 4, N),
        extra={"g": rng.uniform(14, 20, N) * u.mag, "n": rng.integers(0, 9, N), "flag": rng.random(N) < 0.5},
    )


@pytest.fixture(scope="module")
def tile(presets, sky):
    asked = rs.AllocationOptions("lamost_rule", requirements=["sky=40", "standard=15"], sky_separation=20 * u.arcsec)
    return rs.plan_tile(sky, presets["sdss_apo"], CENTER, allocator=asked)


@pytest.fixture(scope="module")
def science_only(presets, sky):
    return rs.plan_tile(sky, presets["sdss_apo"], CENTER)


def field_of(sky, presets):
    return np.flatnonzero(sky.coord.separation(CENTER) <= presets["sdss_apo"].field_radius)


def test_every_target_of_the_field_has_an_outcome(presets, sky, tile):
    rows = field_of(sky, presets)
    found, t = tile.outcomes, tile.table
    assert found["target_id"].tolist() == sky.id[rows].tolist()
    np.testing.assert_allclose(found["ra"].to_value(u.deg), sky.coord.ra.deg[rows], rtol=0, atol=1e-11)
    by_target = {str(t["target_id"][k]): k for k in np.flatnonzero(t["status"] == "assigned")}
    xy = presets["sdss_apo"].projection(CENTER).to_focal_plane(sky[rows]).to_value(u.mm)
    reach = presets["sdss_apo"].focal_plane.arrays.reach(xy)
    for k, row in enumerate(found):
        place = by_target.get(str(row["target_id"]))
        if place is None:
            expected = "in reach not assigned" if reach.covered[k] else "out of reach"
            assert np.ma.is_masked(row["positioner"]) or row["positioner"] == ""
        else:
            expected = "lost to a collision" if t["in_collision"][place] else "observed"
            assert row["positioner"] == t["id"][place]
            for name in "xy":
                assert abs(row[name] - t[f"tip_{name}"][place]) <= 1e-6 * u.mm + 1e-7 * abs(t[f"tip_{name}"][place])
        assert row["outcome"] == expected
    assert set(found["outcome"]) <= set(rs.Tile.OUTCOMES)


def test_targets_that_are_not_requested(presets, sky, science_only):
    found = science_only.outcomes
    others = found["kind"] != "science"
    assert set(found["outcome"][others]) == {"not requested"}
    assert "not requested" not in set(found["outcome"][~others])
    assert np.isnan(found["x"][others]).all()
    assert np.isfinite(found["x"][~others]).all()
    assert len(found) == len(field_of(sky, presets))


def test_columns_travel_to_the_table(sky, tile):
    t = tile.table
    has_target = t["status"] == "assigned"
    row = np.array([int(i) - 1000 for i in t["target_id"].filled(-1)])
    given = has_target & (row >= 0) & (row < N)
    blank = has_target & ~given
    assert given.sum() > 200
    assert blank.sum() > 5
    assert (t["kind"][blank] == "sky").all()
    for name in ("priority", "category", "kind"):
        np.testing.assert_array_equal(t[name][given], getattr(sky, name)[row[given]])
    for name in ("g", "n", "flag"):
        np.testing.assert_array_equal(np.asarray(t[name][given]), np.asarray(sky.extra[name])[row[given]])
    assert t["g"].unit == u.mag
    assert np.isnan(t["g"][~given]).all()
    assert t["n"].mask[~given].all()
    assert not t["n"].mask[given].any()
    assert (t["category"][~given] == "").all()


def test_counts_by_kind_and_class(sky, tile):
    kinds, found = tile.summary["kinds"], tile.outcomes
    assert sum(counts["n_assigned"] for counts in kinds.values()) == tile.summary["n_assigned"]
    assert kinds["sky"]["n_assigned"] >= 40
    assert kinds["standard"]["n_assigned"] >= 15
    rows = {(r["kind"], r["category"], r["priority"]): r for r in tile.completeness}
    observed = found["outcome"] == "observed"
    for name in ("science", "standard", "sky"):
        of_kind = found["kind"] == name
        assert rows[name, "all", "all"]["n_in_field"] == of_kind.sum() == kinds[name]["n_in_field"]
        assert rows[name, "all", "all"]["n_observed"] == (of_kind & observed).sum()
    for name in (1, 2, 3):
        of_class = (found["kind"] == "science") & (found["priority"] == name)
        row = rows["science", "all", str(name)]
        assert (row["n_in_field"], row["n_observed"]) == (of_class.sum(), (of_class & observed).sum())
        assert row["completeness"] == row["n_observed"] / row["n_in_field"]
    for name, label in (("qso", "qso"), ("lrg", "lrg"), ("", "no category")):
        assert rows["all", label, "all"]["n_in_field"] == (found["category"] == name).sum()


def test_many_categories_share_a_row(presets):
    coord = rs.synthetic_catalog("uniform", CENTER, 1 * u.deg, n_targets=400, rng=1).coord
    category = np.array([f"class {k % 40}" for k in range(400)])
    found = rs.plan_tile(rs.Catalog(coord, category=category), presets["sdss_apo"], CENTER).completeness
    named = found[found["category"] != "all"]
    assert (len(named), named["category"][-1], named["n_in_field"].sum()) == (20, "21 others", found["n_in_field"][0])


def test_where_the_tile_is(presets, sky):
    tile = rs.plan_tile(rs.Catalog(sky.coord), presets["moons"], CENTER, position_angle=12 * u.deg)
    assert tile.instrument == "moons"
    assert tile.center.separation(CENTER) < 1e-9 * u.arcsec
    assert tile.position_angle == 12 * u.deg
    assert tile.epoch is None
    assert len(tile) == len(tile.table)
    assert (tile["x"] == tile.table["x"]).all()
    assert "fiber_type" not in tile.table.colnames  # all targets have the same kind
    scored = rs.score_tile(tile.table, presets["moons"])
    assert scored.outcomes is None
    assert scored.completeness is None


@pytest.mark.parametrize("suffix", [".fits.gz", ".ecsv"])
def test_written_and_read_back(tile, science_only, tmp_path, suffix):
    for number, one in enumerate((tile, science_only)):
        path = tmp_path / f"{number}{suffix}"
        one.write(path)
        back = rs.Tile.read(path)
        assert back == one
        if suffix == ".ecsv":
            assert back.outcomes is None
        else:
            assert back.outcomes.colnames == one.outcomes.colnames
            assert (back.completeness == one.completeness).all()


def test_files_explain_themselves(tile, tmp_path):
    tile.write(tmp_path / "tile.fits")
    with fits.open(tmp_path / "tile.fits") as units:
        assert [unit.name for unit in units] == ["PRIMARY", "TILE", "OUTCOMES"]
        for unit in units[1:]:
            names = unit.columns.names
            for k, name in enumerate(names, 1):
                assert unit.header.get(f"TCOMM{k}") or name in ("g", "n", "flag"), name
        header = units["TILE"].header
        assert header["RADESYS"] == "ICRS"
        assert (header["RA"], header["DEC"], header["POSANG"]) == pytest.approx((95, 23, 0))
        assert header["TUNIT3"] == "mm"
    plain = Table.read(tmp_path / "tile.fits", hdu="OUTCOMES")
    assert len(plain) == len(tile.outcomes)


def test_tiles_with_other_outcomes_are_not_equal(tile):
    other = rs.Tile(tile.table.copy(), tile.outcomes.copy())
    assert other == tile
    other.outcomes["outcome"][0] = "elsewhere"
    assert other != tile


def test_many_classes_are_summed_up(presets):
    """Regression: the summary contained at most 100 classes, and the command did not count all others."""
    coord = rs.synthetic_catalog("uniform", CENTER, 1 * u.deg, n_targets=600, rng=1).coord
    tile = rs.plan_tile(rs.Catalog(coord, priority=np.arange(600)), presets["sdss_apo"], CENTER)
    objectives = tile.summary["objectives"]
    n_classes = tile.summary["n_reachable"]
    assert (len(objectives), objectives[-1][0]) == (100, f"{n_classes - 99} more classes")
    assert sum(value for _, value, _ in objectives) == tile.summary["n_assigned"]
    lines = tile_objectives(tile, 12)
    assert (len(lines), lines[-1][0]) == (12, f"{n_classes - 11} more classes")
    assert sum(value for _, value, _ in lines) == tile.summary["n_assigned"]


@pytest.mark.parametrize(("n_classes", "subpriority"), [(14, None), (130, 1)])
def test_the_sum_of_further_classes_does_not_contain_the_total(presets, n_classes, subpriority):
    """Regression: the number of targets of any kind was added to the sum of the classes, which it includes."""
    sky = rs.synthetic_catalog("uniform", CENTER, 1 * u.deg, n_targets=900, rng=1)
    kind = np.where(np.arange(900) % 9 == 0, "sky", "science")
    catalog = rs.Catalog(sky.coord, priority=np.arange(900) % n_classes, kind=kind)
    asked = rs.AllocationOptions(requirements=["sky=20"], subpriority=subpriority)
    tile = rs.plan_tile(catalog, presets["sdss_apo"], CENTER, allocator=asked)
    lines = tile_objectives(tile, 12 + (subpriority is not None))
    if subpriority is not None:
        name, value, _ = lines.pop()
        assert (name, value) == ("sum of the subpriorities", pytest.approx(tile.summary["objectives"][-1][1], rel=1e-5))
    assert len(tile.summary["objectives"]) <= 100
    science, total = (tile.summary["kinds"]["science"]["n_assigned"], tile.summary["n_assigned"])
    assert total > science
    assert len(lines) == 12
    assert lines[-1] == ("targets of any kind", total, "")
    assert lines[-2][0].endswith(" more classes")
    assert sum(value for label, value, _ in lines[:-1] if "fibers missing" not in label) == science
    values = [value for name, value, _ in tile.summary["objectives"] if name.startswith("priority") or "more" in name]
    assert sum(values) == science


def test_the_short_text_counts_kinds(tile, science_only):
    """Regression: the text '500 of 500 assigned' did not mention sky fibers."""
    kinds = {kind: counts["n_assigned"] for kind, counts in tile.summary["kinds"].items()}
    assert f"({kinds['science']} science, {kinds['standard']} standard, {kinds['sky']} sky)" in repr(tile)
    assert repr(science_only).count("(") == 1  # the arm model


@pytest.mark.parametrize("early", [False, True])
def test_a_copied_tile_has_the_same_tables_and_only_the_targets_of_its_field(presets, early):
    model = presets["moons"]
    center = SkyCoord("6h20m +23d")
    wide = rs.synthetic_catalog("uniform", center, 20 * model.field_radius, n_targets=200_000, rng=1)
    kind = np.where(np.arange(len(wide)) % 3 == 0, "standard", "science")
    tile = rs.plan_tile(rs.Catalog(wide.coord, kind=kind), model, center)
    expected = (tile.outcomes, tile.idle, tile.idle_targets) if early else None
    content = pickle.dumps(tile)
    assert len(content) < 1_000_000  # the complete catalog has 8 MB
    copy = pickle.loads(content)
    expected = expected or (tile.outcomes, tile.idle, tile.idle_targets)
    for one, other in zip((copy.outcomes, copy.idle, copy.idle_targets), expected, strict=True):
        assert one.colnames == other.colnames
        for name in one.colnames:
            np.testing.assert_array_equal(np.asarray(one[name]), np.asarray(other[name]))
