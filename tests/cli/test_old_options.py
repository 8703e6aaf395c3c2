"""Option spellings of version 0.2, all of which still work, with one warning for each spelling that was replaced."""

import re

import pytest

import rfpsurvey as rs
from rfpsurvey._cli import _command, _main, _old

# All options of the commands of version 0.2; an exclamation mark follows options without a value.
OLD = {
    "compare": (
        "--arm-model --broken --state-time --margins --catalog --center --pa --epoch --targets --density "
        "--realizations --allocator --require --required --keep-out --sky-separation --time-limit --seed "
        "--workers --hdu --column --unit --frame --fill --output --plot --report --overwrite! --no-overwrite!"
    ),
    "compare-allocators": (
        "--instrument --arm-model --broken --state-time --margins --center --pa --equinox --epoch --allocator "
        "--require --required --keep-out --sky-separation --objective --time-limit --seed --subpriority "
        "--parked! --no-parked! --hdu --column --unit --frame --fill --output --plot --report --overwrite! "
        "--no-overwrite!"
    ),
    "convert": "--format --overwrite! --no-overwrite!",
    "design": (
        "--instrument --state-time --spread --central-arm --ratio --pitch --clearance --n-designs --estimand "
        "--method --targets-per-positioner --target-density --n-skies --time-limit --objective --seed "
        "--workers --processes! --output --resume! --no-resume! --plot --report --overwrite! --no-overwrite!"
    ),
    "instruments": "--arm-model --broken --state-time",
    "plan": (
        "--instrument --arm-model --broken --state-time --margins --center --pa --equinox --epoch --allocator "
        "--conditions --site --time --hour-angle --wavelength --exposure-time --projection --require "
        "--required --keep-out --sky-separation --objective --time-limit --seed --subpriority --parked! "
        "--no-parked! --hdu --column --unit --frame --keep --fill --output --plot --targets --quality "
        "--report --overwrite! --no-overwrite!"
    ),
    "probability": (
        "--arm-model --broken --state-time --margins --method --estimand --precision --max-iterations "
        "--targets --hdu --n-targets --target-radius --min-separation --allocator --density --dynamic --seed "
        "--workers --output --plot --report --overwrite! --no-overwrite!"
    ),
    "score": (
        "--instrument --arm-model --broken --state-time --margins --center --pa --equinox --epoch --positions "
        "--select --skip-missing! --parked! --no-parked! --hdu --column --unit --output --plot --report "
        "--overwrite! --no-overwrite!"
    ),
    "select": (
        "--tiles --tiles-hdu --tiles-column --tiles-unit --instrument --arm-model --broken --state-time "
        "--margins --realizations --allocator --visits --pass --epoch --require --required --keep-out "
        "--sky-separation --time-limit --parked! --no-parked! --lost! --kept! --order --output --folder "
        "--resume! --no-resume! --workers --processes! --scheduler --seed --hdu --column --unit --frame "
        "--fill --overwrite! --no-overwrite!"
    ),
    "survey": (
        "--tiles --tiles-hdu --tiles-column --tiles-unit --instrument --arm-model --broken --state-time "
        "--margins --allocator --visits --pass --epoch --conditions --site --time --hour-angle --wavelength "
        "--exposure-time --require --required --keep-out --sky-separation --time-limit --subpriority "
        "--parked! --no-parked! --lost! --kept! --order --joint-gap --joint-iterations --joint-time --fixed "
        "--folder --resume! --no-resume! --workers --processes! --scheduler --seed --hdu --column --unit "
        "--frame --keep --fill --plot --quality --report --overwrite! --no-overwrite!"
    ),
    "tile": (
        "--region --exclude --instrument --arm-model --broken --state-time --margins --method --passes "
        "--completeness --n-tiles --centers --tiles-hdu --tiles-column --tiles-unit --declination --pa "
        "--allocator --require --sky-separation --time-limit --parked! --no-parked! --lost! --kept! --fibers "
        "--radius --visits --seed --hdu --column --unit --frame --fill --output --plot --report --overwrite! "
        "--no-overwrite!"
    ),
    "benchmark collisions": (
        "--instrument --arm-model --state-time --method --repeats --seed --plot --report --overwrite! --no-overwrite!"
    ),
    "benchmark batches": "--instrument --arm-model --state-time --repeats",
    "benchmark probability": (
        "--instrument --arm-model --state-time --repeats --seed --plot --report --overwrite! --no-overwrite!"
    ),
}
VALUES = {
    "--column": "ra=RA",
    "--unit": "ra=deg",
    "--tiles-column": "ra=RA",
    "--tiles-unit": "ra=deg",
    "--fill": "priority=0",
    "--select": "field=1",
    "--objective": "priority",
    "--keep-out": "95.0,23.0,0.01",
    "--require": "sky=20",
    "--margins": "outer=0.1",
    "--region": "sky",
    "--exclude": "cap 1 2 3",
    "--wavelength": "BOSS=0.54",
    "--site": "-105.82,32.78,2798",
    "--conditions": "night.toml",
    "--broken": "broken.csv",
    "--hdu": "TARGETS",
    "--time": "2026-07-01T06:30:00",
}
"""Values of options that are not numbers."""
KEPT = {
    "--keep-out": "options.constraints",
    "--require": "options.constraints",
    "--required": "options.constraints",
    "--parked": "options.parked_obstacles",
}


