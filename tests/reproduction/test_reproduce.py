"""The experiments of the paper run, write the stated files, and compare numbers with the claims."""

import astropy.units as u
import numpy as np
import pytest
from astropy.table import QTable

import rfpsurvey as rs
from reproduction import EXPERIMENTS, _poisson, reproduce
from reproduction._claims import Claim, claims_page, claims_table, verdict
from reproduction._designs import LARGE, Settings, estimate, random_designs
from reproduction._intervals import SCENES, coverage
from reproduction._large import COVERED, _differences, _of_differences, _of_plain
from reproduction._one_sky import one_sky
from reproduction._poisson import _of_reading, drops_by_ratio
from rfpsurvey._common.folder import locked

QUICK = Settings(quick=True)


def shrink(monkeypatch):
    """Limit the experiments to 61 positioners in the center of their targets, with a lower precision."""
    for layout in (LARGE, COVERED):
        monkeypatch.setitem(layout, "rings", 4)
    monkeypatch.setitem(LARGE, "target_radius", 80 * u.mm)  # the density of 20,000 targets within 200 mm
    for module in ("_designs", "_poisson"):
        monkeypatch.setattr(f"reproduction.{module}.N_TARGETS", 3200)
    loosen(monkeypatch)
    monkeypatch.setattr("reproduction._poisson.SEPARATIONS", (0.52, 2.0))
    monkeypatch.setattr("reproduction._poisson.FEW_ERROR", 2e-2)
    monkeypatch.setattr(Settings, "precision", 2e-2)
    monkeypatch.setattr(Settings, "pick", lambda _, full, quick: quick if quick < 40 else quick // 4)
    monkeypatch.setattr(_poisson, "random_designs", lambda settings: random_designs(settings)[:6])


def loosen(monkeypatch):
    """Double the standard error at which iterations end, which reduces their number to a quarter."""
    for name, (scene, precisions) in SCENES.items():
        monkeypatch.setitem(SCENES, name, (scene, {method: 2 * p for method, p in precisions.items()}))


@pytest.mark.few(2)
@pytest.mark.parametrize("experiment", sorted(EXPERIMENTS))
def test_each_experiment_runs(experiment, tmp_path, monkeypatch):
    shrink(monkeypatch)
    claims = reproduce(experiment, tmp_path / "out", quick=True, workers=2)
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
        reproduce(experiment, tmp_path / "out", quick=True)


def test_a_folder_in_use_and_existing_figures_are_refused(tmp_path, monkeypatch):
    """Two runs replaced the files of each other, and a figure was replaced without ``overwrite``."""
    monkeypatch.setitem(EXPERIMENTS, "small", lambda _: pytest.fail("the experiment must not start"))
    with locked(tmp_path, tmp_path / "lock"), pytest.raises(rs.InputError, match="another run uses this folder"):
        reproduce("small", tmp_path, quick=True, overwrite=True)
    for name in ("small.png", "claims.rst"):
        (tmp_path / name).write_text("mine")
        with pytest.raises(rs.InputError, match=rf"{name} exists; to replace it, use overwrite=True"):
            reproduce("small", tmp_path, quick=True)
        (tmp_path / name).unlink()


@pytest.mark.exhaustive
def test_results_do_not_depend_on_workers(tmp_path, monkeypatch):
    monkeypatch.setattr(Settings, "precision", 2e-2)
    one, two = (reproduce("small", tmp_path / str(n), quick=True, workers=n) for n in (1, 2))
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
    assert (found.meta["n_positioners"], found.meta["n_targets"], found.meta["target_radius_mm"]) == (469, 20_000, 200)


def disc_designs():
    """Return designs for which uniform targets collide more: 10 % for equal arms, 1 % for unequal arms.

    LAMOST's design is last.
    """
    uniform, disc = [0.11, 0.505, 0.053], [0.1, 0.5, 0.05]
    columns = {"ratio": [1.1, 1.9, 1.0], "uniform": uniform, "uniform error": [1e-4] * 3}
    return QTable({**columns, "disc": disc, "disc error": [0.0] * 3})


def test_drops_are_averaged_over_means_and_over_designs():
    (row,) = drops_by_ratio(disc_designs(), {"disc": 1.9})
    assert (row["min_separation"], row["of_means"]) == (1.9 * u.mm, pytest.approx(100 * (0.615 / 0.6 - 1)))
    assert (row["of_designs"], row["ratio_1.00_1.25"]) == (pytest.approx(5.5), pytest.approx(10))
    assert np.isnan(row["ratio_1.25_1.50"])
    assert (row["ratio_1.50_2.00"], row["lamost"]) == (pytest.approx(1), pytest.approx(6))
    errors = 100 * np.array([1e-4 / 0.1, 1e-4 / 0.5])
    assert row["of_designs_error"] == pytest.approx(np.hypot(*errors) / 2)
    assert row["lamost_error"] == pytest.approx(100 * 1e-4 / 0.05)
    assert row["of_means_error"] == pytest.approx(100 * np.hypot(1e-4, 1e-4) / 2 / 0.3)


def test_a_reading_is_judged_by_each_average():
    """The result names an average that agrees.

    If this average includes only some designs, the text does not decide the claim.
    """
    table = disc_designs()
    claim = _of_reading("disc", table)
    assert (claim.verdict, claim.reading) == ("reproduced", "disc; agrees: mean probability")
    assert "+6.00 % +- 0.20 % (LAMOST's design)" in claim.ours
    assert "+2.50 % +- 0.02 % (mean probability)" in claim.ours
    assert "+10.00 % +- 0.10 % (mean over the designs with ratios below 1.25)" in claim.ours
    table["uniform"] = table["disc"]
    assert _of_reading("disc", table).verdict == "not reproduced"
    table["uniform"][2], table["uniform error"][2] = 0.0512, 2e-4  # 2.4 +- 0.4 %
    assert _of_reading("disc", table).reading == "disc; agrees: LAMOST's design"
    assert _of_reading("disc", table).verdict == "cannot be decided from the text"
    table["disc"][0] = 0.0  # without collisions, the ratio is undefined
    assert "; +0.00 % +- 0.02 % (mean over the designs); +nan" in _of_reading("disc", table).ours
    table["disc"][2] = np.nan
    assert "LAMOST" not in _of_reading("disc", table).ours


@pytest.mark.exhaustive
def test_readings_without_discs_are_those_of_the_whole(monkeypatch):
    """The readings with discs, which take a long time, can be omitted without a change of the other columns."""
    monkeypatch.setattr(_poisson, "random_designs", lambda settings: random_designs(settings)[:2])
    coarse = Settings(quick=True, error=2e-2)
    assert coarse.precision == 2e-2
    tables, claims = _poisson.poisson(coarse, discs={})
    whole = _poisson.poisson(coarse, discs={"disc, separation 0.52 mm": 0.52})[0]["poisson"]
    assert len(tables["poisson_disc"]) == 0
    assert [c.reading for c in claims] == [_poisson.POINT_PROCESS, *_poisson.COORDINATES]
    for name in ("uniform", _poisson.POINT_PROCESS, *_poisson.COORDINATES):
        assert np.array_equal(tables["poisson"][name], whole[name], equal_nan=True)


def plain_row(value, standard_error):
    names = ("value", "standard_error", "n")
    columns = {f"plain_{n}": [v] for n, v in zip(names, (value, standard_error, 6000), strict=True)}
    columns |= {f"conditional_{n}": [v] for n, v in zip(names, (0.1, 1e-4, 100), strict=True)}
    return QTable({"design": ["LAMOST"], **columns})


def test_a_proper_number_of_iterations_is_precise_and_right():
    """An interval of more than 1 % is too wide, and a value that differs by five errors is wrong."""
    good, bad = "reproduced", "not reproduced"
    for value, error, words in ((0.1005, 4e-4, good), (0.1, 6e-4, bad), (0.102, 4e-4, bad)):
        (claim,) = _of_plain(plain_row(value, error))
        assert claim.verdict == words
        assert f"a 95 % interval of +- {196 * error / value:.1f} %" in claim.ours


def test_a_mean_that_one_formula_gives_is_attributed_to_it():
    rng = np.random.default_rng(1)
    ratio = rng.uniform(1, 2, 80)
    simulation = ratio**3 / 20
    table = QTable({"range_200": 1.1 * simulation, "covered": simulation})
    for way in ("range_200", "covered"):
        table[f"{way}_error"] = 1e-4
    table["closed_form_corrected"], table["closed_form_pitch"] = ratio / 20, ratio**3 / 40 + rng.normal(0, 1e-3, 80)
    mean, variance, correlated, edge = _of_differences(table, _differences(table, Settings()))
    assert mean.verdict == "not reproduced"  # simulation - formula: -0.1 for the first formula, 0 for the second
    assert "in 0 of 8 interpretations" in mean.ours
    assert (variance.verdict, correlated.verdict, edge.verdict) == ("not reproduced", "reproduced", "reproduced")
    assert "the difference is larger than 3 standard errors in 80 of 80 designs" in edge.ours
    table["closed_form_corrected"] = ratio**2 / 20
    mean = _of_differences(table, _differences(table, Settings()))[0]
    assert "all of which use the corrected closed form" in mean.ours
    table["range_200"] = table["covered"]
    assert _of_differences(table, _differences(table, Settings()))[3].verdict == "not reproduced"


@pytest.mark.exhaustive
def test_intervals_of_one_sky_are_counted():
    """Seven positioners have no interval.

    If all intervals contain the true value, the stated error of the coverage is not 0.
    """
    table = one_sky(QUICK)
    seven = table["positioners"] == 7
    assert (table["with_interval"][seven] == 0).all()
    assert np.isnan(table["coverage"][seven]).all()
    assert (table["coverage"][~seven] > 0.7).all()  # four standard errors below 0.9, for 40 skies
    assert (table["coverage_error"][~seven] > 0).all()
    assert {"uniform", "clusters of 6, 5 mm", "clusters of 60, 40 mm"} == set(table["sky"])


@pytest.mark.exhaustive
def test_an_iteration_is_more_than_one_trial(monkeypatch):
    """With every iteration as one trial, the interval is several times too wide, and always contains the true value."""
    loosen(monkeypatch)
    table = coverage(QUICK, repeats=20)
    width = {r["interval"]: r["half_width"] for r in table if r["scene"] == "LAMOST" and r["method"] == "monte_carlo"}
    assert width["wilson_naive"] < 1.1 * width["wilson"] < width["wilson_iterations"] / 2
    part = table[(table["interval"] == "wilson_iterations") & (table["method"] == "monte_carlo")]
    assert (part["coverage"] == 1).all()


def test_verdicts():
    assert (verdict(1.0, 1.15, 0.1), verdict(1.0, 1.25, 0.1)) == ("reproduced", "not reproduced")


def test_the_page_of_claims():
    claims = [Claim("small", "it grows", "figure", "0.1 to 0.2", "reproduced", "19 positioners")]
    page = claims_page(claims_table(claims), {"seed": 0})
    assert "Small\n-----" in page
    assert "   * - it grows\n     - figure\n     - 0.1 to 0.2\n     - reproduced\n     - 19 positioners\n" in page


def test_bad_input_is_named(tmp_path):
    for words, arguments, options in (
        ("unknown experiment 'large scale'", ("large scale", tmp_path), {}),
        ("rng must be a seed", ("small", tmp_path), {"rng": -1}),
        ("workers must be a whole number", ("small", tmp_path), {"workers": 0}),
        ("must be a folder", ("small", __file__), {}),
    ):
        with pytest.raises(rs.InputError, match=words):
            reproduce(*arguments, **options)
