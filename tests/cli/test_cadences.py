"""The commands of a survey with cadences over several nights."""

import numpy as np
import pytest
from astropy.table import QTable, Table
from astropy.time import Time
from cadence_program import scene
from living import instrument
from naive_cadences import TABLE

import rfpsurvey as rs


@pytest.fixture
def planned(call, tmp_path):
    """Return the folder of a survey, and a table of observations that omits two of the first six tiles."""
    catalog, tiling = scene(3, n=60, n_tiles=16)
    columns = {"id": catalog.id, "ra": catalog.coord.ra, "dec": catalog.coord.dec, "priority": catalog.priority}
    QTable({**columns, "cadence": catalog.extra["cadence"]}).write(tmp_path / "stars.ecsv")
    tiling.table.write(tmp_path / "tiles.ecsv")
    TABLE.write(tmp_path / "cadences.ecsv")
    instrument().write(tmp_path / "instrument.ecsv")
    names = ("stars", "tiles", "instrument", "cadences")
    paths = [tmp_path / f"{name}.ecsv" for name in names]
    text = "survey {} --tiles {} --instrument {} --set cadences={} --allocator repair --folder {}"
    call(text, *paths, tmp_path / "plan")
    days, used = np.asarray(tiling.table["mjd"]), [0, 1, 3, 5]
    rows = [(tiling.table["tile"][k], Time(days[k], format="mjd").isot[:10]) for k in np.argsort(days)[used]]
    Table(rows=rows, names=["tile", "date"]).write(tmp_path / "night.csv")
    return tmp_path / "plan", tmp_path / "night.csv"


def test_a_survey_with_cadences_is_recorded_planned_again_and_shown(call, refused, planned):
    folder, night = planned
    assert call("record {} {}", folder, night).lines["tiles observed"][0] == "4"
    before = call("status {}", folder).lines
    call("survey {} --replan", folder)
    survey = rs.Survey.read(folder)
    lines = call("status {}", folder).lines
    assert lines["observed"] == before["observed"] == [str(int(survey.state().observed.sum()))]
    assert lines["planned"] == [str(survey.summary["n_visits_observed"] - int(survey.state().observed.sum()))]
    names = ("finished", "not observed in time", "not yet observed")
    assert [lines[name] for name in names] == [["4"], ["2"], ["10"]]
    call("status {} --verify", folder)
    text = refused("survey {} --replan --set rule.retries=1", folder)
    assert text == "rfpsurvey: cadences must be used without catalog.visits and rule, got several of them"


def test_probabilities_of_a_survey_with_cadences(call, refused, planned, tmp_path):
    folder, night = planned
    call("record {} {}", folder, night)
    call("survey {} --replan", folder)
    words = "select {} --n-realizations 3 --output {} --report {}"
    lines = call(words, folder, tmp_path / "s.fits", tmp_path / "s.html").lines
    found = rs.SelectionProbabilities.read(tmp_path / "s.fits")
    with pytest.warns(rs.RfpsurveyWarning, match="planned without the option subpriority"):
        own = rs.Survey.read(folder).select(3)
    assert found.table.colnames[-3:] == ["n_with_visits", "n_complete", "probability_complete"]
    for name in found.table.colnames:
        np.testing.assert_array_equal(found.table[name], own.table[name], err_msg=name)
    mean = found.probability_complete[found.requested > 0].mean()
    assert float(lines["mean completion probability"][0]) == pytest.approx(mean, rel=1e-3)
    assert "probability complete" in (tmp_path / "s.html").read_text()
    for text, message in {
        "--set catalog.visits=2": "visits must be the Cadences of the survey in",
        "--set cadences=other.ecsv": "unknown key 'cadences'",
        "--allocator optimal": "--allocator must be 'repair', as for the survey, got 'optimal'",
        "--allocator joint": "joint plan need a survey of which no tile was observed, got observed tiles",
    }.items():
        assert message in refused(f"select {{}} --output {{}} {text}", folder, tmp_path / "t.fits")
    assert not (tmp_path / "t.fits").exists()
