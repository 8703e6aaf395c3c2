import re
import subprocess
import sys

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.table import QTable, Table

import rfpsurvey as rs
from refusals import sentence
from rfpsurvey._cli import _app
from rfpsurvey._cli._main import COMMANDS, commands
from rfpsurvey.inputs._plan_file import add_text


@pytest.mark.few(1)
@pytest.mark.parametrize("instrument", ["lamost", "sdss_apo"])
def test_plan_of_a_real_field(run, tycho, tmp_path, instrument):
    fits, png = tmp_path / "tile.fits", tmp_path / "tile.png"
    code, out, err = run(
        "plan",
        tycho,
        "--instrument",
        instrument,
        "--center",
        "06h20m00s +23d00m00s",
        "--position-angle",
        15,
        "--epoch",
        2026.5,
        "--output",
        fits,
        "--plot",
        png,
    )
    assert (code, err) == (0, "")
    assert "targets in the catalog                  8830" in out
    table = QTable.read(fits)
    assert table["x"].unit == u.mm
    assert png.read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    tile = rs.Tile.read(fits)
    assert f"{tile.summary['n_assigned']:>10}" in out
    if instrument == "lamost":
        assert 1900 < tile.summary["n_in_field"] < 2700
    assert tile.provenance["parameters"]["epoch"] == "J2026.500"


@pytest.mark.few(2)
@pytest.mark.parametrize("name", ["tile.ecsv", "tile.ecsv.gz", "tile.fits", "tile.fits.gz"])
def test_it_is_printed_that_ecsv_has_no_outcomes(run, tmp_path, name):
    path = tmp_path / name
    code, out, err = run("plan", "--instrument", "sdss_apo", "--output", path)
    assert (code, err) == (0, "")
    told = (
        f"{path} does not contain the outcomes of targets; to keep the outcomes, write a .fits file, which can "
        "hold two tables"
    )
    assert (told in out.splitlines()) == (rs.Tile.read(path).outcomes is None) == (".ecsv" in name)
    _, again, _ = run("score", path, "--output", tmp_path / "scored.ecsv")  # a scored tile has no outcomes
    assert "no outcomes" not in again


def test_the_embedded_default(run):
    code, out, _ = run("plan")
    assert code == 0
    assert out.startswith("lamost, allocator repair\n")
    assert "collision rate" in out


def test_module_and_version_and_help(run):
    done = subprocess.run([sys.executable, "-m", "rfpsurvey", "--version"], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout.split()[0]) == (0, "rfpsurvey")
    for arguments, text in ((["--version"], "rfpsurvey "), (["--help"], "plan"), (["plan", "--help"], "Examples:")):
        code, out, _ = run(*arguments)
        assert code == 0
        assert text in out


def test_instruments(run):
    code, out, _ = run("instruments")
    assert code == 0
    assert all(name in out for name in rs.available_instruments())
    code, out, _ = run("instruments", "lamost")
    assert code == 0
    assert "positioner.central_arm = 8.25 mm\n    published: Chen et al." in out
    assert "assumed: " in out
    assert re.search(r"^field shape +circle$", out, re.MULTILINE)
    assert re.search(r"^published values +10$", out, re.MULTILINE)


def test_instruments_side_by_side(run):
    code, out, _ = run("instruments", "lamost", "sdss_apo")
    lines = {line[:22].strip(): line[22:].split() for line in out.splitlines()}
    assert code == 0
    assert lines[""] == ["lamost", "sdss_apo"]
    assert lines["positioners"] == ["4000", "500"]
    assert lines["field shape"] == ["circle", "hexagon"]
    assert lines["fibers"][-4:] == ["BOSS", "500,", "APOGEE", "298"]
    assert "published: " not in out


@pytest.mark.parametrize(
    "command", [*COMMANDS, *(f"benchmark {name}" for name in ("collisions", "batches", "probability"))]
)
@pytest.mark.parametrize("option", ["--help", "--help-keys"])
def test_help_fits_into_80_columns(run, monkeypatch, command, option):
    monkeypatch.setenv("COLUMNS", "80")
    code, out, _ = run(*command.split(), option)
    if option == "--help":
        assert code == 0
    assert [line for line in out.splitlines() if len(line) > 80] == []


