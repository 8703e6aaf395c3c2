"""The rule on guide stars, compared with an independent projection and with the published frames of the cameras."""

import re
import warnings
from dataclasses import replace

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.table import QTable, Table
from configurations import places, stars_around
from own_instrument import description, hexagon
from raising import refused, warned
from shapely import Point, Polygon

import flat
import rfpsurvey as rs
from rfpsurvey._assignment.constraints.stars import distances
from rfpsurvey.constraints import GuideStars

CENTER = SkyCoord("6h20m +23d")
HALF = 13.5e-3 * 1024
SCALE = 'plate_scale = { value = 200.0, unit = "mm / deg" }'
SQUARE = [[-2.0, -2.0], [2.0, -2.0], [2.0, 2.0], [-2.0, 2.0]]


def counts_of(coord, m, center, angle_deg, real_data, low, high):
    """Return the number of stars between two magnitudes in each square of the published table of cameras."""
    model = Table.read(real_data("sdssv_apo_2024/focalPlaneModel.csv"), format="ascii.csv", comment="#")
    cameras = Table.read(real_data("sdssv_apo_2024/gfaCoords.csv"), format="ascii.csv")
    x, y = places(coord, center, angle_deg, model)
    found = []
    for one in cameras:
        dx, dy = x - one["xWok"], y - one["yWok"]
        on = (np.abs(dx * one["ix"] + dy * one["iy"]) < HALF) & (np.abs(dx * one["jx"] + dy * one["jy"]) < HALF)
        found.append(int((on & (m > low) & (m < high)).sum()))
    return found


@pytest.mark.filterwarnings("ignore:guide_stars")
@pytest.mark.parametrize("second", [False, True])
def test_numbers_on_the_cameras_of_sdssv_equal_an_independent_computation(second, real_data):
    """Stars on the outer half of the cameras are beyond the largest field angle of the preset, and count."""
    stars, apo = stars_around(CENTER), rs.Instrument.preset("sdss_apo")
    rule = GuideStars("gaia_g", 12, 17.5, 1, stars=stars if second else None)
    tile = flat.plan_tile(stars, apo, CENTER, "nearest", constraints=rule, position_angle=31 * u.deg)
    expected = counts_of(stars.coord, stars.extra["gaia_g"], CENTER, 31, real_data, 12, 17.5)
    assert min(expected) > 2
    assert tile.rules["note"][0] == ", ".join(f"gfa{k} has {n}" for k, n in enumerate(expected, 1))
    assert (tile.rules["number"][0], tile.rules["verdict"][0]) == (min(expected), "pass")


@pytest.mark.filterwarnings("ignore:.*guide_stars")
def test_the_number_of_a_maximum_is_that_of_the_camera_with_the_most_stars(real_data, presets):
    stars = stars_around(CENTER)
    expected = counts_of(stars.coord, stars.extra["gaia_g"], CENTER, 0, real_data, 12, 17.5)
    assert len({*expected}) > 2
    for minimum, maximum, verdict in ((0, max(expected), "pass"), (1, min(expected), "fail")):
        rule = GuideStars("gaia_g", 12, 17.5, minimum, maximum)
        tile = flat.plan_tile(stars, presets["sdss_apo"], CENTER, "nearest", constraints=rule)
        assert (tile.rules["number"][0], tile.rules["verdict"][0]) == (max(expected), verdict)


