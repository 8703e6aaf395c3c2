import pytest

import rfpsurvey as rs

PLAN = ("--instrument", "desi", "--allocator", "nearest", "--set")


def margins_of(path):
    """Return the margins in the provenance of a tile."""
    return rs.Tile.read(path).provenance["instrument"].get("margins")


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
def test_forms_of_the_option(run, sky, tmp_path, text, expected):
    path = tmp_path / "tile.fits"
    code, out, err = run("plan", sky, *PLAN, f"instrument.margins={text}", "--output", path)
    assert (code, err) == (0, "")
    assert margins_of(path) == expected
    assert ("    margins" in out) == (expected is not None)


@pytest.mark.few(2)
@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("outer", "margins must be off, instrument, or NAME=VALUE"),
        ("outer=wide", "margins must be off, instrument, or NAME=VALUE"),
        ("off,outer=1", "margins must be off, instrument, or NAME=VALUE"),
        ("outer=1,outer=2", "with different names"),
        ("edge=1", "unknown key 'instrument.margins.edge'"),
        ("outer=-1", "the margin outer must be one finite value of at least 0 mm"),
        ("outer=nan", "the margin outer must be one finite value"),
        ("inner=6.5", "the margins outer and inner must leave a part of the patrol area"),
    ],
)
def test_invalid_margins(run, sky, text, sentence):
    code, _, err = run("plan", sky, *PLAN, f"instrument.margins={text}")
    assert code == 2
    assert sentence in err
    assert len(err.strip().splitlines()) == 1


def test_an_instrument_without_margins(run, sky):
    code, _, err = run("plan", sky, "--instrument", "lamost", "--set", "instrument.margins=instrument")
    assert code == 2
    assert "margins must give values, such as outer=0.1" in err


def test_all_commands_that_plan_use_the_margins(run, sky, tmp_path):
    tiles, folder, tile = tmp_path / "tiles.ecsv", tmp_path / "survey", tmp_path / "tile.fits"
    common = ("--instrument", "desi", "--set", "instrument.margins=outer=0.7")
    code, out, err = run("tile", sky, *common, "--method", "max_density", "--n-tiles", 1, "--output", tiles)
    assert (code, err) == (0, "")
    assert "outer 0.7 mm" in out
    code, out, _ = run("survey", sky, "--tiles", tiles, *common, "--folder", folder)
    assert code == 0
    assert "outer 0.7 mm" in out
    assert rs.Survey.read(folder).provenance["instrument"]["margins"] == {"outer_mm": 0.7}
    assert run("select", sky, "--tiles", tiles, *common, "--n-realizations", 2, "--output", tmp_path / "p.fits")[0] == 0
    chances = rs.SelectionProbabilities.read(tmp_path / "p.fits")
    assert chances.provenance["instrument"]["margins"] == {"outer_mm": 0.7}
    code, out, _ = run("compare-allocators", sky, *common, "--allocator", "nearest")
    assert code == 0
    assert "margins: outer 0.7 mm" in out
    assert run("plan", sky, "--instrument", "desi", "--allocator", "nearest", "--output", tile)[0] == 0
    code, out, err = run("score", tile, "--set", "instrument.margins=outer=0.7")
    assert (code, err) == (0, "")
    n = int(next(line for line in out.splitlines() if "within the margins" in line).split()[-1])
    assert n > 10


@pytest.mark.exhaustive
def test_a_comparison_of_instruments_with_margins(run):
    options = ("--targets-per-positioner", 0.2, "--n-realizations", 1, "--allocator", "nearest")
    code, out, err = run("compare", "moons", "pfs", "--set", "instrument.margins=outer=0.3", *options)
    assert (code, err) == (0, "")
    assert "margins of pfs: outer_mm 0.3\n" in out


def test_tiles_without_positioners_have_no_margins(run, sky):
    for options in (("--region", "cap 95 23 5"), (sky, "--set", "fibers=100"), (sky, "--set", "radius=1")):
        code, _, err = run("tile", *options, "--instrument", "desi", "--set", "instrument.margins=outer=0.7")
        assert code == 2
        assert "margins must be given only if positioners observe the targets of a catalog" in err


def test_probabilities_with_margins(run):
    """The margins change the probability and are stated; a formula without these margins refuses them."""
    values, shape = [], ("desi", "--set", "instrument.arm_model=elbow_to_tip")
    for extra in ((), ("--set", "instrument.margins=outer=1.5")):
        code, out, err = run("probability", *shape, "--method", "close_pair", *extra)
        assert (code, err) == (0, "")
        assert ("margins: outer 1.5 mm" in out) == bool(extra)
        values.append(float(out.split("collision probability")[1].split()[0]))
    assert values[0] != values[1]
    code, _, err = run("probability", *shape, "--method", "closed_form", *extra)
    assert code == 2
    assert "the margins outer must be 0 for the method 'closed_form'" in err
