"""The keys of states, arm models and margins of positioners, and instruments with states in TOML files."""

import astropy.units as u
import desi_files
import pytest
from astropy.table import QTable
from astropy.time import Time

import rfpsurvey as rs
from rfpsurvey._cli.application import COMMANDS

PRINTED = "States of positioners from broken.csv"
APO, BROKEN, TIME = "--instrument sdss_apo", "--set instrument.broken={}", "--set instrument.state_time="
NIGHT = "--set 'conditions.site=apache point' --set conditions."
TOML = """name = "worn"
inherits = "sdss_apo"
status = "assumed"
source = "log"
[layout]
states = { value = "broken.csv" }
"""


@pytest.fixture
def broken(tmp_path):
    """Return a table with one broken positioner, and one that is stuck until the beginning of March."""
    path = tmp_path / "broken.csv"
    path.write_text("id,state,from,to,theta,phi\nR+3C5,broken,,,,\nR0C2,stuck,2026-01-01,2026-03-01,30,100\n")
    return path


@pytest.fixture
def always(tmp_path):
    """Return a table without dates."""
    path = tmp_path / "always.csv"
    path.write_text("id\nR+3C5\nR0C2\n")
    return path


@pytest.fixture
def tiles(tmp_path):
    """Return a function that writes a table of two tiles at given times."""

    def write(*times):
        path = tmp_path / "tiles.ecsv"
        table = QTable({"ra": [95.0, 95.1] * u.deg, "dec": [23.0, 23.1] * u.deg, "time": list(times)})
        table.write(path, overwrite=True)
        return path

    return write


@pytest.mark.few(2)
@pytest.mark.parametrize(
    "words",
    [
        *(f"plan {APO}", f"survey {APO}", f"select {APO} --n-realizations 1", f"tile {APO} --region 'cap 95 23 1'"),
        *(f"compare-allocators {APO} --allocator nearest", "probability sdss_apo --max-iterations 200"),
        *("compare sdss_apo --allocator lamost_rule --n-realizations 1", "instruments sdss_apo"),
    ],
)
def test_commands_read_tables_of_states(call, always, words):
    out = call(f"{words} {BROKEN}", always).out
    assert out.startswith("States of positioners from always.csv: 2 broken, 0 stuck.\n")


def test_every_command_with_an_instrument_has_the_keys(run):
    without = {"convert", "benchmark", "record", "status", "diff", "export", "night"}
    for command in set(COMMANDS) - without:
        text = run(command, "--help-keys")[1]
        assert "# state_time = " in text, command
        assert ("# broken = " in text) == ("# arm_model = " in text) == (command != "design"), command
    for command in ("collisions", "batches", "probability"):
        text = run("benchmark", command, "--help")[1]
        assert "--state-time" in text
        assert "--arm-model" in text


def test_the_tile_records_the_states(call, refused, broken, tmp_path):
    output = tmp_path / "tile.fits"
    words = (f"plan {APO} {BROKEN} --output {{}}", broken, output)
    assert "the time of the observation must be given" in refused(*words)
    out = call(f"{words[0]} {TIME}2026-02-01", *words[1:]).out
    assert out.startswith(f"{PRINTED} at 2026-02-01T00:00:00 (UTC): 1 broken, 1 stuck.\n")
    tile = rs.Tile.read(output)
    values = tile.provenance["instrument"]["values"]
    assert [values[f"states.{name}"] for name in ("file", "broken", "stuck", "unused_rows")] == ["broken.csv", 1, 1, 0]
    status = dict(zip(tile.table["id"].tolist(), tile.table["status"].tolist(), strict=True))
    assert (status["R+3C5"], status["R0C2"]) == ("disabled", "stuck")
    text = call(f"score {{}} {BROKEN} {TIME}2026-05-01", output, broken).text
    assert text.startswith(f"{PRINTED} at 2026-05-01T00:00:00 (UTC): 1 broken, 0 stuck. Rows that do not apply at this")


@pytest.mark.parametrize(
    ("options", "stuck"),
    [
        ("--epoch 2026.1", 1),
        ("--epoch 2026-03-01", 0),
        (f"{NIGHT}time=2026-02-01T04:00:00 --epoch 2027", 1),
        (f"{NIGHT}time=2026-02-01T04:00:00 {TIME}2027-01-01", 0),
        (f"{NIGHT}hour_angle=1 --epoch 2026-02-01", 1),
    ],
)
def test_the_time_comes_from_the_options(call, broken, options, stuck):
    assert f"1 broken, {stuck} stuck." in call(f"plan {APO} {BROKEN} {options}", broken).out.splitlines()[0]


