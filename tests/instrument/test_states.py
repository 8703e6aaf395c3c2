"""Broken, stuck and restored positioners, listed by their identifiers in a table, a file or a TOML file."""

from datetime import UTC, datetime

import astropy.units as u
import desi_files
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.table import Column, MaskedColumn, QTable, Table
from astropy.time import Time
from numpy.testing import assert_allclose, assert_array_equal
from raising import refused, warned

import rfpsurvey as rs
import sdssv_files

ROWS = """id,state,from,to,theta,phi
3,broken,,,,
5,stuck,2026-01-01,2026-03-01T12:00:00,30,100
8,broken,2461071.5,,,
"""  # JD 2461071.5 is 2026-01-31 0 h
SUMMARY = ("file", "time", "broken", "stuck", "restored", "unused_rows")


def states_of(instrument):
    """Return the disabled positioners, and the poses of the stuck positioners in degrees."""
    plane = instrument.focal_plane
    stuck = np.rad2deg(plane.arrays.stuck)
    poses = {int(k): tuple(np.round(stuck[k], 9)) for k in np.flatnonzero(plane.arrays.is_stuck)}
    return np.flatnonzero(plane.disabled).tolist(), poses


def summary_of(instrument, prefix="states"):
    return [instrument.values.get(f"{prefix}.{name}", {}).get("value") for name in SUMMARY]


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "broken.csv"
    path.write_text(ROWS)
    return path


TIMES = [
    ("2025-12-31T23:59:59", [3], {}),
    ("2026-01-01", [3], {5: (30, 100)}),  # the interval contains its beginning
    ("2026-01-31", [3, 8], {5: (30, 100)}),
    ("2026-03-01T11:59:59", [3, 8], {5: (30, 100)}),
    ("2026-03-01T12:00:00", [3, 8], {}),  # and not its end
    (Time(2461101.0, format="jd", scale="tai"), [3, 8], {5: (30, 100)}),
    (2026.5, [3, 8], {}),
]


@pytest.mark.few(2)
@pytest.mark.parametrize(("time", "disabled", "poses"), TIMES)
def test_the_time_selects_the_states(small, file, time, disabled, poses):
    worn = small.with_states(file, time=time)
    assert states_of(worn) == (disabled, poses)
    n = len(disabled) + len(poses)
    assert worn.facts()["usable_positioners"] == len(small.focal_plane) - n
    assert f"{len(disabled)} broken, {len(poses)} stuck." in worn.notes
    assert ("do not apply" in worn.notes) == (n < 3)
    assert summary_of(worn)[2:] == [len(disabled), len(poses), 0, 3 - n]
    assert states_of(small) == ([], {})


def test_the_time_is_converted_to_utc(small):
    table = Table({"id": [1], "from": ["2026-01-01T02:00:00+02:00"], "to": ["2026-01-02T00:00:00Z"]})
    inside = Time("2026-01-01T00:00:10", scale="utc")
    assert states_of(small.with_states(table, time=inside.tai)) == ([1], {})  # 37 s later in TAI
    assert states_of(small.with_states(table, time="2026-01-01T23:59:59")) == ([1], {})
    assert states_of(small.with_states(table, time=Time("2026-01-01T00:00:10", scale="tai"))) == ([], {})


@pytest.mark.parametrize("ending", [".ecsv", ".fits", ".csv", ".vot", ".parquet"])
def test_all_formats_contain_the_same_states(small, file, tmp_path, ending):
    if ending == ".parquet":
        pytest.importorskip("pyarrow")
    path = tmp_path / f"states{ending}"
    table = QTable({"id": [3, 5], "state": ["broken", "stuck"], "theta": [np.nan, np.pi / 6] * u.rad})
    table["phi"] = [np.nan, 100] * u.deg
    if ending == ".csv":
        table["theta"] = table["theta"].to(u.deg)
    table.write(path, **({"format": "votable"} if ending == ".vot" else {}))
    assert states_of(small.with_states(path)) == ([3], {5: (30, 100)})


DATES = [
    Column([datetime(2026, 1, 1, tzinfo=UTC), None], dtype=object),
    MaskedColumn([2461041.5, 0], mask=[False, True]),
    MaskedColumn(["2026-01-01", "x"], mask=[False, True]),
    Time(["2026-01-01", "2001-01-01"]),
    np.array(["2026-01-01", "NaT"], dtype="datetime64[s]"),
]


