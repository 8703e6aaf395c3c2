import astropy.units as u
import numpy as np
import pytest
from matplotlib.figure import Figure
from text_tables import text_table

import rfpsurvey as rs

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
    assert down.get_clim() == pytest.approx((-0.3, 0.3))
    assert up.get_sizes() == [7]
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
    assert ax.get_title() == "mine"
    hatches = {c.patches[0].get_hatch() for c in ax.containers}
    assert len(hatches) == 3
    table["missing"] = 0
    assert len(rs.plot.plot_allocators(table).containers) == 2
