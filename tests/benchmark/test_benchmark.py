from dataclasses import replace

import astropy.units as u
import numpy as np
import pytest
from astropy.table import QTable

import rfpsurvey as rs
from rfpsurvey._studies import benchmark_collisions as benchmark
from rfpsurvey._studies.benchmark_probability import random_tips
from scenes import sdss_like

METHOD = QTable({"method": ["exact"]})
METHODS_HERE = ["exact", "sampled", "sweep", "scipy", "every_pair", "endpoints", "shapely"]


@pytest.fixture(scope="module")
def table():
    return rs.benchmark.benchmark_collisions(sdss_like(6), methods=METHODS_HERE, n_configurations=3, repeats=2, rng=2)


def rows(table, method):
    return table[table["method"] == method]


def test_every_method_has_its_rows(table):
    assert list(dict.fromkeys(table["method"])) == METHODS_HERE
    assert rows(table, "sampled")["n_points"].tolist() == list(benchmark.COMPARED["sampled"].numbers_of_points)
    assert rows(table, "exact")["n_points"].mask.all()
    assert (table["time"] > 0 * u.ms).all()
    assert table["ratio"][0] == 1
    np.testing.assert_allclose(table["ratio"], (table["time"] / table["time"][0]).value)
    assert len(set(table["n_colliding_true"].tolist())) == 1
    assert table["n_colliding_true"][0] > 50
    assert table.meta["n_positioners"] == 127


def test_errors_are_those_that_each_method_must_have(table):
    for method in ("exact", "scipy", "every_pair", "shapely"):
        row = rows(table, method)[0]
        assert (row["n_missed"], row["n_spurious"], row["misclassified"]) == (0, 0, 0)
        assert row["max_error"] < 1e-12 * u.mm
    sampled = rows(table, "sampled")
    assert (sampled["n_spurious"] == 0).all()
    assert (np.diff(sampled["max_error"].value) < 0).all()
    assert sampled["max_error"][-1] < 15 / 128 * u.mm
    assert sampled["n_missed"][0] > 0
    assert (table["mean_error"] <= table["max_error"]).all()
    assert (sampled["mean_error"] < 0.6 * sampled["max_error"]).all()
    assert set(table["device"]) == {"CPU"}
    swept = rows(table, "sweep")
    assert (swept["n_missed"] == 0).all()
    assert (swept["n_spurious"] > 0).all()
    np.testing.assert_allclose(
        table["misclassified"], (table["n_missed"] + table["n_spurious"]) / table["n_colliding_true"]
    )


def test_the_truth_comes_from_rational_arithmetic(monkeypatch):
    """A broken kernel changes the errors of its own method, and not the errors of other methods."""
    broken = replace(
        benchmark.COMPARED["exact"], function=lambda scene: benchmark.Found(*np.empty((2, 0), int), np.empty(0))
    )
    monkeypatch.setitem(benchmark.COMPARED, "exact", broken)
    table = rs.benchmark.benchmark_collisions(sdss_like(3), methods=["exact", "scipy"], repeats=1)
    assert (rows(table, "exact")["misclassified"], rows(table, "scipy")["misclassified"]) == ([1], [0])


def test_a_comparison_that_is_not_installed_is_named(monkeypatch):
    monkeypatch.setattr(benchmark, "find_spec", lambda name: None)
    assert "shapely" not in benchmark._check_methods(None)
    with pytest.raises(rs.InputError, match="needs the package shapely"):
        rs.benchmark.benchmark_collisions("lamost", methods=["shapely"])


def test_a_table_survives_the_round_trip(table, tmp_path):
    table.write(tmp_path / "t.ecsv")
    again = QTable.read(tmp_path / "t.ecsv")
    assert (again["n_points"].mask.tolist(), again["max_error"].unit) == (table["n_points"].mask.tolist(), u.mm)
    assert again.meta["min_separation_mm"] == pytest.approx(5.0781907)


def test_batches(monkeypatch):
    table = rs.benchmark.benchmark_batches(sdss_like(2), sizes=[1, 30], workers=[1, 2], repeats=2)
    assert (table["workers"].tolist(), table["size"].tolist()) == ([1, 2, 1, 2], [1, 1, 30, 30])
    np.testing.assert_allclose((table["rate"] * table["time"]).to_value(u.one), table["size"])


