"""Complete surveys: the targets of tiles, the outcomes of targets, and results that do not depend on the executor."""

from dataclasses import replace

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.io import fits
from astropy.table import QTable
from living import differences

import flat
import rfpsurvey as rs
from fields import CENTER, clustered_sky, grid


@pytest.fixture(scope="module")
def sky():
    return clustered_sky()


def one_by_one(sky, tiling, instrument, order, **options):
    """Plan the tiles with `plan_tile` in a loop."""
    left = sky.visits.astype(int).copy()
    visits, summaries = {}, {}
    for k in order:
        rows = np.flatnonzero(left > 0)
        try:
            tile = flat.plan_tile(sky[rows], instrument, tiling.coord[k], **options)
        except rs.InputError:
            continue
        table = tile.table[tile.table["status"] == "assigned"]
        ids = np.asarray(table["target_id"])
        summaries[k] = tile.summary
        rows = zip(ids.tolist(), np.asarray(table["id"]).tolist(), table["in_collision"].tolist(), strict=True)
        visits[k] = set(rows)
        left[ids[~table["in_collision"]]] -= 1
    return left, visits, summaries


@pytest.mark.filterwarnings("ignore:required targets never observed", "ignore:constraint keep_out")
@pytest.mark.parametrize(
    ("constrained", "allocator"), [(False, "lamost_rule"), (True, "lamost_rule"), (True, "repair")]
)
def test_a_survey_of_one_tile_is_a_tile_in_every_column(constrained, allocator):
    """Compare all columns exactly, including those of blank sky, fiber types, required targets and circles that no arm
    may cover.
    """
    rng, text = np.random.default_rng(7), constrained
    sky = rs.synthetic_catalog("poisson", CENTER, 1.6 * u.deg, density=200 / u.deg**2, rng=3)
    n = len(sky)
    sky = rs.Catalog(
        sky.coord,
        id=[f"star {k}" for k in range(n)] if text else 10 * np.arange(n) - 300,
        priority=rng.integers(1, 4, n),
        kind=rng.choice(["science", "standard"], n, p=[0.9, 0.1]),
        fiber_type=rng.choice(["BOSS", "APOGEE", ""], n),
    )
    options = rs.AllocationOptions(allocator, requirements=["sky@BOSS=20", "standard=10"], sky_separation=10 * u.arcsec)
    if constrained:
        circles = [rs.Region.cap(where, 0.01 * u.deg) for where in sky.coord[:60]]
        options = replace(options, required=sky.id[::40], keep_out=circles)
    survey = rs.plan_survey(sky, "sdss_apo", CENTER.reshape(1), allocator=options)
    tile = rs.plan_tile(sky, "sdss_apo", CENTER, allocator=options)
    for name in ("n_obstacle_collisions", "n_colliding", "n_colliding_pairs", "n_assigned"):
        assert survey.tiles[name][0] == tile.summary[name], name
    outside = [s for s in tile.summary["unmet"] if "outside the field" in s]
    assert survey.tiles["n_unmet"][0] == len(tile.summary["unmet"]) - len(outside)
    if constrained:
        assert (survey.tiles["n_obstacle_collisions"][0] > 20) == (allocator == "lamost_rule")
        seen = np.isin(sky.id[::40], tile.table["target_id"].filled("" if text else 0))
        assert survey.summary["n_required"] == len(seen) > seen.sum() > 5
        lost = tile.table["target_id"][tile.table["in_collision"] & (tile.table["status"] == "assigned")]
        assert survey.summary["n_required_observed"] == seen.sum() - np.isin(lost, sky.id[::40]).sum()
    visits, table = survey.targets, tile.table[tile.table["status"] == "assigned"]
    names = {"positioner": "id", "target_id": "target_id", "fiber_type": "fiber_type", "kind": "kind"}
    for name, own in {**names, "in_collision": "in_collision"}.items():
        assert np.asarray(visits[name]).tolist() == np.asarray(table[own]).tolist(), name
    for name in ("ra", "dec"):
        assert visits[name].to_value(u.deg).tolist() == table[name].to_value(u.deg).tolist(), name
    blank = visits["target_row"] < 0
    assert blank.sum() >= 10
    assert (visits["kind"][blank] == "sky").all()
    assert not np.isin(visits["target_id"][blank], sky.id).any()
    assert (sky.id[visits["target_row"][~blank]] == visits["target_id"][~blank]).all()


