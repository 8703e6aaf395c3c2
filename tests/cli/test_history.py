"""The commands of surveys over several nights: ``record``, ``survey --replan``, ``status`` and ``diff``."""

import shutil
import tomllib

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.table import QTable, Table

import rfpsurvey as rs
from refusals import sentence

CENTER = SkyCoord(95 * u.deg, 23 * u.deg)


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """Return a folder with a catalog and a table of tiles."""
    folder = tmp_path_factory.mktemp("history")
    sky = rs.synthetic_catalog("poisson", CENTER, 1.9 * u.deg, density=60 / u.deg**2, rng=3)
    rng = np.random.default_rng(1)
    sky = rs.Catalog(sky.coord, priority=rng.integers(1, 3, len(sky)), visits=rng.integers(1, 3, len(sky)))
    sky.write(folder / "stars.fits")
    tiles = QTable({"tile": [11, 12, 13, 14], "ra": [94.6, 95.4, 95, 95] * u.deg, "dec": [23, 23, 22.7, 23.4] * u.deg})
    tiles.write(folder / "tiles.ecsv")
    return folder


@pytest.fixture
def call(run):
    """Return a function that runs a command and returns its output, and its values by label."""

    def call(*words):
        code, out, err = run(*words)
        assert code == 0, err
        return out, {line[:34].strip(): line[34:].split() for line in out.splitlines()}

    return call


@pytest.fixture
def plan(call, files, tmp_path):
    """Return a function that plans a survey with options in the folder ``plan``, and returns the folder."""

    def plan(*words):
        call(*COMMAND, files / "stars.fits", "--tiles", files / "tiles.ecsv", "--folder", tmp_path / "plan", *words)
        return tmp_path / "plan"

    return plan


COMMAND = ("survey", "--instrument", "sdss_apo", "--allocator", "nearest")


def parts_of(folder):
    """Return the content of the files of the tiles by name."""
    return {path.name: path.read_bytes() for path in folder.rglob("tiles/*/*.fits")}


def write(path, **columns):
    Table(columns).write(path)
    return path


@pytest.mark.parametrize("ending", ["ecsv", "csv", "fits"])
def test_observations_are_recorded_from_files(call, plan, tmp_path, ending):
    folder = plan()
    table = write(tmp_path / f"night.{ending}", tile=[11, 12], date=["2026-01-03"] * 2, fraction=[1.0, 0.5])
    _, lines = call("record", folder, table)
    assert lines["new events"] == ["2"]
    out, lines = call("record", folder, table)
    assert (lines["new events"], lines["already recorded"]) == (["0"], ["2"])
    assert "--replan" not in out
    states = rs.survey.SurveyState.read(folder, _catalog(folder))
    assert [one.state for one in states.attempts] == ["done", "partly"]


def _catalog(folder):
    keys = tomllib.loads((folder / "plan.toml").read_text())
    return rs.Catalog.read(folder / keys["catalog"]["path"])


def test_the_fraction_that_is_enough_is_an_option(call, plan, tmp_path):
    folder = plan()
    call("record", folder, write(tmp_path / "night.csv", tile=[11], fraction=[0.9]), "--enough", 0.8)
    assert rs.survey.SurveyState.read(folder, _catalog(folder)).summary["n_tiles_observed"] == 1


def test_columns_with_other_names_are_named(call, plan, tmp_path):
    folder = plan()
    table = write(tmp_path / "night.csv", field=[11], night_of=["2026-01-03"], state=["observed"])
    call("record", folder, table, "--column", "tile=field", "--column", "date=night_of")
    (event,) = rs.survey.SurveyState.read(folder, _catalog(folder)).attempts
    assert (event.tile, event.date, event.state) == ("11", "2026-01-03", "done")


def test_finished_tiles_of_desi_are_read_as_they_are(call, plan, tmp_path):
    """The list of finished tiles of DESI (mtl-done-tiles.ecsv) has a row for each finished tile."""
    folder = plan()
    table = write(
        tmp_path / "mtl-done-tiles.ecsv",
        TILEID=[11, 13],
        TIMESTAMP=["2021-05-15T17:02:33+00:00", "2021-05-16T17:02:33+00:00"],
        VERSION=["2.1.0", "2.1.0"],
        PROGRAM=["DARK", "DARK"],
        ZDATE=[20210514, 20210515],
        ARCHIVEDATE=[20210601, 20210601],
    )
    assert call("record", folder, table)[1]["new events"] == ["2"]
    found = rs.survey.SurveyState.read(folder, _catalog(folder)).attempts
    assert [(one.tile, one.state, one.date) for one in found] == [
        ("11", "done", "2021-05-14"),
        ("13", "done", "2021-05-15"),
    ]


