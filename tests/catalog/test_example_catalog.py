"""Catalogs that are distributed with the package, and read by name."""

import gzip
import importlib.util
from pathlib import Path

import numpy as np
import pytest
import setuptools
from raising import refused

import rfpsurvey as rs
from rfpsurvey._sky import catalog_files as _catalog_files
from rfpsurvey._sky.catalog_files import unpack

ROOT = Path(__file__).parents[2]


def test_an_example_holds_the_stars_of_the_file(tycho):
    stars, same = rs.example_catalog("anticenter"), rs.Catalog.read(tycho, keep=["bt_mag", "vt_mag"])
    assert stars.meta == {**same.meta, "file": "example:anticenter"}
    one, other = stars.to_table(), same.to_table()
    assert one.colnames == other.colnames
    for name in one.colnames:
        np.testing.assert_array_equal(one[name], other[name])
    assert stars.epoch.jyear == 2000


def test_the_name_of_an_example_replaces_a_path():
    stars = rs.Catalog.read(Path("example:anticenter"), columns={"priority": "-vt_mag"})
    np.testing.assert_array_equal(stars.priority, -rs.example_catalog().extra["vt_mag"].value)


def test_an_unknown_name_lists_the_examples():
    message = "unknown example catalog 'anticentre'; choose one of: anticenter. Did you mean 'anticenter'?"
    for call in (lambda: rs.example_catalog("anticentre"), lambda: rs.Catalog.read("example:anticentre")):
        assert refused("", call) == message
    with pytest.raises(rs.InputTypeError, match="choose one of: anticenter"):
        rs.example_catalog(3)


def test_a_missing_file_is_named(monkeypatch, tmp_path):
    monkeypatch.setattr(_catalog_files, "_PLACES", ((tmp_path, ".packed"),))
    refused(r"must contain .*ecsv.packed, but the file is missing: install rfpsurvey", rs.example_catalog)


COMMANDS = [
    ["plan", "example:anticenter", "--instrument", "sdss_apo", "--center", "95 23"],
    ["compare", "sdss_apo", "--catalog", "example:anticenter", "--center", "95 23", "--allocator", "lamost_rule"],
    ["probability", "sdss_apo", "--targets", "example:anticenter", "--estimand", "allocated"],
]


@pytest.mark.few(1)
@pytest.mark.parametrize("command", COMMANDS)
def test_commands_accept_the_name_of_an_example(run, command):
    code, out, err = run(*command)
    assert code == 0, err
    assert "sdss_apo" in out


def test_commands_refuse_an_unknown_example(run):
    code, _, err = run("plan", "example:spring")
    assert code == 2
    assert err == "rfpsurvey: unknown example catalog 'spring'; choose one of: anticenter.\n"


@pytest.mark.few(1)
@pytest.mark.filterwarnings("ignore:setuptools-scm")
@pytest.mark.parametrize("editable", [False, True])
def test_a_wheel_contains_the_file(tmp_path, monkeypatch, tycho, editable):
    spec = importlib.util.spec_from_file_location("wheel", ROOT / "data" / "wheel.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    build = module.BuildWithExamples(setuptools.Distribution({"packages": []}))
    build.ensure_finalized()
    build.build_lib, build.editable_mode = str(tmp_path), editable
    build.run()
    folder = tmp_path / "rfpsurvey" / "_sky" / "examples"
    assert folder.exists() != editable
    if not editable:
        monkeypatch.setattr(_catalog_files, "_PLACES", ((folder, ".packed"),))
        [path] = folder.iterdir()
        assert path.name == "tycho2_anticenter_r5.ecsv.packed"
        assert path.stat().st_size < 120_000
        assert unpack(path.read_bytes()).encode() == gzip.decompress(tycho.read_bytes())
        found, expected = rs.example_catalog(), rs.Catalog.read(tycho, keep=["bt_mag", "vt_mag"])
        np.testing.assert_array_equal(found.arrays.vectors, expected.arrays.vectors)
        assert {**found.meta, "file": ""} == {**expected.meta, "file": ""}
        assert found.to_table().pformat() == expected.to_table().pformat()
