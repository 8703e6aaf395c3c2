"""The commands ``record`` and ``survey --replan`` of surveys over several nights."""

import shutil
import tomllib

import numpy as np
import pytest
from astropy.table import Table

import rfpsurvey as rs
from rfpsurvey._survey import run as _run

NIGHT = "2026-01-03"


def parts_of(folder):
    """Return the content of the files of the tiles by name."""
    return {path.name: path.read_bytes() for path in folder.rglob("tiles/*/*.fits")}


def write(path, **columns):
    Table(columns).write(path)
    return path


def keys_of(folder):
    return tomllib.loads((folder / "plan.toml").read_text())


def catalog_of(folder):
    return rs.Catalog.read(folder / keys_of(folder)["catalog"]["path"])


def state_of(folder):
    return rs.survey.SurveyState.read(folder, catalog_of(folder))


def attempts_of(folder):
    return [(one.tile, one.state, one.date) for one in state_of(folder).attempts]


@pytest.mark.parametrize("ending", ["ecsv", "csv", "fits"])
def test_observations_are_recorded_from_files(call, plan, tmp_path, ending):
    folder = plan()
    table = write(tmp_path / f"night.{ending}", tile=[11, 12], date=[NIGHT] * 2, fraction=[1.0, 0.5])
    assert call("record", folder, table).lines["new events"] == ["2"]
    again = call("record", folder, table)
    assert (again.lines["new events"], again.lines["already recorded"]) == (["0"], ["2"])
    assert "--replan" not in again.out
    assert [one.state for one in state_of(folder).attempts] == ["done", "partly"]


def test_the_fraction_that_is_enough_is_an_option(record, plan):
    folder = plan()
    record(folder, "--enough 0.8", tile=[11], fraction=[0.9])
    assert state_of(folder).summary["n_tiles_observed"] == 1


def test_columns_with_other_names_are_named(record, plan):
    folder = plan()
    record(folder, "--column tile=field --column date=night_of", field=[11], night_of=[NIGHT], state=["observed"])
    assert attempts_of(folder) == [("11", "done", NIGHT)]


# the list of finished tiles of DESI (mtl-done-tiles.ecsv) has a row for each finished tile
DONE = {
    "TILEID": [11, 13],
    "TIMESTAMP": ["2021-05-15T17:02:33+00:00", "2021-05-16T17:02:33+00:00"],
    "VERSION": ["2.1.0", "2.1.0"],
    "PROGRAM": ["DARK", "DARK"],
    "ZDATE": [20210514, 20210515],
    "ARCHIVEDATE": [20210601, 20210601],
}
# in the table of the states of tiles of DESI, the last night of unobserved tiles is 0
STATES = {
    "TILEID": [11, 12, 13, 99],
    "OBSSTATUS": ["obsend", "obsstart", "unobs", "unobs"],
    "LASTNIGHT": [20210514, 20210515, 0, 0],
}


@pytest.mark.parametrize(
    ("name", "columns", "ignored", "second"),
    [("mtl-done-tiles.ecsv", DONE, ["0"], ("13", "done")), ("tiles-specstatus.ecsv", STATES, ["2"], ("12", "partly"))],
)
def test_tables_of_tiles_of_desi_are_read_as_they_are(record, plan, name, columns, ignored, second):
    folder = plan()
    lines = record(folder, name=name, **columns).lines
    assert (lines["new events"], lines["ignored (not observed)"]) == (["2"], ignored)
    assert attempts_of(folder) == [("11", "done", "2021-05-14"), (*second, "2021-05-15")]


