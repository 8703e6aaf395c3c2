"""Files of SDSS-V that state which fibers were on target are recorded as failed visits of a tile."""

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.table import QTable

import rfpsurvey as rs

CENTER = SkyCoord(95 * u.deg, 23 * u.deg)


@pytest.fixture
def survey(tmp_path):
    """Return a survey of two tiles of SDSS-V in a folder."""
    sky = rs.synthetic_catalog("poisson", CENTER, 1.5 * u.deg, density=60 / u.deg**2, rng=3)
    sky = rs.Catalog(sky.coord, id=np.asarray(sky.id) + 1000)
    tiles = QTable({"ra": [95, 95] * u.deg, "dec": [23, 23] * u.deg, "pass": [1, 2]})
    return sky, rs.plan_survey(sky, "sdss_apo", tiles, folder=tmp_path / "plan")


@pytest.fixture
def configuration(survey, tmp_path):
    """Return a function that writes a configuration of a tile, changed by a function, and returns its path."""

    def write(tile=0, change=lambda plan: None, name="confSummaryF-1.par"):
        visits = survey[1].tile(tile)
        visits["fiber_type"] = "APOGEE"
        plan = rs.plans.as_plan(rs.score_tile(visits, "sdss_apo", center=CENTER, position_angle=0 * u.deg))
        plan["on_target"] = np.asarray(plan["assigned"]).astype("i2")
        change(plan)
        with pytest.warns(rs.RfpsurveyWarning, match="was written without the column spectrograph"):
            rs.plans.write_plan(plan, tmp_path / name, format="confsummary")
        text = (tmp_path / name).read_text()
        (tmp_path / name).write_text(text.replace("\nobservatory", "\nMJD 61043\nobservatory", 1))
        return tmp_path / name

    return write


def failures(folder, catalog):
    (event,) = rs.survey.SurveyState.read(folder, catalog).attempts
    return event.failed


RECORD = "record {} {} --tile"


def test_fibers_that_are_not_on_target_failed(call, survey, configuration, tmp_path):
    def change(plan):
        plan["on_target"][np.flatnonzero(plan["assigned"])[:2]] = 0

    path = configuration(change=change)
    called = call(f"{RECORD} 0", tmp_path / "plan", path)
    assert (called.err, called.out.splitlines()[0].split()) == ("", ["new", "events", "1"])
    found = failures(tmp_path / "plan", survey[0])
    assert list(found.values()) == ["not on target"] * 2
    assert set(found) <= set(rs.plans.read_plan(path)["positioner"].tolist())


def test_fibers_with_another_target_or_without_a_target_failed(call, survey, configuration, tmp_path):
    def change(plan):
        first, second = np.flatnonzero(plan["assigned"])[:2]
        plan["target_id"][first] = 7
        plan["assigned"][second] = False

    call(f"{RECORD} 0", tmp_path / "plan", configuration(change=change))
    found = failures(tmp_path / "plan", survey[0])
    assert sorted(found.values()) == ["another target in the file", "no target in the file"]


def test_the_date_is_that_of_the_configuration(call, survey, configuration, tmp_path):
    call(f"{RECORD} 0", tmp_path / "plan", configuration())
    (event,) = rs.survey.SurveyState.read(tmp_path / "plan", survey[0]).attempts
    assert (event.date, event.failed) == ("2026-01-03", {})


def test_the_tile_must_be_given_and_fit(refused, survey, configuration, tmp_path):
    path = configuration()
    for words, message in (
        ("record {} {}", "the tile of the survey that it observed, got none"),
        (f"{RECORD} 1", "must be the file of tile 1, got a file in which no fiber has its target of the survey"),
        (f"{RECORD} 7", "the survey has no tile 7"),
    ):
        assert message in refused(words, tmp_path / "plan", path)
    assert not (tmp_path / "plan" / "events").exists()


@pytest.mark.parametrize(
    ("name", "n_good"), [("sdssv_apo_2024/confSummary-test.par.gz", 480), ("sdssv_apo_2021/confSummaryF-998.par.gz", 0)]
)
def test_a_real_configuration_is_recorded(call, real_data, tmp_path, name, n_good):
    """Of the configuration of 2021, no fiber is marked as on target, which is a warning."""
    path = real_data(name)
    plan = rs.plans.read_plan(path)
    used = plan[np.asarray(plan["assigned"]) & np.isfinite(plan["ra"])]
    catalog = rs.Catalog(SkyCoord(used["ra"], used["dec"]), id=np.asarray(used["target_id"]))
    tiles = QTable({"tile": [17], "ra": [plan.meta["racen"]] * u.deg, "dec": [plan.meta["deccen"]] * u.deg})
    tiles["position_angle"] = [plan.meta["position_angle"]] * u.deg
    survey = rs.plan_survey(catalog, "sdss_apo", tiles, allocator="nearest", folder=tmp_path / "plan")
    err = call(f"{RECORD} 17", tmp_path / "plan", path).err
    assert ("was on target; therefore, all visits of tile 17 are recorded as failed" in err) == (n_good == 0)
    row_of, good = dict(zip(used["positioner"].tolist(), range(len(used)), strict=True)), 0
    for visit in survey.tile(17):
        row = row_of.get(str(visit["positioner"]), -1)
        same = row >= 0 and used["target_id"][row] == visit["target_id"]
        good += bool(same and used["on_target"][row] == 1 and visit["observed"])
    assert int(rs.survey.SurveyState.read(tmp_path / "plan", catalog).observed.sum()) == good
    assert (good > 0) == (n_good > 0)
