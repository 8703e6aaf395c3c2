"""Plots of tables: speed against accuracy, the legibility of their labels, probabilities, and allocators."""

from itertools import combinations

import astropy.units as u
import numpy as np
import pytest
from astropy.table import QTable
from matplotlib.figure import Figure
from matplotlib.text import Annotation
from text_tables import text_table

import rfpsurvey as rs
from rfpsurvey._studies.benchmark_probability import processor

COLLISIONS = """
method n_points time n_colliding_true misclassified max_error
exact "" 0.030 577 0 1e-15
sampled 3 0.029 577 0.12 4
sampled 5 0.031 577 0.02 2.4
sampled 9 0.032 577 0.007 1
sampled 17 0.06 577 0 0.5
sampled 33 0.2 577 0 0.1
endpoints "" 0.028 577 0.024 4.1
"""
PROBABILITIES = """
method estimand effort time error error_error truth_error
closed_form independent 0 1 0.1 0 2e-4
quadrature independent 64 2 0.01 0.001 2e-4
quadrature independent 128 4 0.005 0.0006 2e-4
conditional allocated 16 3 0.02 0.04 1e-4
"""


def collisions():
    meta = {"instrument": "mine", "n_positioners": 500, "machine": "a processor, 2 cores"}
    return text_table(COLLISIONS, meta, time=u.ms, max_error=u.mm)


@pytest.fixture(scope="module")
def chart():
    """Return the axes of a plot of collision methods, drawn once."""
    return rs.plot.plot_speed_accuracy(collisions())


def probabilities():
    return text_table(PROBABILITIES, {"instrument": "mine", "repeats": 30}, time=u.ms)


def labels_of(ax):
    return [t for t in ax.texts if t.get_text()]


def ticks_of(axis):
    """Return the labels of the ticks within the limits, because only these are drawn."""
    low, high = axis.get_view_interval()
    ticks = [*axis.get_major_ticks(), *axis.get_minor_ticks()]
    return [t.label1 for t in ticks if low <= t.get_loc() <= high and t.label1.get_text() and t.label1.get_visible()]


def assert_readable(axes):
    """Check that no label overlaps another label or extends beyond the figure."""
    figure = axes[0].figure
    figure.draw_without_rendering()
    for ax in axes:
        across, up = ticks_of(ax.xaxis), ticks_of(ax.yaxis)
        assert min(len(across), len(up)) >= 2
        for texts in (labels_of(ax), across + up):
            boxes = [t.get_window_extent() for t in texts]
            assert not [1 for one, other in combinations(boxes, 2) if one.overlaps(other)]
    wide, high = figure.bbox.size
    titles = [ax.title for ax in axes] + [figure._suptitle] * (figure._suptitle is not None)
    for text in [*titles, *(label for ax in axes for label in labels_of(ax))]:
        box = text.get_window_extent()
        assert min(box.x0, box.y0, wide - box.x1, high - box.y1) >= 0


def test_zeros_are_upper_limits_with_arrows(chart):
    above, below = chart
    arrows = [t for t in above.texts if isinstance(t, Annotation) and t.arrow_patch is not None]
    assert (sorted(a.xy[0] for a in arrows), {a.xy[1] for a in arrows}) == ([0.03, 0.06, 0.2], {1 / 577})
    assert all(a.xyann[1] < 0 for a in arrows)
    assert not [t for t in below.texts if t.arrow_patch is not None]
    np.testing.assert_allclose(above.get_lines()[0].get_xydata(), [[0.03, 1 / 577]])
    assert above.get_ylim()[0] < 1 / 577


def test_fractions_of_misclassified_pairs_have_standard_errors(chart):
    above, below = chart
    assert not below.containers
    ends = np.concatenate([np.array(bars.lines[2][0].get_segments())[:, :, 1] for bars in above.containers])
    value = np.array([v for v in collisions()["misclassified"] if v > 0])
    np.testing.assert_allclose(np.sort(ends[:, 1]), np.sort(value + np.sqrt(value / 577)))
    assert (ends[:, 0] > 0).all()


def test_the_chart_states_machine_and_better_corner(chart):
    above, _ = chart
    for words in ("mine: 500 positioners, 577 colliding pairs", "a processor, 2 cores", "lower left is better"):
        assert words in above.get_title()


def test_labels_of_collisions_can_be_read():
    axes = tuple(Figure((6, 6), layout="constrained").subplots(2))
    assert_readable(rs.plot.plot_speed_accuracy(collisions(), axes=axes))


