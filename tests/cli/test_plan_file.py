"""Plan files, the option --set, and the keys of commands."""

import sys
import tomllib
from dataclasses import fields
from pathlib import Path

import astropy.units as u
import numpy as np
import pytest

import rfpsurvey as rs
from rfpsurvey._cli import plan, survey
from rfpsurvey._survey import key_objects as _plan_file
from rfpsurvey._survey.key_types import Part, build, keys_of

SURVEY = keys_of(survey.SurveyKeys)


def values_of(text, keys=SURVEY, folder="."):
    """Return the values in the text of a plan file."""
    values = {}
    _plan_file.add(keys, values, "", tomllib.loads(text), _plan_file.Path(folder))
    return values


def after_set(*texts, keys=SURVEY):
    """Return the values that --set gives."""
    values, earlier = {}, set()
    for text in texts:
        _plan_file.add_text(keys, values, text, earlier)
    return values


def test_the_fields_of_the_library_are_keys():
    """A new field of these classes is a key, with its help, of the file, of --set and of the list of keys."""
    for table, cls in {
        "options": rs.AllocationOptions,
        "joint": rs.JointOptions,
        "conditions": rs.ObservingConditions,
        "instrument.margins": rs.Margins,
    }.items():
        names = {one.name for one in fields(cls)} - {"inform"} - ({"allocator"} if cls is rs.JointOptions else set())
        assert {f"{table}.{name}" for name in names} <= set(SURVEY)
    assert all(key.text for key in SURVEY.values() if not isinstance(key, Part))


def test_a_survey_is_written_as_a_file_and_the_file_gives_the_same_survey(call, refused, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "files").mkdir()
    words = "survey --instrument moons --set options.objective=count --allocator lamost_rule --rng 3 --passes 2 "
    words += "--constraint 'keep_out 95.0 23.0 0.02' --folder"
    assert call(f"{words} first --write-plan files/plan.toml") == (
        "wrote files/plan.toml; to run the plan: rfpsurvey survey files/plan.toml\n",
        "",
    )
    text = Path("files/plan.toml").read_text()
    assert 'folder = "../first"' in text
    assert "# Largest number of iterations. Value: a whole number from 0 to 100000.\n# iterations = 10" in text
    assert not Path("first").exists()
    for command in ("survey files/plan.toml", f"{words} second", "survey first/plan.toml --folder third"):
        call(command)
    first = rs.Survey.read("first")
    assert first.summary["n_tiles"] < 22
    assert first.provenance["parameters"]["rng"] == 3
    for other in ("second", "third"):
        assert np.array_equal(rs.Survey.read(other).targets["target_id"], first.targets["target_id"])
    defaults = {one.name: one.default for one in fields(rs.AllocationOptions) if isinstance(one.default, str | bool)}
    assert (defaults["parked_obstacles"], defaults["moves"]) == (True, "ejection")
    given = {"allocator": "lamost_rule", "objective": "count", "constraints": ["keep_out 95.0 23.0 0.02"]}
    expected = {"tiles": {"passes": [2]}, "instrument": {"name": "moons"}, "output": {"folder": "."}, "rng": 3}
    expected |= {"workers": 1, "processes": False, "order": "color", "lost_in_collision": True}
    expected |= {"catalog": {"frame": "icrs"}, "options": {**defaults, **given, "time_limit": 60}}
    record = Path("first/plan.toml").read_text()
    assert tomllib.loads(record) == expected
    assert f"# rfpsurvey {rs.__version__}; keys without a value have the default values" in record
    resumed = f"{words} first --epoch 2030 --resume --set options.parked_obstacles=false"
    for command in ("survey files/plan.toml --rng 7", f"{words} first --epoch 2030", resumed):
        assert "first holds " in refused(command)
        assert Path("first/plan.toml").read_text() == record  # a refused survey does not change the record


@pytest.mark.skipif(sys.platform != "linux", reason="file names of other systems are text")
def test_the_record_of_a_file_name_that_is_no_utf8_has_a_replacement(run, tmp_path):
    path = tmp_path / "plan.toml"
    code, _, err = run("plan", "bad\udcff.csv", "--write-plan", path)
    assert code == 0
    assert "a plan file can contain only text in UTF-8" in err
    assert tomllib.loads(path.read_text())["catalog"]["path"].endswith("bad\ufffd.csv")