@pytest.mark.parametrize("allocator", ["lamost_rule", "repair"])
def test_every_tile_is_what_plan_tile_makes_of_what_is_left(sky, small, allocator):
    tiling = grid(1.2)
    survey = rs.plan_survey(sky, small, tiling, allocator=allocator)
    order = np.lexsort((np.arange(len(tiling)), survey.tiles["round"]))
    left, visits, summaries = one_by_one(sky, tiling, small, order, allocator=allocator)
    assert len(summaries) == len(tiling)
    for k, summary in summaries.items():
        for name in ("n_in_field", "n_reachable", "n_assigned", "n_colliding", "n_colliding_pairs", "collision_rate"):
            assert survey.tiles[name][k] == summary[name], name
        assert survey.tiles["fiber_use"][k] == summary["n_assigned"] / summary["n_positioners"]
    for k, tile in enumerate(survey.tiles["tile"]):
        table = survey.tile(tile)
        found = zip(*(table[name].tolist() for name in ("target_id", "positioner", "in_collision")), strict=True)
        assert set(found) == visits.get(k, set())
    assert np.array_equal(survey.outcomes["requested"] - survey.outcomes["observed"].astype(int), left)
    assert survey.summary["n_visits_observed"] == sky.visits.sum() - left.sum()
    assert survey.summary["n_colliding"] == (0 if allocator == "repair" else survey.targets["in_collision"].sum())


def test_the_summary_states_the_model_of_every_tile(sky, small, presets, tmp_path):
    """The model of a tile, which `tests/tile/test_tile.py` tests, also states its number of pairs."""
    center = rs.Tiling.from_table(QTable({"ra": [CENTER.ra.deg] * u.deg, "dec": [CENTER.dec.deg] * u.deg}))
    for instrument in (small, presets["lamost"], presets["sdss_apo"]):
        folder = tmp_path / instrument.name
        said = rs.plan_survey(sky, instrument, center, folder=folder, allocator="lamost_rule").summary["model"]
        assert rs.Survey.read(folder).summary["model"] == said
        n_pairs = len(instrument.focal_plane.neighbor_pairs())
        assert f"{n_pairs} pairs of arms can touch. In each tile, distances are computed only for pairs" in said
        tile = rs.plan_tile(sky, instrument, CENTER, allocator="lamost_rule").summary["model"]
        assert tile.split(". ")[0] == said.split(". ")[0]
        assert tile.split(" exact for ")[1] == said.split(" exact for ")[1]
    far = rs.FocalPlane.hexagonal(rs.Positioner(4 * u.mm, 4 * u.mm, 1 * u.mm), rings=2, pitch=30 * u.mm)
    apart = rs.Instrument("apart", far, plate_scale=300 * u.mm / u.deg)
    survey = rs.plan_survey(sky, apart, center, allocator="lamost_rule")
    assert "No two arms can touch (collision type 1), and no pair was tested" in survey.summary["model"]


def test_no_target_twice_in_a_tile_and_never_more_often_than_wanted(sky, small):
    visits = rs.plan_survey(sky, small, grid(1.2), lost_in_collision=False, allocator="lamost_rule").targets
    pairs = np.column_stack([visits["tile"], visits["target_row"]])
    assert len(np.unique(pairs, axis=0)) == len(pairs)
    times = np.bincount(visits["target_row"], minlength=len(sky))
    assert (times <= sky.visits).all()
    assert visits["observed"].all()


