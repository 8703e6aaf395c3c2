"""Tables of plans and tiles that were edited are converted, or are refused with a sentence."""

import astropy.units as u
import numpy as np
import pytest
from astropy.io import fits
from astropy.table import Column, MaskedColumn, QTable
from pfs_files import write_design
from raising import refused

import rfpsurvey as rs
from refusals import refusal, sentence
from rfpsurvey import plans
from rfpsurvey.plans import read_plan

N = 4000


@pytest.fixture(scope="module")
def tile():
    lamost = rs.Instrument.preset("lamost")
    x, y = lamost.focal_plane.xy[:3].T
    return rs.score_tile(QTable({"positioner": [0, 1, 2], "target_id": [7, 8, 9], "x": x + 2 * u.mm, "y": y}), lamost)


def without(name):
    return lambda table: table.remove_column(name)


def column(name, values):
    return lambda table: table.__setitem__(name, values)


def entry(name, value):
    return lambda table: table.meta.__setitem__(name, value)


OBJECTS = Column([{"a": k} for k in range(N)], dtype=object)


DAMAGED_TILES = [
    (without("id"), ": a tile must have the columns id, got spectrograph, "),
    (without("tip_x"), ": a tile must have the columns tip_x, got id, "),
    (column("tip_x", np.zeros(N)), ": column 'tip_x' must be a Quantity with a unit convertible to mm, got"),
    (column("ra", np.zeros(N) * u.mm), ": column 'ra' must have a unit convertible to deg, got mm"),
    (column("kind", np.zeros(N)), ": column 'kind' must hold text, got float64"),
    (column("id", np.zeros((N, 2), dtype=int)), ": column 'id' must have one value per row, got the shape (40"),
    (column("id", OBJECTS), ": column 'id' must hold numbers or text, got "),
    (entry("provenance", {"parameters": 1}), ": the provenance of a tile must have parameters and the instrument"),
]


@pytest.mark.few(2)
@pytest.mark.parametrize(("edit", "message"), DAMAGED_TILES)
def test_damaged_tiles_are_refused(tmp_path, run, tile, edit, message):
    """They ended with a traceback."""
    table = tile.table.copy()
    edit(table)
    table.write(tmp_path / "tile.ecsv", format="ascii.ecsv")
    assert refusal(tmp_path / "tile.ecsv", read_plan).startswith(message)
    code, _, err = run("convert", tmp_path / "tile.ecsv", tmp_path / "plan.ecsv")
    assert message[2:] in sentence(code, err)


DAMAGED_PLANS = [
    (column("assigned", np.full(N, "some")), ": column 'assigned' must hold booleans or numbers, got text such as"),
    (column("positioner", np.full(N, 1.5)), ": column 'positioner' must hold integers or text, got float64"),
    (column("priority", np.full(N, "high")), ": column 'priority' must hold numbers, got <U4"),
    (column("x", np.zeros(N) * u.s), ": column 'x' must have a unit convertible to mm, got s"),
    (entry("format", None), ": format in the meta of a plan must be text, got None"),
    (entry("instrument", {"name": "lamost"}), ": instrument in the meta of a plan must be text, got {"),
    (entry("racen", "north"), ": racen in the meta of a plan must be a finite number, got 'north'"),
    (entry("conditions", "clear"), ": conditions in the meta of a plan must be a dict, got 'clear'"),
]


@pytest.mark.parametrize(("edit", "message"), DAMAGED_PLANS)
def test_damaged_plans_are_refused(tmp_path, tile, edit, message):
    plan = plans.as_plan(tile)
    edit(plan)
    plan.write(tmp_path / "plan.ecsv", format="ascii.ecsv")
    assert refusal(tmp_path / "plan.ecsv", read_plan).startswith(message)


def test_other_units_types_and_masks_are_converted(tmp_path, tile):
    """Unicode, booleans as text, masked columns and objects in further columns are kept."""
    plan = plans.as_plan(tile)
    plan["x"] = plan["x"].to(u.m)
    plan["assigned"] = np.where(plan["assigned"], "true", "false")
    plan["note"] = np.full(N, 'é, "ü" ☆')
    plan["objects"], plan["wide"] = OBJECTS, np.zeros((N, 2, 3))
    plan["flag"] = MaskedColumn(np.arange(N), mask=np.arange(N) % 2 == 0)
    plan.write(tmp_path / "plan.ecsv", format="ascii.ecsv")
    found = plans.read_plan(tmp_path / "plan.ecsv")
    assert (found["x"].unit, found["assigned"].tolist()) == (u.mm, plans.as_plan(tile)["assigned"].tolist())
    plans.write_plan(found, tmp_path / "again.ecsv")
    again = plans.read_plan(tmp_path / "again.ecsv")
    assert (again["note"][0], again["objects"][5], again["wide"].shape) == ('é, "ü" ☆', {"a": 5}, (N, 2, 3))
    assert again["flag"].mask.sum() == N / 2
    with pytest.raises(rs.InputError, match=r"plan.fits: the table cannot be written as FITS: .*; write .ecsv instead"):
        plans.write_plan(
            found["positioner", "fiber_type", "target_id", "kind", "assigned", "x", "y", "objects"],
            tmp_path / "plan.fits",
        )


def test_a_column_with_an_unknown_unit_is_refused(tmp_path, tile):
    """Regression: ``read_plan`` ended in an error of astropy."""
    tile.write(tmp_path / "tile.fits")
    with fits.open(tmp_path / "tile.fits") as units:
        number = units[1].columns.names.index("dec") + 1
        units[1].header[f"TUNIT{number}"] = "1PE(3)"
        units.writeto(tmp_path / "unit.fits")
    refused(r"column 'dec' must have a unit convertible to deg, got 1PE\(3\)", read_plan, tmp_path / "unit.fits")


def test_private_entries_of_a_plan_that_are_damaged_are_refused_when_it_is_written(tmp_path):
    plan = plans.read_plan(write_design(tmp_path / "d.fits"))
    plan.meta["formats"] = plan.meta["formats"][1:]
    with pytest.raises(rs.InputError, match="formats in the meta of the plan must have 'fiberId', got tract"):
        plans.write_plan(plan, tmp_path / "e.fits", format="pfsdesign")
    plan.meta["formats"] = [1, 2]
    with pytest.raises(rs.InputError, match="e.fits: the plan cannot be written, because it is damaged: "):
        plans.write_plan(plan, tmp_path / "e.fits", format="pfsdesign")


def test_errors_of_the_program_are_not_errors_of_the_input(tmp_path, tile, monkeypatch):
    """Regression: every exception of a writer became an InputError that stated that the plan was damaged."""
    monkeypatch.setattr("rfpsurvey._field.format_table.write", lambda *_, **__: [].missing)
    with pytest.raises(AttributeError, match="missing"):
        rs.plans.write_plan(tile, tmp_path / "a.ecsv")