def test_a_tile_records_the_plan_file(call, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    call("plan --instrument moons --center '95 23' --output tile.fits")
    record = tomllib.loads(rs.Tile.read("tile.fits").provenance["plan_file"])
    assert record.pop("options")["allocator"] == "repair"
    others = {"catalog": {"frame": "icrs"}, "position_angle": 0, "rng": 0}
    assert record == {"center": "95 23", "instrument": {"name": "moons"}, "output": {"path": "tile.fits"}, **others}


def test_the_record_of_a_survey_with_a_report_and_plots_can_be_run_again(call, run, tmp_path, monkeypatch):
    """Regression: the record named the report and the plots of the first run, which exist."""
    words = "survey --instrument sdss_apo --allocator joint --passes 2 --set joint.iterations=1 --workers 2 "
    monkeypatch.chdir(tmp_path)
    call(f"{words} --set output.quality=quality.png --folder first --report page.html --plot chart.png")
    record = Path("first/plan.toml")
    found = tomllib.loads(record.read_text())
    assert found["output"] == {"folder": "."}
    assert found["joint"] == {
        "iterations": 1,
        "gap": 0.0,
        "patch_size": 800,
        "early": False,
        "objective": "visits",
    }
    message = "rfpsurvey: first holds a survey; continue it with --resume, or give another folder\n"
    assert run("survey", record)[::2] == (2, message)
    for options in ("--resume", "--folder second"):
        assert "warning" not in call(f"survey {{}} {options}", record).err
    assert Path("second/outcomes.fits").read_bytes() == Path("first/outcomes.fits").read_bytes()
    assert tomllib.loads(Path("second/plan.toml").read_text()) == found


def test_all_values_are_read_again_as_they_are_written(tmp_path):
    text = """
order = "joint"
epoch = 2026-07-01
lost_in_collision = false
[catalog]
path = "stars.fits"
columns = { "a b" = "c", id = "quote \\" and \\\\ and é" }
fill = { priority = 0.5 }
keep = ["mag", "β"]
visits = 2
[instrument]
name = "moons"
margins = "instrument,broken=0.3"
[options]
time_limit = "10 min"
sky_separation = 10
[joint]
fixed = "old"
[conditions]
site = [1.0, 2.0, 3.0]
time = 2026-07-01T06:30:00
wavelength = { BOSS = 0.54, APOGEE = "1.6 um" }
"""
    values = values_of(text, folder=tmp_path)
    assert (values["catalog.path"], values["instrument.name"]) == (str(tmp_path / "stars.fits"), "moons")
    for folder in (tmp_path, tmp_path / "sub"):
        written = _plan_file.Given("survey", SURVEY, values).to_toml(folder, documented=True)
        again = values_of(written, folder=folder)
        again = {name: str(v).replace("sub/../", "") for name, v in again.items()}
        assert again == {name: str(v) for name, v in values.items()}
    keys = build(survey.SurveyKeys, values)
    assert keys.options == {"time_limit": 10 * u.min, "sky_separation": 10 * u.arcsec}
    assert keys.conditions["wavelength"] == {"BOSS": 0.54 * u.um, "APOGEE": 1.6 * u.um}
    assert (keys.instrument.margins, keys.epoch) == ({"published": True, "broken": 0.3 * u.mm}, "2026-07-01")


@pytest.mark.parametrize(
    ("text", "name", "value"),
    [
        ("joint.time_limit=600", "joint.time_limit", 600),
        ("catalog.units.ra=deg", "catalog.units", {"ra": "deg"}),
        ("catalog.units.ra=5", "catalog.units", {"ra": "5"}),
        ("catalog.path=4711", "catalog.path", "4711"),
        ("catalog.hdu=2", "catalog.hdu", 2),
        ('catalog.hdu="2"', "catalog.hdu", "2"),
        ("catalog.keep=mag", "catalog.keep", ["mag"]),
        ('catalog.keep=["a", "b"]', "catalog.keep", ["a", "b"]),
        ("conditions.site=kitt peak", "conditions.site", "kitt peak"),
        ("conditions=night.toml", "conditions.path", "night.toml"),
        ("instrument.margins=off", "instrument.margins.published", False),
        ("instrument.margins.outer=0.2", "instrument.margins.outer", 0.2),
        ("tiles.passes=[2, 1]", "tiles.passes", [2, 1]),
        ("lost_in_collision=false", "lost_in_collision", False),
        ("options.subpriority=3", "options.subpriority", 3),
        ("options.subpriority=SUB", "options.subpriority", "SUB"),
        ("epoch=1\nrng=2", "epoch", "1\nrng=2"),
    ],
)
def test_values_of_set_have_the_syntax_of_toml(text, name, value):
    assert after_set(text) == {name: value}


def test_repeated_values_of_lists_are_added_and_others_replaced():
    assert after_set("catalog.keep=a", 'catalog.keep=["b"]', "rng=1", "rng=2") == {"catalog.keep": ["a", "b"], "rng": 2}
    values = values_of('catalog.keep = ["a"]')
    _plan_file.add_text(SURVEY, values, "catalog.keep=b", set())
    assert values == {"catalog.keep": ["b"]}


def test_set_accepts_whole_tables_of_entries():
    text = 'catalog.columns={ id = "star", ra = "x" }'
    assert after_set(text, "catalog.columns.ra=y") == {"catalog.columns": {"id": "star", "ra": "y"}}
    assert after_set('catalog.units={ ra = "deg" }') == {"catalog.units": {"ra": "deg"}}


def test_the_command_line_overrides_the_file(refused, tmp_path, seen):
    path = tmp_path / "plan.toml"
    path.write_text('rng = 1\norder = "given"\n[instrument]\nname = "moons"\n[options]\ntime_limit = 5\n')
    assert "enough" in refused("survey {} --rng 2 --set options.time_limit=7", path)
    assert (seen["rng"], seen["order"], seen["allocator"].time_limit) == (2, "given", 7 * u.s)
    assert "enough" in refused("survey {} --set rng=3", path)
    assert seen["rng"] == 3


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('[catalog]\npth = "a"', "unknown key 'catalog.pth'; did you mean 'catalog.path'?"),
        ("[joint]\ntme_limit = 1", "unknown key 'joint.tme_limit'; did you mean 'joint.time_limit'?"),
        ('[catlog]\npath = "a"', "unknown key 'catlog'; did you mean 'catalog'?"),
        ("time_limit = 1", "unknown key 'time_limit'; did you mean 'options.time_limit'?"),
        ("qqqq = 1", "unknown key 'qqqq'; --help-keys lists all keys"),
        ("catalog = 3", "catalog must be a table, whose keys are set one by one, such as catalog.path"),
        ("rng = 1.5", "rng must be a whole number, got 1.5"),
        ("rng = true", "rng must be a whole number, got True"),
        ('lost_in_collision = "no"', "lost_in_collision must be true or false, got 'no'"),
        ("[catalog]\nkeep = 3", "catalog.keep must be a list of text, got 3"),
        ("[catalog]\nkeep = [3]", "catalog.keep must be a list of text, got 3"),
        ('[tiles]\npasses = "1,2"', "tiles.passes must be a list of whole numbers, such as [1, 2], got '1,2'"),
        ("[catalog]\nunits = { ra = 1 }", "catalog.units must be a table, got 1"),
        ("[options]\ntime_limit = [1]", ""),
        ("[conditions]\nexposure_time = true", "conditions.exposure_time must be a number (s) or text with a unit"),
        ("[catalog]\npath = ''", "catalog.path must be a path, got ''"),
        ("options = 3", "options must be a table, got 3"),
        ("[instrument]\nmargins = 3", "instrument.margins must be a table or text, got 3"),
        ("[instrument]\nmargins = 'wide'", "margins must be off, instrument, or NAME=VALUE"),
        ("a = ", "cannot be read as TOML"),
    ],
)
def test_wrong_files_are_refused_in_one_sentence(refused, tmp_path, text, message):
    path = tmp_path / "plan.toml"
    path.write_text(text + "\n")
    error = refused("survey", path)
    assert error.startswith(f"rfpsurvey: {path}") or not message
    assert message in error


