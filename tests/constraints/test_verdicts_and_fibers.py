"""Verdicts on plans that disagreed with their fibers, and inputs that were used in another meaning."""

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.table import QTable
from raising import refused

import rfpsurvey as rs
from scenes import two_fibers

CENTER = SkyCoord("6h20m +23d")


@pytest.fixture(scope="module")
def stars():
    return rs.synthetic_catalog("uniform", CENTER, 1.4 * u.deg, n_targets=300, rng=1)


@pytest.mark.parametrize("allocator", ["repair", "optimal"])
@pytest.mark.parametrize("constraints", [["sky=20", "sky@BOSS=-30"], ["sky@BOSS=20-40", "distribution sky 1 95 75"]])
def test_added_sky_positions_count_toward_the_fiber_type_that_observes_them(stars, constraints, allocator):
    """Regression: the maximum of a fiber type did not count added sky positions that require no type."""
    options = rs.AllocationOptions(allocator, constraints=constraints, sky_separation=5 * u.arcsec)
    tile = rs.plan_tile(stars, "sdss_apo", CENTER, allocator=options)
    table = tile.table[tile.table["status"] == "assigned"]
    for one in (rs.Requirement.parse(text) for text in constraints if "=" in text):
        fits = (table["kind"] == one.what) & ((table["fiber_type"] == one.fiber_type) | (one.fiber_type == ""))
        assert one.minimum <= fits.sum() <= (np.inf if one.maximum is None else one.maximum)
        assert tile.rules["number"][tile.rules["rule"] == str(one)][0] == fits.sum()


def test_targets_without_a_fiber_type_count_by_the_fiber_that_observes_them(stars):
    tile = rs.plan_tile(stars, "sdss_apo", CENTER, allocator=rs.AllocationOptions(requirements="science@BOSS=5"))
    assert tile.rules["number"][0] == tile.summary["n_assigned"]
    # without an image of the sky for each fiber type, targets do not receive a type before they are assigned
    plane = two_fibers()
    both, near = rs.Instrument("both", plane, plate_scale=200 * u.mm / u.deg), stars[:60].coord
    near = CENTER.directional_offset_by(CENTER.position_angle(near), CENTER.separation(near) / 4)
    for name in ("A", "B"):
        tile = rs.plan_tile(
            rs.Catalog(near), both, CENTER, allocator=rs.AllocationOptions(requirements=f"science@{name}=5")
        )
        first = np.array([types[0] for types in plane.fiber_type]) == name
        assert tile.rules["number"][0] == (first & (tile.table["status"] == "assigned")).sum() > 5


@pytest.mark.parametrize("allocator", ["nearest", "optimal"])
def test_a_required_target_without_a_fiber_fails(allocator):
    """Regression: the verdict on required targets was "pass" if they were in the field and had no fiber."""
    places = SkyCoord([95.0, 95.0] * u.deg, [23.0, 23.0001] * u.deg)
    plane = rs.FocalPlane([[0, 0]] * u.mm, rs.Positioner(8.25 * u.mm, 8.25 * u.mm, 2.25 * u.mm))
    alone = rs.Instrument("alone", plane, plate_scale=200 * u.mm / u.deg)
    options = rs.AllocationOptions(allocator, required=[1, 2])
    tile = rs.plan_tile(rs.Catalog(places, id=[1, 2]), alone, places[0], allocator=options)
    assert [tile.rules[name][0] for name in ("number", "verdict")] == [1, "fail"]