def test_joint_limits_are_kept(rng):
    unit = rs.Positioner(8.25 * u.mm, 8.25 * u.mm, 2.25 * u.mm, phi_range=[60, 180] * u.deg)
    plane = rs.FocalPlane.hexagonal(unit, rings=2, pitch=25.6 * u.mm)
    tips = random_tips(plane, rng)
    assert np.isfinite(tips).all()
    assert (np.hypot(*(tips - plane.arrays.xy).T) < 2 * 8.25 * np.cos(np.deg2rad(30)) + 1e-9).all()
    assert len(rs.benchmark.benchmark_batches(plane, sizes=[1], workers=[1], repeats=1)) == 1


def test_probabilities_are_compared_within_one_question():
    plane = sdss_like(2)
    efforts = {"closed_form": [0], "quadrature": [64, 512], "monte_carlo": [64], "conditional": [16]}
    table = rs.benchmark.benchmark_probability(plane, efforts=efforts, repeats=3, precision=1e-3)
    truth = {kind: table[table["estimand"] == kind]["truth"] for kind in ("independent", "allocated")}
    assert all(len(set(values)) == 1 for values in truth.values())
    assert abs(truth["independent"][0] - truth["allocated"][0]) > 0.02
    assert (table["error"][1:] < 4 * np.hypot(table["standard_error"][1:], 1e-3)).all()
    assert np.isnan(table["standard_error"][0])
    assert table["error"][0] > 0.2  # the method is a formula, which has a large error
    assert table["time"].unit == u.ms


def test_densities_that_stand_in_for_queues():
    table = rs.benchmark.benchmark_densities(sdss_like(2), precision=3e-3, n_allocations=3)
    assert table["bias"][0] == 0
    np.testing.assert_allclose(table["bias"], table["value"] - table["value"][0])
    assert table["value"][3] < table["value"][1]  # arms that stay in their own cells collide less


def test_bad_input_is_named():
    b, plot = rs.benchmark, rs.plot
    for message, function, given, options in (
        ("seconds must be a number of at least 0, got -1", b.benchmark_collisions, "lamost", {"seconds": -1}),
        ("instrument must be a name, an Instrument or a FocalPlane, got int", b.benchmark_collisions, 3, {}),
        ("methods must be a list of names, got 'exact'", b.benchmark_collisions, "lamost", {"methods": "exact"}),
        (r"sizes must be a list of whole numbers, got \[\]", b.benchmark_batches, "lamost", {"sizes": []}),
        ("workers must be a list of whole numbers, got 2", b.benchmark_batches, "lamost", {"workers": 2}),
        ("unknown method 'guess'; choose one of: ", b.benchmark_collisions, "lamost", {"methods": ["guess"]}),
        ("repeats must be a whole number of at least 1, got 0", b.benchmark_collisions, "lamost", {"repeats": 0}),
        ("n_configurations must be a whole number", b.benchmark_collisions, "lamost", {"n_configurations": 1.5}),
        (r"sizes\[1\] must be a whole number of at least 1", b.benchmark_batches, "lamost", {"sizes": [1, 0]}),
        (r"workers\[0\] must be a whole number of at least 1", b.benchmark_batches, "lamost", {"workers": [0]}),
        ("efforts must map methods", b.benchmark_probability, "lamost", {"efforts": ["quadrature"]}),
        ("unknown method of collision probability", b.benchmark_probability, "lamost", {"efforts": {"guess": [1]}}),
        ("repeats must be a whole number", b.benchmark_probability, "lamost", {"repeats": 0}),
        ("n_allocations must be a whole number", b.benchmark_densities, "lamost", {"n_allocations": 0}),
        ("table must be a QTable, got NoneType", plot.plot_speed_accuracy, None, {}),
        ("without the column max_error, misclassified, n_colliding_true", plot.plot_speed_accuracy, METHOD, {}),
        ("table must be a QTable", plot.plot_probability_accuracy, 3, {}),
        ("without the column effort, error, error_error, estimand", plot.plot_probability_accuracy, METHOD, {}),
    ):
        with pytest.raises(rs.InputError, match=message):
            function(given, **options)


def test_the_benchmark_of_collisions_refuses_outlines(presets):
    """Methods without support for outlines were compared with the distances of segments without a clearance."""
    with pytest.raises(rs.InputError, match="the arms must be segments for this benchmark"):
        rs.benchmark.benchmark_collisions(presets["desi"], methods=["exact"], repeats=1)


def test_the_benchmark_of_probabilities_omits_methods_without_outlines(presets):
    unit = presets["desi"].focal_plane.positioner
    plane = rs.FocalPlane.hexagonal(unit, rings=2, pitch=10.4 * u.mm)
    table = rs.benchmark.benchmark_probability(plane, repeats=1, precision=1e-2)
    assert {"overlap_ratio", "quadrature", "monte_carlo", "conditional"} <= set(table["method"])
    assert not {"closed_form", "close_pair"} & set(table["method"])
