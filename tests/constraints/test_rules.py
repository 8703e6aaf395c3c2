"""Limits of magnitude, bright stars, distributions and contrasts in plans, compared with brute force."""

from itertools import pairwise

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.table import QTable, Table
from raising import refused

import flat
import rfpsurvey as rs
from rfpsurvey.constraints import BrightStars, Contrast, Distribution, MagnitudeLimits, as_constraints

CENTER = SkyCoord("6h20m +23d")
MISSING = (np.nan, -999.0, 99.9, 0.0)


@pytest.fixture(scope="module")
def sky(small):
    """Return targets of all kinds with magnitudes, some of which are missing; a tenth of the targets are bright."""
    sky = rs.synthetic_catalog("uniform", CENTER, 1.3 * small.field_radius, n_targets=1500, rng=3)
    rng = np.random.default_rng(4)
    mag = rng.uniform(9, 20, len(sky))
    mag[:60] = np.tile(MISSING, 15)
    kind = rng.choice(["science", "science", "standard", "sky"], len(sky))
    return rs.Catalog(sky.coord, kind=kind, extra=QTable({"mag": mag, "word": np.full(len(sky), "a")}))


@pytest.fixture(scope="module")
def stars():
    rng = np.random.default_rng(8)
    coord = CENTER.directional_offset_by(rng.uniform(0, 360, 40) * u.deg, rng.uniform(0, 0.3, 40) * u.deg)
    return rs.Catalog(coord, extra=QTable({"mag": rng.uniform(5, 15, 40)}))


def with_fiber(tile, sky):
    """Return whether each target of the catalog has a fiber."""
    return np.isin(sky.id, tile.table["target_id"].compressed())


def plan(sky, small, rules, allocator="repair", **options):
    return rs.plan_tile(sky, small, CENTER, allocator=rs.AllocationOptions(allocator, constraints=rules, **options))


def radius_of(mag, table):
    """Return the radius (arcsec) of a table of magnitudes and radii, by linear interpolation."""
    if mag > table[-1][0]:
        return 0.0
    if mag <= table[0][0]:
        return table[0][1]
    for (m0, r0), (m1, r1) in pairwise(table):
        if m0 <= mag <= m1:
            return r0 + (r1 - r0) * (mag - m0) / (m1 - m0)
    return None


def near_stars(coord, ids, stars, mags, star_ids, radius):
    """Return which positions are within the radius around at least one star other than themselves, from all pairs."""
    found = np.zeros(len(coord), dtype=bool)
    for star, mag, name in zip(stars, mags, star_ids, strict=True):
        if not np.isfinite(mag) or mag in MISSING:
            continue
        found |= (coord.separation(star).arcsec <= radius(mag)) & (ids != name)
    return found


@pytest.mark.parametrize("missing", ["allowed", "refused"])
@pytest.mark.parametrize("allocator", ["nearest", "repair"])
def test_targets_outside_the_limits_have_no_fiber(sky, small, missing, allocator):
    mag, science = sky.extra["mag"], sky.kind == "science"
    tile = plan(sky, small, MagnitudeLimits("mag", 12.0, 17.5, "science", missing=missing), allocator)
    is_missing = np.isnan(mag) | np.isin(mag, MISSING)
    wrong = science & np.where(is_missing, missing == "refused", (mag <= 12) | (mag >= 17.5))
    has = with_fiber(tile, sky)
    assert has.sum() > 20
    assert not (has & wrong).any()
    assert (with_fiber(plan(sky, small, None, allocator), sky) & wrong).any()
    assert (tile.rules["verdict"][0], tile.rules["number"][0]) == ("pass", 0)


def test_limits_without_a_kind_concern_all_targets_except_sky_positions(sky, small):
    tile = plan(sky, small, ["magnitude mag 12 inf '' '' refused", "sky=5", "standard=5"])
    has, mag = with_fiber(tile, sky), sky.extra["mag"]
    assert (has & (sky.kind == "sky")).sum() >= 5
    assert (mag[has & (sky.kind != "sky")] > 12).all()


TABLE = [(9.5, 300.0), (12.0, 60.0)]