@pytest.mark.parametrize("name", [-1, 7, "", "star"])
def test_added_sky_positions_in_the_circle_of_a_star_with_any_identifier(stars, name):
    """Regression: added sky positions were in the circle of a star with the identifier -1 or an empty identifier."""
    ids = np.arange(300) + 100 if isinstance(name, int) else np.array([f"s{k}" for k in range(300)])
    magnitude = np.full(300, 19.0)
    ids[0], magnitude[0] = name, 8.0
    sky = rs.Catalog(stars.coord, id=ids, extra=QTable({"g": magnitude}))
    constraints = ["sky=200", "bright_stars g 8:1500,10:1500"]
    options = rs.AllocationOptions("repair", constraints=constraints, sky_separation=5 * u.arcsec)
    tile = rs.plan_tile(sky, "sdss_apo", sky.coord[0], allocator=options)
    table = tile.table[(tile.table["status"] == "assigned") & (tile.table["kind"] == "sky")]
    assert len(table) > 20
    assert (SkyCoord(table["ra"], table["dec"]).separation(sky.coord[0]) > 1500 * u.arcsec).all()


def test_a_survey_is_not_resumed_with_other_stars_in_the_file(stars, tmp_path):
    """Regression: only the path of the stars was recorded."""
    options = {"folder": tmp_path / "survey", "visits": 1}
    tiles = SkyCoord([95.0, 95.4] * u.deg, [23.0, 23.0] * u.deg)
    for k in range(2):
        near = stars.coord[k::9]
        table = QTable({"ra": near.ra, "dec": near.dec, "g": np.full(len(near), 8.0)})
        table.write(tmp_path / "stars.ecsv", overwrite=True)
        rule = f"bright_stars g 8:30,9:30 '' {tmp_path / 'stars.ecsv'}"
        asked = rs.AllocationOptions("nearest", constraints=rule)
        if k:
            with pytest.raises(rs.InputError, match="stars differs"):
                rs.plan_survey(stars, "sdss_apo", tiles, allocator=asked, resume=True, **options)
        else:
            rs.plan_survey(stars, "sdss_apo", tiles, allocator=asked, **options)
            rs.plan_survey(stars, "sdss_apo", tiles, allocator=asked, resume=True, **options)


@pytest.mark.parametrize("radii", [(720.0, 0.0), (0.0, 720.0)])
def test_constraints_with_the_same_text(small, radii):
    """Regression: the violations of one of two constraints with the same text were lost."""
    star = rs.Catalog(CENTER[None], extra=QTable({"g": [8.0]}))
    targets = rs.Catalog(CENTER.directional_offset_by([0, 120, 240] * u.deg, 0.3 * u.deg))

    def make(radius):
        return rs.constraints.BrightStars("g", lambda m: np.full(m.shape, radius), stars=star, idle="counted")

    rules = [make(radius) for radius in radii]
    assert len({str(rule) for rule in rules}) == 1
    options = rs.AllocationOptions("nearest", constraints=rules)
    tile = rs.plan_tile(targets, small, CENTER, allocator=options)
    # 720 arcsec are 40 mm: seven idle fibers, in the center and at a distance of 25.6 mm from it
    assert tile.rules["number"].tolist() == [7 if radius else 0 for radius in radii]
    assert [text.removeprefix(str(rules[0])) for text in tile.summary["unmet"]] == [
        ": 7 (no fiber in the circle of a star)"
    ]
    with pytest.warns(rs.RfpsurveyWarning, match="counted: 1 violation in 1 of 1 tile"):
        survey = rs.plan_survey(targets, small, CENTER[None], allocator=options)
    assert (survey.tiles["n_unmet"][0], survey.rules["fail"].tolist()) == (1, [1])


@pytest.mark.parametrize("unit", ["nJy", "mm"])
def test_a_column_with_another_unit_is_no_magnitude(stars, unit):
    """Regression: values in nJy were used as magnitudes."""
    table = QTable({"ra": stars.coord.ra, "dec": stars.coord.dec, "g": np.full(300, 17.0) * u.Unit(unit)})
    options = rs.AllocationOptions("nearest", constraints="magnitude g 12 18 science")
    with pytest.raises(rs.InputError, match=f"'g' must contain magnitudes, got values with the unit {unit}"):
        rs.plan_tile(rs.Catalog.from_table(table, keep=["g"]), "sdss_apo", CENTER, allocator=options)
    with pytest.raises(rs.InputError, match="must contain magnitudes"):
        rs.constraints.BrightStars("g", [(8, 60)], stars=rs.Catalog.from_table(table, keep=["g"]))
    table["g"] = np.full(300, 17.0) * u.mag
    rs.plan_tile(rs.Catalog.from_table(table, keep=["g"]), "sdss_apo", CENTER, allocator=options)


