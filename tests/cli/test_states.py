"""The options --broken, --state-time and --arm-model, and instruments with states in TOML files."""

import astropy.units as u
import pytest
from astropy.table import QTable

import rfpsurvey as rs
from refusals import sentence
from rfpsurvey._cli._main import COMMANDS

PRINTED = "States of positioners from broken.csv"
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
    ("command", "options"),
    [
        ("plan", []),
        ("compare-allocators", ["--allocator", "nearest"]),
        ("probability", ["--max-iterations", "200"]),
        ("tile", ["--region", "cap 95 23 1"]),
        ("survey", []),
        ("select", ["--n-realizations", "1"]),
        ("compare", ["--allocator", "lamost_rule", "--n-realizations", "1"]),
        ("instruments", []),
    ],
)
def test_commands_read_tables_of_states(run, always, command, options):
    named = ["sdss_apo"] if command in ("probability", "compare", "instruments") else ["--instrument", "sdss_apo"]
    code, out, _ = run(command, *named, *options, "--set", f"instrument.broken={always}")
    assert code == 0
    assert out.startswith("States of positioners from always.csv: 2 broken, 0 stuck.\n")


def test_every_command_with_an_instrument_has_the_keys(run):
    without = {"convert", "benchmark", "record", "status", "diff"}
    for command in set(COMMANDS) - without:
        text = run(command, "--help-keys")[1]
        assert "# state_time = " in text, command
        assert ("# broken = " in text) == ("# arm_model = " in text) == (command != "design"), command
    for command in ("collisions", "batches", "probability"):
        text = run("benchmark", command, "--help")[1]
        assert "--state-time" in text
        assert "--arm-model" in text


def test_the_tile_records_the_states(run, broken, tmp_path):
    output = tmp_path / "tile.fits"
    call = ("plan", "--instrument", "sdss_apo", "--set", f"instrument.broken={broken}", "--output", output)
    assert "the time of the observation must be given" in sentence(*run(*call)[::2])
    code, out, _ = run(*call, "--set", "instrument.state_time=2026-02-01")
    assert code == 0
    assert out.startswith(f"{PRINTED} at 2026-02-01T00:00:00 (UTC): 1 broken, 1 stuck.\n")
    tile = rs.Tile.read(output)
    values = tile.provenance["instrument"]["values"]
    assert [values[f"states.{name}"] for name in ("file", "broken", "stuck", "unused_rows")] == ["broken.csv", 1, 1, 0]
    status = dict(zip(tile.table["id"].tolist(), tile.table["status"].tolist(), strict=True))
    assert (status["R+3C5"], status["R0C2"]) == ("disabled", "stuck")
    code, out, _ = run(
        "score", output, "--set", f"instrument.broken={broken}", "--set", "instrument.state_time=2026-05-01"
    )
    text = " ".join(out.split())
    assert text.startswith(f"{PRINTED} at 2026-05-01T00:00:00 (UTC): 1 broken, 0 stuck. Rows that do not apply at this")


@pytest.mark.parametrize(
    ("options", "stuck"),
    [
        (["--epoch", "2026.1"], 1),
        (["--epoch", "2026-03-01"], 0),
        (
            [
                "--set",
                "conditions.site=apache point",
                "--set",
                "conditions.time=2026-02-01T04:00:00",
                "--epoch",
                "2027",
            ],
            1,
        ),
        (
            [
                "--set",
                "conditions.site=apache point",
                "--set",
                "conditions.time=2026-02-01T04:00:00",
                "--set",
                "instrument.state_time=2027-01-01",
            ],
            0,
        ),
        (["--set", "conditions.site=apache point", "--set", "conditions.hour_angle=1", "--epoch", "2026-02-01"], 1),
    ],
)
def test_the_time_comes_from_the_options(run, broken, options, stuck):
    code, out, _ = run("plan", "--instrument", "sdss_apo", "--set", f"instrument.broken={broken}", *options)
    assert code == 0
    assert f"1 broken, {stuck} stuck." in out.splitlines()[0]


def test_an_hour_angle_is_no_time(run, broken):
    call = (
        "plan",
        "--instrument",
        "sdss_apo",
        "--set",
        f"instrument.broken={broken}",
        "--set",
        "conditions.site=apache point",
        "--set",
        "conditions.hour_angle=1",
    )
    assert "--set instrument.state_time=DATE" in sentence(*run(*call)[::2])


def test_a_scored_tile_has_the_time_of_its_conditions(run, broken, tmp_path):
    output, seen = (
        tmp_path / "tile.fits",
        ["--set", "conditions.site=apache point", "--set", "conditions.time=2026-02-01T04:00:00"],
    )
    assert run("plan", "--instrument", "sdss_apo", "--output", output, *seen)[0] == 0
    code, out, _ = run("score", output, "--set", f"instrument.broken={broken}")
    assert code == 0
    assert out.startswith(f"{PRINTED} at 2026-02-01T04:00:00 (UTC): 1 broken, 1 stuck.\n")


