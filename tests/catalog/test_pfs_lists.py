"""Target lists and pointings of PFS, as its target uploader and its pointing planner define them."""

import astropy.units as u
import numpy as np
import pytest
from astropy.table import MaskedColumn, QTable, Table
from numpy.testing import assert_allclose
from pfs_files import target_list
from raising import refused

import rfpsurvey as rs


def test_target_lists_of_pfs_have_small_priorities_first_and_visits_from_times():
    """Priority 9, the lowest one, took the fibers, and every target had one visit."""
    catalog = rs.Catalog.from_table(target_list())
    assert catalog.priority.tolist() == [0, -1, -5, -9]
    assert not np.signbit(catalog.priority[0])
    assert (catalog.visits.tolist(), catalog.id.tolist()) == ([1, 2, 3, 1], [4000, 4001, 4002, 4003])
    stated = "PFS targets: priority: priority (reversed sign), visits: exptime (divided by 900.0 s, rounded up)"
    assert catalog.meta["columns"].startswith(stated)
    timed = target_list(single_exptime=[450, 300, 1963.5, 900])
    for table in (target_list(), timed):  # columns that are used were among those that are not used
        assert rs.Catalog.from_table(table).meta["columns"].endswith("not used: ob_code")
    assert "single_exptime" in rs.Catalog.from_table(timed, columns={"visits": "priority"}).meta["columns"]
    assert rs.Catalog.from_table(timed).visits.tolist() == [2, 4, 1, 1]
    timed["exptime"].unit, timed["single_exptime"].unit = "min", "min"
    assert rs.Catalog.from_table(timed).visits.tolist() == [2, 4, 1, 1]
    assert rs.Catalog.from_table(target_list(visits=[7, 7, 7, 7])).visits.tolist() == [7] * 4
    named = rs.Catalog.from_table(target_list(mine=[3] * 4), columns={"visits": "mine", "priority": "priority"})
    assert (named.visits.tolist(), named.priority.tolist()) == ([3] * 4, [0, 1, 5, 9])


def test_lists_of_the_pointing_planner_of_pfs_are_recognized():
    """The names of the columns begin with ob_, and the codes are the only identifiers."""
    table = target_list()["ob_code", "ra", "dec", "priority", "exptime", "resolution"]
    for name in table.colnames[1:]:
        table.rename_column(name, f"ob_{name}")
    catalog = rs.Catalog.from_table(table)
    assert (catalog.priority.tolist(), catalog.visits.tolist()) == ([0, -1, -5, -9], [1, 2, 3, 1])
    assert catalog.id.tolist() == ["ob0", "ob1", "ob2", "ob3"]
    table["ob_resolution"] = ["L", "M", "L", "L"]
    refused("--set catalog.select.ob_resolution=M", rs.Catalog.from_table, table)


def test_all_columns_of_pfs_with_a_prefix_are_read():
    """The identifiers, proper motions and epochs were not used."""
    table = target_list(pmra=[1.0, 2.0, 3.0, 4.0], pmdec=[5.0, 6.0, 7.0, 8.0], epoch=["J2015.5"] * 4)
    plain = rs.Catalog.from_table(table)
    table.rename_columns(table.colnames[1:], [f"ob_{name}" for name in table.colnames[1:]])
    catalog = rs.Catalog.from_table(table)
    assert catalog.id.tolist() == [4000, 4001, 4002, 4003]
    assert (catalog.coord.pm_ra_cosdec == plain.coord.pm_ra_cosdec).all()
    assert (catalog.coord.pm_dec == plain.coord.pm_dec).all()
    assert catalog.epoch.jyear == plain.epoch.jyear == 2015.5


def test_rounding_adds_no_visits_and_missing_times_of_exposures_are_900_s():
    """1.1 h over 0.1 h gave 12 visits, and a list with a missing time of one exposure was refused."""
    table = QTable(target_list(exptime=[1.1, 0.7, 0.3, 2.2] * u.h, single_exptime=[0.1] * 4 * u.h))
    assert rs.Catalog.from_table(table).visits.tolist() == [11, 7, 3, 22]
    table = target_list(exptime=[1800.0] * 4, single_exptime=MaskedColumn([900.0, 450, 600, 100], mask=[0, 1, 0, 0]))
    assert rs.Catalog.from_table(table).visits.tolist() == [2, 2, 3, 18]


@pytest.mark.parametrize("seed", range(2))
def test_numbers_of_visits_are_the_smallest_that_give_the_time(seed):
    rng = np.random.default_rng(seed)
    total, single = rng.integers(1, 20000, 4), rng.integers(100, 3000, 4)
    found = rs.Catalog.from_table(target_list(exptime=total, single_exptime=single)).visits.astype(int)
    assert (found * single >= total).all()
    assert ((found - 1) * single < total).all()


BAD_LISTS = [
    ({"exptime": [900, 0, 900, 900]}, "column 'exptime' must hold positive exposure times, got other values in 1 of"),
    ({"exptime": ["900", "x", "1", "1"]}, "column 'exptime' must hold exposure times in seconds, got text"),
    ({"single_exptime": [900, -1, 1, 1]}, "column 'single_exptime' must hold positive exposure times"),
    ({"exptime": [9e5, 9, 9, 9]}, "visits must"),
    ({"resolution": ["L", "M", "M", "L"]}, r"must have one value in all rows, .* got L \(2\), M \(2\); plan them"),
]


@pytest.mark.parametrize(("columns", "message"), BAD_LISTS)
def test_bad_target_lists_of_pfs_are_refused(columns, message):
    refused(message, lambda: rs.Catalog.from_table(target_list(**columns)))


def test_pointings_of_pfs_are_tiles():
    table = Table({"ppc_code": ["P1", "P2", "P3"], "ppc_ra": [150.0, 151.0, 152.0], "ppc_dec": [2.0, 2.5, 3.0]})
    plain = rs.Tiling.from_table(table)
    assert plain.table["tile"].tolist() == ["P1", "P2", "P3"]
    table["ppc_pa"], table["ppc_resolution"] = [0.0, 60.0, 90.0], ["L", "M", "L"]
    refused(r"got L \(2\), M \(1\); .* --set tiles.select.ppc_resolution=M", rs.Tiling.from_table, table)
    tiling = rs.Tiling.from_table(table, select={"ppc_resolution": "L"})
    assert tiling.table["ra"].to_value(u.deg).tolist() == [150, 152]
    # at ppc_pa = 0, +x of the focal plane points north and +y points west (a design of the observatory)
    assert_allclose(tiling.table["position_angle"].to_value(u.deg), [-89.898, 90 - 89.898])
    assert_allclose(plain.table["position_angle"].to_value(u.deg), -89.898)
    assert tiling.table.meta["selected"] == "ppc_resolution=L (2 of 3 rows)"
    own = Table(table)
    own.rename_columns(["ppc_ra", "ppc_dec"], ["ra", "dec"])  # the angle and the resolutions were not recognized
    table["ra"] = table["ppc_ra"]
    for given, columns in ((own, {}), (table, {"ra": "ra"})):
        refused(r"got L \(2\), M \(1\)", rs.Tiling.from_table, given, columns)
        again = rs.Tiling.from_table(given, columns, select={"ppc_resolution": "L"})
        assert_allclose(again.table["position_angle"], tiling.table["position_angle"])
        assert_allclose(rs.Tiling.from_table(again.table).table["position_angle"], tiling.table["position_angle"])