@pytest.mark.parametrize(
    "command",
    [
        "plan --instrument moons --constraint sky=900/spectrograph",
        "survey --instrument moons --constraint sky=900/spectrograph",
        "select --instrument moons --n-realizations 1",
        "instruments",
        "instruments desi",
        "instruments sdss_apo",
        "instruments moons desi",
    ],
)
def test_results_are_printed_in_lines_of_100_characters(run, command):
    """Sentences such as the one on the model continue on the next line, which is indented."""
    code, out, _ = run(*command.split())
    assert code == 0
    assert [line for line in out.splitlines() if len(line) > 100] == []
    if command.startswith(("plan", "survey", "select")):
        (model,) = re.findall(r"^model: .*\n(?:  .*\n)+?(?=\S)", out, re.MULTILINE)
        assert "Positions: a tangent plane" in " ".join(model.split())


@pytest.mark.exhaustive
def test_benchmark(run, tmp_path):
    chart = tmp_path / "chart.png"
    call = (
        "benchmark",
        "collisions",
        "--instrument",
        "sdss_apo",
        "--method",
        "exact",
        "--method",
        "endpoints",
        "--repeats",
        "1",
        "--plot",
        str(chart),
    )
    code, out, _ = run(*call)
    assert code == 0
    assert "endpoints" in out
    assert chart.stat().st_size > 10_000
    assert QTable.read(chart.with_suffix(".ecsv"))["method"].tolist() == ["exact", "endpoints"]
    code, _, err = run(*call)
    assert code == 2
    assert "chart.ecsv exists" in err
    code, out, _ = run("benchmark", "batches", "--instrument", "sdss_apo", "--repeats", "1")
    assert code == 0
    assert "10000" in out


def test_score(run, tmp_path):
    x, y = rs.Instrument.preset("lamost").focal_plane.xy[:3].T
    path = tmp_path / "plan.ecsv"
    QTable({"positioner": [0, 1, 2], "field": [1, 1, 2], "x": x + 5 * u.mm, "y": y}).write(path)
    assert "--instrument must name the instrument of the assignment" in sentence(*run("score", path)[::2])
    code, out, _ = run(
        "score", path, "--instrument", "lamost", "--select", "field=1", "--output", tmp_path / "out.ecsv"
    )
    assert code == 0
    assert rs.Tile.read(tmp_path / "out.ecsv").summary["n_assigned"] == 2
    assert "allocator scored" in out
    assert "poses: 3998 positioners without a target: 3998 assumed to be parked" in out
    # a tile of this package contains the name of its instrument
    code, out, _ = run("score", tmp_path / "out.ecsv")
    assert code == 0
    assert re.search(r"^lamost, nominal, allocator scored$", out, re.MULTILINE)
    assert "--instrument must be the instrument of the tile, lamost" in sentence(
        *run("score", tmp_path / "out.ecsv", "--instrument", "desi")[::2]
    )
    assert "selects no row" in sentence(*run("score", path, "--select", "field=3")[::2])
    assert "no column 'no'; the columns are: positioner" in sentence(*run("score", path, "--select", "no=3")[::2])
    assert "must have the form NAME=VALUE" in sentence(*run("score", path, "--select", "field")[::2])


@pytest.mark.few(2)
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["probability", "--precision", 2], "--precision must be a number above 0"),
        (["survey", "--instrument", "moons", "--passes", 7], "--passes must be distinct passes of the tiling (1, 2)"),
        (
            ["compare", "moons", "--targets-per-positioner=-1"],
            "--targets-per-positioner must be a positive number, got -1",
        ),
        (["compare", "moons", "--density", "nan"], "--density must be one finite value above 0"),
        (["compare", "moons", "--n-realizations", 0], "--n-realizations must be a whole number from 1"),
    ],
)
def test_errors_name_the_option_that_was_typed(run, arguments, message):
    assert sentence(*run(*arguments)[::2]).startswith(f"rfpsurvey: {message}")


