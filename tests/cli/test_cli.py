import re
import subprocess
import sys

import astropy.units as u
import numpy as np
import pytest
from astropy.table import QTable, Table
from own_instrument import description, hexagon

import rfpsurvey as rs
from rfpsurvey._cli import command as _app
from rfpsurvey._cli.application import COMMANDS

PNG = b"\x89PNG\r\n\x1a\n"
BENCHMARKS = [f"benchmark {name}" for name in ("collisions", "batches", "probability")]


@pytest.mark.few(1)
@pytest.mark.parametrize("instrument", ["lamost", "sdss_apo"])
def test_plan_of_a_real_field(call, tycho, tmp_path, instrument):
    fits, png = tmp_path / "tile.fits", tmp_path / "tile.png"
    field = "--center '06h20m00s +23d00m00s' --position-angle 15 --epoch 2026.5"
    out, err = call(f"plan {{}} --instrument {instrument} {field} --output {{}} --plot {{}}", tycho, fits, png)
    assert err == ""
    assert "targets in the catalog                  8830" in out
    assert (QTable.read(fits)["x"].unit, png.read_bytes()[:8]) == (u.mm, PNG)
    tile = rs.Tile.read(fits)
    assert f"{tile.summary['n_assigned']:>10}" in out
    assert instrument != "lamost" or 1900 < tile.summary["n_in_field"] < 2700
    assert tile.provenance["parameters"]["epoch"] == "J2026.500"


@pytest.mark.few(2)
@pytest.mark.parametrize("name", ["tile.ecsv", "tile.ecsv.gz", "tile.fits"])
def test_it_is_printed_that_ecsv_has_no_outcomes(call, tmp_path, name):
    path = tmp_path / name
    out, err = call("plan --instrument sdss_apo --output", path)
    assert err == ""
    told = (
        f"{path} does not contain the outcomes of targets; to keep the outcomes, write a .fits file, which can "
        "hold two tables"
    )
    assert (told in out.splitlines()) == (rs.Tile.read(path).outcomes is None) == (".ecsv" in name)
    # a scored tile has no outcomes
    assert "no outcomes" not in call("score {} --output {}", path, tmp_path / "scored.ecsv").out


def test_the_embedded_default(call):
    out = call("plan").out
    assert out.startswith("lamost, allocator repair\n")
    assert "collision rate" in out


def test_module_and_version_and_help(call):
    done = subprocess.run([sys.executable, "-m", "rfpsurvey", "--version"], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout.split()[0]) == (0, "rfpsurvey")
    for words, text in (("--version", "rfpsurvey "), ("--help", "plan"), ("plan --help", "Examples:")):
        assert text in call(words).out


def test_instruments(call):
    out = call("instruments").out
    assert all(name in out for name in rs.available_instruments())
    out = call("instruments lamost").out
    assert "positioner.central_arm = 8.25 mm\n    published: Chen et al." in out
    assert "assumed: " in out
    assert re.search(r"^field shape +circle$", out, re.MULTILINE)
    assert re.search(r"^published values +14$", out, re.MULTILINE)


def test_instruments_side_by_side(call):
    out = call("instruments lamost sdss_apo").out
    lines = {line[:22].strip(): line[22:].split() for line in out.splitlines()}
    assert (lines[""], lines["positioners"]) == (["lamost", "sdss_apo"], ["4000", "500"])
    assert lines["field shape"] == ["circle", "hexagon"]
    assert lines["fibers"][-4:] == ["BOSS", "500,", "APOGEE", "298"]
    assert "published: " not in out


@pytest.mark.parametrize("command", [*COMMANDS, *BENCHMARKS])
@pytest.mark.parametrize("option", ["--help", "--help-keys"])
def test_help_fits_into_80_columns(run, monkeypatch, command, option):
    monkeypatch.setenv("COLUMNS", "80")
    code, out, _ = run(*command.split(), option)
    assert code == 0 or option == "--help-keys"
    assert [line for line in out.splitlines() if len(line) > 80] == []