def test_visits_given_by_hand(sky, small):
    tiling = grid(1.2)
    by_column = rs.plan_survey(sky, small, tiling)
    plain = rs.Catalog(sky.coord, priority=sky.priority)
    assert differences(rs.plan_survey(plain, small, tiling, visits=sky.visits), by_column) == []
    assert rs.plan_survey(plain, small, tiling).summary["n_visits_requested"] == len(sky)
    assert rs.plan_survey(sky, small, tiling, visits=2).summary["n_visits_requested"] == 2 * len(sky)


def test_standards_and_sky_are_never_used_up(small):
    coord = rs.synthetic_catalog("uniform", CENTER, 0.5 * u.deg, n_targets=60, rng=2).coord
    kind = np.where(np.arange(60) < 20, "sky", np.where(np.arange(60) < 30, "standard", "science"))
    catalog = rs.Catalog(coord, kind=kind)
    tiles = SkyCoord([CENTER, CENTER.directional_offset_by(0 * u.deg, 0.01 * u.deg)])
    survey = flat.plan_survey(catalog, small, tiles, requirements=["sky=5", "standard=2"])
    for tile in (0, 1):
        kinds = survey.tile(tile)["kind"].tolist()
        assert (kinds.count("sky"), kinds.count("standard")) == (5, 2)
    assert (survey.summary["n_unmet"], survey.summary["n_targets"]) == (0, 30)
    assert not survey.outcomes["observed"][:30].any()
    with pytest.warns(rs.RfpsurveyWarning, match=r"requirement sky=25: \d+ missing in 2 of 2 tiles \(0, 1\)"):
        lacking = flat.plan_survey(catalog, small, tiles, requirements="sky=25")
    missing = 25 - lacking.tiles["n_sky"]
    assert lacking.tiles["unmet"].tolist() == [f"sky=25: {n} missing" for n in missing]
    assert lacking.summary["unmet"] == [f"requirement sky=25: {missing.sum()} missing in 2 of 2 tiles (0, 1)"]
    assert survey.tiles["unmet"].tolist() == ["", ""]
    assert "unmet" not in rs.plan_survey(catalog, small, tiles).tiles.colnames
    assert (lacking.tiles["n_unmet"].tolist(), lacking.summary["n_unmet"]) == ([1, 1], 2)
    codes = survey.outcomes["outcome"][:30]
    assert {rs.Survey.OUTCOMES[k] for k in codes} == {"not requested"}
    assert set(survey.outcome_names[:30].tolist()) == {"not requested"}
    names, numbers = np.unique(survey.outcome_names, return_counts=True)
    assert dict(zip(names.tolist(), numbers.tolist(), strict=True)) == survey.summary["outcomes"]
    assert rs.plan_survey(catalog, small, tiles).summary["n_assigned"] <= 30


def test_blank_sky_has_its_position(small):
    catalog = rs.synthetic_catalog("uniform", CENTER, 0.5 * u.deg, n_targets=20, rng=2)
    options = {"requirements": "sky=3", "sky_separation": 30 * u.arcsec}
    visits = flat.plan_survey(catalog, small, CENTER.reshape(1), **options).targets
    sky = visits[visits["kind"] == "sky"]
    assert (len(sky), set(sky["target_row"])) == (3, {-1})
    where = SkyCoord(sky["ra"], sky["dec"])
    assert catalog.coord[:, None].separation(where).min() > 30 * u.arcsec
    others = visits[visits["kind"] == "science"]
    where = SkyCoord(others["ra"], others["dec"])
    assert catalog.coord[others["target_row"]].separation(where).max() < 1e-8 * u.arcsec


