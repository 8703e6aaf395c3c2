"""Tables of targets given instead of tiles, and tables of tiles for which there is no warning."""

import astropy.units as u
import numpy as np
import pytest
from astropy.table import QTable

import rfpsurvey as rs
from rfpsurvey._survey.tiling.columns import warn_of_targets

TAKEN = "are taken as centers of tiles"


def tiling(names, n=50):
    center = "ra dec raj2000 dej2000 racen deccen field_ra field_dec".split()
    places, numbers = np.linspace(0, 40, n) * u.deg, np.arange(1, n + 1)
    return rs.Tiling.from_table(QTable({k: places if k.lower() in center else numbers for k in names.split()}))


TARGETS = ("ra dec vt_mag", "RAJ2000 DEJ2000 Vmag", "ra dec phot_g_mean_mag", "ra dec pmRA pmDE", "id ra dec parallax")
TARGETS += ("target_id ra dec", "source_id ra dec", "TARGETID ra dec", "name ra dec kind")
TILES = ("ra dec", "id ra dec priority", "name ra dec", "TILEID RA DEC PASS IN_DESI", "tile ra dec star_mag")
TILES += ("plate racen deccen vmag", "field_ra field_dec gmag", "ra dec posang vmag", "ra dec program exptime airmass")
TILES += ("ra dec epoch image",)


def test_columns_of_targets_are_suspected_and_lists_of_tiles_are_not():
    for names in TARGETS:
        with pytest.warns(rs.RfpsurveyWarning, match=f"the 50 rows of a table with the columns .* {TAKEN}"):
            warn_of_targets(tiling(names), 10000)
    for names in TILES:  # a warning would fail the test
        warn_of_targets(tiling(names), 40)
        warn_of_targets(tiling(names, 900), 40)


def test_more_tiles_than_targets_are_suspected():
    with pytest.warns(rs.RfpsurveyWarning, match=f"the 5000 rows of a table with the columns ra, dec {TAKEN}"):
        warn_of_targets(tiling("ra dec", 5000), 4999)
    warn_of_targets(tiling("ra dec", 5000), 5000)
    warn_of_targets(tiling("ra dec tile", 5000), 100)


def test_tilings_of_ours_are_not(tmp_path):
    placed = rs.place_tiles(rs.Region.box(ra=(0 * u.deg, 15 * u.deg), dec=(0 * u.deg, 15 * u.deg)), "moons")
    placed.write(tmp_path / "tiles.ecsv")
    assert len(placed) > 1000
    warn_of_targets(rs.Tiling.read(tmp_path / "tiles.ecsv"), 10)


def test_a_survey_warns_of_its_own_targets(run, tmp_path):
    path = tmp_path / "stars.csv"
    path.write_text("ra,dec,gmag\n95.0,23.0,15\n95.1,23.1,16\n")
    code, _, err = run("survey", path, "--tiles", path, "--instrument", "moons")
    assert code == 0
    assert f"warning: the 2 rows of a table with the columns gmag {TAKEN}" in err
    stars = QTable.read(path, units={"ra": "deg", "dec": "deg"})
    with pytest.warns(rs.RfpsurveyWarning, match=TAKEN):
        rs.plan_survey(stars, "moons", stars)
