"""Surveys under observing conditions."""

import re
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import replace
from multiprocessing import get_context

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.table import MaskedColumn, QTable
from astropy.time import Time
from raising import refused

import rfpsurvey as rs
from rfpsurvey._survey.tiling.columns import conditions_of_tiles

CENTERS = SkyCoord([94.9, 95.2, 95.0] * u.deg, [23, 23, 23.2] * u.deg)
HOURS = [-3.0, 0.5, 4.0]
TEXTS = ["2025-12-10T03:00:00", "2025-12-10T04:00:00", "2025-12-10T05:00:00"]
CONDITIONS = rs.ObservingConditions("paranal", hour_angle=0 * u.deg, wavelength=0.9 * u.um, guide_wavelength=0.6 * u.um)


@pytest.fixture(scope="module")
def sky():
    return rs.synthetic_catalog("poisson", SkyCoord("6h20m +23d"), 1 * u.deg, density=4000 / u.deg**2, rng=1)


def at_time(text):
    return {"time": Time(text), "hour_angle": None}


def tiling_with(**columns):
    table = QTable({"ra": CENTERS.ra, "dec": CENTERS.dec, **columns})
    return rs.Tiling.from_table(table).with_conditions(CONDITIONS)


def same_visits(one, other):
    return all(np.array_equal(a["target_id"], b["target_id"]) for a, b in zip(one.parts, other.parts, strict=True))


def test_each_tile_has_the_conditions_of_its_row(sky, presets):
    survey = rs.plan_survey(sky, presets["moons"], tiling_with(hour_angle=HOURS), rng=3, visits=3)
    assert "with refraction by the fastest model" in survey.summary["model"]
    assert survey.provenance["parameters"]["conditions"] == CONDITIONS.record
    for center, hour, part in zip(CENTERS, HOURS, survey.parts, strict=True):
        conditions = CONDITIONS.at_hour_angle(hour * u.hourangle)
        tile = rs.plan_tile(sky, presets["moons"], center, conditions=conditions)
        static = rs.plan_tile(sky, presets["moons"], center)
        ids = np.asarray(tile["target_id"][tile["status"] == "assigned"])
        assert (np.asarray(part["target_id"]) == ids).all()
        assert not np.array_equal(ids, static["target_id"][static["status"] == "assigned"])


def test_hour_angles_and_times_have_several_forms(sky, presets):
    hours, static = np.array(HOURS), rs.plan_survey(sky, presets["moons"], tiling_with())
    for name, first, others in (
        ("hour_angle", HOURS, (hours * u.hourangle, hours * 15 * u.deg, hours * u.hour)),
        ("time", TEXTS, (Time(TEXTS),)),
    ):
        one = rs.plan_survey(sky, presets["moons"], tiling_with(**{name: first}))
        assert not same_visits(one, static)
        for column in others:
            assert same_visits(one, rs.plan_survey(sky, presets["moons"], tiling_with(**{name: column})))


KEPT_CONDITIONS = [
    ("hour_angle", HOURS * u.hourangle),
    ("hour_angle", HOURS * u.hour),
    ("hour_angle", HOURS),
    ("time", TEXTS),
    ("time", Time(TEXTS)),
    ("time", Time(TEXTS).tai),
    ("time", np.array(TEXTS, dtype="datetime64[s]")),
]


@pytest.mark.few(2)
@pytest.mark.parametrize(("name", "column"), KEPT_CONDITIONS)
def test_files_keep_the_conditions_of_each_tile(name, column, tmp_path):
    tiling = tiling_with(**{name: column})
    expected = [
        CONDITIONS.at_hour_angle(hour * u.hourangle) if name == "hour_angle" else replace(CONDITIONS, **at_time(text))
        for hour, text in zip(HOURS, TEXTS, strict=True)
    ]
    for suffix in ("fits", "ecsv"):
        tiling.write(tmp_path / f"tiles.{suffix}")
        read = rs.Tiling.read(tmp_path / f"tiles.{suffix}")
        assert [one.record for one in conditions_of_tiles(read)] == [one.record for one in expected]


@pytest.mark.parametrize("processes", [False, pytest.param(True, marks=pytest.mark.exhaustive)])
def test_the_parts_do_not_depend_on_the_number_of_workers(sky, presets, tmp_path, processes):
    tiling, files = tiling_with(hour_angle=HOURS), {}
    with ProcessPoolExecutor(2, get_context("spawn")) if processes else ThreadPoolExecutor(3) as workers:
        for name, pool in (("one", None), ("several", workers)):
            folder = tmp_path / name
            rs.plan_survey(sky, presets["moons"], tiling, folder=folder, executor=pool, rng=2)
            files[name] = {
                str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()
            }
    assert len(files["one"]) > 5
    assert files["one"] == files["several"]


def test_the_table_of_a_survey_has_the_time_or_hour_angle_of_each_tile(sky, presets, tmp_path):
    survey = rs.plan_survey(sky, presets["moons"], tiling_with(hour_angle=HOURS), folder=tmp_path / "plan")
    for tiles in (survey.tiles, rs.Survey.read(tmp_path / "plan").tiles):
        np.testing.assert_allclose(tiles["hour_angle"].to_value(u.hourangle), HOURS, rtol=0, atol=1e-12)
    dated = rs.plan_survey(sky, presets["moons"], tiling_with(time=Time(TEXTS)), folder=tmp_path / "dated")
    for tiles in (dated.tiles, rs.Survey.read(tmp_path / "dated").tiles):
        assert [Time(text) for text in tiles["time"]] == list(Time(TEXTS))
    assert "hour_angle" not in rs.plan_survey(sky, presets["moons"], tiling_with()).tiles.colnames


