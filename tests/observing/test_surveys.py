"""Surveys under observing conditions."""

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.table import QTable
from astropy.time import Time

import rfpsurvey as rs

CENTERS = SkyCoord([94.9, 95.2, 95.0] * u.deg, [23, 23, 23.2] * u.deg)
HOURS = [-3.0, 0.5, 4.0]
CONDITIONS = rs.ObservingConditions("paranal", hour_angle=0 * u.deg, wavelength=0.9 * u.um, guide_wavelength=0.6 * u.um)


@pytest.fixture(scope="module")
def sky():
    return rs.synthetic_catalog("poisson", SkyCoord("6h20m +23d"), 1 * u.deg, density=4000 / u.deg**2, rng=1)


def tiling_with(**columns):
    table = QTable({"ra": CENTERS.ra, "dec": CENTERS.dec, **columns})
    return rs.Tiling.from_table(table).with_conditions(CONDITIONS)


def same_visits(one, other):
    return all(np.array_equal(a["target_id"], b["target_id"]) for a, b in zip(one.parts, other.parts, strict=True))


def test_each_tile_has_the_conditions_of_its_row(sky, presets):
    survey = rs.plan_survey(sky, presets["moons"], tiling_with(hour_angle=HOURS), rng=3, visits=3)
    assert "with refraction averaged" in survey.summary["model"]
    assert survey.provenance["parameters"]["conditions"] == CONDITIONS.record
    for center, hour, part in zip(CENTERS, HOURS, survey.parts, strict=True):
        conditions = CONDITIONS.at_hour_angle(hour * u.hourangle)
        tile = rs.plan_tile(sky, presets["moons"], center, conditions=conditions)
        static = rs.plan_tile(sky, presets["moons"], center)
        ids = np.asarray(tile["target_id"][tile["status"] == "assigned"])
        assert (np.asarray(part["target_id"]) == ids).all()
        assert not np.array_equal(ids, static["target_id"][static["status"] == "assigned"])


def test_hour_angles_have_several_units(sky, presets):
    one = rs.plan_survey(sky, presets["moons"], tiling_with(hour_angle=HOURS))
    for column in (np.array(HOURS) * u.hourangle, np.array(HOURS) * 15 * u.deg, np.array(HOURS) * u.hour):
        other = rs.plan_survey(sky, presets["moons"], tiling_with(hour_angle=column))
        assert same_visits(one, other)


def test_times_are_times_or_text(sky, presets):
    texts = ["2025-12-10T03:00:00", "2025-12-10T04:00:00", "2025-12-10T05:00:00"]
    one = rs.plan_survey(sky, presets["moons"], tiling_with(time=texts))
    assert same_visits(one, rs.plan_survey(sky, presets["moons"], tiling_with(time=Time(texts))))
    assert not same_visits(one, rs.plan_survey(sky, presets["moons"], tiling_with()))


def test_conditions_are_in_the_files_and_in_the_identity(sky, presets, tmp_path):
    tiling = tiling_with(hour_angle=HOURS)
    for suffix in ("fits", "ecsv"):
        tiling.write(tmp_path / f"tiles.{suffix}")
        read = rs.Tiling.read(tmp_path / f"tiles.{suffix}")
        assert read.conditions.record == CONDITIONS.record
    rs.plan_survey(sky, presets["moons"], tiling, folder=tmp_path / "plan")
    kept = rs.plan_survey(sky, presets["moons"], tiling, folder=tmp_path / "plan", resume=True)
    assert len(kept) == 3
    for other in (tiling_with(hour_angle=[-3.0, 0.5, 3.9]), tiling.with_conditions(None)):
        with pytest.raises(rs.InputError, match="another"):
            rs.plan_survey(sky, presets["moons"], other, folder=tmp_path / "plan", resume=True)


def test_tiles_below_the_horizon_are_named(sky, presets):
    with pytest.raises(rs.InputError, match="tile 1: the whole field .* hour angle 9 h"):
        rs.plan_survey(sky, presets["moons"], tiling_with(hour_angle=[0, 9, 0]))


@pytest.mark.parametrize(
    ("columns", "text"),
    [
        ({"hour_angle": [1, np.nan, 2]}, "hour_angle must be a finite angle"),
        ({"hour_angle": [1, 2, 3] * u.mm}, "hour_angle must be an angle"),
        ({"time": ["now", "then", ""]}, "time must be a date and time"),
        ({"time": Time(["2025-12-10"] * 3), "hour_angle": [1, 2, 3]}, "a column time or hour_angle, got both"),
    ],
)
def test_columns_that_are_not_valid_are_errors(sky, presets, columns, text):
    with pytest.raises(rs.InputError, match=text):
        rs.plan_survey(sky, presets["moons"], tiling_with(**columns))


def test_conditions_of_another_type_are_errors():
    with pytest.raises(rs.InputError, match="conditions must be ObservingConditions or None"):
        rs.Tiling.from_table(QTable({"ra": CENTERS.ra, "dec": CENTERS.dec})).with_conditions("paranal")
    with pytest.raises(rs.InputError, match="record must be that of observing conditions"):
        rs.ObservingConditions.from_record({"wavelength_um": 0.5})


def test_the_command_plans_a_survey_under_conditions(run, tmp_path):
    path, tiles = tmp_path / "night.toml", tmp_path / "tiles.ecsv"
    path.write_text('site = "paranal"\nhour_angle = "1 hourangle"\n')
    rs.Tiling.from_table(QTable({"ra": CENTERS.ra, "dec": CENTERS.dec})).write(tiles)
    code, out, err = run("survey", "--instrument", "moons", "--tiles", tiles, "--conditions", path)
    assert code == 0, err
    assert "with refraction averaged" in out
