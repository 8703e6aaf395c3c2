"""The scripts of the documentation, on small input."""

import importlib.util
from pathlib import Path

import pytest
from astropy.table import QTable

import rfpsurvey as rs

SCRIPTS = Path(__file__).parent.parent / "docs" / "examples" / "scripts"
DATA = Path(__file__).parent.parent / "data"


@pytest.fixture
def example(tmp_path, monkeypatch):
    """Return a function from the name of a script to its main function; it writes into a folder of its own."""
    monkeypatch.chdir(tmp_path)

    def load(name):
        spec = importlib.util.spec_from_file_location(name, SCRIPTS / f"{name}.py")
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        return module.main

    return load


def test_lamost_spring(example, tmp_path):
    stars = rs.Catalog.read(DATA / "tycho2_spring_60x20.ecsv.gz")
    assert len(stars) == 24_691
    part = stars[stars.coord.ra.deg < 190]
    part.write(tmp_path / "part.fits")
    survey = example("lamost_spring")("part.fits")
    assert 0.75 < survey.summary["completeness"] <= 1
    assert survey.summary["n_colliding"] == 0
    assert (tmp_path / "lamost_spring.png").stat().st_size > 10_000


def test_sdssv_anticenter(example, tycho, tmp_path):
    stars = QTable.read(tycho, format="ascii.ecsv")
    stars[::8].write(tmp_path / "part.ecsv")
    survey = example("sdssv_anticenter")("part.ecsv", 1)
    assert survey.summary["n_colliding"] == 0
    last = survey.completeness[-3:]
    assert last["priority"].tolist() == ["3", "2", "1"]
    assert last["n_wanted"][0] == 2 * last["n_targets"][0]
    assert (tmp_path / "sdssv_anticenter.png").exists()


def test_desi_footprint(example, real_data, tmp_path):
    tiles = rs.Tiling.read(real_data("desi_tiles_main.ecsv.gz"))
    rs.Tiling(tiles.table[:120]).write(tmp_path / "tiles.ecsv")
    main = example("desi_footprint")
    survey = main("tiles.ecsv", 1e5)
    assert survey.summary["n_tiles"] == 120
    assert main("tiles.ecsv", 1e5).summary == survey.summary  # resumed
