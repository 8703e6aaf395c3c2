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


@pytest.fixture
def call(run):
    """Return a function that runs a command, and returns its output by label, and its warnings."""

    def call(*words):
        code, out, err = run(*words)
        assert code == 0, err
        warnings = [line for line in err.splitlines() if "warning" in line]
        return out, {line[:34].strip(): line[34:].split() for line in out.splitlines()}, warnings

    return call


def read_desi(path, priority, visits):
    """Return the coordinates, priorities, and requested visits of the science targets in a file of DESI."""
    table = Table.read(path)
    is_science = (table["DESI_TARGET"] & SCIENCE) != 0
    wanted = np.where(is_science, np.maximum(table[visits], 0), 0)
    return SkyCoord(table["RA"], table["DEC"]), np.asarray(table[priority]), wanted


@pytest.mark.parametrize(
    ("name", "priority", "visits"), [("targets", "PRIORITY_INIT", "NUMOBS_INIT"), ("ledger", "PRIORITY", "NUMOBS_MORE")]
)
def test_targets_of_desi_are_planned(call, real_data, presets, name, priority, visits):
    path = real_data(f"desi/{name}_like.fits.gz")
    coord, priorities, wanted = read_desi(path, priority, visits)
    words = (path, "--instrument", "desi", "--center", "56.75 24.1", "--allocator", "nearest")
    out, lines, warnings = call("plan", *words)
    assert warnings == []
    roles = f"priority: {priority}, subpriority: SUBPRIORITY, visits: {visits}, kind: DESI_TARGET, id: TARGETID"
    assert roles in " ".join(out.split())
    assert lines["targets in the catalog"] == [str(len(coord))]
    inside = coord.separation(PLEIADES) < presets["desi"].field_radius
    assert abs(int(lines["in the field"][0]) - inside.sum()) <= 1  # a target at the edge of the field
    assert (
        abs(int(lines["in the field"][0]) - int(lines["sky, standards or 0 visits"][0]) - (inside & (wanted > 0)).sum())
        <= 1
    )
    rows = [line.split() for line in out.splitlines() if line.split()[:2] == ["science", "all"]]
    counts = {int(float(row[2])): int(row[3]) for row in rows if row[2] != "all"}
    for value in np.unique(priorities[inside & (wanted > 0)]):
        assert abs(counts[value] - (inside & (wanted > 0) & (priorities == value)).sum()) <= 1


@pytest.mark.parametrize(
    ("name", "priority", "visits"), [("targets", "PRIORITY_INIT", "NUMOBS_INIT"), ("ledger", "PRIORITY", "NUMOBS_MORE")]
)
def test_surveys_of_desi_are_planned_with_the_list_of_tiles_of_desi(call, real_data, name, priority, visits):
    """The list of tiles was refused, and no option could state its units."""
    path, tiles = real_data(f"desi/{name}_like.fits.gz"), real_data("desi/tiles-main-head.ecsv")
    coord, _, wanted = read_desi(path, priority, visits)
    table = Table.read(tiles)
    out, lines, _ = call("survey", path, "--instrument", "desi", "--tiles", tiles, "--allocator", "nearest")
    n_out = np.count_nonzero(~table["IN_DESI"])
    text = f"columns of tiles: tile: TILEID, ra: RA, dec: DEC, pass: PASS; omitted: {n_out} of {len(table)} tiles"
    assert text in out
    assert lines["tiles"] == [str(len(table) - n_out)]
    assert lines["targets with requested visits"] == [str(np.count_nonzero(wanted))]
    assert lines["visits requested"] == [str(wanted.sum())]
    centers = SkyCoord(table["RA"], table["DEC"], unit="deg")
    nearest = coord[wanted > 0].match_to_catalog_sky(centers)[1]
    assert lines["targets in no field"] == [str(np.count_nonzero(nearest > 1.63 * u.deg))]


def test_the_targets_of_desi_are_observed_on_tiles_in_their_field(call, real_data, tmp_path):
    """The tiles of the real list that are moved to the targets have the columns of the list."""
    path, tiles = real_data("desi/ledger_like.fits.gz"), tmp_path / "tiles.ecsv"
    table = Table.read(real_data("desi/tiles-main-head.ecsv"))[:3]
    table["RA"], table["DEC"] = [56.75, 56.0, 250.0], [24.1, 25.0, 10.0]
    table["IN_DESI"][1] = False
    table.write(tiles)
    coord, _, wanted = read_desi(path, "PRIORITY", "NUMOBS_MORE")
    _, lines, warnings = call(
        "survey",
        path,
        "--instrument",
        "desi",
        "--tiles",
        tiles,
        "--allocator",
        "nearest",
        "--set",
        "lost_in_collision=false",
    )
    assert [text.partition("warning: ")[2] for text in warnings] == [
        "1 of 3 tiles (IN_DESI = 0) are omitted, because they are not part of DESI's survey"
    ]
    assert lines["tiles"] == ["2"]
    inside = np.count_nonzero((coord.separation(PLEIADES) < rs.Instrument.preset("desi").field_radius) & (wanted > 0))
    assert abs(np.count_nonzero(wanted) - inside - int(lines["targets in no field"][0])) <= 1
    assert 0.8 * inside < int(lines["observed"][0]) <= inside


def test_candidates_of_sdssv_are_planned(call, real_data, presets):
    path = real_data("sdssv_robostrategy_field_a.ecsv")
    table = Table.read(path)
    words = (path, "--instrument", "sdss_apo", "--center", "269.59 66.55", "--position-angle", 40)
    assert any("SDSS-V uses the north of date: give --set equinox=J2026" in text for text in call("plan", *words)[2])
    words += ("--set", "equinox=J2021.0")
    hint = "standard stars and sky positions are assigned only if numbers of them are required"
    assert hint in call("plan", *words)[0]
    out, lines, warnings = call("plan", *words, "--constraint", "sky_boss=20", "--constraint", "standard_boss=5")
    assert hint not in out
    assert warnings == []
    assert "SDSS-V candidates: priority: priority (reversed sign), visits: none, category: category" in out
    assert lines["targets in the catalog"] == [str(len(table))]
    inside = SkyCoord(table["ra"], table["dec"]).separation(FIELD_A) < presets["sdss_apo"].field_radius
    for category in np.unique(table["category"]):
        row = next(line.split() for line in out.splitlines() if line.split()[:2] == ["all", category])
        n = np.count_nonzero(inside & (table["category"] == category))
        assert abs(int(row[3]) - n) <= 1, category
    assert int(lines["to sky"][0]) >= 20
    assert int(lines["to standard stars"][0]) >= 5


def test_surveys_of_sdssv_are_planned(call, real_data, tmp_path):
    path, tiles = real_data("sdssv_robostrategy_field_a.ecsv"), tmp_path / "fields.ecsv"
    Table({"fieldid": [1], "racen": [269.59], "deccen": [66.55], "pa": [40.0]}).write(tiles)
    table = Table.read(path)
    _, lines, warnings = call("survey", path, "--instrument", "sdss_apo", "--tiles", tiles, "--allocator", "nearest")
    assert [text.partition("warning: ")[2] for text in warnings] == [
        "the centers of tiles have no units: the assumed unit of racen and deccen is deg; to use other units, give "
        "units= or --set tiles.units.ra=UNIT"
    ]
    science = ~np.char.startswith(table["category"], "sky") & ~np.char.startswith(table["category"], "standard")
    assert lines["targets with requested visits"] == lines["visits requested"] == [str(np.count_nonzero(science))]
    assert lines["targets not requested"] == [str(np.count_nonzero(~science))]
