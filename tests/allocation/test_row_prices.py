"""Bounds from prices of sets of which a plan must use a number of candidates, against all plans."""

from fractions import Fraction
from itertools import pairwise, product

import numpy as np
import pytest
from scipy.sparse import csr_array

from rfpsurvey._assignment.weighted import RowPrices

SWEEPS = ((0.2, 20), (0.05, 30), (0.01, 30))


@pytest.mark.parametrize("seed", range(40))
def test_no_plan_that_uses_enough_candidates_of_a_set_exceeds_the_bound(seed):
    rng = np.random.default_rng(seed)
    size = rng.integers(1, 4, 6)
    start = np.concatenate([[0], np.cumsum(size)])
    plans = np.array(list(product(*(range(a, b) for a, b in pairwise(start)))))
    x = np.zeros((len(plans), start[-1]))
    np.put_along_axis(x, plans, 1.0, axis=1)
    sets, least = rng.random((3, start[-1])) < 0.4, rng.random((2, start[-1])) < 0.5
    most = np.append(np.ones(3), rng.integers(1, 4, 2)).astype(float)
    weights = (rng.random(start[-1]) < 0.6).astype(float)
    fits = (x @ sets.T <= most[:3]).all(axis=1) & (x @ least.T >= most[3:]).all(axis=1)
    matrix = csr_array(np.concatenate([sets, least]).astype(float))
    for n_least, allowed in ((2, fits), (0, (x @ matrix.T <= most).all(axis=1))):
        prices = RowPrices(start, matrix, most, np.zeros(6, dtype=bool), n_least)
        bound = prices.improve(weights, SWEEPS, lambda: False)
        assert bound >= (x[allowed] @ weights).max(initial=-np.inf)
        assert (prices.price >= prices.lowest).all()
        assert (prices.price <= prices.highest).all()
    # a candidate that was omitted counts, and belongs to the sets of which a plan must use a number
    is_free = np.arange(6) == 0
    bound = RowPrices(start, matrix, most, is_free, 2).improve(weights, SWEEPS, lambda: False)
    sets, least, weights = (
        np.append(one, rest, axis=-1)
        for one, rest in (
            (sets[:, size[0] :], np.zeros((3, 1))),
            (least[:, size[0] :], np.ones((2, 1))),
            (weights[size[0] :], [1.0]),
        )
    )
    y = np.append(x[:, size[0] :], np.ones((len(x), 1)), axis=1)
    fits = (y @ sets.T <= most[:3]).all(axis=1) & (y @ least.T >= most[3:]).all(axis=1)
    assert bound >= (y[fits] @ weights).max(initial=-np.inf)


def test_the_price_of_a_minimum_lowers_the_bound():
    start, matrix = np.array([0, 2, 4, 6]), csr_array(np.tile([0.0, 1.0], 3)[None])
    weights, limits = np.tile([1.0, 0.0], 3), np.array([2.0])
    for n_least, expected in ((0, 3), (1, 1)):
        prices = RowPrices(start, matrix, limits, np.zeros(3, dtype=bool), n_least)
        assert prices.improve(weights, SWEEPS, lambda: False) == pytest.approx(expected, abs=0.01)


def test_rounding_errors_do_not_lower_the_bound():
    """The bound for given prices is compared with the same sum in rational arithmetic."""
    rng, n, size = np.random.default_rng(1), 50, 3
    start, free = np.arange(0, n * size + 1, size), np.zeros(n, dtype=bool)
    n_rounded = 0
    for _ in range(20):
        matrix, most = csr_array((rng.random((8, n * size)) < 0.4).astype(float)), rng.integers(1, 40, 8).astype(float)
        prices, weights = RowPrices(start, matrix, most, free, 0), rng.random(n * size)
        prices.price[:] = rng.uniform(0, 1e6, 8)
        exact = [Fraction(price) for price in prices.price.tolist()]
        priced = [
            Fraction(weight) - sum(price for price, is_in in zip(exact, column, strict=True) if is_in)
            for weight, column in zip(weights.tolist(), matrix.toarray().T.tolist(), strict=True)
        ]
        expected = sum(price * int(limit) for price, limit in zip(exact, most.tolist(), strict=True))
        expected += sum(max(priced[a:b]) for a, b in pairwise(start.tolist()))
        assert expected <= Fraction(prices.bound(weights)) < expected * (1 + Fraction(1, 10**6))
        total = float(prices.price @ most) + np.maximum.reduceat(np.array(list(map(float, priced))), start[:-1]).sum()
        n_rounded += Fraction(float(total)) < expected
    assert n_rounded > 0