def test_the_states_of_a_survey_must_be_the_same_at_all_times(run, broken, tiles):
    call = [
        "survey",
        "--instrument",
        "sdss_apo",
        "--set",
        "conditions.site=apache point",
        "--set",
        f"instrument.broken={broken}",
        "--tiles",
    ]
    code, out, _ = run(*call, tiles("2026-01-15T06:00:00", "2026-02-15T04:00:00"))
    assert code == 0
    text = " ".join(out.split())
    assert text.startswith(f"{PRINTED} at 2026-01-15T06:00:00 to 2026-02-15T04:00:00 (UTC): 1 broken, 1 stuck.")
    path = tiles("2026-01-15T06:00:00", "2026-03-03T03:00:00")
    text = sentence(*run(*call, path)[::2])
    assert "(2026-01-15T06:00:00 to 2026-03-03T03:00:00), but the state of R0C2 changes" in text
    assert "1 broken, 0 stuck" in run(*call, path, "--set", "instrument.state_time=2026-03-01")[1]
    assert "--set instrument.state_time=DATE" in sentence(
        *run(*call[:3], *call[5:], path)[::2]
    )  # without conditions, times are not used


def test_a_survey_is_not_resumed_with_other_states(run, broken, always, tmp_path):
    folder = tmp_path / "plan"
    call = [
        "survey",
        "--instrument",
        "sdss_apo",
        "--folder",
        folder,
        "--set",
        "instrument.state_time=2026-02-01",
    ]
    first, other = (["--set", f"instrument.broken={path}"] for path in (broken, always))
    assert run(*call, *first)[0] == 0
    assert rs.Survey.read(folder).provenance["instrument"]["values"]["states.stuck"] == 1
    assert "instrument differs" in sentence(*run(*call, *other, "--resume")[::2])
    assert "instrument differs" in sentence(*run(*call, "--resume")[::2])
    more = broken.read_text() + "R0C3,broken,2030-01-01,,,\n"  # the states of February do not change
    broken.write_text(more)
    assert "instrument differs" in sentence(*run(*call, *first, "--resume")[::2])


def test_a_toml_file_with_states_is_an_instrument(run, broken, tmp_path):
    path = tmp_path / "worn.toml"
    path.write_text(TOML)
    assert "worn.toml: " in sentence(*run("plan", "--instrument", path)[::2])
    assert "1 broken, 1 stuck" in run("plan", "--instrument", path, "--epoch", "2026.1")[1]
    code, out, _ = run("instruments", path, "--set", "instrument.state_time=2026-04-01")
    assert code == 0
    assert "states.broken = 1\n    assumed: log" in out
    assert "usable positioners    499" in out
    code, out, _ = run(
        "compare",
        path,
        "sdss_apo",
        "--set",
        "instrument.state_time=2026-02-01",
        "--allocator",
        "lamost_rule",
        "--n-realizations",
        "1",
    )
    assert code == 0
    assert [line.split()[1] for line in out.splitlines() if line.split()[:1] in (["worn"], ["sdss_apo"])][:2] == [
        "498",
        "500",
    ]
    code, _, err = run("benchmark", "batches", "--instrument", path, "--repeats", "1")
    assert "--set instrument.state_time=DATE" in sentence(code, err)
    assert "--set instrument.state_time=DATE" in sentence(*run("design", "--instrument", path)[::2])


def test_wrong_options_are_refused(run, always, tmp_path):
    text = sentence(*run("plan", "--set", f"instrument.broken={always}")[::2])
    assert "always.csv: id must be identifiers of positioners of lamost, such as 0, 1, 2, got 'R+3C5', 'R0C2'" in text
    assert "there is no such file" in sentence(*run("plan", "--set", f"instrument.broken={tmp_path / 'no.csv'}")[::2])
    assert "instrument.state_time must be" in sentence(*run("plan", "--set", "instrument.state_time=soon")[::2])
    assert "instrument.broken must be used with one instrument" in sentence(
        *run("compare", "--set", f"instrument.broken={always}")[::2]
    )
    assert "--broken must be used with the name" in sentence(
        *run("instruments", "--set", f"instrument.broken={always}")[::2]
    )


@pytest.mark.exhaustive
def test_instruments_are_compared_with_another_arm_model(run, tmp_path):
    output = tmp_path / "table.ecsv"
    call = [
        "compare",
        "sdss_lco",
        "sdss_apo",
        "--set",
        "instrument.arm_model=fiber_tip",
        "--allocator",
        "lamost_rule",
        "--n-realizations",
        "1",
    ]
    assert run(*call, "--output", output)[0] == 0
    meta = QTable.read(output).meta["instruments"]
    assert [meta[name]["arm_model"] for name in ("sdss_lco", "sdss_apo")] == ["fiber_tip", "fiber_tip"]
    assert (
        "instrument.arm_model must be one of capsule, elbow_to_tip, fiber_tip for sdss_apo, got 'outline'"
        in sentence(*run("compare", "sdss_apo", "--set", "instrument.arm_model=outline")[::2])
    )
    assert (
        "positioner.arm_model = elbow_to_tip"
        in run("instruments", "sdss_apo", "--set", "instrument.arm_model=elbow_to_tip")[1]
    )