@pytest.mark.parametrize("form", ["list", "text", "function"])
def test_fibers_are_kept_away_from_stars_of_the_catalog(sky, small, form):
    """A star does not exclude itself, and stars outside the field and sky positions as stars are considered."""
    radius = {"list": TABLE, "text": "9.5:300,12:60", "function": lambda m: np.where(m < 12, 200.0, 0.0)}[form]
    rule = BrightStars("mag", radius)
    one = (lambda m: 200.0 if m < 12 else 0.0) if form == "function" else (lambda m: radius_of(m, TABLE))
    is_star = sky.kind != "sky"
    wrong = near_stars(sky.coord, sky.id, sky.coord[is_star], sky.extra["mag"][is_star], sky.id[is_star], one)
    tile, free = plan(sky, small, rule), plan(sky, small, None)
    has = with_fiber(tile, sky)
    assert not (has & wrong).any()
    assert (with_fiber(free, sky) & wrong).sum() > 5
    bright = is_star & (sky.extra["mag"] < 12) & (sky.extra["mag"] > 0)
    assert (has & bright & (sky.kind == "science")).any()
    assert tile.rules["verdict"].tolist() == ["pass"]


def test_added_sky_positions_are_kept_away_from_stars_of_a_second_catalog(sky, small, stars, tmp_path):
    path = tmp_path / "stars.ecsv"
    Table({"ra": stars.coord.ra, "dec": stars.coord.dec, "mag": stars.extra["mag"]}).write(path)
    texts = [BrightStars("mag", TABLE, stars=stars), f"bright_stars mag 9.5:300,12:60 '' {path}"]
    science = sky[sky.kind == "science"]
    for rule in texts:
        tile = plan(science, small, [rule, "sky=15"], sky_separation=10 * u.arcsec)
        table = tile.table[np.isfinite(tile.table["ra"]) & (tile.table["status"] == "assigned")]
        coord = SkyCoord(table["ra"], table["dec"])
        near = near_stars(
            coord, np.full(len(coord), "x"), stars.coord, stars.extra["mag"], stars.id, lambda m: radius_of(m, TABLE)
        )
        assert (table["kind"] == "sky").sum() >= 15
        assert not near.any()
    free = plan(science, small, "sky=15", sky_separation=10 * u.arcsec).table
    coord = SkyCoord(free["ra"], free["dec"])[np.isfinite(free["ra"])]
    assert near_stars(
        coord, np.full(len(coord), "x"), stars.coord, stars.extra["mag"], stars.id, lambda m: radius_of(m, TABLE)
    ).any()


def test_a_score_counts_fibers_near_stars_of_a_second_catalog(sky, small, stars):
    """Of stars that are targets, the table contains only those with a fiber: the plan fails or is not checkable."""
    table = plan(sky, small, None, "nearest").table
    table = table[table["status"] == "assigned"]
    rules = [
        BrightStars("mag", TABLE, stars=stars),
        BrightStars("mag", [(11.0, 900.0)]),
        BrightStars("mag", [(8.0, 900.0)]),
    ]
    found = rs.score_tile(table, small, positions="sky", constraints=rules).rules
    coord, ids = SkyCoord(table["ra"], table["dec"]), np.asarray(table["target_id"])
    near = near_stars(
        coord, np.full(len(coord), "x"), stars.coord, stars.extra["mag"], stars.id, lambda m: radius_of(m, TABLE)
    )
    own = near_stars(coord, ids, coord, table["mag"], ids, lambda m: 900.0 if m <= 11 else 0.0)
    assert near.any()
    assert own.any()
    assert found["verdict"].tolist() == ["fail", "fail", "not checkable"]
    assert found["number"].tolist()[:2] == [near.sum(), own.sum()]
    assert found["fibers"][0].split() == table["id"][near].astype(str).tolist()


