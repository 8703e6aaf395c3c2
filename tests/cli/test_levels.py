"""The options --verbose and --quiet, and the lengths of what commands print."""

import re

import pytest

from rfpsurvey._cli.application import COMMANDS, TASKS

MOST_LINES = 12
BRIEF = [
    "plan {stars}",
    "plan {stars} --constraint sky=20 --allocator optimal",
    "score {tile} --instrument sdss_apo --constraint sky=2",
    "tile {stars} --instrument sdss_apo",
    "survey {stars} --tiles {tiles} --instrument sdss_apo",
    "compare lamost desi --n-realizations 1",
    "compare-allocators {stars} --instrument sdss_apo",
    "probability lamost --method close_pair",
    "design --ratio 1:2:4 --pitch 25:35:5",
    "instruments",
    "instruments sdss_apo",
    "night {tiles} --instrument sdss_apo --date 2026-01-10",
    "export {plan} --output {new}",
    "status {plan}",
    "select {stars} --tiles {tiles} --instrument sdss_apo --n-realizations 2",
    "potential {stars} --tiles {tiles} --instrument sdss_apo",
    "paths {tile} --instrument sdss_apo",
]


@pytest.fixture(scope="module")
def places(files, tmp_path_factory):
    """Return the paths that commands use."""
    folder = tmp_path_factory.mktemp("levels")
    return {"stars": files / "stars.fits", "tiles": files / "tiles.ecsv"} | {
        name: folder / name for name in ("plan", "new", "tile.fits")
    }


@pytest.fixture
def made(places, run):
    """Return the paths of a tile and of a survey, which are made at first."""
    if not places["plan"].exists():
        words = ["--instrument", "sdss_apo", "--center", "95 23"]
        assert run("plan", places["stars"], *words, "--output", places["tile.fits"])[0] == 0
        words = ["--tiles", places["tiles"], "--instrument", "sdss_apo", "--folder", places["plan"]]
        assert run("survey", places["stars"], *words)[0] == 0
    return {**places, "tile": places["tile.fits"]}


@pytest.mark.filterwarnings("ignore::rfpsurvey.RfpsurveyWarning")
@pytest.mark.parametrize("words", BRIEF)
def test_the_result_has_few_lines_and_no_line_with_quiet(words, made, run, monkeypatch):
    monkeypatch.setenv("COLUMNS", "100")
    arguments = [word.format(**made) for word in re.findall(r"[^ ]+", words)]
    code, out, err = run(*arguments, brief=True)
    assert code == 0, err
    assert 0 < len(out.splitlines()) <= MOST_LINES, out
    if "--output" not in arguments:
        assert len(run(*arguments)[1].splitlines()) >= len(out.splitlines())
        assert run(*arguments, "--quiet")[:2] == (0, "")


def test_both_options_are_refused(run):
    code, out, err = run("instruments", "--verbose", "--quiet", brief=True)
    assert (code, out) == (2, "")
    assert err == "rfpsurvey: either --verbose or --quiet must be given, got both\n"


def test_text_is_as_wide_as_the_terminal(run, monkeypatch):
    for width, widest in (("72", 72), ("140", 140), ("20", 60)):
        monkeypatch.setenv("COLUMNS", width)
        lines = run("instruments", "sdss_apo")[1].splitlines()
        assert 0.8 * widest < max(map(len, lines)) <= widest + (0 if widest > 60 else 60)  # addresses are not divided


def test_every_command_belongs_to_a_task(run):
    assert sorted(name for names in TASKS.values() for name in names) == sorted(COMMANDS)
    help_ = run("--help")[1]
    assert all(f"\n{task}:\n" in help_ for task in TASKS)


@pytest.mark.parametrize("name", [*COMMANDS, "benchmark batches"])
def test_help_is_complete_and_states_units(name, run):
    text = " ".join(run(*name.split(), "--help")[1].split())
    assert not re.search(
        r"\.\.\.(?! ?['(\[])", text.replace("[ARGS]...", "").replace("]...", "").partition("Examples")[0]
    )
    assert "By default, 0.0." not in text
    if "--position-angle" in text:
        assert re.search(r"--position-angle POSITION_ANGLE .{0,120}\(deg\)", text)
