"""The script that measures the angular correlation function with weights from selection probabilities."""

import importlib.util
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import quad

import rfpsurvey as rs

SCRIPT = Path(__file__).parents[2] / "docs" / "examples" / "scripts" / "clustering.py"


@pytest.fixture(scope="module")
def script():
    spec = importlib.util.spec_from_file_location("clustering", SCRIPT)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def points(script):
    rng = np.random.default_rng(0)
    xy = rng.uniform(-1, 1, (150, 2)) * rng.choice([1.0, 0.1], (150, 1))
    catalog = rs.Catalog(script.to_sky(xy))
    half = np.arange(0, 150, 2)
    first = script.Points(catalog, half, rng.uniform(1, 3, 75))
    return first, script.Points(catalog, half + 1), rng.uniform(1, 3, (75, 75))


def slow_counts(script, first, second, weight, k):
    """Count pairs with angles from arc cosines, without the points of region k (-1: with all points)."""
    angle = np.rad2deg(np.arccos(np.clip(first.vectors @ second.vectors.T, -1, 1)))
    keep = (first.region[:, None] != k) & (second.region[None] != k)
    return [
        weight[keep & (angle > a) & (angle <= b)].sum() for a, b in zip(script.EDGES, script.EDGES[1:], strict=False)
    ]


def test_pairs_are_those_that_are_counted_one_by_one(script, points):
    first, second, pairwise = points
    for a, b in ((first, second), (first, first)):
        weight = a.weight[:, None] * b.weight
        expected = [slow_counts(script, a, b, weight, k) for k in range(-1, script.N_REGIONS)]
        np.testing.assert_allclose(script.count(a, b), expected, atol=1e-9)
    both = pairwise + pairwise.T
    expected = [slow_counts(script, first, first, both, k) for k in range(-1, script.N_REGIONS)]
    np.testing.assert_allclose(script.count_weighted_pairs(first, lambda i, j: both[i, j]), expected, atol=1e-9)
    assert len(np.unique(first.region)) > 10
    assert np.sum(expected[0]) > 0


def test_totals_are_the_sums_over_all_pairs(script, points):
    first, second, _ = points
    for k, (cross, same) in enumerate(
        zip(script.totals(first, second), script.totals(first, first, same=True), strict=True)
    ):
        a, b = first.weight[first.region != k - 1], second.weight[second.region != k - 1]
        assert cross == pytest.approx(a.sum() * b.sum())
        assert same == pytest.approx(sum(2 * x * y for x, y in combinations(a, 2)))


class Enumerated:
    """Selection probabilities in which each subset of half of the targets is observed equally often."""

    def __init__(self, n, repeats):
        subsets = [np.isin(np.arange(n), chosen) for chosen in combinations(range(n), n // 2)]
        self.subsets = np.array(subsets)
        self.seen = np.tile(self.subsets.T, repeats)
        self.n_realizations = self.seen.shape[1]
        padded = np.pad(self.seen, ((0, 0), (0, -self.n_realizations % 64)))
        self.bits = np.packbits(padded, axis=1, bitorder="little").view("<u8")

    def observed_in(self, r):
        return self.seen[:, r]

    def pair_counts(self, first, second):
        return (self.seen[first] & self.seen[second]).sum(axis=1)


def test_pairwise_weights_are_unbiased_over_all_selections(script):
    rng = np.random.default_rng(1)
    found = Enumerated(6, 400)
    catalog = rs.Catalog(script.to_sky(rng.uniform(-0.1, 0.1, (6, 2))))
    complete = script.Points(catalog, np.arange(6))
    expected = script.count(complete, complete)[0]
    counts, sums = [], []
    for subset in found.subsets:
        rows = np.flatnonzero(subset)
        one = script.Points(catalog, rows)
        counts.append(script.count_weighted_pairs(one, script.pair_weights(found, rows))[0])
        sums.append(script.totals_of_pairs(found, one, rows)[0])
    assert np.sum(expected) > 10
    np.testing.assert_allclose(np.mean(counts, axis=0), expected, rtol=1e-3)
    assert np.mean(sums) == pytest.approx(6 * 5, rel=1e-3)


def test_sums_of_pairwise_weights_leave_out_regions(script):
    rng = np.random.default_rng(2)
    found = Enumerated(8, 3)
    points = script.Points(rs.Catalog(script.to_sky(rng.uniform(-1, 1, (8, 2)))), np.arange(8))
    weight_of = script.pair_weights(found, np.arange(8))
    for k, value in enumerate(script.totals_of_pairs(found, points, np.arange(8))):
        rest = np.flatnonzero(points.region != k - 1)
        i, j = np.array(list(combinations(rest, 2))).T
        assert value == pytest.approx(2 * weight_of(i, j).sum(), rel=1e-5)


def test_the_weight_of_a_target_without_a_fiber_goes_to_the_nearest_observed_target(script):
    rng = np.random.default_rng(3)
    vectors, observed = rng.normal(size=(40, 3)), rng.random(40) < 0.6
    rows = np.flatnonzero(observed)
    expected = np.ones(len(rows))
    for lost in vectors[~observed]:
        expected[np.argmin(np.linalg.norm(vectors[rows] - lost, axis=1))] += 1
    assert script.nearest_neighbor_weights(vectors, observed, rows).tolist() == expected.tolist()


def test_the_closed_form_is_the_average_over_each_bin(script):
    def pairs(theta2):  # of one parent
        return np.exp(-theta2 / (4 * script.SIGMA**2)) / (4 * np.pi * script.SIGMA**2)

    for value, low, high in zip(script.thomas_correlation(), script.EDGES, script.EDGES[1:], strict=False):
        mean = quad(pairs, low**2, high**2, epsrel=1e-10)[0] / (high**2 - low**2)
        assert value == pytest.approx(mean / script.PARENTS, rel=1e-7)
