"""Scans around an instrument: the design of the instrument, the scan, and the comparison with the best designs."""

from dataclasses import replace

import astropy.units as u
import numpy as np
import pytest
from astropy.table import QTable, vstack

import rfpsurvey as rs

MM = u.mm
LAMOST = (8.25, 1.0, 25.6, 2.25)
ROW = "one row for the design of an instrument"
AXES = ("central_arm", "ratio", "pitch", "clearance")


def design_of(row):
    return tuple(float(getattr(row[name], "value", row[name])) for name in AXES)


def own_row(table):
    (row,) = table[table["instrument"] != ""]
    return row


@pytest.fixture(scope="module")
def lamost():
    return rs.design.explore_around("lamost", spread=0.1, n_nodes=3)


def test_the_grid_is_around_the_instrument_and_holds_it_once(lamost):
    assert len(lamost) == 27
    assert (own_row(lamost)["instrument"], design_of(own_row(lamost))) == ("lamost", LAMOST)
    for name, value in zip(AXES, LAMOST, strict=True):
        nodes = [value] if name == "clearance" else value * np.array([0.9, 1, 1.1])
        np.testing.assert_allclose(np.unique(lamost[name]).value if name != "ratio" else np.unique(lamost[name]), nodes)
    again = rs.design.explore_designs(central_arm=8.25 * MM, ratio=1, pitch=25.6 * MM, clearance=2.25 * MM)
    assert (own_row(lamost)["loss"], own_row(lamost)["coverage"]) == (again["loss"][0], again["coverage"][0])


def test_an_instrument_off_the_grid_is_added_as_the_last_row():
    table = rs.design.explore_around("lamost", pitch=[26, 30] * MM, central_arm=8 * MM, n_designs=8, rng=3)
    plain = rs.design.explore_designs(
        central_arm=8 * MM, ratio=[0.85, 1.15], pitch=[26, 30] * MM, clearance=2.25 * MM, n_designs=8, rng=3
    )
    assert (len(table), table["instrument"].tolist(), design_of(table[-1])) == (9, [*[""] * 8, "lamost"], LAMOST)
    np.testing.assert_array_equal(table["loss"][:8], plain["loss"])


def test_the_minimum_separation_is_that_of_the_instrument(presets):
    with pytest.warns(rs.RfpsurveyWarning, match="instead of the arm model 'capsule' of sdss_apo"):
        table = rs.design.explore_around("sdss_apo", n_nodes=2)
    unit = presets["sdss_apo"].focal_plane.positioner
    assert own_row(table)["min_separation"].to_value(MM) == pytest.approx(unit.min_separation.to_value(MM), abs=1e-9)
    assert own_row(table)["eccentric_arm"].to_value(MM) == pytest.approx(unit.eccentric_arm.to_value(MM))


def test_designs_around_an_instrument_with_outlines_have_the_clearance_of_its_segments(presets):
    """The clearance of the outline is 0; segments without a clearance have too few collisions."""
    with pytest.warns(rs.RfpsurveyWarning, match="a clearance of 0.99 mm instead of the arm model 'outline' of desi"):
        table = rs.design.explore_around("desi", n_nodes=2)
    assert own_row(table)["clearance"].to_value(MM) == 0.99
    desi = presets["desi"]
    values = {k: v for k, v in desi.values.items() if k != "positioner.segment_clearance"}
    with pytest.raises(rs.InputError, match="desi must have the entry positioner.segment_clearance"):
        rs.design.explore_around(replace(desi, values=values), n_nodes=2)


def test_improvements_are_those_of_a_search_of_all_designs(lamost):
    own, found = own_row(lamost), rs.design.design_improvements(lamost)
    assert found["objective"].tolist() == ["coverage", "loss"]
    best = min(row["loss"] for row in lamost if row["coverage"] >= own["coverage"])
    widest = max(row["coverage"] for row in lamost if row["loss"] <= own["loss"])
    assert (found["best"].tolist(), found["value"].tolist()) == ([widest, best], [own["coverage"], own["loss"]])
    np.testing.assert_allclose(found["change"], [widest - own["coverage"], best - own["loss"]])
    assert found["change"][0] == 0
    assert found["change"][1] < -0.05
    assert design_of(found[0]) == LAMOST
    (row,) = lamost[(lamost["loss"] == best)]
    assert (design_of(row), found["other"][1]) == (design_of(found[1]), row["coverage"])