TIME = "options.time_limit must be a number (s) or text with a unit"
MARGINS = "margins must be off, instrument, or NAME=VALUE"
WHOLE = "--rng must be a whole number, got"


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("survey --set rng", "--set must have the form KEY=VALUE, such as joint.time_limit=600, got 'rng'"),
        ("plan --set instrument=moons", "instrument must be a table, whose keys are set one by one, such as instrume"),
        ("plan --set =1", "--set must have the form KEY=VALUE"),
        ("plan --set options.time_limit=soon", TIME),
        ("plan --set 'options.time_limit=5 km'", "options.time_limit must have a unit convertible to s, got km"),
        ("plan --set options.time_limit=[{{}}]", TIME),
        ("""plan --set "options.time_limit=['1 s', '2 m']" """, TIME),
        ("plan --set options.time_limit=1_0", TIME),
        ("plan --set 'options.time_limit=\u0661 min'", TIME),
        ("survey --set rng=-1", "rng must be a whole number from 0 to 340282366920938463463374607431768211455, got -1"),
        ("survey --workers 0", "--workers must be a whole number of at least 1, got 0"),
        ("plan --rng two", f"{WHOLE} 'two'"),
        ("survey --rng 1_0", f"{WHOLE} '1_0'"),
        ("plan --rng 0x10", f"{WHOLE} '0x10'"),
        ("plan --rng \u0661", f"{WHOLE} '\u0661'"),
        (
            "survey --set tiles.passes=[1_0]",
            "tiles.passes must be a list of whole numbers, such as [1, 2], got '[1_0]'",
        ),
        ("plan --set instrument.margins=outer=1_0", MARGINS),
        ("plan --set instrument.margins=outer=1,outer=2", "with different names"),
        ("plan --set instrument.margins=outer", MARGINS),
        ("plan --set instrument.margins=off,outer=1", MARGINS),
        ("plan --set instrument.margins=edge=1", "unknown key 'instrument.margins.edge'"),
        ("plan --epoch 2_026", "--epoch must be a Time, a Julian year from 1700 to 2300"),
        ("plan --constraint 'keep_out 9_5 23 1'", "keep_out must have the form 'keep_out RA DEC RADIUS' (deg)"),
        ("survey --constraint sky=\u0661", "a requirement must have a form such as sky=20/spectrograph"),
        ("plan --constraint 'magnitude g 1_0 20'", "the constraint must have the form 'magnitude"),
        ("survey --set catalog=stars.fits", "catalog must be a table, whose keys are set one by one"),
        ("plan --column ra", "--column must have the form NAME=VALUE, got 'ra'"),
        ("survey nothing.toml", "nothing.toml: there is no such file"),
        ("plan --write-plan plan.txt", "plan.txt: the name of this output file must end in .toml"),
    ],
)
def test_wrong_values_are_refused_in_one_sentence(refused, words, message):
    assert message in refused(words.replace("{{}}", "{}"), *["{}"] * words.count("{{}}"))


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("--instrument mons", "unknown instrument 'mons'; choose one of: "),
        ("--instrument mine.toml", "mine.toml: there is no such file"),
        ("--constraint 'keepout 95 23 1'", "unknown constraint 'keepout'; choose one of: "),
        ("--set instrument.name=moons --set instrument.arm_model=round", "unknown arm model 'round'"),
        ("--allocator lamst", "unknown allocator 'lamst'; choose one of: "),
        ("--set options.start=lamst", "unknown allocator to start with 'lamst'; choose one of: "),
    ],
)
def test_plan_files_with_unknown_names_are_not_written(refused, tmp_path, words, message):
    """Regression: --write-plan did not check the names of instruments and allocators."""
    path = tmp_path / "plan.toml"
    for command in ("plan", "survey", "tile", "select", "compare-allocators", "score"):
        if command != "score" or words.startswith(("--instrument", "--constraint")):  # it has no allocator
            assert message in refused(f"{command} {words} --write-plan", path)
    assert not path.exists()


