"""The paper's experiments run, write what they say they write, and judge by numbers."""

import numpy as np
import pytest
from astropy.table import QTable

import rfpsurvey as rs
from rfpsurvey.reproduction import EXPERIMENTS
from rfpsurvey.reproduction._claims import Claim, claims_page, claims_table, verdict
from rfpsurvey.reproduction._designs import LARGE, Settings, estimate, random_designs

QUICK = Settings(quick=True)


@pytest.mark.parametrize("experiment", sorted(EXPERIMENTS))
def test_each_experiment_runs(experiment, tmp_path):
    claims = rs.reproduce(experiment, tmp_path / "out", quick=True, workers=2)
    assert len(claims) > 0
    assert set(claims["experiment"]) == {experiment}
    assert set(claims["verdict"]) <= {"reproduced", "not reproduced", "cannot be decided from the text"}
    names = {p.name for p in (tmp_path / "out").iterdir()}
    assert {"claims.ecsv", "claims.rst"} < names
    assert any(n.endswith(".png") for n in names)
    written = QTable.read(tmp_path / "out" / "claims.ecsv")
    assert written["ours"].tolist() == claims["ours"].tolist()
    assert written.meta["quick"] is True
    page = (tmp_path / "out" / "claims.rst").read_text()
    assert all(claim in page for claim in claims["claim"])
    with pytest.raises(rs.InputError, match="exists"):
        rs.reproduce(experiment, tmp_path / "out", quick=True)


def test_results_do_not_depend_on_workers(tmp_path):
    one, two = (rs.reproduce("small", tmp_path / str(n), quick=True, workers=n) for n in (1, 2))
    assert one["ours"].tolist() == two["ours"].tolist()
    assert (tmp_path / "1" / "small.ecsv").read_text() == (tmp_path / "2" / "small.ecsv").read_text()


def test_designs_are_those_of_the_paper():
    table = random_designs(Settings())
    assert len(table) == 80
    for name, low, high in (("central_arm", 7.25, 14.5), ("ratio", 1, 2), ("pitch", 24.6, 35)):
        values = np.asarray(getattr(table[name], "value", table[name]))
        assert low < values.min() < low + 0.1 * (high - low)
        assert high - 0.1 * (high - low) < values.max() < high
    found = estimate(8.25, 1.0, 25.6, LARGE, QUICK, [1])
    assert found.meta["n_positioners"] == 469
    assert found.meta["n_targets"] == 20_000
    assert found.meta["target_radius_mm"] == 200


def test_verdicts():
    assert verdict(1.0, 1.15, 0.1) == "reproduced"
    assert verdict(1.0, 1.25, 0.1) == "not reproduced"


def test_the_page_of_claims():
    claims = [Claim("small", "it grows", "figure", "0.1 to 0.2", "reproduced", "19 positioners")]
    page = claims_page(claims_table(claims), {"seed": 0})
    assert "Small\n-----" in page
    assert "   * - it grows\n     - figure\n     - 0.1 to 0.2\n     - reproduced\n     - 19 positioners\n" in page


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda p: rs.reproduce("large scale", p), "unknown experiment 'large scale'"),
        (lambda p: rs.reproduce("small", p, rng=-1), "rng must be a seed"),
        (lambda p: rs.reproduce("small", p, workers=0), "workers must be a whole number"),
        (lambda p: rs.reproduce("small", __file__), "must be a folder"),
    ],
)
def test_bad_input_is_named(call, words, tmp_path):
    with pytest.raises(rs.InputError, match=words):
        call(tmp_path)