def test_an_instrument_on_the_front_has_no_improvement():
    table = rs.design.explore_around("lamost", pitch=[20, 22] * MM, central_arm=8.25 * MM, ratio=1)
    assert own_row(table)["pareto"]
    assert (rs.design.design_improvements(table)["change"] == 0).all()


def test_sensitivities_leave_an_added_instrument_out():
    grid = {"central_arm": [8, 9] * MM, "ratio": [1.1, 1.3], "pitch": [24, 26] * MM}
    around = rs.design.explore_around("lamost", **grid)
    plain = rs.design.explore_designs(**grid, clearance=2.25 * MM)
    assert len(around) == len(plain) + 1
    found, truth = (rs.design.design_sensitivities(table, figures=["loss"]) for table in (around, plain))
    np.testing.assert_array_equal(found["share"], truth["share"])


@pytest.mark.few(1)
@pytest.mark.parametrize("ending", ["ecsv", "fits"])
def test_a_scan_around_an_instrument_continues_and_can_be_read(tmp_path, ending):
    path = tmp_path / f"scan.{ending}"
    options = {"n_nodes": 2, "path": path}
    first = rs.design.explore_around("lamost", **options)
    content = path.read_bytes()
    rs.design.explore_around("lamost", **options, resume=True)
    assert path.read_bytes() == content
    read = QTable.read(path)
    assert len(rs.plot.plot_designs(first).texts) == 1
    if ending == "ecsv":
        found, expected = (rs.design.design_improvements(one)["best"].tolist() for one in (read, first))
        assert found == expected
    with pytest.raises(rs.InputError, match="holds another scan: .*start"):
        rs.design.explore_around("pfs", **options, resume=True)


def test_tables_of_designs_print_few_digits_and_keep_all(lamost, tmp_path):
    text = "\n".join(lamost.pformat(max_width=-1, max_lines=-1))
    assert "0.1094" in text
    assert "0.10936" not in text
    lamost.write(tmp_path / "t.ecsv")
    np.testing.assert_array_equal(QTable.read(tmp_path / "t.ecsv")["loss"], lamost["loss"])


def test_what_cannot_be_a_scan_is_refused(lamost, small):
    one = rs.Instrument("one", rs.FocalPlane([[0, 0]] * MM, small.focal_plane.positioner), plate_scale=1 * u.mm / u.deg)
    for call, words in (
        (lambda: rs.design.explore_around("lamst"), "unknown instrument 'lamst'.*Did you mean 'lamost'"),
        (lambda: rs.design.explore_around(one), "one must have at least two positioners"),
        (lambda: rs.design.explore_around("lamost", spread=1), "spread must be a number above 0 and below 1, got 1"),
        (lambda: rs.design.explore_around("lamost", n_nodes=1), "n_nodes must be a whole number from 2 to 1000, got 1"),
        (lambda: rs.design.explore_around("lamost", pich=3), "unknown parameter of explore_designs 'pich'.*'pitch'"),
        (lambda: rs.design.design_improvements("t"), "must be a table that explore_around returned"),
        (lambda: rs.design.design_improvements(lamost[lamost["instrument"] == ""]), f"{ROW}, got 0"),
        (lambda: rs.design.design_improvements(vstack([lamost, lamost])), f"{ROW}, got 2"),
    ):
        with pytest.raises(rs.InputError, match=words):
            call()


def test_an_instrument_without_a_loss_has_no_improvements():
    with pytest.warns(rs.RfpsurveyWarning, match="have no values"):
        table = rs.design.explore_around("lamost", clearance=13 * MM, n_nodes=2, pitch=[25, 40] * MM)
    table["loss"][table["instrument"] != ""] = np.nan
    with pytest.raises(rs.InputError, match="lamost has no values of coverage and loss"):
        rs.design.design_improvements(table)


def test_an_instrument_with_margins_has_no_design(presets):
    model = presets["desi"].with_margins()
    with pytest.raises(rs.InputError, match="desi must have no margins, .*, got outer 0.2 mm, inner"):
        rs.design.explore_around(model)