def test_nothing_assigned_has_no_collision_rate(run, tmp_path):
    """Idle arms of unequal length are not obstacles, so that no positioner is counted.

    The focal plane requires no center.
    """
    unit = rs.Instrument.preset("sdss_apo").focal_plane
    x, y = unit.xy[:1].T
    QTable({"positioner": unit.id[:1], "x": x + 500 * u.mm, "y": y, "assigned": [1]}).write(tmp_path / "one.ecsv")
    keep = ["--constraint", "keep_out 95 23 3", "--allocator", "repair"]
    code, out, _ = run("plan", "--instrument", "sdss_apo", "--center", "95 23", *keep)
    assert code == 0
    assert "undefined, because no arm is assigned" in out
    assert "nan" not in out.lower().split()
    with pytest.warns(rs.RfpsurveyWarning, match="out of reach"):
        rs.score_tile(QTable.read(tmp_path / "one.ecsv"), "sdss_apo")
    _, out, _ = run("score", tmp_path / "one.ecsv", "--instrument", "sdss_apo")
    assert "collisions were found from positions on the focal plane, which do not require a field center" in out


def test_columns_units_and_toml(run, tmp_path):
    center = "10.0 20.0"
    rng = np.random.default_rng(1)
    t = Table({"a": rng.uniform(9.7, 10.3, 50), "b": rng.uniform(19.7, 20.3, 50), "rank": np.arange(50)})
    t.write(tmp_path / "t.ecsv")
    arguments = ("plan", tmp_path / "t.ecsv", "--center", center, "--instrument", "moons")
    names = ("--column", "ra=a", "--column", "dec=b", "--column", "priority=-rank")
    code, out, err = run(*arguments, *names)
    assert code == 0
    assert "the assumed units are a in deg, b in deg; to use other units, give units= or --set catalog.units" in err
    code, out, err = run(*arguments, *names, "--set", "catalog.units.ra=deg", "--set", "catalog.units.dec=deg")
    assert code == 0
    assert "unit" not in err
    assert "in reach of a positioner" in out


def test_dropped_rows_are_a_warning_and_a_count(run, tmp_path):
    t = QTable({"ra": [10, np.nan] * u.deg, "dec": [20, 20] * u.deg})
    t.write(tmp_path / "t.ecsv")
    code, out, err = run("plan", tmp_path / "t.ecsv", "--center", "10.0 20.0")
    assert code == 0
    assert re.search(r"removed \(coordinates not finite\) +1\n", out)
    assert err == "rfpsurvey: warning: 1 of 2 targets have no finite coordinates and were removed\n"


