"""The command ``design``, and the figure that it draws."""

import re

import astropy.units as u
import numpy as np
import pytest
from astropy.table import QTable
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from own_instrument import description, hexagon

import flat
import rfpsurvey as rs
from rfpsurvey._cli import design
from rfpsurvey.plot._axes import COLLISION

MM = u.mm
GRID = {"central_arm": [7.5, 8.25, 9] * MM, "ratio": [1, 1.5], "pitch": [25, 28, 31] * MM, "clearance": 2 * MM}


@pytest.fixture(scope="module")
def table():
    return flat.explore_designs(**GRID)


def test_a_grid_is_scanned_printed_and_drawn(call, refused, tmp_path, table):
    output, plot = tmp_path / "designs.ecsv", tmp_path / "front.svg"
    words = "design --central-arm 7.5:9:3 --ratio 1,1.5 --pitch 25:31:3 --clearance 2 --output"
    found = call(f"{words} {{}} --plot {{}} --workers 2", output, plot)
    assert found.err == ""
    assert found.text.startswith(
        "18 designs, definition of the loss (fraction of lost fibers): independent; "
        "on the Pareto front (coverage max, loss min)"
    )
    assert found.out.rstrip().endswith(f"wrote {output}\nwrote {plot}")
    written = QTable.read(output)
    for name in ("central_arm", "pitch", "loss", "pareto"):
        assert (written[name] == table[name]).all()
    share = rs.design.design_sensitivities(table, figures=["loss"])["share"][0]
    assert re.search(rf"loss +central_arm +{share:.3f}", found.out)
    assert b"</svg>" in plot.read_bytes()
    assert "exists; continue the scan (--resume" in refused(words, output)
    resume = f"{words} {{}} --resume --plot {{}}"
    assert "front.svg exists; to replace it, use --overwrite" in refused(resume, output, plot)
    call(f"{resume} --overwrite", output, plot)


def test_rows_of_the_front_are_told_apart(capsys):
    """Numbers are printed with more digits only if they would otherwise look equal; equal numbers look equal."""
    table = QTable({"a": [1.0, 1.0, 2.0], "b": [0.12345678, 0.12345679, 0.5], "c": [0.5, 0.25, np.nan], "n": [1, 2, 3]})
    table["a"].info.format = ".3f"
    for name in "abc":
        design._format(table[name])
    shown = [list(table[name].info.iter_str_vals()) for name in "abc"]
    assert shown == [["1.000", "1.000", "2.000"], ["0.12345678", "0.12345679", "0.5"], ["0.5", "0.25", "nan"]]


@pytest.mark.exhaustive
def test_points_of_sobol_and_other_losses(call, tmp_path):
    grid = "--ratio 1:1.5 --pitch 26:30 --n-designs 8 --targets-per-positioner 2"
    loss = "--estimand collision_free --set loss.n_skies=2 --objective usable=max --objective loss=min"
    text = call(f"design {grid} {loss} --output", tmp_path / "d.fits").text
    assert "(fraction of lost fibers): collision_free; on the Pareto front (usable max, loss min)" in text
    found = QTable.read(tmp_path / "d.fits")
    assert (len(found), set(found["method"])) == (8, {"optimal"})
    assert (found["targets"] == 2).all()
    assert "36 designs, definition of the loss (fraction of lost fibers): independent" in call("design").out
    assert "no sensitivities: at least one of central_arm" in call("design --ratio 1 --pitch 25.6").out


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ("--central-arm long", "--central-arm must be a number, several numbers such as 7,8,9, or LOW:HIGH:NODES"),
        ("--pitch 22:30:3:4", "--pitch must be a number, several numbers"),
        ("--pitch 22:30", "--pitch 22:30: a grid needs at least two nodes, such as 22:30:5"),
        ("--pitch 22:30:5 --n-designs 9", "with --n-designs, give only limits, such as 22:30"),
        ("--ratio -1", "ratio must be finite and above 0, got -1"),
        ("--objective loss", "--objective must have the form NAME=VALUE"),
        ("--plot d.jpg", "must end in .png or .pdf or .svg"),
        ("--resume", "resume requires the path"),
        ("--spread 0.2", "--spread must be used with --instrument"),
    ],
)
def test_bad_input_is_one_sentence(refused, options, message):
    assert message in refused(f"design {options}")


@pytest.mark.exhaustive
def test_a_scan_starts_from_an_instrument_and_says_how_far_from_the_best_it_is(call, refused, tmp_path):
    (tmp_path / "mine.toml").write_text(description((8.25, 8.25), 2.0, hexagon(3, 25.6)))
    files = tmp_path / "mine.toml", tmp_path / "d.ecsv", tmp_path / "d.svg"
    words = "design --instrument {} --output {} --plot {} --spread 0.1 --central-arm "
    called = call(f"{words} 8.25", *files)
    assert called.err == ""
    assert called.out.startswith("25 designs, definition of the loss (fraction of lost fibers): independent")
    found = QTable.read(files[1])
    assert np.ma.filled(found["instrument"], "").tolist().count("mine") == 1
    assert set(found["clearance"].value) == {2.0}
    np.testing.assert_allclose(np.unique(found["pitch"].value), 25.6 * np.array([0.9, 0.95, 1, 1.05, 1.1]))
    better = rs.design.design_improvements(found)
    assert "mine: central arm 8.25 mm, ratio 1, pitch 25.6 mm, clearance 2 mm" in called.out
    assert f"  smallest loss with at least this coverage: {better['best'][1]:.5g} (" in called.out
    assert "largest coverage with at most this loss: the value of this instrument" in called.out
    assert re.search(r"by pitch 28\.16 mm \(\+10 %, at the edge of the scan\)", called.text)
    assert "mine" in files[2].read_text()
    call(f"{words} 8.25 --resume --overwrite", *files)
    message = refused(f"{words} 8.3 --resume --overwrite", *files)
    assert "holds another scan: --central-arm, start differ" in message