SKY = "--constraint sky=900/spectrograph"


@pytest.mark.parametrize(
    "command",
    [
        *(f"plan --instrument moons {SKY}", f"survey --instrument moons {SKY}"),
        *("select --instrument moons --n-realizations 1", "instruments", "instruments desi", "instruments sdss_apo"),
        "instruments moons desi",
    ],
)
def test_results_are_printed_in_lines_of_100_characters(call, command):
    """Sentences such as the one on the model continue on the next line, which is indented."""
    out = call(command).out
    assert [line for line in out.splitlines() if len(line) > 100] == []
    if not command.startswith("instruments"):
        (model,) = re.findall(r"^model: .*\n(?:  .*\n)+?(?=\S)", out, re.MULTILINE)
        assert "Positions: a tangent plane" in " ".join(model.split())


@pytest.mark.exhaustive
def test_benchmarks(call, refused, tmp_path):
    mine, chart = tmp_path / "mine.toml", tmp_path / "chart.png"
    mine.write_text(description((3.0, 5.0), 1.0, hexagon(1, 12.0)))
    words = "benchmark collisions --instrument {} --method exact --method endpoints --repeats 1 --plot {}"
    assert "endpoints" in call(words, mine, chart).out
    assert chart.stat().st_size > 10_000
    assert QTable.read(chart.with_suffix(".ecsv"))["method"].tolist() == ["exact", "endpoints"]
    assert "chart.ecsv exists" in refused(words, mine, chart)
    assert "10000" in call("benchmark batches --repeats 1 --instrument", mine).out
    chart = tmp_path / "chart.svg"
    probability = "benchmark probability --repeats 2 --instrument {} --plot {} --overwrite"
    assert "empirical" in call(probability, mine, chart).out
    assert set(QTable.read(tmp_path / "chart.ecsv")["method"]) == set(rs.probability.METHODS)
    assert chart.exists()


def test_score(call, refused, tmp_path):
    x, y = rs.Instrument.preset("lamost").focal_plane.xy[:3].T
    path, output = tmp_path / "plan.ecsv", tmp_path / "out.ecsv"
    QTable({"positioner": [0, 1, 2], "field": [1, 1, 2], "x": x + 5 * u.mm, "y": y}).write(path)
    assert "--instrument must name the instrument of the assignment" in refused("score", path)
    out = call("score {} --instrument lamost --select field=1 --output {}", path, output).out
    assert rs.Tile.read(output).summary["n_assigned"] == 2
    assert "allocator scored" in out
    assert "poses: 3998 positioners without a target: 3998 assumed to be parked" in out
    # a tile of this package contains the name of its instrument
    assert "lamost, nominal, allocator scored" in call("score", output).out.splitlines()
    for file, options, message in (
        (output, "--instrument desi", "--instrument must be the instrument of the tile, lamost"),
        (path, "--select field=3", "selects no row"),
        (path, "--select no=3", "no column 'no'; the columns are: positioner"),
        (path, "--select field", "must have the form NAME=VALUE"),
    ):
        assert message in refused(f"score {{}} {options}", file)


def test_nothing_assigned_has_no_collision_rate(call, tmp_path):
    """Idle arms of unequal length are not obstacles, so that no positioner is counted.

    The focal plane requires no center.
    """
    unit, one = rs.Instrument.preset("sdss_apo").focal_plane, tmp_path / "one.ecsv"
    x, y = unit.xy[:1].T
    QTable({"positioner": unit.id[:1], "x": x + 500 * u.mm, "y": y, "assigned": [1]}).write(one)
    out = call("plan --instrument sdss_apo --center '95 23' --constraint 'keep_out 95 23 3' --allocator repair").out
    assert "undefined, because no arm is assigned" in out
    assert "nan" not in out.lower().split()
    with pytest.warns(rs.RfpsurveyWarning, match="out of reach"):
        rs.score_tile(QTable.read(one), "sdss_apo")
    out = call("score --instrument sdss_apo", one).out
    assert "collisions were found from positions on the focal plane, which do not require a field center" in out