@pytest.mark.few(12)
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["{no}.fits"], "there is no such file"),
        (["{bad}.fits"], "cannot be read as fits"),
        (["{bad}.txt"], "must end in one of .fits"),
        (["{empty}.ecsv"], "the catalog must have at least one target"),
        (["{noname}.ecsv"], "there is no column for ra and dec; the columns are: x, y"),
        (["{units}.ecsv"], "column 'ra' (ra) must have a unit convertible to deg, got mm"),
        (["{unitless}.ecsv"], "column 'ra' has no unit"),
        (["{good}.ecsv", "--center", "0.0 -60.0"], "no target lies within"),
        (
            ["{good}.ecsv", "--center", "10.0 22.4765"],
            "reaches a science target; the field around the center 00h40m00s",
        ),
        (["--center", "somewhere"], "--center must be coordinates"),
        (["--instrument", "lamots"], "unknown instrument 'lamots'; choose one of"),
        (["--instrument", "{no}.toml"], "no.toml: there is no such file"),
        (["--instrument", "lamost.csv"], ", or a TOML file."),
        (["--center", "400 0"], "the right ascension must lie between -360 and 360 deg"),
        (["--set", "options.time_limit=nan"], "options.time_limit must be one finite value above 0 s"),
        (["{good}.ecsv", "--set", "catalog.frame=altaz"], "frame must be a frame that has a fixed relation to ICRS"),
        (["--allocator", "magic"], "unknown allocator 'magic'; choose one of: balanced, lamost"),
        (["{good}.ecsv", "--epoch", "soon", "--center", "10.0 20.0"], "must be a Time, a Julian year"),
        (["--output", "{no}/tile.fits"], "does not exist"),
        (["--output", "{good}.ecsv"], "exists; to replace it, use --overwrite"),
        (["--output", "{tile}.csv"], "must end in .fits or .ecsv"),
        (["--plot", "{tile}.jpg"], "must end in .png or .pdf or .svg"),
        (["{good}.ecsv", "--set", "catalog.units.ra"], "--set must have the form KEY=VALUE"),
        (["{good}.ecsv", "--column", "rightascension=x"], "unknown column role 'rightascension'"),
    ],
)
def test_bad_input_is_one_sentence(run, tmp_path, arguments, message):
    (tmp_path / "bad.fits").write_bytes(b"nothing")
    (tmp_path / "bad.txt").write_bytes(b"nothing")
    deg = u.deg
    for name, content in {
        "empty": {"ra": [] * deg, "dec": [] * deg},
        "noname": {"x": [1.0], "y": [2.0]},
        "units": {"ra": [1.0] * u.mm, "dec": [2.0] * deg},
        "unitless": {"ra": [1.0], "dec": [2.0] * u.deg},
        "good": {"ra": [10.0] * deg, "dec": [20.0] * deg},
    }.items():
        QTable(content).write(tmp_path / f"{name}.ecsv")
    filled = [
        a.format(**{k: tmp_path / k for k in "no bad empty noname units unitless good tile".split()}) for a in arguments
    ]
    before = sorted(p.name for p in tmp_path.iterdir())
    code, _, err = run("plan", *filled)
    assert message in sentence(code, err)
    assert sorted(p.name for p in tmp_path.iterdir()) == before


def test_overwrite(run, tmp_path):
    path = tmp_path / "tile.ecsv"
    path.write_text("old")
    assert run("plan", "--instrument", "moons", "--output", path, "--overwrite")[0] == 0
    assert rs.Tile.read(path).summary["n_positioners"] == 1001


def test_usage_errors_exit_with_2(run):
    assert run("plan", "--nonsense")[0] == 2
    assert run("nonsense")[0] == 2


@pytest.mark.parametrize("center", ["95 23", "95.0,23.0", "9.5e1 2.3e1", "06:20:00 +23:00:00", "06 20 00 +23 00 00"])
def test_centers_in_any_spelling(center):
    coord = _app.parse_center(center)
    assert (coord.ra.deg, coord.dec.deg) == pytest.approx((95, 23))


def test_without_a_center_the_middle_of_the_catalog_is_taken(run, tycho):
    code, out, _ = run("plan", tycho, "--instrument", "moons")
    assert code == 0
    assert "center 94.69" in out


def test_a_spreadsheets_csv(run, tmp_path):
    """The file begins with a byte-order mark and contains a comment."""
    rows = "\n".join(f"s{k},{10 + 0.01 * k},20.0" for k in range(10))
    (tmp_path / "s.csv").write_text("\ufeffid,ra,dec\n# a comment\n" + rows + "\n", encoding="utf-8")
    code, out, _ = run("plan", tmp_path / "s.csv", "--center", "10 20", "--instrument", "lamost")
    assert code == 0
    assert "targets in the catalog                    10" in out


@pytest.mark.few(3)
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--set", "equinox=foo"], "equinox must be a Time, a Julian year"),
        (["--set", "catalog.frame=foo", "{good}"], "unknown frame 'foo'"),
        (["--position-angle", "4000"], "--position-angle must be one finite value"),
        (["--position-angle", "nan"], "--position-angle must be one finite value"),
        (["--position-angle=1e17"], "--position-angle must be one finite value"),
        (["--plot", "{folder}/x.png.gz"], "must end in .png or .pdf or .svg"),
        (["--output", "{folder}/x.ecsv.bz2"], "must end in .fits or .ecsv"),
        (["{folder}/dir.fits"], "must contain partitions"),
        (["--instrument", "LAMOST"], "Did you mean 'lamost'"),
    ],
)
def test_more_bad_input_is_one_sentence(run, tmp_path, arguments, message):
    (tmp_path / "dir.fits").mkdir()
    QTable({"ra": [10.0] * u.deg, "dec": [20.0] * u.deg}).write(tmp_path / "good.ecsv")
    code, _, err = run("plan", *[a.format(folder=tmp_path, good=tmp_path / "good.ecsv") for a in arguments])
    assert message in sentence(code, err)


