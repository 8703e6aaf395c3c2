"""Catalogs and lists of tiles of DESI and SDSS-V are planned without options about columns or units.

The expected numbers are computed with astropy from the columns of the files, not with rfpsurvey.
"""

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.table import Table

import rfpsurvey as rs

PLEIADES = SkyCoord(56.75 * u.deg, 24.1 * u.deg)
FIELD_A = SkyCoord(269.59 * u.deg, 66.55 * u.deg)
STANDARD, SCIENCE = (1 << 33) | (1 << 34) | (1 << 35), (1 << 0) | (1 << 1) | (1 << 2) | (3 << 60)


def read_desi(path, priority, visits):
    """Return the coordinates, priorities, and requested visits of the science targets in a file of DESI."""
    table = Table.read(path)
    is_science = (table["DESI_TARGET"] & SCIENCE) != 0
    wanted = np.where(is_science, np.maximum(table[visits], 0), 0)
    return SkyCoord(table["RA"], table["DEC"]), np.asarray(table[priority]), wanted


LISTS = [("targets", "PRIORITY_INIT", "NUMOBS_INIT"), ("ledger", "PRIORITY", "NUMOBS_MORE")]


def warnings_of(called):
    return [line.partition("warning: ")[2] for line in called.err.splitlines() if "warning" in line]


@pytest.mark.parametrize(("name", "priority", "visits"), LISTS)
def test_targets_of_desi_are_planned(call, real_data, presets, name, priority, visits):
    path = real_data(f"desi/{name}_like.fits.gz")
    coord, priorities, wanted = read_desi(path, priority, visits)
    called = call("plan {} --instrument desi --center '56.75 24.1' --allocator nearest", path)
    out, lines = called.out, called.lines
    assert warnings_of(called) == []
    roles = f"priority: {priority}, subpriority: SUBPRIORITY, visits: {visits}, kind: DESI_TARGET, id: TARGETID"
    assert roles in called.text
    assert lines["targets in the catalog"] == [str(len(coord))]
    inside, n_inside = coord.separation(PLEIADES) < presets["desi"].field_radius, int(lines["in the field"][0])
    assert abs(n_inside - inside.sum()) <= 1  # a target at the edge of the field
    assert abs(n_inside - int(lines["sky, standards or 0 visits"][0]) - (inside & (wanted > 0)).sum()) <= 1
    rows = [line.split() for line in out.splitlines() if line.split()[:2] == ["science", "all"]]
    counts = {int(float(row[2])): int(row[3]) for row in rows if row[2] != "all"}
    for value in np.unique(priorities[inside & (wanted > 0)]):
        assert abs(counts[value] - (inside & (wanted > 0) & (priorities == value)).sum()) <= 1


@pytest.mark.parametrize(("name", "priority", "visits"), LISTS)
def test_surveys_of_desi_are_planned_with_the_list_of_tiles_of_desi(call, real_data, name, priority, visits):
    """The list of tiles was refused, and no option could state its units."""
    path, tiles = real_data(f"desi/{name}_like.fits.gz"), real_data("desi/tiles-main-head.ecsv")
    coord, _, wanted = read_desi(path, priority, visits)
    table = Table.read(tiles)
    called = call("survey {} --instrument desi --tiles {} --allocator nearest", path, tiles)
    lines, n_out = called.lines, np.count_nonzero(~table["IN_DESI"])
    text = f"columns of tiles: tile: TILEID, ra: RA, dec: DEC, pass: PASS; omitted: {n_out} of {len(table)} tiles"
    assert text in called.out
    assert lines["tiles"] == [str(len(table) - n_out)]
    assert lines["targets with requested visits"] == [str(np.count_nonzero(wanted))]
    assert lines["visits requested"] == [str(wanted.sum())]
    nearest = coord[wanted > 0].match_to_catalog_sky(SkyCoord(table["RA"], table["DEC"], unit="deg"))[1]
    assert lines["targets in no field"] == [str(np.count_nonzero(nearest > 1.63 * u.deg))]


def test_the_targets_of_desi_are_observed_on_tiles_in_their_field(call, real_data, tmp_path):
    """The tiles of the real list that are moved to the targets have the columns of the list."""
    path, tiles = real_data("desi/ledger_like.fits.gz"), tmp_path / "tiles.ecsv"
    table = Table.read(real_data("desi/tiles-main-head.ecsv"))[:3]
    table["RA"], table["DEC"] = [56.75, 56.0, 250.0], [24.1, 25.0, 10.0]
    table["IN_DESI"][1] = False
    table.write(tiles)
    coord, _, wanted = read_desi(path, "PRIORITY", "NUMOBS_MORE")
    called = call(
        "survey {} --instrument desi --tiles {} --allocator nearest --set lost_in_collision=false", path, tiles
    )
    lines = called.lines
    omitted = "1 of 3 tiles (IN_DESI = 0) are omitted, because they are not part of DESI's survey"
    assert (warnings_of(called), lines["tiles"]) == ([omitted], ["2"])
    inside = np.count_nonzero((coord.separation(PLEIADES) < rs.Instrument.preset("desi").field_radius) & (wanted > 0))
    assert abs(np.count_nonzero(wanted) - inside - int(lines["targets in no field"][0])) <= 1
    assert 0.8 * inside < int(lines["observed"][0]) <= inside


def test_candidates_of_sdssv_are_planned(call, real_data, presets):
    path = real_data("sdssv_robostrategy_field_a.ecsv")
    table, words = Table.read(path), "plan {} --instrument sdss_apo --center '269.59 66.55' --position-angle 40"
    assert "SDSS-V uses the north of date: give --set equinox=J2026" in call(words, path).err
    words += " --set equinox=J2021.0"
    hint = "standard stars and sky positions are assigned only if numbers of them are required"
    assert hint in call(words, path).out
    called = call(f"{words} --constraint sky_boss=20 --constraint standard_boss=5", path)
    assert hint not in called.out
    assert warnings_of(called) == []
    assert "SDSS-V candidates: priority: priority (reversed sign), visits: none, category: category" in called.out
    assert called.lines["targets in the catalog"] == [str(len(table))]
    inside = SkyCoord(table["ra"], table["dec"]).separation(FIELD_A) < presets["sdss_apo"].field_radius
    rows = [line.split() for line in called.out.splitlines()]
    for category in np.unique(table["category"]):
        row = next(row for row in rows if row[:2] == ["all", category])
        assert abs(int(row[3]) - np.count_nonzero(inside & (table["category"] == category))) <= 1, category
    assert int(called.lines["to sky"][0]) >= 20
    assert int(called.lines["to standard stars"][0]) >= 5


def test_surveys_of_sdssv_are_planned(call, real_data, tmp_path):
    path, tiles = real_data("sdssv_robostrategy_field_a.ecsv"), tmp_path / "fields.ecsv"
    Table({"fieldid": [1], "racen": [269.59], "deccen": [66.55], "pa": [40.0]}).write(tiles)
    category = Table.read(path)["category"]
    called = call("survey {} --instrument sdss_apo --tiles {} --allocator nearest", path, tiles)
    assert warnings_of(called) == [
        "the centers of tiles have no units: the assumed unit of racen and deccen is deg; to use other units, give "
        "units= or --set tiles.units.ra=UNIT"
    ]
    science, lines = ~np.char.startswith(category, "sky") & ~np.char.startswith(category, "standard"), called.lines
    assert lines["targets with requested visits"] == lines["visits requested"] == [str(np.count_nonzero(science))]
    assert lines["targets not requested"] == [str(np.count_nonzero(~science))]