@pytest.mark.parametrize("dates", DATES)
def test_dates_have_many_forms(small, dates):
    table = QTable({"id": [1, 2], "from": dates})
    assert states_of(small.with_states(table, time="2025-12-31"))[0] in ([], [2])
    assert states_of(small.with_states(table, time="2000-01-01"))[0] == ([] if isinstance(dates, Time) else [2])
    assert states_of(small.with_states(table, time="2026-01-01"))[0] == [1, 2]


def test_a_table_of_identifiers_lists_broken_positioners(presets):
    apo = presets["sdss_apo"].with_states(Table({"id": ["R+3C5", "R0C1"]}))
    assert apo.focal_plane.id[apo.focal_plane.disabled].tolist() == ["R0C1", "R+3C5"]
    assert (summary_of(apo), apo.provenance["values"]["states.broken"]) == (["a table", None, 2, 0, 0, 0], 2)
    assert apo.provenance["digest"] != presets["sdss_apo"].provenance["digest"]


def test_no_row_changes_nothing(small):
    empty = Table({"id": np.array([], dtype=int), "from": np.array([], dtype=str)})
    assert states_of(small.with_states(empty)) == ([], {})
    assert "0 broken, 0 stuck." in small.with_states(empty).notes


def test_a_broken_arm_is_an_obstacle_in_its_pose(small):
    """A broken arm that points to its neighbor is touched by the arm of the neighbor, and a parked arm is not."""
    plane = small.focal_plane
    i, j = (int(k) for k in plane.neighbor_pairs()[0])
    towards = plane.arrays.xy[i] - plane.arrays.xy[j]
    angle, tips = np.rad2deg(np.arctan2(*towards[::-1])), plane.xy.copy()
    tips[:] = np.nan
    tips[i] = plane.xy[i] - 12 * u.mm * towards / np.hypot(*towards)
    for pose, n in (([angle, 0], 1), ([np.nan, np.nan], 0)):
        worn = small.with_states(Table({"id": [j], "theta": pose[:1], "phi": pose[1:]})).focal_plane
        assert worn.disabled[j]
        assert not worn.arrays.usable[j]
        assert len(rs.find_collisions(worn, tips, parked_obstacles=False).pairs) == n


def test_neither_broken_nor_stuck_positioners_take_targets(small):
    center = SkyCoord("12h +30d")
    sky = rs.synthetic_catalog("uniform", center, small.field_radius, n_targets=300, rng=1)
    table = Table({"id": [4, 9], "state": ["broken", "stuck"], "theta": [np.nan, 10], "phi": [np.nan, 60]})
    tile = rs.plan_tile(sky, small.with_states(table), center, allocator="nearest")
    status = dict(zip(tile.table["id"].tolist(), tile.table["status"].tolist(), strict=True))
    assert {k: one for k, one in status.items() if one != "assigned"} == {4: "disabled", 9: "stuck"}


def test_only_fibers_that_are_not_broken_observe_blank_sky(small):
    center = SkyCoord("12h +30d")
    edge = small.focal_plane.xy[-1:] + [[5, 5]] * u.mm  # far from positioners 4 and 9
    target = small.projection(center).to_sky(edge)
    table = Table({"id": [4, 9], "state": ["broken", "stuck"], **{"theta": [10, 10], "phi": [60, 60]}})
    options = rs.AllocationOptions("lamost_rule", requirements="sky=10", sky_separation=5 * u.arcsec)
    tile = rs.plan_tile(target, small.with_states(table), center, allocator=options)
    kinds = dict(zip(tile.table["id"].tolist(), tile.table["kind"].tolist(), strict=True))
    assert (kinds[4], kinds[9]) == ("", "sky")


def test_a_second_table_replaces_states(small, file):
    first = small.with_states(file, time="2026-02-01")
    second = first.with_states(Table({"id": [3, 5, 8], "state": ["ok", "broken", "Restored"]}))
    assert states_of(second) == ([5], {})
    assert summary_of(second) == ["broken.csv", "2026-02-01T00:00:00", 2, 1, 0, 0]
    assert summary_of(second, "states_2") == ["a table", None, 1, 0, 2, 0]
    assert second.notes.endswith("States of positioners from a table: 1 broken, 0 stuck, 2 restored.")