def test_columns_units_and_toml(call, tmp_path):
    rng = np.random.default_rng(1)
    t = Table({"a": rng.uniform(9.7, 10.3, 50), "b": rng.uniform(19.7, 20.3, 50), "rank": np.arange(50)})
    t.write(tmp_path / "t.ecsv")
    words = "plan {} --center '10.0 20.0' --instrument moons --column ra=a --column dec=b --column priority=-rank"
    err = call(words, tmp_path / "t.ecsv").err
    assert "the assumed units are a in deg, b in deg; to use other units, give units= or --set catalog.units" in err
    out, err = call(f"{words} --set catalog.units.ra=deg --set catalog.units.dec=deg", tmp_path / "t.ecsv")
    assert "unit" not in err
    assert "in reach of a positioner" in out


def test_dropped_rows_are_a_warning_and_a_count(call, tmp_path):
    QTable({"ra": [10, np.nan] * u.deg, "dec": [20, 20] * u.deg}).write(tmp_path / "t.ecsv")
    out, err = call("plan {} --center '10.0 20.0'", tmp_path / "t.ecsv")
    assert re.search(r"removed \(coordinates not finite\) +1\n", out)
    assert err == "rfpsurvey: warning: 1 of 2 targets have no finite coordinates and were removed\n"


def test_overwrite(call, tmp_path):
    path = tmp_path / "tile.ecsv"
    path.write_text("old")
    call("plan --instrument moons --overwrite --output", path)
    assert rs.Tile.read(path).summary["n_positioners"] == 1001


def test_usage_errors_exit_with_2(run):
    assert (run("plan", "--nonsense")[0], run("nonsense")[0]) == (2, 2)


@pytest.mark.parametrize("center", ["95 23", "95.0,23.0", "9.5e1 2.3e1", "06:20:00 +23:00:00", "06 20 00 +23 00 00"])
def test_centers_in_any_spelling(center):
    coord = _app.parse_center(center)
    assert (coord.ra.deg, coord.dec.deg) == pytest.approx((95, 23))


def test_without_a_center_the_middle_of_the_catalog_is_taken(call, tycho):
    assert "center 94.69" in call("plan {} --instrument moons", tycho).out


def test_a_spreadsheets_csv(call, tmp_path):
    """The file begins with a byte-order mark and contains a comment."""
    rows = "\n".join(f"s{k},{10 + 0.01 * k},20.0" for k in range(10))
    (tmp_path / "s.csv").write_text("\ufeffid,ra,dec\n# a comment\n" + rows + "\n", encoding="utf-8")
    out = call("plan {} --center '10 20' --instrument lamost", tmp_path / "s.csv").out
    assert "targets in the catalog                    10" in out


def test_probability(call, tmp_path):
    out = call("probability sdss_apo --precision 0.01 --workers 2").out
    estimate = rs.collision_probability("sdss_apo", method="auto", precision=0.01)
    assert f"collision probability             {estimate.value:.5f}" in out
    assert f"{estimate.low:.5f} to {estimate.high:.5f}" in out
    path = tmp_path / "map.ecsv"
    assert "no error is known" in call("probability moons --method closed_form --output", path).out
    table = QTable.read(path)
    assert (table["x"].unit, table["probability"].mean()) == (u.mm, pytest.approx(table.meta["value"]))


def test_probability_of_a_catalog_and_of_other_targets(call, refused, tycho):
    assert "targets given" in call("probability lamost --targets", tycho).out
    disc = "--targets poisson_disc --set targets.min_separation=1 --set targets.number=500 --set targets.radius=60"
    assert "min_separation_mm 1" in call(f"probability sdss_apo {disc} --max-iterations 8").out
    message = refused("probability lamost --targets {} --set targets.number=500", tycho)
    assert "targets.number can be used only with random targets, but a catalog was given" in message
    assert "unknown method of collision probability 'guess'" in refused("probability lamost --method guess")