def test_states_of_tiles_of_desi_are_read_as_they_are(call, plan, tmp_path):
    """In the table of the states of tiles of DESI, the last night of unobserved tiles is 0."""
    folder = plan()
    table = write(
        tmp_path / "tiles-specstatus.ecsv",
        TILEID=[11, 12, 13, 99],
        OBSSTATUS=["obsend", "obsstart", "unobs", "unobs"],
        LASTNIGHT=[20210514, 20210515, 0, 0],
    )
    _, lines = call("record", folder, table)
    assert (lines["new events"], lines["ignored (not observed)"]) == (["2"], ["2"])
    found = rs.survey.SurveyState.read(folder, _catalog(folder)).attempts
    assert [(one.tile, one.state, one.date) for one in found] == [
        ("11", "done", "2021-05-14"),
        ("12", "partly", "2021-05-15"),
    ]


@pytest.mark.parametrize(
    ("columns", "words", "message"),
    [
        ({"tile": [77], "state": ["done"]}, [], "tile must be a tile of the survey, such as 11, got '77'"),
        ({"tile": [11], "state": ["lost"]}, [], "unknown state of a tile 'lost'"),
        ({"tile": [11], "date": ["soon"]}, [], "date must be a date such as 2026-01-03, got 'soon'"),
        ({"tile": [11]}, ["--tile", "12"], "--tile must be given only for a table without a column of tiles"),
        ({"tile": [11], "fraction": [0.5]}, ["--enough", "nan"], "--enough must be a number above 0, got nan"),
        ({"tile": [11], "fraction": [0.5]}, ["--enough", "0"], "--enough must be a number above 0, got 0.0"),
        ({"tile": [11], "fraction": [0.5]}, ["--enough", "1_0"], "--enough must be a number above 0, got '1_0'"),
        ({"tile": [11], "fraction": [0.5]}, ["--enough", "0x1"], "--enough must be a number above 0, got '0x1'"),
        ({"tile": [11]}, ["--column", "date"], "--column must have the form ROLE=NAME, got 'date'"),
        ({"tile": [11]}, ["--column", "date=no"], "must name columns of the table (tile), got 'no'"),
        ({"tile": [11]}, ["--column", "night=tile"], "unknown role of a column 'night'"),
        ({"x": [11]}, [], "must have a column tile or target, got the columns x"),
    ],
)
def test_invalid_observations_are_one_sentence_and_record_nothing(run, plan, tmp_path, columns, words, message):
    folder = plan()
    table = write(tmp_path / "night.csv", **columns)
    assert message in sentence(*run("record", folder, table, *words)[::2])
    assert not (folder / "events").exists()


def test_nothing_is_recorded_without_a_survey_or_a_table(run, plan, tmp_path):
    table = write(tmp_path / "night.csv", tile=[11])
    assert "does not hold a survey" in sentence(*run("record", tmp_path, table)[::2])
    assert "there is no such file" in sentence(*run("record", plan(), tmp_path / "no.csv")[::2])


@pytest.mark.parametrize("allocator", ["nearest", "joint"])
def test_the_rest_is_planned_with_the_options_of_the_first_plan(call, plan, tmp_path, allocator):
    folder = plan("--allocator", allocator, "--set", "lost_in_collision=false")
    before = parts_of(folder)
    failed = rs.Survey.read(folder).tile(11)["positioner"][:3]
    call("record", folder, write(tmp_path / "a.csv", tile=[11, 12], date=["2026-01-03"] * 2, state=["done", "partly"]))
    call("record", folder, write(tmp_path / "b.csv", positioner=failed, date=["2026-01-03"] * 3), "--tile", 11)
    out, _ = call("survey", folder, "--replan", "--workers", 2)
    again = rs.Survey.read(folder)
    assert again.tiles["state"].tolist() == ["done", "partly", "planned", "planned"]
    assert again.tiles["n_failed"][0] == 3
    assert again.provenance["parameters"]["lost_in_collision"] is False
    after = parts_of(folder)
    assert all(after[name] == before[name] for name in ("000000.fits", "000001.fits"))
    assert after["000002.fits"] != before["000002.fits"]
    assert "replan" not in tomllib.loads((folder / "plan.toml").read_text())["output"]
    state = again.state(_catalog(folder))
    options = {"allocator": allocator, "lost_in_collision": False, "visits": state}
    tiles = rs.Tiling.read(tmp_path / "plan" / "tiles.fits")
    expected = rs.plan_survey(_catalog(folder), "sdss_apo", tiles, **options)
    assert (expected.targets == again.targets).all()
    assert f"wrote {folder}" in out
    call("survey", folder, "--replan")
    assert parts_of(folder) == after


