"""Messages of commands for invalid input, and for options that do not exist."""

import re

import astropy.units as u
import pytest
from astropy.coordinates import SkyCoord
from astropy.table import QTable

import rfpsurvey as rs
from rfpsurvey._cli.application import COMMANDS, commands
from rfpsurvey._survey.key_objects import add_text


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("plan no.fits", "there is no such file"),
        ("plan unitless.ecsv", "column 'ra' has no unit"),
        ("plan good.ecsv --center '0.0 -60.0'", "no target lies within"),
        ("plan --center somewhere", "--center must be coordinates"),
        ("plan --center '400 0'", "the right ascension must lie between -360 and 360 deg"),
        ("plan --instrument lamots", "unknown instrument 'lamots'; choose one of"),
        ("plan --instrument lamost.csv", ", or a TOML file."),
        ("plan --set options.time_limit=nan", "options.time_limit must be one finite value above 0 s"),
        ("plan good.ecsv --set catalog.frame=altaz", "frame must be a frame that has a fixed relation to ICRS"),
        ("plan good.ecsv --set catalog.frame=foo", "unknown frame 'foo'"),
        ("plan --set equinox=foo", "equinox must be a Time, a Julian year"),
        ("plan --position-angle=1e17", "--position-angle must be one finite value"),
        ("plan --output no/tile.fits", "does not exist"),
        ("plan --output good.ecsv", "exists; to replace it, use --overwrite"),
        ("plan --plot tile.jpg", "must end in .png or .pdf or .svg"),
        ("plan good.ecsv --column rightascension=x", "unknown column role 'rightascension'"),
        ("probability --precision 2", "rfpsurvey: --precision must be a number above 0"),
        ("survey --instrument moons --passes 7", "rfpsurvey: --passes must be distinct passes of the tiling (1, 2)"),
        ("compare moons --density nan", "rfpsurvey: --density must be one finite value above 0"),
        ("compare moons --n-realizations 0", "rfpsurvey: --n-realizations must be a whole number from 1"),
    ],
)
def test_bad_input_is_one_sentence_that_names_the_option_that_was_typed(refused, tmp_path, monkeypatch, words, message):
    """The tests of the library test most messages."""
    monkeypatch.chdir(tmp_path)
    for name, unit in (("good", u.deg), ("unitless", 1)):
        QTable({"ra": [10.0] * unit, "dec": [20.0] * u.deg}).write(f"{name}.ecsv")
    assert message in refused(words)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["good.ecsv", "unitless.ecsv"]


def test_the_message_for_an_unknown_option_names_a_key(run):
    for *words, key in (
        ("--frame", "galactic", "catalog.frame"),
        ("--time-limit", "5", "options.time_limit"),
        ("--time-limit=5 min", "options.time_limit"),
        ("--time-limit", "options.time_limit"),
        ("--parked-obstacles", "stars.csv", "options.parked_obstacles"),
        ("--units", "ra=hour", "catalog.units.NAME"),
        ("--targets", "outcome", "output.targets"),
    ):
        code, _, err = run("plan", *words)
        assert code == 2
        assert f"No such option: {words[0].partition('=')[0]}" in err
        assert f"--set {key}=VALUE" in err


def test_the_message_for_an_unknown_option_names_no_key_for_other_kinds_of_values(run):
    """``plan --targets 1000`` named ``output.targets``, which is the color of targets in plots."""
    for words in (("--targets", 1000), ("--targets=1000",), ("--programs", "few")):
        code, _, err = run("plan", *words)
        assert (code, "No such option" in err, "Possible" in err) == (2, True, False)


def test_the_keys_that_messages_for_unknown_options_name_accept_the_value(run):
    n = 0
    for name in COMMANDS:
        group = commands().get_command(None, name)
        inner = getattr(group, "commands", {"": group})
        for words, command in [([name, *one.split()], command) for one, command in inner.items()]:
            keys = getattr(command.callback, "keys", {})
            options = {"--" + key.rpartition(".")[2].replace("_", "-") for key in keys}
            for option in options - {one for parameter in command.params for one in parameter.opts}:
                for value in ("1000", "text", "a=b"):
                    err = run(*words, option, value)[2]
                    assert "No such option" in err
                    if found := re.search(r"--set (\S+?)(\.NAME)?=VALUE", err):
                        n += 1
                        if bool not in keys[found[1]].kinds:
                            add_text(keys, {}, f"{found[1]}{'.' if found[2] else '='}{value}", set())
                            assert value != "1000" or not keys[found[1]].texts_only(entry=False)
    assert n > 100


@pytest.mark.parametrize("digits", [400, 5000])
@pytest.mark.parametrize(
    "options",
    [
        *("--rng={}", "--set options.subpriority={}", "--constraint=sky={}", "--position-angle={}"),
        "--set conditions.site={},0,0 --set conditions.hour_angle=1",
    ],
)
def test_numbers_of_hundreds_of_digits_are_refused(run, digits, options):
    """A site with an infinite longitude was accepted, and a subpriority of 5000 digits caused a traceback."""
    words = options.format("9" * digits).split()
    code, _, error = run("plan", "example:anticenter", "--instrument", "moons", *words)
    assert code == 2
    assert len(error) < 1200 + digits  # some versions of click repeat the number
    assert "Traceback" not in error


def test_visits_of_hundreds_of_digits_are_refused():
    """Such a number caused an OverflowError."""
    with pytest.raises(rs.InputError, match=r"visits must be"):
        rs.Catalog(SkyCoord([0], [0], unit="deg"), visits=[10**400])
