"""Columns and numbers of results are described once: tables, files, summaries and reports read the description."""

import astropy.units as u
import numpy as np
import pytest

import rfpsurvey as rs
from rfpsurvey._common import descriptions as _descriptions
from rfpsurvey._field import facts as _facts
from rfpsurvey._field import table as _table

DESCRIBED = {
    "tile": (_table.TILE_COLUMNS, lambda tile: tile.table),
    "outcomes": (_table.OUTCOMES_COLUMNS, lambda tile: tile.outcomes),
}


def plan():
    sky = rs.synthetic_catalog("uniform", "10h +30d", 1.4 * u.deg, n_targets=300, rng=1)
    return rs.plan_tile(sky, "sdss_apo", "10h +30d")


@pytest.mark.parametrize("name", DESCRIBED)
def test_every_column_has_its_description_and_unit(name):
    columns, table_of = DESCRIBED[name]
    table = table_of(plan())
    assert set(table.colnames) <= set(columns)
    for column in table.colnames:
        assert table[column].info.description == columns[column].text
        assert str(table[column].unit or "") == columns[column].unit


def test_a_column_and_a_number_are_added_at_one_place(monkeypatch, tmp_path):
    length = _descriptions.Column("longest", "length of both arms", "mm", lambda t: np.full(len(t.plane), 22.4))
    number = _facts.Fact("n_near", "positioners near others", value=lambda t: 7)
    monkeypatch.setitem(_table.TILE_COLUMNS, "longest", length)
    monkeypatch.setattr(_facts, "TILE_FACTS", (*_facts.TILE_FACTS, number))
    tile = plan()
    assert tile.table["longest"][3] == 22.4 * u.mm
    assert tile.summary["n_near"] == _facts.tile_facts(tile)["positioners near others"] == 7
    for ending in ("fits", "ecsv"):
        tile.write(tmp_path / f"tile.{ending}")
        table = rs.Tile.read(tmp_path / f"tile.{ending}").table
        assert (table["longest"].unit, table["longest"].info.description) == (u.mm, length.text)
    rs.report.write_report(tile, tmp_path / "tile.html")
    assert "positioners near others" in (tmp_path / "tile.html").read_text()