@pytest.mark.parametrize(
    ("columns", "options", "message"),
    [
        ({"tile": [77], "state": ["done"]}, "", "tile must be a tile of the survey, such as 11, got '77'"),
        ({"tile": [11]}, "--tile 12", "--tile must be given only for a table without a column of tiles"),
        ({"fraction": [0.5]}, "--enough nan", "--enough must be a number above 0, got nan"),
        ({"fraction": [0.5]}, "--enough 0", "--enough must be a number above 0, got 0.0"),
        ({"fraction": [0.5]}, "--enough 1_0", "--enough must be a number above 0, got '1_0'"),
        ({"fraction": [0.5]}, "--enough 0x1", "--enough must be a number above 0, got '0x1'"),
        ({}, "--column date", "--column must have the form ROLE=NAME, got 'date'"),
        ({}, "--column date=no", "must name columns of the table (tile), got 'no'"),
        ({}, "--column night=tile", "unknown role of a column 'night'"),
    ],
)
def test_invalid_observations_are_one_sentence_and_record_nothing(refused, plan, tmp_path, columns, options, message):
    folder, table = plan(), write(tmp_path / "night.csv", **{"tile": [11], **columns})
    assert message in refused(f"record {{}} {{}} {options}", folder, table)
    assert not (folder / "events").exists()


def test_nothing_is_recorded_without_a_survey_or_a_table(refused, plan, tmp_path):
    assert "does not hold a survey" in refused("record", tmp_path, write(tmp_path / "night.csv", tile=[11]))
    assert "there is no such file" in refused("record", plan(), tmp_path / "no.csv")


@pytest.mark.parametrize("allocator", ["nearest", "joint"])
def test_the_rest_is_planned_with_the_options_of_the_first_plan(call, plan, record, allocator):
    folder = plan(f"--allocator {allocator} --set lost_in_collision=false")
    before, failed = parts_of(folder), rs.Survey.read(folder).tile(11)["positioner"][:3]
    record(folder, tile=[11, 12], date=[NIGHT] * 2, state=["done", "partly"])
    record(folder, "--tile 11", positioner=failed, date=[NIGHT] * 3)
    out, again = call("survey {} --replan --workers 2", folder).out, rs.Survey.read(folder)
    assert again.tiles["state"].tolist() == ["done", "partly", "planned", "planned"]
    assert again.tiles["n_failed"][0] == 3
    assert again.provenance["parameters"]["lost_in_collision"] is False
    after = parts_of(folder)
    assert all(after[name] == before[name] for name in ("000000.fits", "000001.fits"))
    assert after["000002.fits"] != before["000002.fits"]
    assert "replan" not in keys_of(folder)["output"]
    options = {"allocator": allocator, "lost_in_collision": False, "visits": again.state(catalog_of(folder))}
    expected = rs.plan_survey(catalog_of(folder), "sdss_apo", rs.Tiling.read(folder / "tiles.fits"), **options)
    assert (expected.targets == again.targets).all()
    assert f"wrote {folder}" in out
    call("survey {} --replan", folder)
    assert parts_of(folder) == after


def test_a_copy_of_a_survey_is_planned_again_in_the_copy(call, plan, record, tmp_path, files):
    folder, copy = plan(), files / "copy"
    (tmp_path / "else").mkdir()
    shutil.copytree(folder, copy)
    before = parts_of(folder)
    record(copy, tile=[11], state=["done"])
    catalog = f"catalog.path={files / 'stars.fits'}"
    call("survey {} --replan --set {} --tiles {}", copy, catalog, files / "tiles.ecsv")
    assert (parts_of(folder), rs.Survey.read(copy).tiles["state"][0]) == (before, "done")
    assert not (folder / "events").exists()


def test_options_of_a_new_plan_must_be_those_of_the_first_plan(refused, plan, record):
    folder = plan()
    record(folder, tile=[11], state=["done"])
    before = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    assert "allocator" in refused("survey {} --replan --allocator repair", folder)
    assert {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()} == before


