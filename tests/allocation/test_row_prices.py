"""Bounds from prices of sets of which a plan must use a number of candidates, against all plans."""

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