def test_a_recorded_configuration_is_checked_with_a_catalog_of_stars(real_data):
    """Without such a catalog or without the field center, the rule is not checkable."""
    plan, apo = rs.plans.read_plan(real_data("sdssv_apo_2021/confSummary-998.par.gz")), rs.Instrument.preset("sdss_apo")
    center = SkyCoord(plan.meta["racen"], plan.meta["deccen"], unit="deg")
    stars = stars_around(center, 1500)
    expected = counts_of(
        stars.coord, stars.extra["gaia_g"], center, plan.meta["position_angle"], real_data, -np.inf, 19
    )
    rule = GuideStars("gaia_g", -np.inf, 19, 5, stars=stars)
    given = {"positions": "sky", "center": center, "position_angle": plan.meta["position_angle"] * u.deg}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", rs.RfpsurveyWarning)
        found = rs.score_tile(plan, apo, constraints=rule, **given).rules[0]
        numbers = dict(re.findall(r"(gfa\d) has (\d+)", found["note"]))
        for name, n in numbers.items():
            assert int(n) == expected[int(name[3]) - 1]
        assert (found["number"], found["verdict"]) == (min(expected), "pass" if min(expected) >= 5 else "fail")
        for rules, more in ((apo.rules("guiding"), given), ([rule], {})):
            found = rs.score_tile(plan, apo, constraints=rules, **more).rules[0]
            assert found["verdict"] == "not checkable"
            assert np.isnan(found["number"])


def test_the_presets_have_the_published_cameras(real_data, presets):
    for row in Table.read(real_data("sdssv_apo_2024/gfaCoords.csv"), format="ascii.csv"):
        corners = presets["sdss_apo"].cameras[f"gfa{row['id']}"]
        center, i, j = ([row[f"{a}{b}"] for b in c] for a, c in (("", ("xWok", "yWok")), ("i", "xy"), ("j", "xy")))
        inside = (corners - center) @ np.array([i, j]).T
        np.testing.assert_allclose(np.abs(inside), HALF, atol=2e-3)
        assert len({tuple(np.sign(one)) for one in inside}) == 4
        assert np.abs(presets["sdss_lco"].cameras[f"gfa{row['id']}"] - corners).max() < 2


def test_the_cameras_of_pfs_are_squares_around_the_field(presets):
    """They have sides of 13.312 mm, and their centers are 241.292 mm from the field center, every 60 degrees."""
    for k, corners in enumerate(presets["pfs"].cameras.values()):
        center = corners.mean(axis=0)
        np.testing.assert_allclose(np.hypot(*(np.roll(corners, -1, axis=0) - corners).T), 13.312, atol=2e-3)
        np.testing.assert_allclose(np.hypot(*center), 241.292, atol=1e-3)
        assert np.rad2deg(np.arctan2(*center[::-1])) % 360 == pytest.approx(30 + 60 * k, abs=1e-3)


@pytest.fixture(scope="module")
def one():
    """Return an instrument with a square camera of 4 mm, 0.4 deg north of the field center."""
    plane = rs.FocalPlane.hexagonal(rs.Positioner(8.25 * u.mm, 8.25 * u.mm, 2.25 * u.mm), rings=2, pitch=25.6 * u.mm)
    corners = (np.array(SQUARE) + [0, 80]).tolist()
    entry = {"value": corners, "unit": "mm", "status": "assumed", "source": "a test"}
    return rs.Instrument("one", plane, plate_scale=200 * u.mm / u.deg, values={"cameras.north": entry})


def catalog(dy_mm, mags):
    """Return a target near the center, and stars north of the center at distances from the center of the camera."""
    dec = 23 + np.rad2deg(np.arctan(np.deg2rad((80 + np.array([-75, *dy_mm])) / 200)))
    extra = QTable({"g": np.array([20.0, *mags])})
    return rs.Catalog(SkyCoord(np.full(len(dec), 95.0), dec, unit="deg"), extra=extra)


def rules_of(sky, one, rule):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        tile = rs.plan_tile(sky, one, CENTER, allocator=rs.AllocationOptions("nearest", constraints=rule))
    return tile, [str(w.message) for w in caught]


VIOLATIONS = [
    ([0], [12], "guide_stars g 10 15 1", 1, "pass", "north has 1"),
    ([0, 1], [12, 15], "guide_stars g 10 15 1 1 north", 1, "pass", "north has 1"),
    ([5], [12], "guide_stars g 10 15 1", 0, "fail", "north has 0 (the next star is 3 mm away from it)"),
    (
        [0, 1, -4.5],
        [15, 9.5, 11],
        "guide_stars g 10 15 2",
        0,
        "fail",
        "north has 0 (the next star is 2.5 mm away from it and the next star on it has magnitude 15)",
    ),
    ([0], [np.nan], "guide_stars g 10 15 2", 0, "fail", "north has 0 (no other star is known)"),
    ([0, 1], [7.9, 8.1], "guide_stars g -inf 8 0 0", 1, "fail", "north has 1 (magnitudes 7.9)"),
    ([0, 1], [8, 8.1], "guide_stars g -inf 8 0 0", 0, "pass", "north has 0"),
    ([0, 1, -1], [8, 8.1, 9], "guide_stars g 7 15 1 2", 3, "fail", "north has 3 (magnitudes 8, 8.1, 9)"),
]