@pytest.mark.parametrize(("night", "core"), [("bright", (1.75, 0.6)), ("dark", (1.5, 0.8))])
def test_the_formula_of_sdssv_is_the_largest_of_three_terms(night, core, small):
    rule = BrightStars("mag", f"sdssv_{night}:16")
    for m in np.arange(-1.5, 17, 0.37):
        depth = 16 - m
        radius = 0.0 if m > 16 else max((depth - 8.2) / 0.05, (depth - 4.5) / 0.25, core[0] * depth ** core[1])
        apart = np.array([0.99, 1.01]) * radius + [0, 1e-3]
        coord = SkyCoord([CENTER, *CENTER.directional_offset_by(0 * u.deg, apart * u.arcsec)])
        field = field_of(coord, {"mag": np.array([m, np.nan, np.nan])})
        assert rule.excluded(field).tolist() == [False, radius > 0, False]


def field_of(coord, extra, kind=None, xy=None, fiber_type=None):
    """Return a complete field of targets."""
    n = len(coord)
    kind = np.full(n, "science") if kind is None else kind
    xy = np.zeros((n, 2)) if xy is None else xy
    every, text = np.ones(n, dtype=bool), np.full(n, "")
    vectors = coord.cartesian.xyz.value.T
    return rs.constraints.ConstraintField(
        None, None, vectors, xy, np.arange(n), every, kind, text, np.zeros(n), extra, fiber_type=fiber_type
    )


@pytest.mark.parametrize("seed", range(10))
def test_a_distribution_counts_science_fibers_with_neighbors(seed):
    rng, n = np.random.default_rng(seed), 60
    kind, fiber = rng.choice(["science", "sky"], n, p=[0.8, 0.2]), rng.choice(["A", "B"], n)
    xy, has = rng.uniform(0, 100, (n, 2)), rng.random(n) < 0.8
    field = field_of(SkyCoord(np.zeros(n), np.zeros(n), unit="deg"), {}, kind, xy, fiber)
    k, percent, distance = int(rng.integers(1, 4)), rng.uniform(20, 90), rng.uniform(10, 60)
    found = Distribution("sky", k, percent, distance, "A").verdict(field, has)
    science = [p for p, one in enumerate(kind) if has[p] and fiber[p] == "A" and one == "science"]
    near = [p for p, one in enumerate(kind) if has[p] and fiber[p] == "A" and one == "sky"]
    enough = [sum(np.hypot(*(xy[p] - xy[q])) <= distance for q in near) >= k for p in science]
    assert found.number == pytest.approx(100 * sum(enough) / len(science))
    passes = sum(enough) * 100 >= percent * len(science)
    assert found.verdict == ("pass" if passes else "fail")
    assert found.rows.tolist() == ([] if passes else [p for p, one in zip(science, enough, strict=True) if not one])


@pytest.mark.parametrize("missing", ["allowed", "refused"])
def test_only_targets_outside_the_limits_are_excluded(missing):
    """Codes for missing magnitudes are not bright stars, limits are excluded, and sky positions have no limits."""
    mags = np.array([*MISSING, 11.9, 12.0, 12.1, 16.9, 17.0, 17.1, 5.0, np.nan])
    kind = np.array(["science"] * 10 + ["sky"] * 2)
    field = field_of(SkyCoord(np.arange(12), np.zeros(12), unit="deg"), {"mag": mags}, kind)
    found = MagnitudeLimits("mag", 12, 17, missing=missing).excluded(field).tolist()
    assert found == [missing == "refused"] * 4 + [True, True, False, False, True, True, False, False]


def test_only_targets_in_circles_are_excluded():
    """Stars that are fainter than the last magnitude of a table, and sky positions, have no circle."""
    rng = np.random.default_rng(7)
    coord = SkyCoord(rng.uniform(0, 1, 300), rng.uniform(0, 1, 300), unit="deg")
    mag, kind = rng.uniform(5, 18, 300), rng.choice(["science", "sky"], 300)
    found = BrightStars("mag", TABLE).excluded(field_of(coord, {"mag": mag}, kind))
    star, ids = kind != "sky", np.arange(300)
    expected = near_stars(coord, ids, coord[star], mag[star], ids[star], lambda m: radius_of(m, TABLE))
    assert found.tolist() == expected.tolist()
    assert 20 < found.sum() < 280