@pytest.mark.parametrize("allocator", ["nearest", "joint"])
def test_positioners_can_break_between_two_nights(call, refused, plan, record, tmp_path, allocator):
    """Only tiles that were not observed are planned with the present states of positioners."""
    folder = plan(f"--allocator {allocator}")
    before, ids = parts_of(folder), rs.Survey.read(folder).tile(13)["positioner"][:20].tolist()
    record(folder, tile=[11, 12], state=["done", "partly"])
    message = "(instrument was sdss_apo and is now sdss_lco)"
    assert message in refused("survey {} --replan --instrument sdss_lco", folder)
    broken = write(tmp_path / "broken.csv", id=ids)
    call("survey {} --replan --set instrument.broken={}", folder, broken)
    after, survey = parts_of(folder), rs.Survey.read(folder)
    assert all(after[name] == before[name] for name in ("000000.fits", "000001.fits"))
    assert not set(survey.tile(13)["positioner"].tolist()) & set(ids)
    assert keys_of(folder)["instrument"]["broken"] == str(broken)
    record(folder, tile=[12], state=["done"])
    call("survey {} --replan", folder)
    assert parts_of(folder)["000001.fits"] == before["000001.fits"]


def test_an_interrupted_new_plan_continues_with_the_same_command(call, run, plan, record, tmp_path, monkeypatch):
    folder, other, work = plan(), tmp_path / "other", _run.work
    record(folder, tile=[11, 12], state=["done", "bad"])
    shutil.copytree(folder, other)

    def stop(job):
        if job.tile == 13:
            raise OSError("the disk is full")
        return work(job)

    with monkeypatch.context() as patch:
        patch.setattr(_run, "work", stop)
        code, _, err = run("survey", folder, "--replan")
    assert (code, err.splitlines()[-1]) == (2, "rfpsurvey: the disk is full")
    # the status is that of the present plan
    assert call("status", folder).text.endswith(f"to plan the rest: rfpsurvey survey {folder} --replan")
    assert len([*(folder / "next/tiles/000").iterdir()]) == 1
    for one in (folder, other):
        call("survey {} --replan", one)
    assert parts_of(folder) == parts_of(other)
    assert (folder / "tiles.fits").read_bytes() == (other / "tiles.fits").read_bytes()


def test_a_survey_without_a_plan_file_is_planned_again_with_its_options(call, refused, plan, record, words):
    folder = plan()
    (folder / "plan.toml").unlink()
    assert f"{folder} must contain the file plan.toml, got" in refused("survey {} --replan", folder)
    record(folder, tile=[11], state=["done"])
    call(f"{words[0]} --folder {{}} --replan", *words[1:], folder)
    assert rs.Survey.read(folder).tiles["state"][0] == "done"


def test_a_new_plan_needs_a_survey(refused, words, tmp_path):
    message = "--replan must be used with the folder of a survey, such as rfpsurvey survey FOLDER --replan, got"
    assert message in refused(f"{words[0]} --replan", *words[1:])
    assert message in refused(f"{words[0]} --replan --folder", *words[1:], tmp_path / "new")
    assert f"{message} {tmp_path / 'none'}" in refused("survey {} --replan", tmp_path / "none")
    assert not (tmp_path / "new").exists()


def test_a_survey_with_events_is_not_continued_as_a_first_plan(refused, plan, record):
    folder = plan()
    record(folder, tile=[11], state=["done"])
    assert "holds a survey with recorded events" in refused("survey {} --resume", folder / "plan.toml")


def test_the_first_plan_follows_the_rule(call, plan, record):
    """Before the first success, the rule requests one visit of each target."""
    folder = plan("--set rule.after_success=4")
    assert set(rs.Survey.read(folder).outcomes["requested"].tolist()) == {1}
    assert keys_of(folder)["rule"] == {"after_success": 4}
    record(folder, tile=[11], state=["done"])
    call("survey {} --replan", folder)
    again = rs.Survey.read(folder)
    good, visits = np.zeros(len(again.outcomes), dtype=bool), again.tile(11)
    good[visits["target_row"][visits["observed"]]] = True
    assert (again.outcomes["requested"] == np.where(good, 4, 1)).all()