def offsets(collections):
    points = np.vstack([c.get_offsets() for c in collections])
    return points[np.lexsort(points.T)]


def test_every_design_is_drawn_and_the_front_is_joined(table):
    ax = rs.plot.plot_designs(table)
    everything, front = ax.collections[::2], ax.collections[1::2]
    assert len(everything) == len(front) == 2  # values of the ratio
    drawn, best = (offsets([ax.scatter(t["coverage"], t["loss"])]) for t in (table, table[table["pareto"]]))
    np.testing.assert_allclose(offsets(everything), drawn)
    np.testing.assert_allclose(offsets(front), best)
    assert len(best) > 1
    best = best[np.argsort(best[:, 0], kind="stable")]
    np.testing.assert_allclose(ax.get_lines()[0].get_xydata(), best)
    assert ax.get_ylabel() == "fraction of fibers lost to collisions (independent)"


def test_ratios_have_colors_and_markers_and_the_front_has_a_name(table):
    """Regression: few points were invisible, and the ratio of the arms was not shown if the pitch had more values."""
    ax = rs.plot.plot_designs(table)
    words = [text.get_text() for text in ax.get_legend().get_texts()]
    assert words[:-1] == [f"arm ratio {ratio:g}" for ratio in np.unique(table["ratio"])]
    assert words[-1] == f"Pareto front ({table['pareto'].sum()} of {len(table)} designs)"
    ax.figure.draw_without_rendering()  # matplotlib computes colors from values when it draws a figure
    one, other = ax.collections[0], ax.collections[2]
    assert len(one.get_paths()[0].vertices) != len(other.get_paths()[0].vertices)
    assert to_hex(one.get_facecolor()[0]) != to_hex(other.get_facecolor()[0])
    assert min(one.get_sizes()[0], other.get_sizes()[0]) >= 50
    assert one.get_facecolor()[0, 3] >= 0.8
    # many values have a color bar
    many = rs.plot.plot_designs(table, color="loss")
    assert many.figure.axes[1].get_ylabel() == "fraction of fibers lost to collisions (independent)"


def test_columns_marks_and_style_can_be_chosen(table):
    lamost = flat.explore_designs(central_arm=8.25 * MM, ratio=1, pitch=25.6 * MM, clearance=2.25 * MM)
    ax, options = Figure().add_subplot(), {"x": "pitch", "y": "loss", "color": "ratio", "cmap": "cividis"}
    assert rs.plot.plot_designs(table, mark={"LAMOST": lamost}, ax=ax, **options) is ax
    assert len(ax.get_lines()) == 0
    star = ax.collections[-1]
    assert to_hex(star.get_facecolor()[0]) == COLLISION.lower()
    np.testing.assert_allclose(star.get_offsets(), [[25.6, lamost["loss"][0]]])
    assert ([t.get_text() for t in ax.texts], ax.collections[0].get_cmap().name) == (["LAMOST"], "cividis")
    assert ax.get_xlabel() == "pitch [mm]"


def test_what_cannot_be_drawn_is_refused(table):
    grid = {**GRID, "estimand": "allocated", "n_skies": 2, "central_arm": 8 * MM, "pitch": 25 * MM}
    other = {"other": flat.explore_designs(**grid)}
    definition = "must have the same definition as in the plotted table .independent., got allocated, 4 targets"
    for value, options, words in (
        ("table", {}, "must be a table that explore_designs returned"),
        (table, {"x": "method"}, "unknown column of designs 'method'"),
        (table, {"mark": other}, definition),
    ):
        with pytest.raises(rs.InputError, match=words):
            rs.plot.plot_designs(value, **options)


def test_the_instrument_of_a_scan_is_a_star_with_its_name_and_no_other_point():
    around = rs.design.explore_around("lamost", spread=0.1, n_nodes=2)
    ax = rs.plot.plot_designs(around)
    assert [t.get_text() for t in ax.texts] == ["lamost"]
    own = around[-1]
    np.testing.assert_allclose(ax.collections[-1].get_offsets(), [[own["coverage"], own["loss"]]])
    assert len(offsets(ax.collections[:-1:2])) == len(around) - 1
    words = [text.get_text() for text in ax.get_legend().get_texts()]
    assert [word for word in words if word.startswith("arm ratio")] == ["arm ratio 0.9", "arm ratio 1.1"]


def test_a_long_front_is_cut_and_a_comparison_may_be_impossible(run, monkeypatch):
    def impossible(table):
        raise rs.InputError("no design is better")

    monkeypatch.setattr(design, "MOST_ROWS", 1)
    monkeypatch.setattr(rs.design, "design_improvements", impossible)
    out = run("design", "--instrument", "sdss_apo", "--n-designs", 8)[1]
    n_front = int(out.partition("max, loss min): ")[2].split("\n")[0])
    assert f"and {n_front - 1} more designs on the front\n" in out
    assert "  no comparison: no design is better\n" in out