def test_an_hour_angle_is_no_time(refused, broken):
    assert "--set instrument.state_time=DATE" in refused(f"plan {APO} {BROKEN} {NIGHT}hour_angle=1", broken)


def test_a_scored_tile_has_the_time_of_its_conditions(call, broken, tmp_path):
    output = tmp_path / "tile.fits"
    call(f"plan {APO} {NIGHT}time=2026-02-01T04:00:00 --output", output)
    out = call(f"score {{}} {BROKEN}", output, broken).out
    assert out.startswith(f"{PRINTED} at 2026-02-01T04:00:00 (UTC): 1 broken, 1 stuck.\n")


def test_each_tile_of_a_survey_has_the_states_of_its_time(call, refused, broken, tiles, tmp_path):
    words = f"survey {APO} {BROKEN} --tiles {{}}"
    site = f"{words} --set 'conditions.site=apache point'"
    text = call(site, broken, tiles("2026-01-15T06:00:00", "2026-02-15T04:00:00")).text
    assert text.startswith(f"{PRINTED} at 2026-01-15T06:00:00 to 2026-02-15T04:00:00 (UTC): 1 broken, 1 stuck.")
    path = tiles("2026-01-15T06:00:00", "2026-03-03T03:00:00")
    for number, start in enumerate((site, words)):  # with and without conditions
        folder = tmp_path / f"plan{number}"
        out = call(f"{start} --folder {{}}", broken, path, folder).out
        assert out.startswith(f"{PRINTED} at the time of each tile.")
        survey = rs.Survey.read(folder)
        assert survey.summary["n_fibers"] == 498 + 499
        assert not {"R+3C5", "R0C2"} & {*survey.tile(0)["positioner"].tolist()}
        scores = [call("score {}", folder / f"tiles/000/{row:06d}.fits").out for row in (0, 1)]
        assert ["1 stuck at the angles" in " ".join(out.split()) for out in scores] == [True, False]
    assert "1 broken, 0 stuck" in call(f"{site} {TIME}2026-03-01", broken, path).out


def test_conditions_are_computed_at_the_dates_of_tiles(call, tiles, tmp_path):
    path = tiles("2026-01-15T06:00:00", "2026-02-15T04:00:00")
    table = QTable.read(path)
    table["mjd"] = Time(table["time"].tolist()).mjd
    for name, other in (("time", "mjd"), ("mjd", "time")):
        table.copy()[[c for c in table.colnames if c != other]].write(path, overwrite=True)
        call(f"survey {APO} --set 'conditions.site=apache point' --tiles {{}} --folder {{}}", path, tmp_path / name)
    both = [rs.Survey.read(tmp_path / name) for name in ("time", "mjd")]
    assert both[0].tiles["time"].tolist() == both[1].tiles["time"].tolist()
    assert all((both[0].tile(tile) == both[1].tile(tile)).all() for tile in (0, 1))


@pytest.mark.filterwarnings("ignore:.*DESI has 5000 positioners")
def test_the_log_of_desi_is_evaluated_at_the_times_of_tiles(call, refused, tiles, tmp_path):
    folder = tmp_path / "desi"
    folder.mkdir()
    plane = desi_files.focal_plane(folder / "desi-focalplane_2019-01-01T00:00:00.ecsv", per_petal=40)
    ids = plane["LOCATION"][:-1].tolist()
    events = [
        {"TIME": "2026-02-01T00:00:00", "LOCATION": k, "STATE": 4, "POS_T": 1.0, "POS_P": 90.0} for k in ids[:300]
    ]
    desi_files.state(folder / "desi-state_2019-01-01T00:00:00.ecsv", plane, events)
    path = tiles("2026-01-15T06:00:00", "2026-02-15T04:00:00")
    words = "survey --instrument {} --tiles {} --folder {}"
    out = call(words, folder, path, tmp_path / "plan").out
    assert out.startswith("States of positioners from desi-state_2019-01-01T00:00:00.ecsv at the time of each tile.")
    survey = rs.Survey.read(tmp_path / "plan")
    assert survey.summary["n_fibers"] == 400 + 100
    assert not {*survey.tile(1)["positioner"].tolist()} & {*ids[:300]}
    assert {*survey.tile(0)["positioner"].tolist()} & {*ids[:300]}
    night = tmp_path / "night.csv"
    night.write_text("tile,date,state\n0,2026-02-10,done\n")
    err = call("record {} {} --allow-future", tmp_path / "plan", night).err
    assert "(300 positioners, " in err
    call("survey {} --replan", tmp_path / "plan")
    assert rs.Survey.read(tmp_path / "plan").summary["n_fibers"] == 400 + 100
    with_time = call(f"{words} {TIME}2026-02-15", folder, path, tmp_path / "late").out
    assert not with_time.startswith("States")
    assert rs.Survey.read(tmp_path / "late").summary["n_fibers"] == 100 + 100
    early = tiles("2018-01-15T06:00:00", "2026-02-15T04:00:00")
    assert "time must not be before the first focal plane" in refused(words, folder, early, tmp_path / "early")