def test_conditions_are_in_the_files_and_in_the_identity(sky, presets, tmp_path):
    tiling = tiling_with(hour_angle=HOURS)
    for suffix in ("fits", "ecsv"):
        tiling.write(tmp_path / f"tiles.{suffix}")
        assert rs.Tiling.read(tmp_path / f"tiles.{suffix}").conditions.record == CONDITIONS.record
    rs.plan_survey(sky, presets["moons"], tiling, folder=tmp_path / "plan")
    assert len(rs.plan_survey(sky, presets["moons"], tiling, folder=tmp_path / "plan", resume=True)) == 3
    for other in (tiling_with(hour_angle=[-3.0, 0.5, 3.9]), tiling.with_conditions(None)):
        with pytest.raises(rs.InputError, match="another"):
            rs.plan_survey(sky, presets["moons"], other, folder=tmp_path / "plan", resume=True)


def test_tiles_at_times_outside_the_installed_tables_are_named(sky, presets):
    with pytest.raises(rs.InputError, match="tile 2: time must .* tables of the Earth's rotation cover"):
        rs.plan_survey(sky, presets["moons"], tiling_with(time=[*TEXTS[:2], "2070-01-01"]))


def test_tiles_below_the_horizon_are_named(sky, presets):
    with pytest.raises(rs.InputError, match="tile 1: the whole field .* hour angle 9 h"):
        rs.plan_survey(sky, presets["moons"], tiling_with(hour_angle=[0, 9, 0]))


WRONG_COLUMNS = [
    ({"hour_angle": [1, np.nan, 2]}, "hour_angle must be a finite angle .* got nan deg for tile 1"),
    ({"hour_angle": [1, 2, 24.5]}, "hour_angle must be .* below 360 deg .* got 367.5 deg for tile 2"),
    ({"hour_angle": MaskedColumn([1.0, 2, 3], mask=[1, 0, 0])}, "got nan deg for tile 0"),
    ({"hour_angle": [1, 2, 3] * u.mm}, "hour_angle must be an angle"),
    ({"time": [*TEXTS[:2], "then"]}, "time of tile 2 must be a date and time .* got 'then'"),
    ({"time": MaskedColumn(TEXTS, mask=[0, 1, 0])}, "time of tile 1 must be a date and time .* got ''"),
    ({"time": [2460427.0] * 3}, "time of tile 0 must be a date and time .* got 2460427.0"),
    ({"time": Time(["2025-12-10"] * 3), "hour_angle": [1, 2, 3]}, "at most one of the columns .* got both"),
]


@pytest.mark.parametrize(("columns", "text"), WRONG_COLUMNS)
def test_columns_that_are_not_valid_are_errors(columns, text):
    refused(text, lambda: tiling_with(**columns))


def test_conditions_of_another_type_are_errors():
    with pytest.raises(rs.InputError, match="conditions must be ObservingConditions or None"):
        rs.Tiling.from_table(QTable({"ra": CENTERS.ra, "dec": CENTERS.dec})).with_conditions("paranal")
    refused("record must describe observing conditions", rs.ObservingConditions.from_record, {"wavelength_um": 0.5})


@pytest.fixture
def command(run, tmp_path):
    """Return a function that plans a survey by the command, and returns its output and its table of tiles."""

    def command(columns, *options):
        tiles, folder = tmp_path / "tiles.ecsv", tmp_path / "plan"
        rs.Tiling.from_table(QTable({"ra": CENTERS.ra, "dec": CENTERS.dec, **columns})).write(tiles)
        code, out, err = run("survey", "--instrument", "moons", "--tiles", tiles, "--folder", folder, *options)
        assert code == 0, err
        return out, rs.Survey.read(folder)

    return command


def test_the_command_plans_a_survey_under_the_conditions_of_a_file(command, tmp_path):
    path = tmp_path / "night.toml"
    path.write_text('site = "paranal"\nhour_angle = "1 hourangle"\n')
    out, survey = command({}, "--set", f"conditions.path={path}", "--set", "conditions.wavelength=0.7")
    assert "with refraction by the fastest model" in out
    record = survey.provenance["parameters"]["conditions"]
    assert (record["hour_angle_deg"], record["wavelength_um"]) == (pytest.approx(15), pytest.approx(0.7))


def test_the_command_plans_each_tile_at_its_hour_angle(command):
    out, survey = command(
        {"hour_angle": HOURS}, "--set", "conditions.site=paranal", "--set", "conditions.exposure_time=600"
    )
    assert "with refraction by the fastest model" in out
    np.testing.assert_allclose(survey.tiles["hour_angle"].to_value(u.hourangle), HOURS, rtol=0, atol=1e-12)
    assert survey.provenance["parameters"]["conditions"]["exposure_time_s"] == 600


def test_the_command_neglects_refraction_without_conditions(command):
    out, survey = command({"hour_angle": HOURS})
    assert "with refraction" not in out
    assert "hour_angle" not in survey.tiles.colnames


REFUSED_CONDITIONS = [
    (["--set", "conditions.hour_angle=3"], "conditions.site must be given"),
    (["--set", "conditions.site=paranal"], "either a time or an hour_angle"),
    (["--set", "conditions.site=paranal", "--set", "conditions.hour_angle=9"], "tile 0: .* must be above the horizon"),
]


@pytest.mark.few(1)
@pytest.mark.parametrize(("options", "text"), REFUSED_CONDITIONS)
def test_the_command_refuses_conditions_that_are_not_valid(run, tmp_path, options, text):
    tiles = tmp_path / "tiles.ecsv"
    rs.Tiling.from_table(QTable({"ra": CENTERS.ra, "dec": CENTERS.dec})).write(tiles)
    code, _, err = run("survey", "--instrument", "moons", "--tiles", tiles, *options)
    assert code == 2
    assert re.search(text, " ".join(err.split()))