def test_an_epoch_that_no_column_says(call, refused, tmp_path):
    """Catalogs of Gaia from other archives state the epoch only in the description of a column."""
    rows = ["Source,RA_ICRS,DE_ICRS,pmRA,pmDE"] + [f"{k},{95 + 0.01 * k},23,100,50" for k in range(50)]
    path, output = tmp_path / "gaia.csv", tmp_path / "tile.fits"
    path.write_text("\n".join(rows))
    words = "plan {} --instrument sdss_apo --center '95.25 23' --epoch 2026.0"
    assert "catalog.epoch=J2016" in refused(words, path)
    call(f"{words} --set catalog.epoch=J2016.0 --output {{}}", path, output)
    tile = rs.Tile.read(output)
    dec = tile.table["dec"][tile.table["status"] == "assigned"].to_value("deg")
    assert len(dec) > 5
    assert dec == pytest.approx(23 + 10 * 0.05 / 3600, abs=1e-7)


def test_plan_draws_all_targets_and_the_quality(call, run, tmp_path):
    plain, plot, quality = (tmp_path / f"{name}.png" for name in ("plain", "plot", "quality"))
    words = "plan --instrument sdss_apo --plot"
    call(words, plain)
    out, err = call(f"{words} {{}} --set output.targets=outcome --set output.quality={{}}", plot, quality)
    assert err == ""
    assert out.endswith(f"wrote {plot}\nwrote {quality}\n")
    assert plot.read_bytes() != plain.read_bytes()
    assert quality.read_bytes()[:8] == PNG
    file = ("--plot", tmp_path / "a.png")
    for key, others, message in (
        ("targets=kind", (), "output.targets colors the targets in a plot"),
        ("targets=all", file, "unknown output.targets 'all'"),
        ("targets=priority", file, "output.targets=priority needs the column priority"),
        (f"quality={tmp_path / 'a.txt'}", (), "must end in"),
        (f"quality={quality}", (), "exists"),
    ):
        code, out, err = run("plan", "--instrument", "sdss_apo", "--set", f"output.{key}", *others)
        assert (code, out) == (2, "")
        assert message in err


def test_text_that_fits_cannot_hold_is_refused_before_planning(call, refused, tmp_path, monkeypatch):
    def write(names, notes):
        rows = zip(names, (95, 95.1, 130), (23, 23.1, 23), notes, strict=True)
        text = "id,ra,dec,note\n" + "\n".join(",".join(map(str, row)) for row in rows)
        (tmp_path / "a.csv").write_text(text, encoding="utf-8")

    plan = "plan {} --center '95 23' --instrument moons --overwrite --output {}"
    fits, note = (tmp_path / "a.csv", tmp_path / "a.fits"), ("--set", "catalog.keep=note")
    write(["a", "b", "β Ori"], ["x", "y", "ö"])  # the last target is in another field
    call(plan, *fits, *note)
    with monkeypatch.context() as patch:
        patch.setattr(rs, "plan_tile", None)
        write(["β Ori", "b", "c"], ["x", "y", "z"])
        message = refused(plan, *fits)
        assert "can contain only printable ASCII text, but 1 target ids contain other characters" in message
        assert "(for example, 'β Ori')" in message
        assert "write .ecsv instead" in message
        write(["a", "b", "c"], ["x", "ä", "z"])
        assert "1 values of 'note' contain other characters (for example, 'ä')" in refused(plan, *fits, *note)
    call(plan, tmp_path / "a.csv", tmp_path / "a.ecsv", *note)


MODEL = "--set instrument.arm_model="