def test_stars_outside_the_field_exclude_targets_at_its_edge(sky, small):
    free = plan(sky, small, None, "nearest").table
    free = free[free["status"] == "assigned"]
    coord = SkyCoord(free["ra"], free["dec"])
    k, edge = np.argmax(coord.separation(CENTER)), 1.02 * small.field_radius
    star = CENTER.directional_offset_by(CENTER.position_angle(coord[k]), edge)
    radius = (star.separation(coord[k]) * 1.01).to_value(u.arcsec)
    assert radius > (edge - small.field_radius).to_value(u.arcsec)
    n = len(sky)
    more = rs.Catalog(
        SkyCoord([*sky.coord.ra, star.ra], [*sky.coord.dec, star.dec]),
        kind=np.append(sky.kind, "science"),
        extra=QTable({"mag": np.append(np.full(n, 15.0), 8.0)}),
    )
    for allocator in ("nearest", "repair"):
        tile = plan(more, small, BrightStars("mag", [(9, radius)]), allocator)
        assert free["target_id"][k] not in tile.table["target_id"].compressed()


@pytest.mark.filterwarnings("ignore:.*no allocator honors it")
@pytest.mark.filterwarnings("ignore:the rules on the distribution of fibers cost")
def test_rules_of_a_tile_are_kept_in_files(sky, small, tmp_path):
    tile = plan(sky, small, ["magnitude mag 12 inf", "sky=5", "distribution sky 2 99.9 3"])
    assert tile.rules["verdict"].tolist() == ["pass", "pass", "fail"]
    assert tile.rules["rule"].tolist() == [
        "sky=5",
        "magnitude mag 12.0 inf '' '' allowed",
        "distribution sky 2 99.9 3.0 ''",
    ]
    assert any(text.startswith("distribution sky 2 99.9 3.0 ''") for text in tile.summary["unmet"])
    for name in ("tile.fits", "tile.ecsv"):
        tile.write(tmp_path / name)
        assert rs.Tile.read(tmp_path / name).rules.pformat() == tile.rules.pformat()
    violating = tile.rules["fibers"][2].split()
    assert set(violating) <= set(tile.table["id"].astype(str))
    assert len(violating) == round((1 - tile.rules["number"][2] / 100) * (tile.table["kind"] == "science").sum())


@pytest.mark.filterwarnings("ignore:.*no allocator honors it")
def test_the_order_on_the_slit_is_not_known_in_a_plan_of_targets(sky, small):
    tile = plan(sky, small, Contrast("mag", 5.0))
    assert tile.rules["verdict"].tolist() == ["not checkable"]
    assert "unmet" in tile.summary
    assert tile.summary["unmet"] == []


@pytest.mark.filterwarnings("ignore:.*no allocator honors it")
def test_rules_of_an_instrument_are_constraints_of_a_plan():
    apo = rs.Instrument.preset("sdss_apo")
    sky = rs.synthetic_catalog("uniform", CENTER, 1.4 * u.deg, n_targets=900, rng=1)
    rng = np.random.default_rng(2)
    extra = QTable({band: rng.uniform(14, 20, len(sky)) for band in ("g", "r", "i", "gaia_g", "h")})
    kind = rng.choice(["science", "standard", "sky"], len(sky), p=[0.6, 0.2, 0.2])
    sky = rs.Catalog(sky.coord, kind=kind, fiber_type=rng.choice(["BOSS", "APOGEE"], len(sky)), extra=extra)
    one = rs.plan_tile(sky, apo, CENTER, allocator=rs.AllocationOptions("repair", rules="dark_monit"))
    other = flat.plan_tile(sky, apo, CENTER, "repair", constraints=apo.rules("dark_monit"))
    assert one.rules.pformat() == other.rules.pformat()
    assert (one.table["target_id"] == other.table["target_id"]).all()
    assert len(one.rules) == 16
    boss = one.table[(one.table["fiber_type"] == "BOSS") & (one.table["kind"] == "science")]
    assert len(boss) > 10
    assert min(boss["g"].min(), boss["r"].min(), boss["i"].min()) > 16