@pytest.mark.parametrize(("dy", "mags", "rule", "number", "verdict", "text"), VIOLATIONS)
def test_a_violation_is_stated_before_fibers_are_assigned(dy, mags, rule, number, verdict, text, one):
    """The sentence states how close a camera is to the limits; plans and their files contain the same verdict."""
    seen = []

    def allocate(problem):
        seen.extend(str(w.message) for w in caught)
        return rs.allocation.AllocationAnswer(np.full(len(problem.focal_plane), -1))

    tile, told = rules_of(catalog(dy, mags), one, rule)
    row = tile.rules[0]
    assert (row["number"], row["verdict"], row["note"]) == (number, verdict, text)
    assert [text in sentence for sentence in told] == [True] * (verdict == "fail")
    assert [text in sentence for sentence in tile.summary["unmet"]] == [True] * (verdict == "fail")
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        rs.plan_tile(catalog(dy, mags), one, CENTER, allocator=rs.AllocationOptions(allocate, constraints=rule))
    assert sum(text in sentence for sentence in seen) == (verdict == "fail")


def test_a_star_with_several_rows_counts_once(one):
    """Catalogs of SDSS-V have a row for each fiber type of a target."""
    tile, _ = rules_of(catalog([0, 0, 1], [12, 12, 12]), one, "guide_stars g 10 15 1")
    assert tile.rules["number"].tolist() == [2]


def test_distances_from_polygons_equal_those_of_shapely():
    """Polygons can be concave, can have any orientation, and can be closed."""
    rng = np.random.default_rng(5)
    for n in (3, 4, 7):
        turn = np.sort(rng.uniform(0, 2 * np.pi, n))
        corners = rng.uniform(2, 9, n)[:, None] * np.column_stack([np.cos(turn), np.sin(turn)])
        points = rng.uniform(-12, 12, (300, 2))
        for given in (corners, corners[::-1], np.vstack([corners, corners[:1]])):
            expected = [Polygon(corners).distance(Point(point)) for point in points]
            np.testing.assert_allclose(distances(points, given), expected, atol=1e-9)
    assert np.isinf(distances(np.array([[np.nan, 0.0]]), corners)).all()


def test_a_catalog_without_magnitudes_is_not_checkable(one):
    tile, told = rules_of(rs.Catalog(CENTER[None], extra=QTable({"g": [np.nan]})), one, "guide_stars g 10 15 1")
    assert tile.rules["verdict"].tolist() == ["not checkable"]
    assert not told


def test_refraction_moves_stars_onto_a_camera(one):
    """The stars of a tile with observing conditions are where the targets of this tile are."""
    sky, rule = catalog([2.0 - 1e-4], [12]), "guide_stars g 10 15 1"
    assert rules_of(sky, one, rule)[0].rules["verdict"][0] == "pass"
    at = rs.ObservingConditions("kitt peak", hour_angle=5 * u.hourangle, wavelength=0.4 * u.um)
    asked = rs.AllocationOptions(constraints=rule)
    warned("north has 0", rs.plan_tile, catalog([2.2], [12]), one, CENTER, allocator=asked)
    tile = rs.plan_tile(catalog([2.02], [12]), one, CENTER, conditions=at, allocator=asked)
    assert tile.rules["verdict"][0] == "pass"