def test_a_survey_is_not_resumed_with_other_states(call, refused, broken, always, tmp_path):
    folder, words = tmp_path / "plan", f"survey {APO} {TIME}2026-02-01 --folder {{}}"
    call(f"{words} {BROKEN}", folder, broken)
    assert rs.Survey.read(folder).provenance["instrument"]["values"]["states.stuck"] == 1
    assert "instrument differs" in refused(f"{words} {BROKEN} --resume", folder, always)
    assert "instrument differs" in refused(f"{words} --resume", folder)
    more = broken.read_text() + "R0C3,broken,2030-01-01,,,\n"  # the states of February do not change
    broken.write_text(more)
    assert "instrument differs" in refused(f"{words} {BROKEN} --resume", folder, broken)


def test_a_toml_file_with_states_is_an_instrument(call, refused, broken, tmp_path):
    path = tmp_path / "worn.toml"
    path.write_text(TOML)
    assert "worn.toml: " in refused("plan --instrument", path)
    assert "1 broken, 1 stuck" in call("plan --epoch 2026.1 --instrument", path).out
    out = call(f"instruments {{}} {TIME}2026-04-01", path).out
    assert "states.broken = 1\n    assumed: log" in out
    assert "usable positioners    499" in out
    out = call(f"compare {{}} sdss_apo {TIME}2026-02-01 --allocator lamost_rule --n-realizations 1", path).out
    rows = [line.split()[:2] for line in out.splitlines()]
    assert [row for row in rows if row[:1] in (["worn"], ["sdss_apo"])][:2] == [["worn", "498"], ["sdss_apo", "500"]]
    for words in ("benchmark batches --repeats 1 --instrument", "design --instrument"):
        assert "--set instrument.state_time=DATE" in refused(words, path)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (
            f"plan {BROKEN}",
            "always.csv: id must be identifiers of positioners of lamost, such as 0, 1, 2, got 'R+3C5', 'R0C2'",
        ),
        ("plan --set instrument.broken={}.csv", "there is no such file"),
        ("plan --set instrument.state_time=soon", "instrument.state_time must be"),
        (f"compare {BROKEN}", "instrument.broken must be used with one instrument"),
        (f"instruments {BROKEN}", "--broken must be used with the name"),
    ],
)
def test_wrong_options_are_refused(refused, always, words, message):
    assert message in refused(words, *[always] * words.count("{}"))


@pytest.mark.exhaustive
def test_instruments_are_compared_with_another_arm_model(call, refused, tmp_path):
    output, model = tmp_path / "table.ecsv", "sdss_apo --set instrument.arm_model="
    call(f"compare {model}fiber_tip sdss_lco --allocator lamost_rule --n-realizations 1 --output", output)
    meta = QTable.read(output).meta["instruments"]
    assert [meta[name]["arm_model"] for name in ("sdss_lco", "sdss_apo")] == ["fiber_tip", "fiber_tip"]
    message = "instrument.arm_model must be one of capsule, elbow_to_tip, fiber_tip for sdss_apo, got 'outline'"
    assert message in refused(f"compare {model}outline")
    assert "positioner.arm_model = elbow_to_tip" in call(f"instruments {model}elbow_to_tip").out


PLAN = "plan {} --instrument desi --allocator nearest"