def test_labels_of_probabilities_can_be_read():
    table = probabilities()
    table["time"][2] = 2.1 * u.ms
    table["error"][2] = 0.0098
    assert_readable(rs.plot.plot_probability_accuracy(table))


def test_ticks_of_a_short_axis_do_not_overlap():
    """Regression: labels such as 2 x 10^0, 3 x 10^0 and 4 x 10^0 overlapped."""
    table = QTable({"method": ["conditional"] * 4, "estimand": ["allocated"] * 4, "effort": [4, 16, 64, 256]})
    table["time"], table["error"] = [2.2, 5.7, 21, 38] * u.ms, [3e-3, 1.7e-3, 9e-4, 7e-4]
    table["error_error"], table["truth_error"] = 3e-4, 2e-4
    axes = rs.plot.plot_probability_accuracy(table, axes=(Figure((4.5, 4), layout="constrained").add_subplot(),))
    assert_readable(axes)
    assert {"5", "10", "20"} <= {t.get_text() for t in ticks_of(axes[0].xaxis)}


def test_estimands_have_panels_of_their_own():
    allocated, independent = rs.plot.plot_probability_accuracy(probabilities())
    assert [ax.get_title() for ax in (allocated, independent)] == ["allocated targets", "independent targets"]
    assert [t.get_text() for t in independent.get_legend().get_texts()] == ["closed_form", "quadrature"]
    assert [t.get_text() for t in allocated.get_legend().get_texts()] == ["conditional"]
    assert [t.get_text() for t in labels_of(independent)] == ["64", "128"]
    formula, quadrature = independent.containers
    assert formula[0].get_markerfacecolor() == "none"
    np.testing.assert_array_equal(quadrature[0].get_xydata(), [[2, 0.01], [4, 0.005]])
    bars = quadrature[2][0].get_segments()
    np.testing.assert_allclose([bar[:, 1] for bar in bars], [[0.009, 0.011], [0.0044, 0.0056]])
    assert allocated.containers[0][2][0].get_segments()[0][0, 1] > 0  # error bars end above 0
    assert "30 runs per point" in allocated.figure.get_suptitle()


def test_options_reach_the_lines_and_axes_are_those_given():
    axes = tuple(Figure().subplots(1, 2))
    assert rs.plot.plot_probability_accuracy(probabilities(), axes=axes, markersize=9) == axes
    assert axes[0].containers[0][0].get_markersize() == 9
    with pytest.raises(rs.InputError, match="axes must be 2 Axes, one for each estimand, got 1"):
        rs.plot.plot_probability_accuracy(probabilities(), axes=axes[:1])


def test_errors_of_repeated_runs_have_errors_of_their_own():
    """Compare the stated standard error of the error with the scatter of many independent benchmarks."""
    robot = rs.Positioner(8.25 * u.mm, 8.25 * u.mm, 2.25 * u.mm)
    plane = rs.FocalPlane.hexagonal(robot, rings=1, pitch=25.6 * u.mm)
    options = {"efforts": {"conditional": [32]}, "repeats": 20, "precision": 1e-3}
    tables = [rs.benchmark.benchmark_probability(plane, rng=k, **options) for k in range(30)]
    errors, stated = np.array([t["error"][0] for t in tables]), np.mean([t["error_error"][0] for t in tables])
    # a standard deviation of 30 values is known to 13 %, and the mean of the stated ones to 6 %; the limit is three
    # times their sum
    assert stated == pytest.approx(errors.std(ddof=1), rel=0.45)
    bias = np.array([t["bias"][0] for t in tables])
    assert (np.abs(bias) < 4 * np.array([t["bias_error"][0] for t in tables])).all()
    np.testing.assert_allclose(bias, [t["value"][0] - t["truth"][0] for t in tables])


def test_the_processor_is_named_as_the_system_does(tmp_path):
    file = tmp_path / "cpuinfo"
    file.write_text("processor : 0\nmodel name\t: A Processor 9000\nprocessor : 1\nmodel name\t: A Processor 9000\n")
    assert processor(file) == "A Processor 9000"
    assert processor(tmp_path / "none") != ""


SCAN = text_table(
    """
pitch value low high formula formula_error arms
35 0.1 0.05 0.12 0.0 0.01 long
26 0.4 0.37 0.42 0.1 0.02 short
30 0.2 0.18 0.25 "" 0.03 long
""",
    pitch=u.mm,
)


def band(collection):
    """Return the lower and upper edges of the interval by x."""
    corners = collection.get_paths()[0].vertices
    return {x: (corners[corners[:, 0] == x, 1].min(), corners[corners[:, 0] == x, 1].max()) for x in corners[:, 0]}


