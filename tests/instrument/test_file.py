"""Files of complete instruments."""

import json
from dataclasses import replace

import astropy.units as u
import numpy as np
import pytest
from astropy.table import QTable, Table
from raising import refused

import rfpsurvey as rs


@pytest.mark.few(4)
@pytest.mark.parametrize("name", sorted(rs.available_instruments(), key=["must", "spec_s5"].count))  # the largest last
def test_presets_are_restored_exactly(name, tmp_path):
    instrument = rs.Instrument.preset(name)
    instrument.write(tmp_path / "instrument.ecsv")
    found = rs.Instrument.read(tmp_path / "instrument.ecsv")
    assert found.provenance == instrument.provenance  # contains a digest
    assert found.requirements == instrument.requirements
    assert found.facts()["field_radius"] == instrument.facts()["field_radius"]
    assert found.notes == instrument.notes


def test_states_margins_and_distortion_maps_are_restored_exactly(tmp_path):
    moons = rs.Instrument.preset("moons").use_margins(rs.Margins(outer=0.1 * u.mm))
    states = Table({"id": [3, 5], "state": ["broken", "stuck"], "theta": [0.0, 30.1], "phi": [180.0, 90.7]})
    maps = {
        "radial": rs.projection.RadialMap("sine", [1.4, 0.006], max_angle=1.5 * u.deg, radius=8939 * u.mm),
        "none": None,
    }
    for k, (what, optics) in enumerate(maps.items()):
        changed = {} if optics is None else {"plate_scale": None, "distortion": optics}
        instrument = replace(moons.with_states(states), **changed)
        instrument.write(tmp_path / f"{k}.ecsv")
        found = rs.Instrument.read(tmp_path / f"{k}.ecsv")
        assert found.provenance == instrument.provenance, what
        assert found.focal_plane.margins == instrument.focal_plane.margins
        assert not found.focal_plane.arrays.usable[[3, 5]].any()


def test_angles_in_degrees_are_restored_exactly(tmp_path):
    """Regression: zero points and joint limits were converted to radians and back, with rounding errors."""
    rng, unit = np.random.default_rng(2), rs.Positioner(8.25 * u.mm, 8.25 * u.mm, 2.25 * u.mm)
    plane = rs.FocalPlane.hexagonal(unit, rings=4, pitch=25.6 * u.mm)
    zeros, ends = rng.uniform(-90, 90, (2, len(plane), 2)) * u.deg
    plane = replace(plane, zero_points=zeros, phi_range=np.sort(ends, axis=1) + [0, 90] * u.deg)
    instrument = rs.Instrument("tiny", plane, plate_scale=200 * u.mm / u.deg)
    instrument.write(tmp_path / "instrument.ecsv")
    assert rs.Instrument.read(tmp_path / "instrument.ecsv").provenance == instrument.provenance


def test_the_path_is_checked(tmp_path):
    lamost = rs.Instrument.preset("lamost")
    lamost.write(tmp_path / "lamost.ecsv")
    refused("exists", lamost.write, tmp_path / "lamost.ecsv")
    lamost.write(tmp_path / "lamost.ecsv", overwrite=True)
    refused(r"must end in \.ecsv", lamost.write, tmp_path / "lamost.fits")


def break_entry(table, **changes):
    about = json.loads(table.meta["instrument"])
    for name, value in changes.items():
        about.pop(name) if value is None else about.update({name: value})
    table.meta["instrument"] = json.dumps(about)


OTHER_TABLES = [
    (lambda table: table.meta.pop("instrument"), "the entry instrument of meta must be an object in JSON"),
    (lambda table: table.meta.update(instrument="{"), "the entry instrument of meta must be an object in JSON"),
    (lambda table: break_entry(table, plate_scale=None), "must be a valid description of an instrument"),
    (lambda table: break_entry(table, plate_scale="3 kg"), "plate_scale must have"),
    (lambda table: break_entry(table, name=None), "must be a valid description of an instrument"),
    (lambda table: break_entry(table, distortion=3), "must be a valid description of an instrument"),
    (lambda table: table.meta.pop("positioner"), "must have an entry 'positioner'"),
    (lambda table: table.remove_column("x"), "'x'"),
]


@pytest.mark.parametrize(("damage", "message"), OTHER_TABLES)
def test_other_tables_are_refused_with_a_sentence(damage, message, tmp_path):
    path = tmp_path / "moons.ecsv"
    rs.Instrument.preset("moons").write(path)
    table = QTable.read(path)
    damage(table)
    table.write(path, overwrite=True)
    assert str(path) in refused(message, rs.Instrument.read, path)
