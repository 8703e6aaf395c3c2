"""Models of the projection, the choice among them, and tiles under observing conditions."""

from dataclasses import replace
from itertools import pairwise

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.time import Time
from raising import refused

import rfpsurvey as rs
from rfpsurvey._instruments.compare_projections import choose_projection
from rfpsurvey._sky.conditions import MODELS
from rfpsurvey.observing import ObservedField
from rfpsurvey.projection import FieldProjection

CENTER = SkyCoord(95 * u.deg, 23 * u.deg)
WAVES = {"BOSS": 0.54 * u.um, "APOGEE": 1.6 * u.um}


def conditions_at(hours=3.0, **changes):
    given = {"hour_angle": hours * u.hourangle, "wavelength": WAVES, "exposure_time": 15 * u.min, **changes}
    given = {"guide_wavelength": WAVES["BOSS"], **given}
    return rs.ObservingConditions("apache point", **given)


@pytest.fixture(scope="module")
def catalog(presets):
    kinds = np.array(["BOSS", "APOGEE"])
    sky = rs.synthetic_catalog("poisson", CENTER, 1.6 * u.deg, density=200 / u.deg**2, rng=3)
    return rs.Catalog(sky.coord, fiber_type=kinds[np.arange(len(sky)) % 2])


def test_each_model_adds_one_effect(presets):
    """The reference adds the effects one by one, by conditions in which the others are absent."""
    instrument, conditions = presets["sdss_apo"], conditions_at()
    plane = instrument.projection(CENTER, 20 * u.deg)
    instant, green = replace(conditions, exposure_time=0 * u.s), WAVES["BOSS"]
    expected = {
        "tangent": rs.projection.TangentPlane(CENTER, instrument.plate_scale, 20 * u.deg),
        "radial": plane,
        "refraction": instrument.projection(CENTER, 20 * u.deg, replace(instant, wavelength=green)),
        "dispersion": instrument.projection(CENTER, 20 * u.deg, instant),
        "full": instrument.projection(CENTER, 20 * u.deg, conditions),
    }
    assert list(expected) == list(MODELS)
    targets = CENTER.directional_offset_by(np.arange(0, 360, 30) * u.deg, 1.2 * u.deg)
    vectors, images = targets.cartesian.xyz.value.T, {}
    for name, plane_of_model in expected.items():
        field, record = choose_projection(instrument, plane, conditions, name)
        assert record["model"] == name
        images[name] = field.project(vectors, "APOGEE")
        seen = plane_of_model.to_focal_plane(targets, "APOGEE").value
        np.testing.assert_allclose(images[name], seen, rtol=0, atol=1e-9)
    names = list(MODELS)
    for cheap, full in pairwise(names):
        assert np.abs(images[cheap] - images[full]).max() > 1e-5