@pytest.mark.filterwarnings("ignore:no target of the catalog is")
@pytest.mark.parametrize("others", [[], ["distribution sky 1 50 100"]])
def test_targets_without_a_fiber_type_follow_the_rules_of_the_fiber_that_they_get(others):
    """The preset gives them a BOSS fiber; whether rules use positions on the focal plane makes no difference."""
    apo = rs.Instrument.preset("sdss_apo")
    sky = rs.synthetic_catalog("uniform", CENTER, 1.4 * u.deg, n_targets=300, rng=1)
    sky = rs.Catalog(sky.coord, extra=QTable({"h": np.random.default_rng(2).uniform(5, 15, len(sky))}))
    for fiber, least in (("BOSS", 10), ("APOGEE", 0)):
        allocator = rs.AllocationOptions("repair", constraints=[f"magnitude h 10 inf science {fiber}", *others])
        mags = rs.plan_tile(sky, apo, CENTER, allocator=allocator).table["h"]
        assert np.nanmin(mags) > least
        assert least or np.nanmin(mags) < 10


WRONG_RULES = [
    ("magnitude mag 17 12", "the brightest magnitude of 'mag' must be smaller than the faintest magnitude 12, got 17"),
    ("magnitude mag x 12", "the constraint must have the form 'magnitude COLUMN BRIGHTEST FAINTEST"),
    ("magnitude mag nan 12", "the brightest magnitude of 'mag' must be a number, got nan"),
    ("magnitude mag 1 12 science '' never", "unknown treatment of missing magnitudes 'never'"),
    ("magnitude gag 12 17", "the catalog must have the column 'gag', but its further columns are: mag, word"),
    ("magnitude word 12 17", "the column 'word' must contain magnitudes, got values of the type str"),
    ("magnitude mag 12 17 science BOSS", "'BOSS'"),
    ("bright_stars gag 8:60", "the catalog must have the column 'gag'"),
    ("bright_stars mag 8:60,7:10", "must have ascending magnitudes and radii of at least 0, got '8:60,7:10'"),
    ("bright_stars mag 8:-60", "must have ascending magnitudes and radii of at least 0"),
    ("bright_stars mag sdssv_dim:12", "the radius around bright stars must be a table such as '8:60,12:10'"),
    ("bright_stars mag sdssv_dark:nan", "the radius around bright stars must be a table such as '8:60,12:10'"),
    ("bright_stars mag 8:60 '' nowhere.ecsv", "nowhere.ecsv"),
    ("distribution sky 0 95 75", "k of a distribution must be"),
    ("distribution sky 1 101 75", "percent of a distribution must be a number from 0 to 100, got 101"),
    ("distribution sky 1 95 inf", "distance_mm of a distribution must be a number from 0 to 1e"),
    ("contrast mag -1", "the largest contrast must be a number from 0 to 1000, got -1"),
]


@pytest.mark.parametrize(("text", "message"), WRONG_RULES)
def test_wrong_rules_get_one_sentence(text, message, sky, small):
    sentence = refused("", plan, sky, small, text)
    assert message in sentence
    assert "\n" not in sentence


def test_rules_of_another_instrument_get_one_sentence(sky, small):
    own, other = rs.AllocationOptions(rules="dark_rm"), rs.AllocationOptions(rules="dark_mm")
    words = "the instrument must have rules of the name 'dark_rm', but"
    refused(words, rs.plan_tile, sky, small, CENTER, allocator=own)
    words = "unknown name of rules of sdss_apo 'dark_mm'; choose one of: bright_time, dark_faint"
    refused(words, rs.plan_tile, sky, "sdss_apo", CENTER, allocator=other)
    words, xy = "rules='dark_rm' can be used only with an instrument; use plan_tile", [[0, 0]] * u.mm
    refused(words, rs.allocate, small.focal_plane, xy, allocator=own)
    refused("describes random configurations, not one field", rs.collision_probability, "sdss_apo", allocator=own)
    limits = rs.AllocationOptions(constraints="magnitude mag 1 2")
    words = "constraints can be used only with a catalog, got 'magnitude"
    refused(words, rs.allocate, small.focal_plane, xy, allocator=limits)


def test_a_function_of_radii_must_return_radii(sky, small):
    for function in (lambda m: -m, lambda m: m[:-1], lambda m: np.full(len(m), np.nan)):
        with pytest.raises(rs.InputError, match="the radii around stars must be finite numbers"):
            plan(sky, small, BrightStars("mag", function))


