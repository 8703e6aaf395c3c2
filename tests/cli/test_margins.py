import pytest

import rfpsurvey as rs

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
    assert err == ""
    assert rs.Tile.read(path).provenance["instrument"].get("margins") == expected
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
    message = "the margins outer must be 0 for the method 'closed_form'"
    assert message in refused(f"{words} closed_form {extra}")