@pytest.fixture
def sky(tmp_path):
    """Return the path of a small catalog."""
    path = tmp_path / "sky.ecsv"
    path.write_text(
        "# %ECSV 1.0\n# ---\n# datatype:\n# - {name: ra, unit: deg, datatype: float64}\n"
        "# - {name: dec, unit: deg, datatype: float64}\n# schema: astropy-2.0\nra dec\n"
        + "".join(f"{95 + 0.01 * i} {23 + 0.01 * j}\n" for i in range(-20, 21) for j in range(-20, 21))
    )
    return path


@pytest.mark.few(2)
@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("off", None),
        ("instrument", {"outer_mm": 0.2, "inner_mm": 0.1, "arms_mm": 0.05}),
        ("instrument, broken=0.3, arms=0", {"outer_mm": 0.2, "inner_mm": 0.1, "broken_mm": 0.3}),
        ("outer=0.4,hidden_factor=1.5", {"outer_mm": 0.4, "hidden_factor": 1.5}),
    ],
)
def test_forms_of_the_option(call, sky, tmp_path, text, expected):
    path = tmp_path / "tile.fits"
    out, err = call(f"{PLAN} --output {{}} --set", sky, path, f"instrument.margins={text}")
    assert (err, rs.Tile.read(path).provenance["instrument"].get("margins")) == ("", expected)
    assert ("    margins" in out) == (expected is not None)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (f"{PLAN} --set instrument.margins=outer=nan", "the margin outer must be one finite value of at least 0 mm"),
        (f"{PLAN} --set instrument.margins=inner=6.5", "the margins outer and inner must leave a part of the patrol"),
        ("plan {} --set instrument.margins=instrument", "margins must give values, such as outer=0.1"),
    ],
)
def test_invalid_margins(refused, sky, words, message):
    assert message in refused(words, sky)


def test_all_commands_that_plan_use_the_margins(call, sky, tmp_path):
    tiles, folder, tile, selection = (tmp_path / name for name in ("tiles.ecsv", "survey", "tile.fits", "p.fits"))
    common, expected = "--instrument desi --set instrument.margins=outer=0.7", {"outer_mm": 0.7}
    called = call(f"tile {{}} {common} --method max_density --n-tiles 1 --output {{}}", sky, tiles)
    assert called.err == ""
    assert "outer 0.7 mm" in called.out
    assert "outer 0.7 mm" in call(f"survey {{}} --tiles {{}} {common} --folder {{}}", sky, tiles, folder).out
    assert rs.Survey.read(folder).provenance["instrument"]["margins"] == expected
    call(f"select {{}} --tiles {{}} {common} --n-realizations 2 --output {{}}", sky, tiles, selection)
    assert rs.SelectionProbabilities.read(selection).provenance["instrument"]["margins"] == expected
    assert "margins: outer 0.7 mm" in call(f"compare-allocators {{}} {common} --allocator nearest", sky).out
    call(f"{PLAN} --output {{}}", sky, tile)
    called = call("score {} --set instrument.margins=outer=0.7", tile)
    assert called.err == ""
    assert int(next(line for line in called.out.splitlines() if "within the margins" in line).split()[-1]) > 10


@pytest.mark.exhaustive
def test_a_comparison_of_instruments_with_margins(call):
    options = "--targets-per-positioner 0.2 --n-realizations 1 --allocator nearest"
    out, err = call(f"compare moons pfs --set instrument.margins=outer=0.3 {options}")
    assert err == ""
    assert "margins of pfs: outer_mm 0.3\n" in out


def test_tiles_without_positioners_have_no_margins(refused, sky):
    for options in ("--region 'cap 95 23 5'", "{} --set fibers=100", "{} --set radius=1"):
        words = f"tile {options} --instrument desi --set instrument.margins=outer=0.7"
        message = "margins must be given only if positioners observe the targets of a catalog"
        assert message in refused(words, *[sky] * options.count("{}"))


def test_probabilities_with_margins(call, refused):
    """The margins change the probability and are stated; a formula without these margins refuses them."""
    values, words = [], "probability desi --set instrument.arm_model=elbow_to_tip --method "
    for extra in ("", " --set instrument.margins=outer=1.5"):
        out, err = call(f"{words} close_pair {extra}")
        assert err == ""
        assert ("margins: outer 1.5 mm" in out) == bool(extra)
        values.append(float(out.split("collision probability")[1].split()[0]))
    assert values[0] != values[1]
    assert "the margins outer must be 0 for the method 'closed_form'" in refused(f"{words} closed_form {extra}")