def test_lines_have_their_intervals():
    ax = rs.plot.plot_probability(SCAN, "pitch", values=["value", "formula"], linewidth=3)
    value, formula = ax.get_lines()
    np.testing.assert_array_equal(value.get_xydata(), [[26, 0.4], [30, 0.2], [35, 0.1]])
    np.testing.assert_array_equal(formula.get_ydata(), [0.1, np.nan, 0])
    assert value.get_linewidth() == 3
    assert value.get_marker() != formula.get_marker()
    assert value.get_linestyle() != formula.get_linestyle()
    of_value, of_formula = map(band, ax.collections)
    assert of_value == {26: (0.37, 0.42), 30: (0.18, 0.25), 35: (0.05, 0.12)}
    assert of_formula[26] == pytest.approx((0.1 - 1.96 * 0.02, 0.1 + 1.96 * 0.02))
    assert [t.get_text() for t in ax.get_legend().get_texts()] == ["value", "formula", "interval"]
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("pitch [mm]", "collision probability")


def test_groups_have_lines_of_their_own():
    into = Figure().add_subplot()
    ax = rs.plot.plot_probability(SCAN["pitch", "value", "arms"], "pitch", by="arms", ax=into)
    assert ax is into
    lines = {line.get_label(): line.get_xydata().tolist() for line in ax.get_lines()}
    assert lines == {"long": [[30, 0.2], [35, 0.1]], "short": [[26, 0.4]]}
    assert not ax.collections  # the intervals are unknown


probability, residuals = rs.plot.plot_probability, rs.plot.plot_residuals


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: probability([1]), "table must be a QTable, got list"),
        (lambda: probability(SCAN), "table must have the column ratio; it has pitch"),
        (lambda: probability(SCAN, "pitch", values="arms"), "arms must be a column of numbers"),
        (lambda: probability(SCAN, "pitch", values=[]), "values must name at least one column"),
        (lambda: probability(SCAN[:0], "pitch"), "table must have at least one row"),
        (lambda: residuals(SCAN, "value", "nothing"), "table must have the column nothing"),
        (lambda: residuals(SCAN[2:], "value", "formula", x="pitch"), "must both have a number in at least one row"),
        (lambda: rs.plot.plot_allocators(SCAN), "must come from compare_allocators, got one without the column alloc"),
    ],
)
def test_other_tables_are_refused(call, message):
    with pytest.raises(rs.InputError, match=message):
        call()


def test_residuals_point_where_they_go():
    table = text_table(
        "ratio pitch here there\n1 26 0.3 0.1\n1.2 28 0.1 0.4\n1.4 30 0.2 0.2\n1.6 32 0.5 nan", pitch=u.mm
    )
    ax = rs.plot.plot_residuals(table, "here", "there", s=7)
    up, down, zero = ax.collections[:3]
    assert [c.get_offsets().tolist() for c in (up, down, zero)] == [[[1, 26]], [[1.2, 28]], [[1.4, 30]]]
    assert len({c.get_paths()[0].vertices.tobytes() for c in (up, down, zero)}) == 3
    np.testing.assert_allclose(down.get_array(), [-0.3])
    assert (down.get_clim(), up.get_sizes()) == (pytest.approx((-0.3, 0.3)), [7])
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("arm ratio", "pitch [mm]")
    assert ax.figure.axes[1].get_ylabel() == "here - there"


def test_allocators_are_bars_of_what_is_usable_lost_and_missing():
    text = "allocator science usable missing seconds\nblind 90 60 0 0.0123\ncareful 70 70 5 4.56"
    table = text_table(text, {"blind_science": 95, "instrument": "mine"}, seconds=u.s)
    ax = rs.plot.plot_allocators(table, height=0.5)
    bars = {c.get_label(): [(p.get_x(), p.get_width()) for p in c.patches] for c in ax.containers}
    assert bars == {
        "usable science fibers": [(0, 60), (0, 70)],
        "lost to collisions": [(60, 30), (70, 0)],
        "fibers missing for requirements": [(90, 0), (70, 5)],
    }
    assert ax.patches[0].get_height() == 0.5
    assert {t.get_text() for t in ax.texts} == {"60", "70", "12 ms", "4.6 s"}
    assert ax.get_lines()[0].get_xdata()[0] == 95
    assert [t.get_text() for t in ax.get_yticklabels()] == ["blind", "careful"]
    assert ax.yaxis_inverted()
    assert (ax.get_title(), len({c.patches[0].get_hatch() for c in ax.containers})) == ("mine", 3)
    table["missing"] = 0
    assert len(rs.plot.plot_allocators(table).containers) == 2