def test_a_copy_of_a_survey_is_planned_again_in_the_copy(call, plan, tmp_path, files):
    folder = plan()
    (tmp_path / "else").mkdir()
    shutil.copytree(folder, files / "copy")
    before = parts_of(folder)
    call("record", files / "copy", write(tmp_path / "a.csv", tile=[11], state=["done"]))
    catalog = f"catalog.path={files / 'stars.fits'}"
    call("survey", files / "copy", "--replan", "--set", catalog, "--tiles", files / "tiles.ecsv")
    assert parts_of(folder) == before
    assert rs.Survey.read(files / "copy").tiles["state"][0] == "done"
    assert not (folder / "events").exists()


def test_options_of_a_new_plan_must_be_those_of_the_first_plan(run, call, plan, tmp_path):
    folder = plan()
    call("record", folder, write(tmp_path / "a.csv", tile=[11], state=["done"]))
    before = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    assert "allocator" in sentence(*run("survey", folder, "--replan", "--allocator", "repair")[::2])
    assert {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()} == before


@pytest.mark.parametrize("allocator", ["nearest", "joint"])
def test_positioners_can_break_between_two_nights(call, run, plan, tmp_path, allocator):
    """Only tiles that were not observed are planned with the present states of positioners."""
    folder = plan("--allocator", allocator)
    before, ids = parts_of(folder), rs.Survey.read(folder).tile(13)["positioner"][:20].tolist()
    call("record", folder, write(tmp_path / "a.csv", tile=[11, 12], state=["done", "partly"]))
    words = ("survey", folder, "--replan")
    message = "(instrument was sdss_apo and is now sdss_lco)"
    assert message in sentence(*run(*words, "--instrument", "sdss_lco")[::2])
    broken = write(tmp_path / "broken.csv", id=ids)
    call(*words, "--set", f"instrument.broken={broken}")
    after, survey = parts_of(folder), rs.Survey.read(folder)
    assert all(after[name] == before[name] for name in ("000000.fits", "000001.fits"))
    assert not set(survey.tile(13)["positioner"].tolist()) & set(ids)
    assert tomllib.loads((folder / "plan.toml").read_text())["instrument"]["broken"] == str(broken)
    call("record", folder, write(tmp_path / "b.csv", tile=[12], state=["done"]))
    call(*words)
    assert parts_of(folder)["000001.fits"] == before["000001.fits"]


def test_an_interrupted_new_plan_continues_with_the_same_command(call, run, plan, tmp_path, monkeypatch):
    folder = plan()
    call("record", folder, write(tmp_path / "a.csv", tile=[11, 12], state=["done", "bad"]))
    shutil.copytree(folder, tmp_path / "other")
    from rfpsurvey.survey import _run

    def stop(job):
        if job.tile == 13:
            raise OSError("the disk is full")
        return work(job)

    work = _run.work
    with monkeypatch.context() as patch:
        patch.setattr(_run, "work", stop)
        code, _, err = run("survey", folder, "--replan")
    assert (code, err.splitlines()[-1]) == (2, "rfpsurvey: the disk is full")
    text = " ".join(call("status", folder)[0].split())  # that of the present plan
    assert text.endswith(f"to plan the rest: rfpsurvey survey {folder} --replan")
    assert len([*(folder / "next/tiles/000").iterdir()]) == 1
    call("survey", folder, "--replan")
    call("survey", tmp_path / "other", "--replan")
    assert parts_of(folder) == parts_of(tmp_path / "other")
    assert (folder / "tiles.fits").read_bytes() == (tmp_path / "other" / "tiles.fits").read_bytes()


