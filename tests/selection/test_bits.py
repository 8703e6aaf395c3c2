"""Packed bits of realizations, and the estimates that follow from counts of them."""

import numpy as np
import pytest
from astropy.table import QTable
from scipy import stats

from rfpsurvey._survey.selection import probabilities as _probabilities


def lss_columns(observed):
    """Return the columns that desihub's LSS writes: one bit per realization, added to signed 64-bit integers."""
    n, m = observed.shape
    columns = np.zeros((n, -(-m // 64)), dtype=np.int64)
    for t in range(n):
        for r in range(m):
            if observed[t, r]:
                value = 1 << (r % 64)
                columns[t, r // 64] |= np.int64(value - (1 << 64) if value >= 1 << 63 else value)
    return columns


@pytest.mark.parametrize("n", [1, 7, 63, 64, 65, 128, 200])
def test_bits_in_the_order_of_lss_are_counted(rng, n):
    observed = rng.random((40, n)) < 0.4
    observed[0], observed[1] = True, False
    bits = lss_columns(observed).view(np.uint64)
    assert bits.shape == (40, _probabilities.n_words(n))
    np.testing.assert_array_equal(_probabilities.count_bits(bits), observed.sum(axis=1))


def observed_times(count, n):
    """Return selection probabilities of targets that the first ``count`` of n realizations observed."""
    bits = np.packbits(np.arange(n) < count[:, None], axis=1, bitorder="little").view(np.uint64)
    ones = np.ones(len(count), dtype=np.int64)
    realizations = QTable({"realization": np.arange(n)})
    return _probabilities.SelectionProbabilities(np.arange(len(count)), ones, ones, bits, realizations)


def test_weights_are_those_of_desi_and_nearly_unbiased():
    """The expected value of the weight of an observed target is (1 - (1 - p)^(n + 1)) / p."""
    n = 128
    count = np.arange(n + 1)
    weight = observed_times(count, n).weight
    np.testing.assert_allclose(weight, 129 / (1 + 128 * (count / 128)), rtol=1e-15)
    for p in (0.004, 0.1, 0.7, 1.0):
        expected = stats.binom.pmf(count, n, p) @ weight
        assert expected == pytest.approx((1 - (1 - p) ** (n + 1)) / p, rel=1e-10)


def test_standard_errors_are_those_of_a_uniform_prior():
    n = 64
    count = np.arange(n + 1)
    found = observed_times(count, n)
    error = found.probability_error
    np.testing.assert_allclose(error, stats.beta(count + 1, n - count + 1).std(), rtol=1e-12)
    step = 1e-6  # the error of the weight follows from the derivative of 1 / p
    p = 1 / found.weight
    slope = (1 / (p - step) - 1 / (p + step)) / (2 * step)
    np.testing.assert_allclose(found.weight_error, slope * error, rtol=1e-6)


@pytest.mark.parametrize("p", [0.05, 0.3, 0.9])
def test_standard_errors_cover_the_truth(rng, p):
    """The estimate is within two standard errors in about 95% of all cases."""
    n = 128
    count = rng.binomial(n, p, size=20_000)
    inside = np.abs(count / n - p) < 2 * observed_times(count, n).probability_error
    assert 0.92 < inside.mean() < 0.98