def test_blank_sky_keeps_away_from_targets_that_nobody_wants(small):
    catalog = rs.synthetic_catalog("uniform", CENTER, 0.5 * u.deg, n_targets=400, rng=2)
    options = {"requirements": "sky=5", "sky_separation": 100 * u.arcsec, "visits": np.arange(400) % 40 == 0}
    visits = flat.plan_survey(catalog, small, CENTER.reshape(1), **options).targets
    sky = visits[visits["kind"] == "sky"]
    assert len(sky) == 5
    where = SkyCoord(sky["ra"], sky["dec"])
    assert catalog.coord[:, None].separation(where).min() > 100 * u.arcsec


def test_fields_that_overlap_are_planned_in_turn(sky, small):
    radius = small.field_radius
    for factor, n in ((1.95, 2), (2.05, 1)):
        apart = SkyCoord([CENTER, CENTER.directional_offset_by(30 * u.deg, factor * radius)])
        assert rs.plan_survey(sky, small, apart).summary["n_rounds"] == n


def test_each_tile_draws_by_itself(sky, small):
    """Two distant tiles with the same targets have different random numbers."""
    other = CENTER.directional_offset_by(0 * u.deg, 10 * u.deg)
    offsets = np.random.default_rng(1).uniform(-0.4, 0.4, (2, 2000)) * u.deg
    both = [SkyCoord(*offsets, frame=c.skyoffset_frame()).icrs for c in (CENTER, other)]
    survey = rs.plan_survey(SkyCoord(both).ravel(), small, SkyCoord([CENTER, other]), allocator="balanced")
    assert survey.summary["n_rounds"] == 1
    one, two = (survey.tile(k)["target_row"] % 2000 for k in (0, 1))
    assert not np.array_equal(one, two)


BAD = {
    "must be distinct passes": [("passes", [1, 1]), ("passes", [1.5]), ("passes", "all"), ("passes", [np.nan])],
    "rng must be a seed from 0 to 2": [("rng", -1)],
    "whole numbers from 1 to 255": [("visits", 256)],
    "whole numbers from 1 to 255, got 0": [("visits", 0.0), ("visits", 0)],
    "must be one number or have the shape": [("visits", [1, 2])],
    "visits must be": [("visits", "often")],
    "must be a concurrent.futures.Executor": [("executor", 2)],
    "allocator to start with": [("start", "repair")],
    "time_limit must be a Quantity": [("time_limit", 5)],
    "unknown objective": [("objective", "most")],
}


def test_bad_options(sky, small):
    for sentence, options in BAD.items():
        for option in options:
            with pytest.raises(rs.InputError, match=sentence):
                flat.plan_survey(sky, small, grid(1.2), **dict([option]))


def test_nothing_to_plan(sky, small):
    with pytest.raises(rs.InputError, match="at least one target"):
        rs.plan_survey(sky[:0], small, grid(1.2))
    with pytest.raises(rs.InputError, match="at least one tile"):
        rs.plan_survey(sky, small, grid(1.2).table[:0])
    nobody = rs.plan_survey(sky, small, grid(1.2), visits=[0] * len(sky))
    assert (nobody.summary["n_assigned"], set(nobody.summary["outcomes"])) == (0, {"not requested"})