WRONG_TABLES = [
    ({"name": [1]}, "states: the table must have the column 'id', got name"),
    ({"id": [1, 99, -1]}, "states: id must be identifiers of positioners of small, such as 0, 1, 2, got '99', '-1"),
    ({"id": np.arange(100, 113)}, "'109' and 3 more$"),
    ({"id": [[1, 2]]}, "column 'id' must have one value per row"),
    ({"id": [1], "state": ["gone"]}, "unknown state in states 'gone'; choose one of: broken, ok, restored, stuck"),
    ({"id": [1], "state": [2]}, "unknown state in states '2'"),
    ({"id": [1], "state": ["stuck"]}, "must have both values for a positioner that is stuck, got none"),
    ({"id": [1], "theta": [5.0]}, "must have both values or none for a positioner that is broken, got 5"),
    ({"id": [1], "state": ["ok"], "theta": [5], "phi": [5]}, "must have no values for a positioner that is ok"),
    ({"id": [1], "theta": [5], "phi": [500]}, "column 'phi' must hold angles from -400 to 400 deg, got 500"),
    ({"id": [1], "theta": ["east"], "phi": ["x"]}, "column 'theta' must hold angles in degrees"),
    ({"id": [1], "theta": [5] * u.mm, "phi": [5] * u.deg}, "'theta' must have a unit convertible to deg, got mm"),
    ({"id": [1], "from": ["yesterday"]}, "'from' must hold Julian dates, or .* '2021-05-14T00:00:00', got 'yes"),
    ({"id": [1], "from": Time([6e4], format="mjd", scale="local")}, "'from' must hold .* got <Time object: scale"),
    ({"id": [1], "to": [2026]}, "column 'to' must hold Julian dates, or .*, got 2026"),
    ({"id": [1], "to": ["2026"]}, "column 'to' must hold Julian dates, or .*, got 2026"),
    ({"id": [1], "from": ["2026-05-01"], "to": ["2026-05-01"]}, "to must be later than from, got 2026-05-01T"),
]


@pytest.mark.parametrize(("columns", "text"), WRONG_TABLES)
def test_wrong_tables_are_refused(small, columns, text):
    refused(text, lambda: small.with_states(QTable(columns), time="2026-01-01"))


def test_overlapping_rows_must_agree(small):
    table = Table({"id": [1, 1, 2], "state": ["broken", "ok", "broken"], "from": ["", "2026-05-01", ""]})
    with pytest.raises(rs.InputError, match="must have the same state and pose, got broken and restored for 1"):
        small.with_states(table, time="2020-01-01")  # although they do not overlap at this time
    table["to"] = ["2026-05-01", "", ""]
    assert states_of(small.with_states(table, time="2026-05-01")) == ([2], {})
    nested = Table({"id": [1] * 3, "from": ["2020-01-01", "2021-01-01", "2022-06-01"]})
    nested["to"] = ["2025-01-01", "2022-01-01", "2023-01-01"]
    assert states_of(small.with_states(nested, time="2024-06-01")) == ([1], {})
    nested["state"] = ["broken", "broken", "ok"]
    refused("overlap in time", small.with_states, nested, time="2024-06-01")


def test_dates_require_a_time(small, file):
    refused(
        r"broken\.csv: the time of the observation must be given.*--set instrument.state_time", small.with_states, file
    )
    refused("time must be a Time", small.with_states, file, time="soon")


def test_several_times_between_which_no_state_changes(small, file):
    worn = small.with_states(file, time=Time(["2026-01-05", "2026-01-10"]))
    assert states_of(worn) == ([3], {5: (30, 100)})
    assert summary_of(worn)[1] == "2026-01-05T00:00:00 to 2026-01-10T00:00:00"


def test_similar_names_of_columns_cause_a_warning(small):
    with pytest.warns(rs.RfpsurveyWarning, match="column 'status' is not used; did you mean 'state'"):
        small.with_states(Table({"id": [1], "status": ["ok"], "reason": ["motor"]}))


