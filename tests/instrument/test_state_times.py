"""States of positioners at several times, compared with an instrument that is read for each of the times."""

import desi_files
import numpy as np
import pytest
from astropy.table import Table
from astropy.time import Time
from numpy.testing import assert_allclose
from raising import refused

import rfpsurvey as rs
from rfpsurvey._instruments.states import instruments_at, states_of


def random_times(rng, n):
    """Return times from 2020 to 2023 as text, not in ascending order."""
    days, hours = rng.integers(0, 1400, n), rng.integers(0, 24, n)
    return (Time("2020-01-02").mjd + days + hours / 24).tolist()


def as_times(days):
    return Time(days, format="mjd", scale="utc")


def compare(many, read, times):
    """Check that an instrument has the states of the instruments that a function of the time returns."""
    different = instruments_at(many, times)
    for time, instrument in zip(times, different, strict=True):
        expected = states_of(read(time).focal_plane)
        assert_allclose(states_of(instrument.focal_plane), expected, rtol=0, atol=1e-12)
        assert_allclose(states_of(many.at_time(time).focal_plane), expected, rtol=0, atol=1e-12)
    return len({*map(id, different)})


@pytest.mark.few(5)
@pytest.mark.parametrize("seed", range(30))
def test_tables_apply_at_each_time(small, seed):
    """A second table, also one without dates, replaces the states of the first."""
    rng, n = np.random.default_rng(seed), 37
    limits = np.sort(np.reshape([random_times(rng, 2) for _ in range(2 * n)], (2, n, 2)))
    tables = []
    for first, last in limits.transpose(0, 2, 1):
        table = Table({"id": np.arange(n), "state": rng.choice(["broken", "ok"], n)})
        table["from"], table["to"] = as_times(first).isot, as_times(last + 1).isot
        tables.append(table)
    tables.append(Table({"id": [3, 4]}))
    # a state begins at its first moment, and has ended at its last
    times, many = Time([*as_times(random_times(rng, 20)).isot, *tables[0]["from"][:5], *tables[0]["to"][:5]]), small
    for table in tables:
        many = many.with_states(table, time=times)
    read = small.with_states(tables[0], time=times)
    assert read.provenance["digest"] != many.provenance["digest"] != small.provenance["digest"]

    def at(time):
        return small.with_states(tables[0], time=time).with_states(tables[1], time=time).with_states(tables[2])

    assert compare(many, at, times) > 5


@pytest.mark.few(3)
@pytest.mark.parametrize("seed", range(20))
@pytest.mark.filterwarnings("ignore:.*DESI has 5000 positioners")
def test_the_log_of_desi_applies_at_each_time(tmp_path, seed):
    """Events are not in the order of their times, and change poses and joint limits."""
    rng = np.random.default_rng(seed)
    plane = desi_files.focal_plane(tmp_path / "desi-focalplane_2019-01-01T00:00:00.ecsv", per_petal=4)
    events = []
    for day in random_times(rng, 150):
        state = int(rng.choice([0, 2, 4, 6, 8]))
        event = {"TIME": as_times(day).isot, "LOCATION": int(rng.choice(plane["LOCATION"][:-1])), "STATE": state}
        event |= {"POS_T": float(rng.uniform(-90, 90)), "POS_P": float(rng.uniform(0, 180))}
        events.append(event | ({"MIN_P": float(rng.uniform(0, 50))} if state == 8 else {}))
    desi_files.state(tmp_path / "desi-state_2019-01-01T00:00:00.ecsv", plane, events)
    times = as_times(random_times(rng, 15))
    many = rs.Instrument.read(tmp_path, time=times)
    many.write(tmp_path / "desi.ecsv")
    for instrument in (many, rs.Instrument.read(tmp_path / "desi.ecsv")):
        assert compare(instrument, lambda time: rs.Instrument.read(tmp_path, time=time), times) > 5


@pytest.mark.filterwarnings("ignore:.*DESI has 5000 positioners")
def test_a_focal_plane_of_desi_must_be_the_same_at_all_times(tmp_path):
    for year in (2019, 2021):
        plane = desi_files.focal_plane(tmp_path / f"desi-focalplane_{year}-01-01T00:00:00.ecsv", per_petal=4)
        desi_files.state(tmp_path / f"desi-state_{year}-01-01T00:00:00.ecsv", plane)
    assert rs.Instrument.read(tmp_path, time=Time(["2021-02-01", "2021-05-01"])).focal_plane.arrays.usable.all()
    refused("must be the same at all times", rs.Instrument.read, tmp_path, time=Time(["2020-02-01", "2021-02-01"]))


@pytest.mark.filterwarnings("ignore:.*DESI has 5000 positioners")
def test_joint_limits_of_events_are_checked(tmp_path):
    plane = desi_files.focal_plane(tmp_path / "desi-focalplane_2019-01-01T00:00:00.ecsv", per_petal=4)
    event = {"TIME": "2020-06-01T00:00:00", "LOCATION": int(plane["LOCATION"][0]), "STATE": 8, "MIN_P": 300.0}
    desi_files.state(tmp_path / "desi-state_2019-01-01T00:00:00.ecsv", plane, [event])
    refused("MIN_P must be less than", rs.Instrument.read, tmp_path, time=Time(["2020-01-01", "2021-01-01"]))