def patrol_edges(instrument):
    """Return points (n, 2) with unit on the edges of the patrol areas of the outermost quarter of the positioners."""
    arrays = instrument.focal_plane.arrays
    outer = np.argsort(np.hypot(*arrays.xy.T))[-len(arrays.xy) // 4 :]
    turn = np.arange(60) * np.pi / 30
    circle = np.column_stack([np.cos(turn), np.sin(turn)])
    return (arrays.xy[outer, None] + arrays.outer_radius[outer, None, None] * circle).reshape(-1, 2) * u.mm


@pytest.mark.few(2)
@pytest.mark.parametrize("name", rs.available_instruments())
def test_the_largest_displacements_are_those_of_targets_in_patrol_areas(presets, name):
    """Regression: the maxima were taken over the centers of positioners, and were up to 23 % too small."""
    instrument, waves = presets[name], WAVES if name.startswith("sdss") else 0.54 * u.um
    conditions = conditions_at(wavelength=waves, guide_wavelength=0.65 * u.um)
    instant = conditions.without_exposure
    result = rs.instrument.compare_projections(instrument, CENTER, conditions)
    full, start, end = (
        instrument.projection(CENTER, conditions=one)
        for one in (conditions, instant.shifted(-7.5 * u.min), instant.shifted(7.5 * u.min))
    )
    others = {
        "tangent": rs.projection.TangentPlane(CENTER, instrument.plate_scale),
        "radial": instrument.projection(CENTER),
        "refraction": instrument.projection(CENTER, conditions=instant.at_guide_wavelength),
        "dispersion": instrument.projection(CENTER, conditions=instant),
        "start": start,
        "end": end,
    }
    xy, centers = patrol_edges(instrument), instrument.focal_plane.xy
    largest, median = dict.fromkeys(others, 0.0), {}
    for kind in waves if isinstance(waves, dict) else [None]:
        coord, middle = full.to_sky(xy, kind), full.to_sky(centers, kind)
        for model, plane in others.items():
            moved = np.hypot(*(plane.to_focal_plane(coord, kind) - xy).T).to_value("mm")
            largest[model] = max(largest[model], moved.max())
            moved = np.hypot(*(plane.to_focal_plane(middle, kind) - centers).T).to_value("mm")
            median.setdefault(model, []).append(moved)
    claimed = dict(zip(MODELS, result.table["max"].to_value("mm"), strict=True))
    assert claimed.pop("full") == 0
    drift = max(largest.pop("start"), largest.pop("end"))
    assert drift * (1 - 1e-3) <= result.drift.to_value("mm") <= drift * 1.01
    for model, value in claimed.items():
        assert largest[model] * (1 - 1e-3) <= value <= largest[model] * 1.01, model
        row = result.table[list(MODELS).index(model)]
        assert row["median"].to_value("mm") == pytest.approx(np.median(median[model]), rel=0.15)


def test_the_radial_map_may_end_inside_the_patrol_areas(presets):
    """The largest displacement is then that of the outermost target that has an image."""
    pfs = presets["pfs"]
    limit = pfs.distortion.to_angle(220 * u.mm)
    instrument = replace(pfs, distortion=replace(pfs.distortion, max_angle=limit))
    conditions = conditions_at(wavelength=0.6 * u.um)
    table = rs.instrument.compare_projections(instrument, CENTER, conditions).table
    turn = np.arange(360) * u.deg
    xy = 219.999 * np.column_stack([np.cos(turn), np.sin(turn)]) * u.mm
    coord = instrument.projection(CENTER, conditions=conditions).to_sky(xy)
    moved = np.hypot(*(rs.projection.TangentPlane(CENTER, pfs.plate_scale).to_focal_plane(coord) - xy).T)
    assert abs(table["max"][0] / moved.max() - 1) < 0.01


@pytest.mark.parametrize(
    ("tolerance", "sufficient"),
    [(1e-6, "full"), (0.005, "dispersion"), (0.05, "refraction"), (0.3, "radial"), (10.0, "tangent")],
)
def test_the_cheapest_model_within_the_tolerance_suffices(presets, tolerance, sufficient):
    conditions = conditions_at(tolerance=tolerance * u.mm)
    result = rs.instrument.compare_projections(presets["sdss_apo"], CENTER, conditions)
    assert result.sufficient == sufficient
    assert result.table["max"][list(MODELS).index(sufficient)] <= tolerance * u.mm
    field, record = choose_projection(presets["sdss_apo"], presets["sdss_apo"].projection(CENTER), conditions, "auto")
    assert record["model"] == record["sufficient"] == sufficient
    assert isinstance(field, FieldProjection if sufficient in ("tangent", "radial") else ObservedField)
    assert f"{sufficient}" in str(result)


def test_a_range_of_hour_angles_gives_the_largest_displacements(presets):
    hours = [-3.0, 0.0, 1.0]
    both = rs.instrument.compare_projections(
        presets["lamost"], CENTER, conditions_at(wavelength=0.5 * u.um), hour_angles=hours * u.hour
    )
    single = [
        rs.instrument.compare_projections(presets["lamost"], CENTER, conditions_at(hour, wavelength=0.5 * u.um))
        for hour in hours
    ]
    largest = np.max([one.table["max"].value for one in single], axis=0)
    np.testing.assert_allclose(both.table["max"].value[:-1], largest[:-1], rtol=0, atol=1e-9)
    assert both.drift.value == pytest.approx(max(one.drift.value for one in single))


@pytest.mark.exhaustive
def test_the_default_tolerance_is_a_tenth_of_the_fiber(presets):
    diameters = {"lamost": 320, "sdss_apo": 120, "sdss_lco": 120, "moons": 571, "desi": 107, "pfs": 99.2}
    for name, microns in diameters.items():
        conditions = conditions_at(wavelength=0.6 * u.um)
        result = rs.instrument.compare_projections(presets[name], CENTER, conditions)
        assert result.tolerance.to_value(u.um) == pytest.approx(microns / 10)
        given = rs.instrument.compare_projections(presets[name], CENTER, conditions, tolerance=9 * u.um)
        assert given.tolerance == 9 * u.um


def test_without_a_diameter_of_the_fibers_there_is_no_verdict(small):
    sky = rs.synthetic_catalog("poisson", CENTER, 0.5 * u.deg, density=400 / u.deg**2, rng=3)
    conditions = conditions_at(wavelength=0.6 * u.um)
    tile = rs.plan_tile(sky, small, CENTER, conditions=conditions)
    assert tile.summary["projection"]["model"] == "full"
    assert tile.summary["projection"]["tolerance_mm"] is None
    assert "tolerance" not in tile.summary["projection"]["sentence"]
    assert rs.instrument.compare_projections(small, CENTER, conditions).sufficient is None
    conditions = replace(conditions, tolerance=0.5 * u.mm)
    assert rs.plan_tile(sky, small, CENTER, conditions=conditions, projection="auto").summary["projection"]["model"]


def test_a_tile_has_the_positions_of_its_conditions(presets, catalog, tmp_path):
    instrument, conditions = presets["sdss_apo"], conditions_at(projection="full")
    static = rs.plan_tile(catalog, instrument, CENTER)
    tile = rs.plan_tile(catalog, instrument, CENTER, conditions=conditions)
    plane = instrument.projection(CENTER, conditions=conditions)
    rows = tile[tile["status"] == "assigned"]
    assert len(rows) > 300
    seen = plane.to_focal_plane(SkyCoord(rows["ra"], rows["dec"]), np.asarray(rows["fiber_type"]))
    tips = np.column_stack([rows["tip_x"], rows["tip_y"]])
    np.testing.assert_allclose(tips.to_value("mm"), seen.to_value("mm"), rtol=0, atol=1e-6)
    assert static.provenance["parameters"]["conditions"] is None
    assert static.summary["projection"] == {"model": "radial"}
    assert "without refraction" in static.summary["model"]
    assert "with refraction averaged over the exposure" in tile.summary["model"]
    assert "with atmospheric refraction" in tile.provenance["model"]
    assert tile.provenance["parameters"]["conditions"] == conditions.record
    assert tile.summary["projection"]["sufficient"] == "dispersion"
    for suffix in ("fits", "ecsv"):
        tile.write(tmp_path / f"tile.{suffix}")
        assert rs.Tile.read(tmp_path / f"tile.{suffix}") == tile
    auto = rs.plan_tile(catalog, instrument, CENTER, conditions=conditions, projection="auto")
    assert auto.summary["projection"]["model"] == "dispersion"
    plain = rs.plan_tile(catalog, instrument, CENTER, projection="auto")
    assert plain.summary["projection"]["model"] == "radial"
    assert (plain["target_id"] == static["target_id"]).all()


def test_a_plan_is_scored_under_its_conditions(presets, catalog):
    instrument, conditions = presets["sdss_apo"], conditions_at()
    tile = rs.plan_tile(catalog, instrument, CENTER, conditions=conditions, allocator="lamost_rule")
    rows = tile.table[tile["status"] == "assigned"]
    plan = rows["id", "target_id", "ra", "dec", "fiber_type"]
    given = {"center": CENTER, "position_angle": 0 * u.deg, "positions": "sky", "columns": {"positioner": "id"}}
    scored = rs.score_tile(plan, instrument, conditions=conditions, **given)
    same = scored[tile["status"] == "assigned"]
    np.testing.assert_allclose(same["tip_x"].value, rows["tip_x"].value, rtol=0, atol=1e-6)
    assert scored.summary["n_colliding"] == tile.summary["n_colliding"]
    assert scored.provenance["parameters"]["conditions"] == conditions.record
    assert "with refraction" in scored.summary["model"]
    plan.meta.clear()  # the meta of a tile contains its conditions
    static = rs.score_tile(plan, instrument, **given)[tile["status"] == "assigned"]
    assert np.abs(static["tip_x"].value - rows["tip_x"].value).max() > 0.03


def test_targets_that_refraction_brings_into_the_field_are_planned(presets):
    """Refraction compresses the field, so that it extends beyond its nominal radius on the sky."""
    instrument = presets["lamost"]
    conditions = rs.ObservingConditions("xinglong", hour_angle=5.3 * u.hourangle)
    plane = instrument.projection(CENTER, conditions=conditions)
    assert 5 * u.deg < plane.altitude - instrument.field_radius < 25 * u.deg
    arrays = instrument.focal_plane.arrays
    distance = np.maximum(np.hypot(*arrays.xy.T), 1.0)
    coord = plane.to_sky((arrays.xy * (1 + arrays.outer_radius / distance * (1 - 1e-7))[:, None]) * u.mm)
    apart = coord.separation(CENTER)
    assert (apart > instrument.field_radius).sum() > 10
    tile = rs.plan_tile(rs.Catalog(coord[apart > instrument.field_radius]), instrument, CENTER, conditions=conditions)
    assert tile.summary["n_in_field"] == tile.summary["n_reachable"] == (apart > instrument.field_radius).sum()


def test_circles_that_no_arm_may_cover_are_seen_under_the_conditions(presets, catalog):
    options = rs.AllocationOptions(
        "repair", keep_out=[rs.Region.cap(CENTER.directional_offset_by(1 * u.rad, 1 * u.deg), 0.01 * u.deg)]
    )
    conditions = conditions_at(hours=4.0, projection="full")
    tile = rs.plan_tile(catalog, presets["sdss_apo"], CENTER, allocator=options, conditions=conditions)
    plane = presets["sdss_apo"].projection(CENTER, conditions=conditions)
    x, y, r = tile.table.meta["geometry"]["obstacles_mm"][-1]
    spot = CENTER.directional_offset_by(1 * u.rad, 1 * u.deg)
    images = [plane.to_focal_plane(SkyCoord([spot.ra], [spot.dec]), kind).value[0] for kind in WAVES]
    np.testing.assert_allclose([x, y], np.mean(images, axis=0), atol=1e-6)
    assert r > 2.2


WRONG_PROJECTIONS = [
    ({"projection": "full"}, "the projection 'full' must have conditions, got none"),
    ({"projection": "best"}, "unknown projection 'best'"),
    ({"conditions": "apache point"}, "conditions must be ObservingConditions"),
    ({"conditions": conditions_at(11)}, "must be above the horizon"),
]


@pytest.mark.parametrize(("given", "text"), WRONG_PROJECTIONS)
def test_projections_that_are_not_valid_are_errors(presets, catalog, given, text):
    refused(text, lambda: rs.plan_tile(catalog, presets["sdss_apo"], CENTER, **given))


def test_hour_angles_that_are_not_valid_are_errors(presets):
    for angles in ([] * u.deg, [[1]] * u.deg, 5 * u.mm):
        with pytest.raises(rs.InputError, match="hour_angles must"):
            rs.instrument.compare_projections(presets["pfs"], CENTER, conditions_at(), hour_angles=angles)
    with pytest.raises(rs.InputError, match="tolerance must"):
        rs.instrument.compare_projections(presets["pfs"], CENTER, conditions_at(), tolerance=-1 * u.mm)


TOML = """
site = "apache point"
hour_angle = "3 hourangle"
guide_wavelength = "6231 AA"
pressure = "720 hPa"
temperature = "5 deg_C"
humidity = 0.4
exposure_time = "15 min"
tolerance = "20 um"
[wavelength]
BOSS = "0.54 um"
APOGEE = "1.6 um"
"""


def test_conditions_are_read_from_a_file(tmp_path):
    path = tmp_path / "night.toml"
    path.write_text(TOML)
    expected = conditions_at(
        guide_wavelength=0.6231 * u.um,
        pressure=720 * u.hPa,
        temperature=5 * u.deg_C,
        humidity=0.4,
        tolerance=0.02 * u.mm,
    )
    assert rs.ObservingConditions.read(path).record == expected.record
    path.write_text('site = [10, 20, 30]\ntime = 2024-05-10T05:00:00\npressure = "0 hPa"')
    read = rs.ObservingConditions.read(path)
    assert (read.time, read.record["latitude_deg"]) == (Time("2024-05-10T05:00:00"), pytest.approx(20))
    assert rs.ObservingConditions.read(path, hour_angle=1 * u.deg).time is None
    for text, message in (
        ("sight = 5\n", "unknown key of .* 'sight'.* Did you mean 'site'"),
        ('site = "paranal"\npressure = "high"', "pressure must be text such as"),
        ('site = "paranal"\nhour_angle = "1 m"', "night.toml: hour_angle must have a unit"),
        ("site = [1, 2]\n", "site must be longitude, latitude"),
    ):
        path.write_text(text)
        refused(message, rs.ObservingConditions.read, path)


def settings(**values):
    """Return the words that set options of the conditions."""
    return [word for name, value in values.items() for word in ("--set", f"conditions.{name}={value}")]


def test_the_command_plans_under_conditions(run, tmp_path):
    path, output = tmp_path / "night.toml", tmp_path / "tile.ecsv"
    path.write_text(TOML)
    common = "plan", "example:anticenter", "--instrument", "sdss_apo", "--center", "95 23", "--epoch", "2026"
    waves = {"wavelength.BOSS": 0.54, "wavelength.APOGEE": 1.6}
    for words, text in (
        ([*settings(path=path), "--output", output], "projection: dispersion; positions are within"),
        (settings(site="-105.82,32.78,2798", hour_angle=3, projection="full", **waves), "projection: full; "),
        (settings(path=path, time="2026-01-15T05:00:00", wavelength=0.6), "(tolerance 20 um)"),
    ):
        code, out, err = run(*common, *words)
        assert code == 0, err
        assert text in " ".join(out.split()).replace("0.02 mm", "20 um")
    record = rs.Tile.read(output).provenance["parameters"]["conditions"]
    assert record == rs.ObservingConditions.read(path).record


REFUSED_CONDITIONS = [
    (settings(hour_angle=3), "conditions.site must be given"),
    (settings(site="paranal"), "either a time or an hour_angle"),
    (settings(site="paranal", time="now"), "conditions.time must be a date and time (UTC) such as"),
    (
        settings(site="paranal", hour_angle=1, wavelength="BOSS"),
        "conditions.wavelength must be a number (um) or text with a unit",
    ),
    (settings(site="1,2", hour_angle=1), "site must be longitude"),
    (["--set", "projection=full"], "must have conditions"),
]


@pytest.mark.few(2)
@pytest.mark.parametrize(("options", "text"), REFUSED_CONDITIONS)
def test_the_command_refuses_conditions_that_are_not_valid(run, options, text):
    code, _, err = run("plan", "example:anticenter", "--epoch", "2026", *options)
    assert code == 2
    assert text in err


def test_the_sentence_states_the_drift_only_for_exposures(presets):
    for time, stated in ((0 * u.s, False), (15 * u.min, True)):
        result = rs.instrument.compare_projections(
            presets["pfs"], CENTER, conditions_at(wavelength=0.6 * u.um, exposure_time=time)
        )
        assert ("during the exposure" in str(result)) == stated
        assert (result.drift > 0 * u.mm) == stated


def test_the_sentence_names_effects_that_are_not_included(presets):
    """Regression: the sentence stated that refraction is within the tolerance although dispersion was not computed,
    and although an hour angle leaves out aberration.
    """
    dated = {"hour_angle": None, "time": "2026-01-15T06:30:00"}
    dispersion = "dispersion (all fibers and the guide camera are assumed to observe at 0.54 um)"
    aberration = "differential aberration (the conditions have an hour angle and no date)"
    for name, changes, effects in (
        ("must", {}, [dispersion, aberration]),
        ("must", dated, [dispersion]),
        ("must", {"wavelength": 0.5 * u.um}, [aberration]),
        ("sdss_apo", {}, [aberration]),
        ("sdss_apo", {"date": "2026-01-15"}, []),
        ("sdss_apo", dated, []),
    ):
        given = {"hour_angle": 2 * u.hourangle, **changes}
        conditions = rs.ObservingConditions("apache point", **{k: v for k, v in given.items() if v is not None})
        limit = {"tolerance": 0.01 * u.mm}
        result = rs.instrument.compare_projections(presets[name], CENTER, conditions, **limit)
        assert result.record["not_included"] == effects
        tail = f"; not included, and possibly larger than the tolerance: {', '.join(effects)}" if effects else ""
        assert str(result).endswith(f" is {result.sufficient}{tail}")
        assert ("dispersion move" in str(result)) == (dispersion not in effects)
        hours = rs.instrument.compare_projections(presets[name], CENTER, conditions, hour_angles=[1] * u.hourangle)
        assert (aberration in hours.not_included) == (aberration in effects)