DESCRIPTION = """name = "worn"
inherits = "lamost"
status = "assumed"
source = "log"
[layout]
states = {}
"""


TOML_STATES = [
    '{ value = "broken.csv" }',
    "{ value = [{ id = 3 }, { id = 5, state = 'stuck', from = 2026-01-01, to = '2026-03-01T12:00:00', theta = 30, "
    "phi = 100.0 }, { id = '8', from = 2026-01-31T00:00:00Z }] }",
]


@pytest.mark.parametrize("states", TOML_STATES)
def test_a_toml_file_contains_states(file, states):
    path = file.with_name("worn.toml")
    path.write_text(DESCRIPTION.format(states))
    worn = rs.Instrument.read(path, time="2026-02-01")
    assert states_of(worn) == ([3, 8], {5: (30, 100)})
    assert "layout.states" not in worn.values
    assert worn.values["states.broken"] == {"value": 2, "status": "assumed", "source": "log"}
    assert states_of(rs.Instrument.read(path, time="2020-01-01")) == ([3], {})
    refused(r"worn\.toml: .*the time of the observation must be given", rs.Instrument.read, path)
    with pytest.raises(rs.InputError, match="the time of the observation must be given"):
        rs.place_tiles(rs.Region.parse("cap 95 23 2"), str(path))


WRONG_TOML_STATES = [
    ("{ value = 3 }", "layout.states must be the name of a file, or a list of tables with the key id, got 3"),
    ("{ value = [] }", "layout.states must be the name of a file, or a list of tables with the key id"),
    ("{ value = [{ name = 3 }] }", "layout.states must be the name of a file, or a list of tables with the key id"),
    ("{ value = [{ id = 3, since = 1 }] }", "unknown key of layout.states 'since'"),
    ("{ value = [{ id = -3 }] }", "layout.states: id must be identifiers of positioners of worn, .* got '-3'"),
    ("{ value = 'absent.csv' }", r"absent\.csv: there is no such file"),
    ("{ value = [{ id = 1, from = 12:00:00 }] }", "layout.states: column 'from' must hold Julian dates"),
]


@pytest.mark.parametrize(("states", "text"), WRONG_TOML_STATES)
def test_wrong_states_in_a_toml_file_are_refused(tmp_path, states, text):
    path = tmp_path / "worn.toml"
    path.write_text(DESCRIPTION.format(states))
    refused(rf"worn\.toml: .*{text}", rs.Instrument.read, path, time="2026-01-01")


@pytest.mark.filterwarnings("ignore:.*DESI has 5000 positioners")
def test_a_table_changes_the_states_of_desi_as_built(tmp_path):
    table = desi_files.focal_plane(tmp_path / "desi-focalplane_2020-01-01T00:00:00.ecsv", per_petal=5)
    events = [
        {"TIME": "2021-01-01T00:00:00", "LOCATION": k, "STATE": 4, "POS_T": 1.0, "POS_P": 90.0} for k in (1, 1003)
    ]
    desi_files.state(tmp_path / "desi-state_2020-01-01T00:00:00.ecsv", table, events)
    log = rs.Instrument.read(tmp_path, time="2020-06-01")
    assert log.focal_plane.arrays.usable.all()
    log = rs.Instrument.read(tmp_path, time="2022-06-01")
    rows = {"id": [1003, 2004], "state": ["ok", "stuck"], "theta": [np.nan, -10], "phi": [np.nan, -100]}
    plane = log.with_states(Table(rows)).focal_plane
    ids = plane.id
    assert (ids[plane.disabled].tolist(), ids[plane.arrays.is_stuck].tolist()) == ([1], [1, 2004])
    assert_allclose(plane.stuck.to_value(u.deg)[np.isin(ids, [1, 2004])], [[-1, -90], [-10, -100]])
    assert_array_equal(plane.arrays.usable, ~np.isin(ids, [1, 2004]))


