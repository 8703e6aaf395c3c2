"""Assigned rows of plans that have no position are named, or are skipped on request."""

import astropy.units as u
import desi_files
import numpy as np
import pytest
from astropy.table import QTable
from numpy.testing import assert_array_equal
from pfs_files import design, write_design
from raising import refused

import rfpsurvey as rs
import sdssv_files
from refusals import sentence
from rfpsurvey import plans


def fiberassign(folder):
    def edit(table):
        table["FIBERASSIGN_X"][[1, 2, 5]] = np.nan  # the fibers 1 and 2 are not assigned
        table["TARGET_DEC"][[5, 8]] = np.nan

    desi_files.metrology(folder / "fp-metrology.csv", per_petal=20)
    desi_files.tile(folder / "plan.fits", per_petal=20, edit=edit)
    return "plan.fits", "fp-metrology.csv", ("row 6", "positioner 5"), ("rows 6, 9", "positioners 5, 8")


def confsummary(folder):
    pytest.importorskip("pydl", reason="pydl is not installed")
    sdssv_files.calibration(folder / "calibration")
    plane = rs.Instrument.preset("sdss_apo").focal_plane
    centers = dict(zip(plane.id.tolist(), plane.xy.value.tolist(), strict=True))
    x, y = sdssv_files.formula(sdssv_files.robot_values()["R-1C14"], centers["R-1C14"], 43.0, 70.0, "boss")
    sky = "120.03 29.97 1.5"

    def change(text):
        assert f"BOSS 1 1 {x} {y}" in text
        assert sky in text
        return (
            text.replace(f"BOSS 1 1 {x} {y}", "BOSS 1 1 -999 -999")
            .replace(sky, "-999 -999 -999")
            .replace("float pmra;", "float other;")
        )

    sdssv_files.configuration(folder / "plan.par", change=change)
    return "plan.par", "calibration", ("row 5", "positioner R-1C14"), ("row 11", "positioner R0C15")


def pfsdesign(folder):
    columns, *others = design()
    columns["pfiNominal"][[0, 4]] = np.nan
    columns["ra"][2] = np.nan
    write_design(folder / "plan.fits", (columns, *others))
    return "plan.fits", "pfs", ("row 1", "positioner 1"), ("row 3", "positioner 3")


@pytest.mark.filterwarnings("ignore:.*(DESI has 5000|out of reach|north of ICRS|recorded joint angles)")
@pytest.mark.few(2)
@pytest.mark.parametrize("positions", ["focal_plane", "sky"])
@pytest.mark.parametrize("make", [fiberassign, confsummary, pfsdesign])
def test_rows_without_a_position_are_named_or_skipped(tmp_path, run, monkeypatch, make, positions):
    """The message stated only the number of rows, and no option scored the other rows."""
    monkeypatch.chdir(tmp_path)
    name, model, *expected = make(tmp_path)
    where, who = expected[positions == "sky"]
    plan = plans.read_plan(name)
    instrument = rs.Instrument.preset("pfs") if model == "pfs" else rs.Instrument.read(model)
    text = rf"of {len(plan)} rows .{where}. have none .{who}.; correct these rows, or use missing=.skip"
    refused(text, rs.score_tile, plan, instrument, positions=positions)
    with pytest.warns(rs.RfpsurveyWarning, match=rf"rows .{where}. have no finite position and are skipped .{who}."):
        tile = rs.score_tile(plan, instrument, positions=positions, missing="skip")
    n = 2 if where.startswith("rows") else 1
    assert (tile.summary["n_skipped"], tile.summary["n_targets"]) == (n, plan["assigned"].sum() - n)
    assert tile.summary["n_rows_ignored"] == (~plan["assigned"]).sum()
    plan["assigned"][[int(number) - 1 for number in where.split(" ", 1)[1].split(", ")]] = False
    alone = rs.score_tile(plan, instrument, positions=positions)
    for column in ("id", "status", "target_id", "in_collision", "theta", "ra"):
        assert_array_equal(tile.table[column], alone.table[column])

    code, _, err = run("score", name, "--instrument", model, "--positions", positions)
    assert f"{where}) have none" in sentence(code, err)
    code, out, err = run("score", name, "--instrument", model, "--positions", positions, "--set", "missing=skip")
    assert code == 0, err
    assert f"({where}) have no finite position and are skipped" in err
    assert f"assigned rows without a position  {n:>10}" in out


def test_skipping_needs_one_row_with_a_position_and_a_known_word(presets):
    plane = presets["lamost"].focal_plane
    table = QTable({"positioner": [0], "x": plane.xy[:1, 0], "y": plane.xy[:1, 1]})
    assert rs.score_tile(table, "lamost", missing="skip").summary["n_skipped"] == 0
    refused("unknown treatment of rows without a position 'drop'", rs.score_tile, table, "lamost", missing="drop")
    table["x"] = np.nan * u.mm
    with pytest.raises(rs.InputError, match="at least one assigned row must have a finite position, but 1 of"):
        rs.score_tile(table, "lamost", missing="skip")