def test_tables_of_rules_are_relative_to_the_plan_file(call, plan, record, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write(tmp_path / "rule.ecsv", observed=[0, 1], visits=[2, 2], priority=[5.0, 1.0])
    folder = plan("--set rule.table=rule.ecsv")
    assert keys_of(folder)["rule"] == {"table": "../rule.ecsv"}
    monkeypatch.chdir(folder)
    assert set(rs.Survey.read(folder).outcomes["requested"].tolist()) == {2}
    record(folder, tile=[11], state=["done"])
    call("survey {} --replan", folder)
    assert {"5", "1"} <= {str(one).removesuffix(".0") for one in rs.Survey.read(folder).completeness["priority"]}


def test_visits_of_the_command_line_are_those_of_the_rule(plan):
    assert set(rs.Survey.read(plan("--set rule.retries=1 --visits 3")).outcomes["requested"].tolist()) == {3}


def test_visits_that_a_rule_replaces_cause_a_warning(call, words):
    """Regression: the number of visits was ignored without a warning."""
    for key in ("rule.visits", "rule.after_success"):
        err = call(f"{words[0]} --visits 2 --set {key}=4", *words[1:]).err
        assert f"{key} replaces the number of visits of all targets (2)" in err
    assert "replaces" not in call(f"{words[0]} --visits 2 --set rule.retries=1", *words[1:]).err


def test_invalid_rules_are_one_sentence(refused, words, tmp_path):
    new = (*words[1:], tmp_path / "new")
    message = "rule.after_success must be a whole number from 1 to 255, got 0"
    assert message in refused(f"{words[0]} --folder {{}} --set rule.after_success=0", *new)
    assert "there is no such file" in refused(f"{words[0]} --folder {{}} --set rule.table=no.ecsv", *new)
    assert message in refused(f"{words[0]} --write-plan {{}} --set rule.after_success=0", *new)
    assert not (tmp_path / "new").exists()


def test_a_wrong_night_is_found_and_undone(call, refused, plan, record, tmp_path):
    folder = plan()
    record(folder, "--note 'first night'", tile=[11], date=[NIGHT])
    record(folder, tile=[12, 13], date=["2026-01-04"] * 2)
    out = call("status {} --events", folder).out.splitlines()
    assert out[0].split()[:6] == ["number", "generation", "time", "user", "table", "note"]
    assert [line.split()[0] for line in out[2:]] == ["1", "2"]
    assert "first night" in out[2]
    found = call("record {} --undo 2 --dry-run", folder)
    assert found.lines["tiles observed"] == ["2", "12,", "13"]
    assert "nothing was undone (--dry-run)" in found.out
    assert "record 2 undone" in call("record {} --undo 2 --note 'another survey'", folder).out
    assert [event.tile for event in rs.Survey.read(folder).state().attempts] == ["11"]
    found = call("record {} --undo 3 --dry-run", folder)
    assert found.lines["tiles observed"] == ["2", "12,", "13"]
    assert "record 2 takes effect again" in found.out
    assert "either a table or --undo must be given, got neither" in refused("record", folder)
    both = refused("record {} {} --undo 1", folder, tmp_path / "night.csv")
    assert "either a table or --undo must be given, got both" in both
    assert "without options of tables" in refused("record {} --undo 1 --replaces", folder)
    assert "without other options" in refused("status {} --events --verify", folder)


def test_a_rule_is_an_entry_point_of_a_package(plan, install):
    code = "def rule(table):\n    return {'visits': 3 - (table['priority'] == 1)}\n"
    install("mine", code, visit_rules={"mine": "rule"})
    folder = plan("--set rule.function=mine")
    assert keys_of(folder)["rule"] == {"function": "mine"}
    assert (rs.Survey.read(folder).outcomes["requested"] == 3 - (catalog_of(folder).priority == 1)).all()


def test_lists_of_tiles_and_catalogs_are_not_recorded(refused, plan, record, files):
    """Regression: all tiles became finished tiles without a date, and each target of a catalog became an event."""
    folder = plan()
    assert "must have one of the columns state, good" in refused("record", folder, files / "tiles.ecsv")
    assert "must have a column state" in refused("record", folder, files / "stars.fits")
    found = record(folder, "--dry-run", tile=[11, 12], state=["done", "bad"])
    assert (found.lines["new events"], found.lines["tiles observed"]) == (["2"], ["1", "11"])
    assert found.lines["tiles whose observation was bad"] == ["1", "12"]
    assert "nothing was recorded" in found.out
    assert not (folder / "events").exists()


SEED = "--set options.subpriority=1"
NIGHTS = (
    {"tile": [11, 12], "date": [NIGHT] * 2, "state": ["done", "partly"]},
    {"tile": [12], "date": ["2026-01-04"], "state": ["done"]},
    {"tile": [13, 14], "date": ["2026-01-05"] * 2, "state": ["bad", "done"]},
)


@pytest.mark.parametrize("users", ["ppp", "cpc", "pcp"])
def test_python_and_commands_continue_each_others_surveys(call, plan, record, words, tmp_path, users):
    """All tiles, the outcomes and the selection of three nights equal those of commands only, in any turn."""
    expected, others = plan(SEED), tmp_path / "others"
    if users[0] == "c":
        call(f"{words[0]} --folder {{}} {SEED}", *words[1:], others)
    else:
        sky, tiling = rs.Catalog.read(words[1]), rs.Tiling.read(words[2])
        sky = rs.Catalog(sky.coord, id=sky.id, priority=sky.priority, visits=sky.visits)  # not that of a file
        options = rs.AllocationOptions("nearest", subpriority=1)
        rs.plan_survey(sky, rs.Instrument.preset("sdss_apo"), tiling, allocator=options, folder=others)
    for user, night in zip(users, NIGHTS, strict=True):
        record(expected, **night)
        call("survey {} --replan", expected)
        if user == "c":
            record(others, **night)
            call("survey {} --replan --workers 2", others)
        else:
            rs.Survey.read(others).record(Table(night))
            rs.Survey.read(others).replan()
        assert parts_of(others) == parts_of(expected)
        assert (others / "outcomes.fits").read_bytes() == (expected / "outcomes.fits").read_bytes()
    both = [call("status", folder).lines for folder in (others, expected)]
    one, other = ({name: value for name, value in one.items() if not name.startswith("columns")} for one in both)
    assert one == other
    assert int(one["finished"][0]) == rs.Survey.read(others).state().summary["n_tiles_observed"] == 3
    call("select {} --n-realizations 2 --output {}", others, tmp_path / "selection.fits")
    bits = rs.SelectionProbabilities.read(tmp_path / "selection.fits").bits
    assert np.array_equal(bits, rs.Survey.read(expected).select(2).bits)


@pytest.mark.filterwarnings("ignore:no target was observed")
def test_what_no_file_describes_is_no_default_of_commands(refused, words, tmp_path):
    folder, tiles = tmp_path / "plan", rs.Tiling.read(words[2])
    survey = rs.plan_survey(rs.Catalog.read(words[1]), "sdss_apo", tiles, allocator=nothing, folder=folder)
    assert survey.summary["n_assigned"] == 0
    assert "unknown allocator 'given in Python'" in refused("survey {} --replan", folder)


def nothing(problem):
    """Assign nothing."""
    return np.full(len(problem.focal_plane), -1)


def test_visits_of_the_command_replace_those_of_the_survey(call, plan, tmp_path):
    folder = plan()
    expected = rs.Survey.read(folder).state(visits=2).requested
    call("select {} --visits 2 --n-realizations 1 --output {}", folder, tmp_path / "selection.fits")
    found = rs.SelectionProbabilities.read(tmp_path / "selection.fits").requested
    assert set(found.tolist()) == {2}
    assert np.array_equal(found, expected)