def test_a_table_changes_the_states_of_sdssv_as_built(tmp_path):
    sdssv_files.calibration(tmp_path / "apo")
    apo = rs.Instrument.from_sdssv(tmp_path / "apo", disabled=["R+1C13", "R0C15"])
    rows = {"id": ["R+1C13", "R-1C14"], "state": ["ok", "stuck"], "theta": [np.nan, 40], "phi": [np.nan, 120]}
    plane = apo.with_states(Table(rows)).focal_plane
    assert plane.id[plane.disabled].tolist() == ["R0C15"]
    k = np.flatnonzero(plane.id == "R-1C14")[0]
    tip = plane.forward(np.full(len(plane), 40) * u.deg, np.full(len(plane), 120) * u.deg)[k].to_value(u.mm)
    assert_allclose(plane.arrays.idle(True).segments[2:, k], tip)


def fiberstatus(plane, rows, **changes):
    """Return the table fiberstatus of fiberassign; two rows are in the past."""
    fiber = plane.xy[rows].to_value(u.mm) + [2, 1]
    table = QTable({"FIBER": np.arange(5), "LOCATION": plane.id[rows].astype(int), "X": -fiber[:, 0] * u.mm})
    table["Y"], table["BROKEN"], table["STUCK"] = fiber[:, 1] * u.mm, [1, 0, 0, 1, 0], [0, 1, 0, 0, 1]
    table["START_DATE"] = ["2018-02-21T09:23:51"] * 5
    table["END_DATE"] = ["2100-02-21T09:24:24"] * 3 + ["2020-01-01T00:00:00"] * 2
    for name, values in changes.items():
        table[name] = values
    return table


@pytest.mark.parametrize("ending", [".ecsv", ".fits"])
def test_the_table_of_broken_fibers_of_fiberassign_is_accepted(tmp_path, ending):
    """The table was refused because it has no column id."""
    desi_files.metrology(tmp_path / "fp.csv", per_petal=4)
    desi = warned("DESI has 5000 positioners, but the file has 40", rs.Instrument.from_desi, tmp_path / "fp.csv")
    plane, rows = desi.focal_plane, np.arange(0, 20, 4)
    table = fiberstatus(plane, rows)
    table.write(tmp_path / f"fiberstatus{ending}")
    worn = desi.with_states(tmp_path / f"fiberstatus{ending}", time="2026-06-01")
    assert np.flatnonzero(worn.focal_plane.disabled).tolist() == [0]
    assert np.flatnonzero(worn.focal_plane.arrays.is_stuck).tolist() == [4]
    theta, phi = (angle.copy() for angle in worn.focal_plane.stuck.T)
    assert_allclose(plane.forward(np.nan_to_num(theta), np.nan_to_num(phi))[4].value, plane.xy[4].value + [2, 1])
    assert summary_of(worn)[2:] == [1, 1, 0, 2]  # the row without flags is not counted
    assert states_of(desi.with_states(table, time="2019-01-01"))[0] == [0, 12]
    assert "_row" not in table.colnames
    refused("the time of the observation must be given", desi.with_states, table)
    for changes, message in (
        (
            {"X": np.full(5, 500) * u.mm},
            "X and Y of a stuck fiber must be a position in reach of the positioner, got 500",
        ),
        ({"X": np.full(5, np.nan) * u.mm}, "column 'X' must hold a finite number for each row, but 2 of 5"),
        ({"LOCATION": np.arange(5) + 17000}, "id must be identifiers of positioners of desi"),
        ({"BROKEN": np.full(5, 0.5)}, "column 'BROKEN' must hold a whole number"),
    ):
        with pytest.raises(rs.InputError, match=message):
            desi.with_states(fiberstatus(plane, rows, **changes), time="2026-06-01")
    both = fiberstatus(plane, rows, STUCK=np.ones(5, int), BROKEN=np.ones(5, int), X=np.full(5, 500) * u.mm)
    assert states_of(desi.with_states(both, time="2026-06-01")) == ([0, 4, 8], {})  # broken fibers need no pose


def test_the_table_of_broken_fibers_of_fiberassign_needs_locations(presets):
    """LOCATION 95 disabled the positioner with the running number 95 of the preset, which is at another position."""
    table = {"LOCATION": [95], "X": [-4.1], "Y": [-176.0], "BROKEN": [1], "STUCK": [0]}
    for name in ("desi", "sdss_apo"):
        with pytest.raises(rs.InputError, match=r"must be LOCATIONs of DESI .*, got .*; use DESI as built"):
            presets[name].with_states(Table(table))