def test_a_survey_without_a_plan_file_is_planned_again_with_its_options(run, call, plan, files, tmp_path):
    folder = plan()
    (folder / "plan.toml").unlink()
    message = f"{folder} must contain the file plan.toml, got"
    assert message in sentence(*run("survey", folder, "--replan")[::2])
    call("record", folder, write(tmp_path / "a.csv", tile=[11], state=["done"]))
    words = (files / "stars.fits", "--tiles", files / "tiles.ecsv", "--folder", folder)
    call(*COMMAND, *words, "--replan")
    assert rs.Survey.read(folder).tiles["state"][0] == "done"


def test_a_new_plan_needs_a_survey(run, files, tmp_path):
    message = "--replan must be used with the folder of a survey, such as rfpsurvey survey FOLDER --replan, got"
    words = (*COMMAND, files / "stars.fits", "--tiles", files / "tiles.ecsv", "--replan")
    assert message in sentence(*run(*words)[::2])
    assert message in sentence(*run(*words, "--folder", tmp_path / "new")[::2])
    assert f"{message} {tmp_path / 'none'}" in sentence(*run("survey", tmp_path / "none", "--replan")[::2])
    assert not (tmp_path / "new").exists()


def test_a_survey_with_events_is_not_continued_as_a_first_plan(run, call, plan, tmp_path):
    folder = plan()
    call("record", folder, write(tmp_path / "a.csv", tile=[11], state=["done"]))
    message = "holds a survey with recorded events"
    assert message in sentence(*run("survey", folder / "plan.toml", "--resume")[::2])


def test_the_first_plan_follows_the_rule(call, plan, tmp_path):
    """Before the first success, the rule requests one visit of each target."""
    folder = plan("--set", "rule.after_success=4")
    survey = rs.Survey.read(folder)
    assert set(survey.outcomes["requested"].tolist()) == {1}
    assert tomllib.loads((folder / "plan.toml").read_text())["rule"] == {"after_success": 4}
    call("record", folder, write(tmp_path / "a.csv", tile=[11], state=["done"]))
    call("survey", folder, "--replan")
    again = rs.Survey.read(folder)
    good = np.zeros(len(again.outcomes), dtype=bool)
    visits = again.tile(11)
    good[visits["target_row"][visits["observed"]]] = True
    assert (again.outcomes["requested"] == np.where(good, 4, 1)).all()