def test_existing_plan_files_are_kept(call, refused, tmp_path):
    path = tmp_path / "plan.toml"
    path.write_text("mine")
    assert "exists; to replace it, use --overwrite" in refused("plan --write-plan", path)
    assert path.read_text() == "mine"
    call("plan --overwrite --write-plan", path)
    assert "overwrite" not in tomllib.loads(path.read_text()).get("output", {})  # each run states it


@pytest.mark.parametrize("command", ["plan", "survey", "tile", "select", "compare-allocators", "score", "probability"])
def test_commands_list_their_keys_and_have_few_options(run, command):
    code, out, _ = run(command, "--help-keys")
    assert code == 0
    assert tomllib.loads(out).keys() >= {"instrument", "output"}
    n = sum(line.startswith(("  --", "  -h, --")) for line in run(command, "--help")[1].splitlines())
    assert n <= 23  # with --help, --verbose and --quiet


def test_constraints_are_those_of_the_library():
    texts = ["sky=20", "required 4711", "required 'star 7'", "keep_out 95 23 0.5"]
    found = rs.AllocationOptions(**build(survey.SurveyKeys, {"options.constraints": texts}).options)
    region = rs.Region.parse("cap 95 23 0.5")
    expected = rs.AllocationOptions(requirements="sky=20", required=["4711", "star 7"], keep_out=region)
    assert found.record == expected.record


@pytest.mark.parametrize("command", ["compare", "compare-allocators"])
def test_comparisons_have_no_second_key_for_the_allocator(refused, command):
    """Regression: the commands accepted the key options.allocator, and ignored its value."""
    assert "unknown key 'options.allocator'" in refused(f"{command} --set options.allocator=nearest")


def test_a_name_of_an_object_is_no_path(tmp_path):
    keys = keys_of(plan.PlanKeys)
    (tmp_path / "mine.toml").touch()
    for name, expected in (("mine.toml", str(tmp_path / "mine.toml")), ("moons", "moons")):
        assert values_of(f'instrument.name = "{name}"', keys, tmp_path)["instrument.name"] == expected
    path = "example:anticenter"
    assert values_of(f'catalog.path = "{path}"', keys, tmp_path)["catalog.path"] == path