def test_a_radius_that_fails_names_the_constraint():
    """Regression: the exception of a function for radii was raised without the constraint."""
    rule = rs.constraints.BrightStars("g", lambda m: 1 / 0)
    refused(r"bright_stars .* failed: ZeroDivisionError", rs.AllocationOptions, constraints=[rule])


def test_a_tile_of_a_survey_with_priorities_and_added_sky_positions_is_scored(stars):
    """Regression: added sky positions, which have no priority, were refused."""
    sky = rs.Catalog(stars.coord, priority=np.arange(300) % 3)
    options = rs.AllocationOptions("repair", requirements="sky=20", sky_separation=5 * u.arcsec)
    survey = rs.plan_survey(sky, "sdss_apo", CENTER[None], allocator=options)
    found = rs.score_tile(survey.tile(0), "sdss_apo", center=CENTER, position_angle=0 * u.deg, constraints="sky=20")
    assert found.summary["n_assigned"] == len(survey.tile(0))


def test_stuck_fibers_on_sky_count_in_the_score_of_a_tile():
    """Regression: the score of a tile did not count the sky fibers of stuck positioners, unlike its plan."""
    robot, angles = rs.Positioner(8 * u.mm, 17 * u.mm, 1 * u.mm), np.full((19, 2), np.nan)
    angles[[0, 5]] = [[30, 100], [50, 60]]
    plane = rs.FocalPlane.hexagonal(robot, rings=2, pitch=26 * u.mm)
    plane = rs.FocalPlane(plane.xy, robot, stuck=angles * u.deg)
    instrument = rs.Instrument("toy", plane, plate_scale=0.05 * u.mm / u.arcsec)
    sky = rs.synthetic_catalog("uniform", CENTER, instrument.field_radius, n_targets=30, rng=0)
    options = rs.AllocationOptions("optimal", requirements="sky=2-2", sky_separation=3 * u.arcsec)
    tile = rs.plan_tile(sky, instrument, CENTER, allocator=options)
    assert ((tile.table["status"] == "stuck") & (tile.table["kind"] == "sky")).sum() == 2
    found = rs.score_tile(tile.table, instrument, constraints="sky=2-2")
    assert [one["number"] for one in (tile.rules[0], found.rules[0])] == [2, 2]
    assert found.summary["n_assigned"] == tile.summary["n_assigned"]


@pytest.mark.parametrize("allocator", ["repair", "optimal"])
@pytest.mark.filterwarnings("ignore:.*same id")
def test_all_rows_of_a_required_target_must_have_a_fiber(allocator):
    """Regression: if one of two rows with the same identifier had a fiber, the verdict was "pass"."""
    robot = rs.Positioner(8.25 * u.mm, 8.25 * u.mm, 2.25 * u.mm)
    plane = rs.FocalPlane([[0, 0], [25.6, 0]] * u.mm, robot)
    model = rs.Instrument("pair", plane, plate_scale=200 * u.mm / u.deg)
    center = SkyCoord(95 * u.deg, 23 * u.deg)
    options = rs.AllocationOptions(allocator, required=["a"])
    for x, ids, expected in (([3, 5], "aa", "fail"), ([3, 5], "ab", "pass"), ([3, 35], "aa", "pass")):
        places = center.directional_offset_by(90 * u.deg, x * u.mm / (200 * u.mm / u.deg))
        tile = rs.plan_tile(rs.Catalog(places, id=list(ids)), model, center, allocator=options)
        assert (tile.rules["verdict"].tolist(), bool(tile.summary["unmet"])) == ([expected], expected == "fail")