def test_tables_of_rules_are_relative_to_the_plan_file(call, plan, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write(tmp_path / "rule.ecsv", observed=[0, 1], visits=[2, 2], priority=[5.0, 1.0])
    folder = plan("--set", "rule.table=rule.ecsv")
    assert tomllib.loads((folder / "plan.toml").read_text())["rule"] == {"table": "../rule.ecsv"}
    monkeypatch.chdir(folder)
    assert set(rs.Survey.read(folder).outcomes["requested"].tolist()) == {2}
    call("record", folder, write(tmp_path / "a.csv", tile=[11], state=["done"]))
    call("survey", folder, "--replan")
    assert {"5", "1"} <= {str(one).removesuffix(".0") for one in rs.Survey.read(folder).completeness["priority"]}


def test_visits_of_the_command_line_are_those_of_the_rule(call, plan):
    folder = plan("--set", "rule.retries=1", "--visits", 3)
    assert set(rs.Survey.read(folder).outcomes["requested"].tolist()) == {3}


def test_visits_that_a_rule_replaces_cause_a_warning(run, files):
    """Regression: the number of visits was ignored without a warning."""
    words = (*COMMAND, files / "stars.fits", "--tiles", files / "tiles.ecsv", "--visits", 2)
    for key in ("rule.visits", "rule.after_success"):
        assert f"{key} replaces the number of visits of all targets (2)" in run(*words, "--set", f"{key}=4")[2]
    assert "replaces" not in run(*words, "--set", "rule.retries=1")[2]


def test_invalid_rules_are_one_sentence(run, files, tmp_path):
    words = (*COMMAND, files / "stars.fits", "--tiles", files / "tiles.ecsv", "--folder", tmp_path / "new")
    message = "rule.after_success must be a whole number from 1 to 255, got 0"
    assert message in sentence(*run(*words, "--set", "rule.after_success=0")[::2])
    assert "there is no such file" in sentence(*run(*words, "--set", "rule.table=no.ecsv")[::2])
    assert not (tmp_path / "new").exists()
    written = ("--set", "rule.after_success=0", "--write-plan", tmp_path / "plan.toml")
    assert message in sentence(*run(*words, *written)[::2])
    assert not (tmp_path / "plan.toml").exists()


def test_a_survey_without_events_is_planned_again(call, plan):
    folder = plan()
    before = parts_of(folder)
    call("survey", folder, "--replan")
    assert parts_of(folder) == before
    assert set(rs.Survey.read(folder).tiles["state"].tolist()) == {"planned"}


@pytest.fixture
def observed(call, plan, tmp_path):
    """Return a survey with two observed tiles, of which three visits failed, and a dropped tile."""
    folder = plan()
    failed = rs.Survey.read(folder).tile(11)["positioner"][:3]
    table = write(
        tmp_path / "a.csv", tile=[11, 12, 13], date=["2026-01-03", "2026-01-05", ""], state=["done", "done", "dropped"]
    )
    call("record", folder, table)
    call("record", folder, write(tmp_path / "b.csv", positioner=failed, date=["2026-01-03"] * 3), "--tile", 11)
    return folder


def test_the_status_is_that_of_the_library(call, observed, tmp_path):
    out, lines = call("status", observed)
    assert [line for line in out.splitlines() if len(line) > 100] == []
    assert "the last plan does not take all recorded events into account" in out
    call("survey", observed, "--replan")
    out, again = call("status", observed, "--output", tmp_path / "targets.fits", "--plot", tmp_path / "status.png")
    assert "the last plan does not" not in out
    survey, state = rs.Survey.read(observed), rs.survey.SurveyState.read(observed, _catalog(observed))
    assert again["observed"] == lines["observed"]
    s = survey.summary
    assert again["observed"] == [str(int(state.observed.sum()))]
    assert [again[name] for name in ("finished", "dropped", "not yet observed")] == [["2"], ["1"], ["1"]]
    assert again["visits requested"] == [str(s["n_visits_requested"])]
    assert again["failed visits"] == lines["failed visits"] == ["3"]
    assert again["planned"] == [str(s["n_visits_observed"] - int(state.observed.sum()))]
    assert again["first and last date"] == ["2026-01-03", "2026-01-05"]
    table = Table.read(tmp_path / "targets.fits")
    assert (np.asarray(table["observed"]) == state.observed).all()
    assert table["last_date"].tolist().count("2026-01-05") == int((state.table["last_date"] == "2026-01-05").sum()) > 0
    assert (tmp_path / "status.png").read_bytes().startswith(b"\x89PNG")


def test_the_status_of_an_earlier_date(call, observed):
    out, lines = call("status", observed, "--until", "2026-01-04")
    assert lines["finished"] == ["1"]
    assert "the last plan" not in out
    assert lines["first and last date"] == ["2026-01-03", "2026-01-03"]


def test_the_report_of_the_status(call, observed, tmp_path):
    call("status", observed, "--report", tmp_path / "status.html")
    page = (tmp_path / "status.html").read_text()
    assert "Status of a survey with sdss_apo" in page
    assert "Events were recorded after the last plan" in page
    assert "2026-01-05" in page


def test_invalid_input_of_the_status_is_one_sentence(run, observed, tmp_path):
    assert "does not hold a survey" in sentence(*run("status", tmp_path)[::2])
    assert "date must be a date" in sentence(*run("status", observed, "--until", "soon")[::2])
    assert "must end in" in sentence(*run("status", observed, "--output", tmp_path / "x.txt")[::2])
    (observed / "plan.toml").unlink()
    assert "must contain the file plan.toml" in sentence(*run("status", observed, "--report", tmp_path / "x.html")[::2])
    assert not (tmp_path / "x.html").exists()


def test_files_are_verified(call, run, observed, tmp_path):
    """Each missing or damaged file is one line, and the exit code is 1."""
    assert call("status", observed, "--verify")[0] == "0 files missing or damaged\n"
    call("survey", observed, "--replan")
    (observed / "notes.txt").write_text("")
    notes = "notes.txt: does not belong to the survey, and is not used"
    assert call("status", observed, "--verify")[0].splitlines() == [notes, "0 files missing or damaged"]
    (observed / "tiles/000/000003.fits").write_bytes(b"")
    (observed / "events/000001.json").unlink()
    code, out, err = run("status", observed, "--verify")
    assert (code, err) == (1, "")
    assert out.splitlines() == [
        "events/000001.json: is missing, but 000002.json exists; restore it from a backup",
        "tiles/000/000003.fits: is damaged (its checksum differs from the checksum recorded in the index); it is made "
        "again when the survey is planned again",
        notes,
        "2 files missing or damaged",
    ]
    assert "does not hold a survey" in sentence(*run("status", tmp_path, "--verify")[::2])
    assert "without other options" in sentence(*run("status", observed, "--verify", "--until", "2026-01-04")[::2])


def test_differences_of_two_plans(call, observed, tmp_path):
    shutil.copytree(observed, tmp_path / "before")
    out = " ".join(call("diff", tmp_path / "before", observed)[0].split())  # long paths are wrapped
    assert out.startswith("the plans are the same: 4 tiles events that were recorded in")
    assert out.count("after its last plan are not compared") == 2
    call("survey", observed, "--replan")
    out, lines = call("diff", tmp_path / "before", observed, "--output", tmp_path / "changes.fits")
    table = Table.read(tmp_path / "changes.fits")
    expected = rs.survey.diff_surveys(tmp_path / "before", observed)
    assert table["reason"].tolist() == expected["reason"].tolist()
    assert lines["tiles: observed"] == ["2"]
    assert lines["tiles: dropped"] == ["1"]
    n = int(((expected["tile"] == "14") & (expected["positioner"] != "")).sum())
    assert f"tile 14: {n} fibers changed" in out
    assert "tile 11: observed\n" in out


def test_invalid_input_of_differences_is_one_sentence(run, observed, tmp_path):
    assert "does not hold a survey" in sentence(*run("diff", observed, tmp_path)[::2])
    assert "must end in" in sentence(*run("diff", observed, observed, "--output", tmp_path / "x.txt")[::2])


def test_a_wrong_night_is_found_and_undone(run, call, plan, tmp_path):
    folder = plan()
    call("record", folder, write(tmp_path / "a.csv", tile=[11], date=["2026-01-03"]), "--note", "first night")
    call("record", folder, write(tmp_path / "b.csv", tile=[12, 13], date=["2026-01-04"] * 2))
    out = call("status", folder, "--events")[0].splitlines()
    assert out[0].split()[:6] == ["number", "generation", "time", "user", "table", "note"]
    assert [line.split()[0] for line in out[2:]] == ["1", "2"]
    assert "first night" in out[2]
    out, lines = call("record", folder, "--undo", "2", "--dry-run")
    assert lines["tiles observed"] == ["2", "12,", "13"]
    assert "nothing was undone (--dry-run)" in out
    assert "record 2 undone" in call("record", folder, "--undo", "2", "--note", "another survey")[0]
    assert [event.tile for event in rs.Survey.read(folder).state().attempts] == ["11"]
    out, lines = call("record", folder, "--undo", "3", "--dry-run")
    assert lines["tiles observed"] == ["2", "12,", "13"]
    assert "record 2 takes effect again" in out
    assert "either a table or --undo must be given, got neither" in sentence(*run("record", folder)[::2])
    both = run("record", folder, tmp_path / "a.csv", "--undo", "1")
    assert "either a table or --undo must be given, got both" in sentence(*both[::2])
    assert "without options of tables" in sentence(*run("record", folder, "--undo", "1", "--replaces")[::2])
    assert "without other options" in sentence(*run("status", folder, "--events", "--verify")[::2])


def test_a_rule_is_an_entry_point_of_a_package(call, plan, install):
    install(
        "mine", "def rule(table):\n    return {'visits': 3 - (table['priority'] == 1)}\n", visit_rules={"mine": "rule"}
    )
    folder = plan("--set", "rule.function=mine")
    assert tomllib.loads((folder / "plan.toml").read_text())["rule"] == {"function": "mine"}
    survey = rs.Survey.read(folder)
    assert (survey.outcomes["requested"] == 3 - (_catalog(folder).priority == 1)).all()


def test_lists_of_tiles_and_catalogs_are_not_recorded(run, call, plan, files, tmp_path):
    """Regression: all tiles became finished tiles without a date, and each target of a catalog became an event."""
    folder = plan()
    assert "must have one of the columns state, good" in sentence(*run("record", folder, files / "tiles.ecsv")[::2])
    assert "must have a column state" in sentence(*run("record", folder, files / "stars.fits")[::2])
    out, lines = call("record", folder, write(tmp_path / "a.csv", tile=[11, 12], state=["done", "bad"]), "--dry-run")
    assert lines["new events"] == ["2"]
    assert lines["tiles observed"] == ["1", "11"]
    assert lines["tiles whose observation was bad"] == ["1", "12"]
    assert "nothing was recorded" in out
    assert not (folder / "events").exists()


SEED = "options.subpriority=1"
NIGHTS = (
    {"tile": [11, 12], "date": ["2026-01-03"] * 2, "state": ["done", "partly"]},
    {"tile": [12], "date": ["2026-01-04"], "state": ["done"]},
    {"tile": [13, 14], "date": ["2026-01-05"] * 2, "state": ["bad", "done"]},
)


@pytest.mark.parametrize("users", ["ppp", "cpc", "pcp", "pcc", "cpp"])
def test_python_and_commands_continue_each_others_surveys(call, plan, files, tmp_path, users):
    """All tiles, the outcomes and the selection of three nights equal those of commands only, in any turn."""
    expected = plan("--set", SEED)
    others = tmp_path / "others"
    if users[0] == "c":
        call(*COMMAND, *(files / "stars.fits", "--tiles", files / "tiles.ecsv", "--folder", others), "--set", SEED)
    else:
        sky, tiling = rs.Catalog.read(files / "stars.fits"), rs.Tiling.read(files / "tiles.ecsv")
        sky = rs.Catalog(sky.coord, id=sky.id, priority=sky.priority, visits=sky.visits)  # not that of a file
        options = rs.AllocationOptions("nearest", subpriority=1)
        rs.plan_survey(sky, rs.Instrument.preset("sdss_apo"), tiling, allocator=options, folder=others)
    for k, (user, night) in enumerate(zip(users, NIGHTS, strict=True)):
        table = write(tmp_path / f"{k}.csv", **night)
        call("record", expected, table)
        call("survey", expected, "--replan")
        if user == "c":
            call("record", others, table)
            call("survey", others, "--replan", "--workers", 2)
        else:
            rs.Survey.read(others).record(Table(night))
            rs.Survey.read(others).replan()
        assert parts_of(others) == parts_of(expected)
        assert (others / "outcomes.fits").read_bytes() == (expected / "outcomes.fits").read_bytes()
    _, lines = call("status", others)
    same = {name: value for name, value in call("status", expected)[1].items() if not name.startswith("columns")}
    assert {name: value for name, value in lines.items() if not name.startswith("columns")} == same
    assert int(lines["finished"][0]) == rs.Survey.read(others).state().summary["n_tiles_observed"] == 3
    call("select", others, "--n-realizations", 2, "--output", tmp_path / "selection.fits")
    bits = rs.SelectionProbabilities.read(tmp_path / "selection.fits").bits
    assert np.array_equal(bits, rs.Survey.read(expected).select(2).bits)


@pytest.mark.filterwarnings("ignore:no target was observed")
def test_what_no_file_describes_is_no_default_of_commands(run, files, tmp_path):
    sky = rs.Catalog.read(files / "stars.fits")
    survey = rs.plan_survey(
        sky, "sdss_apo", rs.Tiling.read(files / "tiles.ecsv"), allocator=nothing, folder=tmp_path / "plan"
    )
    assert survey.summary["n_assigned"] == 0
    code, _, err = run("survey", tmp_path / "plan", "--replan")
    assert "unknown allocator 'given in Python'" in sentence(code, err)


def nothing(problem):
    """Assign nothing."""
    return np.full(len(problem.focal_plane), -1)


def test_visits_of_the_command_replace_those_of_the_survey(call, plan, tmp_path):
    folder = plan()
    expected = rs.Survey.read(folder).state(visits=2).requested
    call("select", folder, "--visits", 2, "--n-realizations", 1, "--output", tmp_path / "selection.fits")
    found = rs.SelectionProbabilities.read(tmp_path / "selection.fits").requested
    assert set(found.tolist()) == {2}
    assert np.array_equal(found, expected)
