"""The scripts of the documentation. The pages show the output of the scripts when the pages are built."""

import importlib.util
import re
import runpy
from pathlib import Path

import matplotlib.pyplot as plt
import pytest
from astropy.table import QTable

import rfpsurvey as rs

SCRIPTS = Path(__file__).parent.parent / "docs" / "examples" / "scripts"
MOST_LINES = 40


@pytest.fixture
def script(tmp_path, monkeypatch, capsys):
    """Return a function that runs a script in a separate folder, and returns its variables and its output."""
    monkeypatch.chdir(tmp_path)
    plt.close("all")

    def call(name):
        return runpy.run_path(str(SCRIPTS / f"{name}.py")), capsys.readouterr().out

    yield call
    plt.close("all")


def test_scripts_are_short():
    names = sorted(path.name for path in SCRIPTS.glob("plot_*.py"))
    assert [name.split("_")[2] for name in names] == ["lamost.py", "sdssv.py", "moons.py", "desi.py", "pfs.py"]
    assert all(len((SCRIPTS / name).read_text().splitlines()) <= MOST_LINES for name in names)


def test_lamost_observes_the_fraction_that_is_asked_for(script):
    values, printed = script("plot_1_lamost")
    survey = values["survey"]
    assert printed.startswith(f"<Tiling of 5 tiles in 1 pass>\n{survey}\n")
    assert 0.8 <= survey.summary["completeness"] < 0.85
    assert survey.summary["n_colliding"] == 0
    assert sum(map(int, re.findall(r"^ *(\d+) ", printed, re.MULTILINE))) == len(values["stars"])
    assert len(QTable.read("lamost_tiles.ecsv", format="ascii.ecsv")) == 5
    assert len(QTable.read("lamost_targets.ecsv", format="ascii.ecsv")) == survey.summary["n_visits_observed"]
    assert plt.get_fignums()


def test_sdssv_observes_bright_stars_first(script):
    values, printed = script("plot_2_sdssv")
    assert str(values["survey"]) in printed
    rows = re.findall(r"^ +4 +([123]) +(\d+) +(\d+)$", printed, re.MULTILINE)
    assert [row[0] for row in rows] == ["3", "2", "1"]
    fractions = [int(observed) / int(wanted) for _, wanted, observed in rows]
    assert (fractions, fractions[0]) == (sorted(fractions, reverse=True), 1)
    assert len(QTable.read("sdssv_outcomes.ecsv", format="ascii.ecsv")) == len(values["stars"])


def test_moons_gains_by_the_overlap(script):
    values, printed = script("plot_3_moons")
    surveys = values["surveys"]
    assert values["reaching"][2:].sum() > 0.9 * values["reaching"].sum()
    rule, optimum = (surveys[name].summary for name in ("lamost_rule", "optimal"))
    assert (rule["n_colliding"] > 1000, optimum["n_colliding"]) == (True, 0)
    assert optimum["n_visits_observed"] > 1.2 * rule["n_visits_observed"]
    assert f"optimal: {surveys['optimal']}, 0 arms in collision\n" in printed
    assert len(QTable.read("moons_targets.fits")) == optimum["n_visits_observed"]


def test_desi_makes_several_visits(script):
    values, printed = script("plot_4_desi")
    survey = values["survey"]
    fractions = {
        name: n / wanted for name, wanted, n in survey.completeness["category", "n_requested", "n_observed"][-3:]
    }
    assert fractions["QSO"] > fractions["LRG"] > fractions["ELG"]
    assert survey.outcomes["observed"].max() == 4
    assert re.search(r"^ +4 +QSO +48312 ", printed, re.MULTILINE)
    assert len(QTable.read("desi_targets.fits")) == survey.summary["n_visits_observed"]


def test_pfs_meets_the_requirements_of_each_tile(script):
    values, printed = script("plot_5_pfs")
    assert printed.startswith("required in each tile: sky=240 standard=40\n")
    tiles = QTable.read("pfs_tiles.ecsv", format="ascii.ecsv")
    assert tiles["n_sky"].min() >= 240
    assert tiles["n_standard"].min() >= 40
    assert tiles["n_unmet"].max() == tiles["n_colliding"].max() == 0
    assert values["survey"].outcomes["observed"].max() == 3


def test_desi_footprint(monkeypatch, real_data, tmp_path):
    monkeypatch.chdir(tmp_path)
    rs.Tiling(rs.Tiling.read(real_data("desi_tiles_main.ecsv.gz")).table[:120]).write(tmp_path / "tiles.ecsv")
    spec = importlib.util.spec_from_file_location("desi_footprint", SCRIPTS / "desi_footprint.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    survey = module.main("tiles.ecsv", 1e5)
    assert survey.summary["n_tiles"] == 120
    assert module.main("tiles.ecsv", 1e5).summary == survey.summary  # the survey is resumed