@pytest.fixture
def settings(run, monkeypatch):
    """Return a function that runs a command until its keys are known, and returns these keys and the warnings."""

    def call(*words):
        found = {}

        def build(cls, values, prefix=""):
            found.update(values)
            built = whole(cls, values, prefix)
            raise rs.InputError(f"enough {type(built).__name__}")

        whole = _command.build
        with monkeypatch.context() as patch:
            patch.setattr(_command, "build", build)
            code, _, err = run(*words)
        assert code == 2
        assert "rfpsurvey: enough" in err, err
        return found, [line for line in err.splitlines() if "warning: " in line]

    return call


@pytest.mark.parametrize("command", [command for command in OLD if command != "convert"])
def test_every_option_of_version_02_still_works(settings, command):
    for option in OLD[command].split():
        name, is_flag = option.rstrip("!"), option.endswith("!")
        value = "max" if name == "--objective" and command == "design" else VALUES.get(name, "1")
        value = f"loss={value}" if value == "max" else value
        value = "outcome" if (command, name) == ("plan", "--targets") else value  # numbers were never valid
        given = [] if is_flag else ["-10", "60"] if name == "--declination" else [value]
        argument = ["sdss_apo.csv"] if command == "score" else []
        found, warnings = settings(*command.split(), *argument, name, *given)
        new = {key: one for key, one in found.items() if not (argument and key == "catalog.path")}
        assert len(new) == (0 if name in ("--overwrite",) and not is_flag else 1), (command, name, found)
        assert len(warnings) <= 1
        for text in warnings:
            assert f"{name} will not be accepted by the next version; write " in text
            words = re.search(r"; write (.*)$", text)[1].replace("'", "").split(" ", 1)
            again, none = settings(*command.split(), *argument, *words)
            assert (again, none) == (found, [])
        joined = settings(*command.split(), *argument, f"{name}={given[0]}")[0] if len(given) == 1 else found
        assert joined == found


def test_no_key_is_suggested_that_is_then_refused(run):
    """Regression: the warning about ``--targets 1000`` named a key whose value cannot be a number."""
    code, _, error = run("plan", "--targets", "1000")
    assert (code, "output.targets" in error, "No such option: --targets" in error) == (2, False, True)


def test_a_warning_is_issued_once_for_each_spelling(settings):
    found, warnings = settings("survey", "--pass", "2", "--pass", "1", "--seed", "4")
    assert found == {"tiles.passes": [2, 1], "rng": 4}
    assert [text.split("; write ")[1] for text in warnings] == ["--passes 2", "--rng 4"]


@pytest.mark.parametrize(
    ("words", "key", "value"),
    [
        (["--keep-out", "cap 95 23 1", "--required", "7"], "options.constraints", ["keep_out 95 23 1", "required 7"]),
        (["--require", "instrument"], "options.requirements", "instrument"),
        (["--column", "epoch=J2016"], "catalog.epoch", "J2016"),
        (["--column", "epoch=J"], "catalog.columns", {"epoch": "J"}),
        (["--wavelength", "0.5"], "conditions.wavelength", 0.5),
        (["--wavelength", "BOSS=0.5"], "conditions.wavelength", {"BOSS": 0.5}),
        (["--margins", "instrument,broken=0.3"], "instrument.margins.broken", 0.3),
        (["--no-parked"], "options.parked_obstacles", False),
        (["--keep", "a", "--keep", "b"], "catalog.keep", ["a", "b"]),
        (["--center=--pa", "--rng", "3"], "rng", 3),
        (["--center", "--seed", "--rng", "3"], "center", "--seed"),
    ],
)
def test_values_are_converted(settings, words, key, value):
    assert settings("plan", *words)[0][key] == value


def test_old_spellings_are_not_in_the_help(run):
    for command in _main.COMMANDS:
        text = run(command, "--help")[1]
        for name in ("--pa ", "--seed", "--pass ", "--realizations", "--kept", "--no-parked", "--require"):
            assert name not in text


def test_words_after_two_hyphens_are_not_options():
    assert _old.rewritten(["--", "--seed", "4"], {"rng": None}, {"rng": "--rng"}, {}) == ["--", "--seed", "4"]
    assert _old.rewritten(["--seed"], {"rng": None}, {"rng": "--rng"}, {}) == ["--seed"]