def test_probability(run, tmp_path):
    code, out, _ = run("probability", "sdss_apo", "--precision", 0.01, "--workers", 2)
    assert code == 0
    estimate = rs.collision_probability("sdss_apo", method="auto", precision=0.01)
    assert f"collision probability             {estimate.value:.5f}" in out
    assert f"{estimate.low:.5f} to {estimate.high:.5f}" in out
    path = tmp_path / "map.ecsv"
    code, out, _ = run("probability", "moons", "--method", "closed_form", "--output", path)
    assert code == 0
    assert "no error is known" in out
    table = QTable.read(path)
    assert table["x"].unit == u.mm
    assert table["probability"].mean() == pytest.approx(table.meta["value"])


def test_probability_of_a_catalog_and_of_other_targets(run, tycho):
    code, out, _ = run("probability", "lamost", "--targets", tycho)
    assert code == 0
    assert "targets given" in out
    options = [
        "--targets",
        "poisson_disc",
        "--set",
        "targets.min_separation=1",
        "--set",
        "targets.number=500",
        "--set",
        "targets.radius=60",
    ]
    code, out, _ = run("probability", "sdss_apo", *options, "--max-iterations", 8)
    assert code == 0
    assert "min_separation_mm 1" in out
    code, _, err = run("probability", "lamost", "--targets", "clustered")
    assert "unknown kind of targets 'clustered'" in sentence(code, err)
    code, _, err = run("probability", "lamost", "--targets", tycho, "--set", "targets.number=500")
    assert "targets.number can be used only with random targets, but a catalog was given" in sentence(code, err)
    code, _, err = run("probability", "lamost", "--method", "guess")
    assert "unknown method of collision probability 'guess'" in sentence(code, err)


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


@pytest.mark.exhaustive
def test_benchmark_of_probabilities(run, tmp_path):
    figures = {"central_arm": "3.0 mm", "eccentric_arm": "5.0 mm", "clearance": "1.0 mm"}
    figure = '{{ value = {}, unit = "{}", status = "assumed", source = "a test of mine" }}'
    arms = "".join(f"{name} = {figure.format(*text.split())}\n" for name, text in figures.items())
    bare = '{{ value = {}, status = "assumed", source = "a test of mine" }}'
    mine = tmp_path / "mine.toml"
    mine.write_text(
        f'schema = 1\nname = "mine"\nlayout_is = "nominal"\n[positioner]\n{arms}[layout]\nrings = {bare.format(2)}\n'
        f"pitch = {figure.format(12.0, 'mm')}\n[optics]\nplate_scale = {figure.format(60.0, 'um / arcsec')}\n"
    )
    chart = tmp_path / "chart.svg"
    code, out, _ = run("benchmark", "probability", "--instrument", mine, "--repeats", 2, "--plot", chart)
    assert code == 0
    assert "empirical" in out
    table = QTable.read(tmp_path / "chart.ecsv")
    assert set(table["method"]) == set(rs.probability.METHODS)
    assert chart.exists()


def test_an_epoch_that_no_column_says(run, tmp_path):
    """Catalogs of Gaia from other archives state the epoch only in the description of a column."""
    rows = ["Source,RA_ICRS,DE_ICRS,pmRA,pmDE"] + [f"{k},{95 + 0.01 * k},23,100,50" for k in range(50)]
    path = tmp_path / "gaia.csv"
    path.write_text("\n".join(rows))
    options = ("plan", path, "--instrument", "sdss_apo", "--center", "95.25 23", "--epoch", "2026.0")
    code, _, err = run(*options)
    assert code == 2
    assert "catalog.epoch=J2016" in err
    assert run(*options, "--set", "catalog.epoch=J2016.0", "--output", tmp_path / "tile.fits")[0] == 0
    tile = rs.Tile.read(tmp_path / "tile.fits")
    dec = tile.table["dec"][tile.table["status"] == "assigned"].to_value("deg")
    assert len(dec) > 5
    assert dec == pytest.approx(23 + 10 * 0.05 / 3600, abs=1e-7)