def test_texts_of_rules_can_be_read():
    for text in (
        "magnitude h 7.0 inf science APOGEE allowed",
        "contrast h 5.0 APOGEE fiberId",
        "distribution sky 1 95.0 75.0 BOSS",
        "bright_stars gaia_g sdssv_dark:16 BOSS",
    ):
        (one,) = as_constraints(text)
        assert str(one) == text
    assert str(rs.Requirement("magnitude", 3)) == "'magnitude'=3"


def test_an_unknown_kind_of_magnitude_limits_has_a_hint(sky, small):
    with pytest.warns(rs.RfpsurveyWarning, match="no target of the catalog is 'standards', but the rule .*'standard'?"):
        tile = plan(sky, small, ["magnitude mag 0 30 standards"])
    assert tile.rules["verdict"].tolist() == ["not checkable"]
    assert tile.rules["note"][0] == "no fiber has such a target; did you mean 'standard'?"


@pytest.mark.parametrize("allocator", ["repair", "optimal", "lamost_rule"])
def test_limits_of_a_role_take_only_this_role_from_a_science_target(sky, small, allocator):
    """A science target that is too faint as a standard star is only a science target."""
    rng = np.random.default_rng(5)
    kind = rng.choice(["science", "science+standard", "science+standard", "standard"], len(sky))
    catalog = rs.Catalog(sky.coord, id=sky.id, kind=kind, extra=sky.extra)
    mag = catalog.arrays.extra["mag"]
    limits, needs = "magnitude mag 9.5 14 standard", "standard=20"
    tile = plan(catalog, small, [limits, needs], allocator)
    table = tile.table[tile.table["status"] == "assigned"]
    rows, kinds = np.asarray(table["target_id"]), np.asarray(table["kind"]).astype(str)
    fits = ~((mag <= 9.5) | (mag >= 14)) | np.isin(mag, MISSING[1:])  # targets without a magnitude have no limits
    assert kinds.tolist() == np.where(fits, kind, np.char.replace(kind, "+standard", ""))[rows].tolist()
    assert not ((kind == "standard") & ~fits)[rows].any()
    assert (kinds != kind[rows]).any()  # some science targets are too faint or too bright as standards
    n = int(np.sum(np.char.find(kinds, "standard") >= 0))
    assert tile.summary["kinds"]["standard"]["n_assigned"] == n
    assert dict(zip(tile.completeness["kind"], tile.completeness["n_assigned"], strict=True))["standard"] == n
    assert not tile.summary["unmet"]
    assert {one["verdict"] for one in tile.rules} == {"pass"}
    score = rs.score_tile(tile.table, small, constraints=[limits, needs])
    assert {one["verdict"] for one in score.rules} == {"pass"}
    # of a rule on science, the target is excluded
    plain = plan(catalog, small, ["magnitude mag 9.5 14 science"], allocator)
    assert fits[with_fiber(plain, catalog)].all()
    table["kind"] = kind[rows]  # a finished plan states which fibers are standards
    scored = {one["rule"]: one["number"] for one in rs.score_tile(table, small, constraints=[limits, needs]).rules}
    standard = np.char.find(kind[rows], "standard") >= 0
    assert list(scored.values()) == [standard.sum(), (standard & ~fits[rows]).sum()]


def test_limits_of_standards_do_not_exclude_sky_positions(sky, small):
    kind = np.where(np.arange(len(sky)) % 2, "standard+sky", "science")
    catalog = rs.Catalog(sky.coord, id=sky.id, kind=kind, extra=sky.extra)
    tile = plan(catalog, small, ["magnitude mag 30 31 standard", "sky=20"], "repair")
    assert not tile.summary["unmet"]
    assigned = tile.table[tile.table["status"] == "assigned"]
    known = np.asarray(assigned["target_id"]).astype(int) >= 60  # the magnitudes of the first targets are missing
    assert {"sky", "science"} == set(assigned["kind"][known].tolist())
    assert {"sky", "science", "standard+sky"} >= set(assigned["kind"].tolist())