@pytest.mark.parametrize("in_folder", [False, True])
def test_a_survey_names_the_tiles_without_guide_stars(in_folder, one, tmp_path):
    """The first warning names the tiles before they are planned; their counts are in the table of tiles."""
    sky, folder = catalog([0], [12]), tmp_path / "survey" if in_folder else None
    tiles = SkyCoord([95, 95, 95.1], [23, 23.02, 23], unit="deg")
    allocator = rs.AllocationOptions("nearest", constraints="guide_stars g 10 15 1")
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        survey = rs.plan_survey(sky, one, tiles, allocator=allocator, folder=folder)
    told = [str(w.message) for w in caught]
    assert told[0].startswith(
        "2 of 3 tiles (1, 2) cannot meet a constraint, whichever targets they observe; tile 1: guide_stars g 10.0 15.0 "
        "1: 0 (at least 1 star fainter than 10 and brighter than 15 on each camera); north has 0 (the next star is 2 mm"
    )
    rule = "guide_stars g 10.0 15.0 1"
    assert survey.tiles["unmet"].tolist() == ["", f"{rule}: 1 violation", f"{rule}: 1 violation"]
    assert any(f"constraint {rule}: 2 violations in 2 of 3 tiles (1, 2)" in text for text in told)
    if in_folder:  # a finished survey is read, and its fields are not checked again
        with pytest.warns(rs.RfpsurveyWarning, match="2 violations") as caught:
            rs.plan_survey(sky, one, tiles, allocator=allocator, folder=folder, resume=True)
        assert not any("cannot meet" in str(w.message) for w in caught)


WRONG_RULES = [
    ("guide_stars g 15 10 1", "the brightest magnitude of 'g' must be smaller than the faintest magnitude 10"),
    ("guide_stars g 10 15", "the constraint must have the form 'guide_stars COLUMN BRIGHTEST FAINTEST MINIMUM"),
    ("guide_stars g 10 15 0", "guide stars must have a minimum above 0 or a maximum, got neither"),
    ("guide_stars g 10 15 -1", "the minimum of guide stars must be a whole number of at least 0, got -1"),
    ("guide_stars g 10 15 3 2", "the maximum of guide stars must be a whole number of at least 3, or inf, got 2"),
    ("guide_stars g 10 15 1 1.5", "the maximum of guide stars must be a whole number of at least 1, or inf"),
    ("guide_stars gg 10 15 1", "the catalog must have the column 'gg'"),
    ("guide_stars g 10 15 1 inf south", "unknown camera of one 'south'; choose one of: north"),
    ("guide_stars g 10 15 1 inf north nowhere.ecsv", "nowhere.ecsv"),
]


@pytest.mark.parametrize(("text", "message"), WRONG_RULES)
def test_wrong_rules_get_one_sentence(text, message, one):
    assert message in refused("", rules_of, catalog([0], [12]), one, text)


def test_an_instrument_without_cameras_is_refused(one):
    with pytest.raises(rs.InputError, match="needs cameras, but one has none; describe them in the section"):
        rules_of(catalog([0], [12]), replace(one, values={}), "guide_stars g 10 15 1")


WRONG_CAMERAS = [
    (SQUARE, '"mm"', None),
    ([[0, 0], [0.1, 0], [0, 0.1]], '"cm"', None),
    ([[0, 0], [1, 1], [2, 2]], '"mm"', "cameras.north must be the corners of a camera, which are at least three"),
    ([[0, 0], [1, 1]], '"mm"', "cameras.north must be the corners of a camera"),
    (SQUARE, '"deg"', "the unit of cameras.north must be convertible to mm"),
]


@pytest.mark.parametrize(("value", "unit", "message"), WRONG_CAMERAS)
def test_cameras_of_a_file_are_validated(value, unit, message, tmp_path):
    path = tmp_path / "one.toml"
    camera = f"[cameras]\nnorth = {{ value = {value}, unit = {unit} }}\n"
    path.write_text(description((8.25, 8.25), 2.25, hexagon(2, 25.6), SCALE, end=camera))
    if message is None:
        corners = rs.Instrument.read(path).cameras["north"]
        np.testing.assert_allclose(corners, np.array(value) * (10 if unit == '"cm"' else 1))
    else:
        refused(re.escape(message), rs.Instrument.read, path)