def test_plan_draws_all_targets_and_the_quality(run, tmp_path):
    plain, plot, quality = (tmp_path / f"{name}.png" for name in ("plain", "plot", "quality"))
    common = "plan", "--instrument", "sdss_apo"
    assert run(*common, "--plot", plain)[0] == 0
    code, out, err = run(
        *common, "--plot", plot, "--set", "output.targets=outcome", "--set", f"output.quality={quality}"
    )
    assert (code, err) == (0, "")
    assert out.endswith(f"wrote {plot}\nwrote {quality}\n")
    assert plot.read_bytes() != plain.read_bytes()
    assert quality.read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    for options, message in (
        (("--set", "output.targets=kind"), "output.targets colors the targets in a plot"),
        (("--set", "output.targets=all", "--plot", tmp_path / "a.png"), "unknown output.targets 'all'"),
        (
            ("--set", "output.targets=priority", "--plot", tmp_path / "a.png"),
            "output.targets=priority needs the column priority",
        ),
        (("--set", f"output.quality={tmp_path / 'a.txt'}"), "must end in"),
        (("--set", f"output.quality={quality}"), "exists"),
    ):
        code, out, err = run(*common, *options)
        assert code == 2
        assert message in err
        assert out == ""


def test_text_that_fits_cannot_hold_is_refused_before_planning(run, tmp_path, monkeypatch):
    def write(names, notes):
        rows = zip(names, (95, 95.1, 130), (23, 23.1, 23), notes, strict=True)
        text = "id,ra,dec,note\n" + "\n".join(",".join(map(str, row)) for row in rows)
        (tmp_path / "a.csv").write_text(text, encoding="utf-8")

    plan = ["plan", tmp_path / "a.csv", "--center", "95 23", "--instrument", "sdss_apo"]
    fits = ["--output", tmp_path / "a.fits"]
    write(["a", "b", "β Ori"], ["x", "y", "ö"])  # the last target is in another field
    assert run(*plan, "--set", "catalog.keep=note", *fits)[0] == 0
    with monkeypatch.context() as patch:
        patch.setattr(rs, "plan_tile", None)
        write(["β Ori", "b", "c"], ["x", "y", "z"])
        code, _, err = run(*plan, *fits, "--overwrite")
        assert code == 2
        assert (
            "can contain only printable ASCII text, but 1 target ids contain other characters (for example, 'β Ori')"
            in err
        )
        assert "write .ecsv instead" in err
        write(["a", "b", "c"], ["x", "ä", "z"])
        code, _, err = run(*plan, "--set", "catalog.keep=note", *fits, "--overwrite")
        assert code == 2
        assert "1 values of 'note' contain other characters (for example, 'ä')" in err
    assert run(*plan, "--set", "catalog.keep=note", "--output", tmp_path / "a.ecsv")[0] == 0


def test_the_arm_model_of_a_command_is_used_stated_and_recorded(run, tmp_path):
    path = tmp_path / "tile.fits"
    code, out, err = run("plan", "--instrument", "desi", "--set", "instrument.arm_model=elbow_to_tip", "--output", path)
    assert (code, err) == (0, "")
    lines = out.splitlines()
    k = next(k for k, line in enumerate(lines) if line.startswith("  in collision"))
    assert lines[k + 1].split() == ["arm", "model", "elbow_to_tip"]
    tile = rs.Tile.read(path)
    assert tile.summary["arm_model"] == tile.provenance["instrument"]["arm_model"] == "elbow_to_tip"
    assert repr(tile).endswith(f"{tile.summary['n_colliding']} in collision (arm model: elbow_to_tip)>")
    code, scored, _ = run("score", path, "--set", "instrument.arm_model=outline")
    assert code == 0
    assert "    arm model                        outline" in scored
    (line,) = (line for line in scored.splitlines() if line.startswith("  in collision"))
    assert int(line.split()[-1]) > 2 * tile.summary["n_colliding"]