def test_the_arm_model_of_a_command_is_used_stated_and_recorded(call, tmp_path):
    path = tmp_path / "tile.fits"
    out, err = call(f"plan --instrument desi {MODEL}elbow_to_tip --output", path)
    assert err == ""
    lines = out.splitlines()
    k = next(k for k, line in enumerate(lines) if line.startswith("  in collision"))
    assert lines[k + 1].split() == ["arm", "model", "elbow_to_tip"]
    tile = rs.Tile.read(path)
    assert tile.summary["arm_model"] == tile.provenance["instrument"]["arm_model"] == "elbow_to_tip"
    assert repr(tile).endswith(f"{tile.summary['n_colliding']} in collision (arm model: elbow_to_tip)>")
    scored = call(f"score {{}} {MODEL}outline", path)
    assert "    arm model                        outline" in scored.out
    assert int(scored.lines["in collision"][-1]) > 2 * tile.summary["n_colliding"]


@pytest.mark.few(1)
@pytest.mark.parametrize(
    ("words", "text"),
    [
        ("compare-allocators --allocator nearest", "sdss_apo, arm model elbow_to_tip; "),
        ("survey", "  arm model                       elbow_to_tip"),
        ("tile --allocator lamost_rule --n-tiles 1 --method max_density", "arm model"),
    ],
)
def test_commands_take_an_arm_model(call, words, text):
    assert text in call(f"{words} --instrument sdss_apo {MODEL}elbow_to_tip").out


@pytest.mark.few(2)
@pytest.mark.parametrize("command", ["plan", "survey", "tile", "select", "compare-allocators", "probability"])
def test_an_arm_model_that_an_instrument_does_not_have_is_refused(refused, command):
    name = "lamost" if command == "probability" else "--instrument lamost"
    message = "instrument.arm_model must be one of elbow_to_tip, fiber_tip for lamost, got 'outline'"
    assert message in refused(f"{command} {name} {MODEL}outline")


def test_the_command_probability_states_the_arm_model(call, refused):
    words = "probability desi --method closed_form"
    out = call(f"{words} {MODEL}elbow_to_tip").out
    assert out.startswith("desi, arm model elbow_to_tip, closed_form, independent targets")
    assert "got 'outline'" in refused(words)


def test_score_checks_the_constraints_that_a_plan_met(call, refused, tmp_path):
    """A plan is scored with the constraints with which it was made, and with others that it cannot meet."""
    path, page, sky = tmp_path / "tile.fits", tmp_path / "tile.html", rs.example_catalog()
    middle = sky.coord.separation(sky.mean_direction).argmin()
    asked = ["--constraint", f"required {sky.id[middle]}", "--constraint", "science=10-300"]
    call("plan example:anticenter --instrument sdss_apo --output", path, *asked)
    had, out = int((rs.Tile.read(path).table["status"] == "assigned").sum()), call("score", path, *asked).out
    lines = [" ".join(line.split()) for line in out.splitlines()]
    assert {"constraints not met 0 of 2", f"targets that science=10-300 counts {had}"} <= {*lines}
    assert "not met:" not in out
    others = "--constraint sky=5/spectrograph --constraint science=1-9 --constraint 'required no'"
    out = call(f"score {others} --report", page, path, *asked).out
    lines = [" ".join(line.split()) for line in out.splitlines()]
    assert "constraints not met 3 of 4" in lines  # both lists of required targets are one constraint
    assert "targets that sky=5/spectrograph counts 0" in lines
    assert f"not met: science targets: {had}, {had - 9} more than the maximum of 9" in lines
    assert "not met: required targets without a fiber: no (1 in all)" in lines
    assert "science targets: " in page.read_text()
    circle = f"keep_out {sky.coord.ra[middle].deg} {sky.coord.dec[middle].deg} 0.5"
    words = ("score {} --constraint", path, circle)
    assert "can be checked only with positions on the sky: give --positions sky" in refused(*words)
    assert f"not met: {circle}: " in call(*words, "--positions", "sky").out
    assert "unknown constraint 'sky'" in refused("score {} --constraint sky", path)