@pytest.mark.filterwarnings("ignore:requirement sky")
def test_what_is_told_is_told_once(sky, small):
    twins = rs.Catalog(sky.coord, id=np.arange(len(sky)) // 2)
    region = rs.Region.cap(CENTER, 1 * u.deg)
    wide, lamost = rs.place_tiles(region, radius=1 * u.deg), rs.place_tiles(region, "lamost")
    away = SkyCoord([CENTER.directional_offset_by(0 * u.deg, 30 * u.deg)])
    for arguments, options, sentence in (
        ((sky, grid(1.2)), {"sky_separation": 30 * u.arcsec}, "no requirement counts"),
        ((sky, grid(1.2)), {"epoch": 2026.5}, "the epoch has no effect"),
        ((sky, grid(1.2)), {"requirements": "sky=2"}, "no target of the catalog is 'sky', .* set sky_separation"),
        ((sky, grid(1.2)), {"requirements": "sky_boss=2"}, "no target of the catalog is 'sky_boss'"),
        ((twins, grid(1.2)), {}, "have the same id"),
        ((sky, away), {}, "no target was observed"),
        ((sky, wide), {}, "fields with a radius of 1 deg, but the fields of small have a radius of 0.4"),
        ((sky, lamost), {}, "the tiles were placed for fields of lamost, which have a radius of 2.477 deg, but"),
    ):
        with pytest.warns(rs.RfpsurveyWarning, match=sentence) as told:
            flat.plan_survey(arguments[0], small, arguments[1], **options)
        told = [text for text in (str(one.message) for one in told) if not text.startswith("requirement sky")]
        assert len(told) == 1
    flat.plan_survey(sky, small, grid(1.2), requirements=["science=3", "sky=2"], sky_separation=10 * u.arcsec)


def test_order_and_passes(sky, small):
    tiling = grid(1.2)
    second_first = rs.plan_survey(sky, small, tiling, passes=[2, 1])
    assert second_first.tiles["round"][9:].max() < second_first.tiles["round"][:9].min()
    only = rs.plan_survey(sky, small, tiling, passes=[2])
    assert len(only) == 9
    assert np.array_equal(only.tiles["n_observed"], second_first.tiles["n_observed"][9:])
    given = rs.plan_survey(sky, small, tiling, allocator="lamost_rule", order="given")
    left, *_ = one_by_one(sky, tiling, small, range(len(tiling)))
    assert np.array_equal(given.outcomes["requested"] - given.outcomes["observed"].astype(int), left)


def test_drawing_allocators_draw_the_same_for_the_same_seed(sky, small):
    tiling = grid(1.2)
    surveys = [rs.plan_survey(sky, small, tiling, allocator="balanced", rng=seed) for seed in (1, 1, 2)]
    assert differences(*surveys[:2]) == []
    assert not np.array_equal(surveys[0].targets["target_id"], surveys[2].targets["target_id"])
    drawn = rs.plan_survey(sky, small, tiling, allocator="balanced", rng=np.random.default_rng(1))
    assert drawn.summary["n_tiles"] == len(tiling)


def test_tiles_at_the_pole_and_across_the_origin_of_right_ascension(small):
    """Rotate a survey to a pole and to the origin of right ascension."""
    results = []
    for center in (SkyCoord(180 * u.deg, 0 * u.deg), SkyCoord(0 * u.deg, 0 * u.deg), SkyCoord(77 * u.deg, 90 * u.deg)):
        rng = np.random.default_rng(8)
        frame = center.skyoffset_frame()
        lon, lat = rng.uniform(-1, 1, (2, 2000)) * u.deg
        catalog = rs.Catalog(SkyCoord(lon, lat, frame=frame).icrs)
        tiles = SkyCoord([-0.5, 0, 0.5] * u.deg, [0, 0.2, -0.2] * u.deg, frame=frame).icrs
        # the direction of north differs between tiles, so that arms differ; the number of targets in the field does not
        survey = rs.plan_survey(catalog, small, tiles, allocator="nearest")
        results.append((survey.tiles["n_in_field"][0], survey.summary["n_rounds"]))
    assert results[0] == results[1] == results[2]


@pytest.mark.filterwarnings("ignore:no target was observed")
def test_targets_move_to_the_epoch(small):
    fast = SkyCoord(CENTER.ra, CENTER.dec, pm_ra_cosdec=0 * u.mas / u.yr, pm_dec=36e6 * u.mas / u.yr).reshape(1)
    catalog = rs.Catalog(fast, epoch=2000.0)
    assert rs.plan_survey(catalog, small, CENTER.reshape(1)).summary["n_assigned"] == 1
    assert rs.plan_survey(catalog, small, CENTER.reshape(1), epoch=2002.0).summary["n_assigned"] == 0


def test_columns_of_the_catalog_travel(small, tmp_path):
    """The visits contain priority, category and further columns of the targets, in memory and in files."""
    rng = np.random.default_rng(3)
    coord = rs.synthetic_catalog("uniform", CENTER, 0.5 * u.deg, n_targets=80, rng=2).coord
    columns = {"priority": rng.integers(1, 4, 80), "category": rng.choice(["qso", "lrg"], 80)}
    extra = {"g": rng.uniform(14, 20, 80) * u.mag, "n": np.arange(80), "flag": rng.random(80) < 0.5}
    catalog = rs.Catalog(coord, **columns, extra=extra)
    tiles = SkyCoord([CENTER, CENTER.directional_offset_by(0 * u.deg, 0.01 * u.deg)])
    options = {"allocator": rs.AllocationOptions("lamost_rule", requirements="sky=3", sky_separation=30 * u.arcsec)}
    survey = rs.plan_survey(catalog, small, tiles, folder=tmp_path / "s", **options)
    for visits in (survey.targets, rs.plan_survey(catalog, small, tiles, **options).targets):
        given = visits["target_row"] >= 0
        rows = visits["target_row"][given]
        assert 20 < given.sum() < len(visits)
        for name, values in {**columns, **extra}.items():
            np.testing.assert_array_equal(np.asarray(visits[name][given]), np.asarray(values)[rows])
        assert visits["g"].unit == u.mag
        assert np.isnan(visits["g"][~given]).all()
        assert set(visits["n"][~given].tolist()) == {-1}
    last = survey.completeness
    for name in ("qso", "lrg"):
        row = last[(last["category"] == name) & (last["priority"] == "all")][0]
        of_class = columns["category"] == name
        observed = survey.outcomes["observed"][of_class].sum()
        assert (row["n_targets"], row["n_observed"]) == (of_class.sum(), observed)
    again = rs.plan_survey(catalog, small, tiles, folder=tmp_path / "s", resume=True, **options)
    assert (again.targets["n"] == survey.targets["n"]).all()
    other = rs.Catalog(coord, **columns, extra={**extra, "n": np.arange(80) + 1})
    with pytest.raises(rs.InputError, match="catalog"):
        rs.plan_survey(other, small, tiles, folder=tmp_path / "s", resume=True, **options)


def test_files_of_a_survey_explain_themselves(small, tmp_path):
    catalog = rs.synthetic_catalog("uniform", CENTER, 0.5 * u.deg, n_targets=20, rng=2)
    survey = rs.plan_survey(catalog, small, CENTER.reshape(1), folder=tmp_path / "s")
    names = {"tiles.fits": "TILES", "outcomes.fits": "OUTCOMES", "tiles/000/000000.fits": "VISITS"}
    for path, name in names.items():
        with fits.open(survey.folder / path) as units:
            unit = units[1]
            assert unit.name == name
            described = [unit.header.get(f"TCOMM{k}") for k in range(1, len(unit.columns) + 1)]
            lacking = [c for c, words in zip(unit.columns.names, described, strict=True) if not words]
            assert lacking in ([], ["pass"])
    with fits.open(survey.folder / "outcomes.fits") as units:
        codes = [units[1].header[f"OUTCOME{k}"] for k in range(len(rs.Survey.OUTCOMES))]
    assert tuple(codes) == rs.Survey.OUTCOMES


def test_the_description_of_the_outcomes_lists_their_codes(sky, small, tmp_path):
    """Surveys contain codes of outcomes, whereas tiles contain text."""
    survey = rs.plan_survey(sky, small, CENTER.reshape(1), folder=tmp_path / "survey")
    for found in (survey, rs.Survey.read(tmp_path / "survey")):
        about = found.outcomes["outcome"].info.description.removeprefix("code of the outcome: ").split(", ")
        assert about == [f"{k} {name}" for k, name in enumerate(rs.Survey.OUTCOMES)]
        assert np.array_equal(found.outcome_names, np.array(rs.Survey.OUTCOMES)[survey.outcomes["outcome"]])