@pytest.mark.few(1)
@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["compare-allocators", "--allocator", "nearest"], "sdss_apo, arm model elbow_to_tip; "),
        (["survey"], "  arm model                       elbow_to_tip"),
        (["tile", "--allocator", "lamost_rule", "--n-tiles", "1", "--method", "max_density"], "arm model"),
    ],
)
def test_commands_take_an_arm_model(run, arguments, words):
    code, out, err = run(*arguments, "--instrument", "sdss_apo", "--set", "instrument.arm_model=elbow_to_tip")
    assert code == 0, err
    assert words in out


@pytest.mark.few(2)
@pytest.mark.parametrize("command", ["plan", "survey", "tile", "select", "compare-allocators", "probability"])
def test_an_arm_model_that_an_instrument_does_not_have_is_refused(run, command):
    model = ["lamost"] if command == "probability" else ["--instrument", "lamost"]
    code, _, err = run(command, *model, "--set", "instrument.arm_model=outline")
    assert code != 0
    assert "instrument.arm_model must be one of elbow_to_tip, fiber_tip for lamost, got 'outline'" in err


def test_the_command_probability_states_the_arm_model(run):
    code, out, _ = run("probability", "desi", "--method", "closed_form", "--set", "instrument.arm_model=elbow_to_tip")
    assert code == 0
    assert out.startswith("desi, arm model elbow_to_tip, closed_form, independent targets")
    code, _, err = run("probability", "desi", "--method", "closed_form")
    assert code != 0
    assert "got 'outline'" in err


@pytest.mark.parametrize("digits", [400, 5000])
@pytest.mark.parametrize(
    "options",
    [
        "--rng={}",
        "--set options.subpriority={}",
        "--set conditions.site={},0,0 --set conditions.hour_angle=1",
        "--constraint=sky={}",
        "--position-angle={}",
    ],
)
def test_numbers_of_hundreds_of_digits_are_refused(tmp_path, run, digits, options):
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


def test_score_checks_the_constraints_that_a_plan_met(run, tmp_path):
    """A plan is scored with the constraints with which it was made, and with others that it cannot meet."""
    path, sky = tmp_path / "tile.fits", rs.example_catalog()
    middle = sky.coord.separation(sky.mean_direction).argmin()
    asked = ["--constraint", f"required {sky.id[middle]}", "--constraint", "science=10-300"]
    code, _, _ = run("plan", "example:anticenter", "--instrument", "sdss_apo", *asked, "--output", path)
    assert code == 0
    had = int((rs.Tile.read(path).table["status"] == "assigned").sum())
    code, out, _ = run("score", path, *asked)
    assert code == 0
    lines = [" ".join(line.split()) for line in out.splitlines()]
    assert {"constraints not met 0 of 2", f"targets that science=10-300 counts {had}"} <= {*lines}
    assert "not met:" not in out
    others = ["--constraint", "sky=5/spectrograph", "--constraint", "science=1-9", "--constraint", "required no"]
    code, out, _ = run("score", path, *asked, *others, "--report", tmp_path / "tile.html")
    assert code == 0
    lines = [" ".join(line.split()) for line in out.splitlines()]
    assert "constraints not met 3 of 4" in lines  # both lists of required targets are one constraint
    assert "targets that sky=5/spectrograph counts 0" in lines
    assert f"not met: science targets: {had}, {had - 9} more than the maximum of 9" in lines
    assert "not met: required targets without a fiber: no (1 in all)" in lines
    assert "science targets: " in (tmp_path / "tile.html").read_text()
    circle = f"keep_out {sky.coord.ra[middle].deg} {sky.coord.dec[middle].deg} 0.5"
    message = sentence(*run("score", path, "--constraint", circle)[::2])
    assert "can be checked only with positions on the sky: give --positions sky" in message
    code, out, _ = run("score", path, "--constraint", circle, "--positions", "sky")
    assert code == 0
    assert f"not met: {circle}: " in out
    assert "unknown constraint 'sky'" in sentence(*run("score", path, "--constraint", "sky")[::2])
