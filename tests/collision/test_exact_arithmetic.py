"""The test of pairs, compared with exact rational arithmetic for random and adversarial pairs."""

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from adversarial import ADVERSARIAL, random_pairs
from oracles import closer_than, squared_distance
from pair_test import decide
from rfpsurvey._instruments.collision_methods import closer_exactly
from rfpsurvey._kernels import batch as reference
from rfpsurvey._kernels import collisions
from strategies import segments


def longest_difference(first, second):
    ends = np.array([first[:2], first[2:], second[:2], second[2:]])
    return float(np.hypot(*(ends[:, None] - ends[None]).transpose(2, 0, 1)).max())


def assert_within_the_bound(first, second):
    """Check that the computed distance differs from the true distance (in rational arithmetic) by at most 20 u S."""
    # convert to float, since numba would compile separate code for integers
    ends = np.array([*first, *second], dtype=float)
    got = Fraction(float(np.sqrt(collisions.segments_squared(*ends))))
    bound = Fraction(collisions.DISTANCE_ERROR) * Fraction(longest_difference(first, second) * (1 + 1e-15))
    assert max(got - bound, 0) ** 2 <= squared_distance(first, second) <= (got + bound) ** 2


def test_random_pairs_are_decided_as_by_rationals():
    answers = [(decide(*p), closer_than(*p)) for p in random_pairs(np.random.default_rng(1), 3000)]
    assert all(got == expected for got, expected in answers)
    assert np.mean([expected for _, expected in answers]) > 0.1


@pytest.mark.few(2)
@pytest.mark.parametrize("name", ADVERSARIAL)
def test_adversarial_pairs_are_decided_as_by_rationals_or_borderline(name):
    rng, n, n_borderline = np.random.default_rng(2), 500, 0
    for _ in range(n):
        first, second, limit = ADVERSARIAL[name](rng)
        got = decide(first, second, limit)
        assert decide(second, first, limit) == got
        expected = closer_than(first, second, limit)
        assert closer_exactly(first, second, limit) == expected
        n_borderline += got is None
        assert got in (None, expected)
        assert_within_the_bound(first, second)
    # some pairs are difficult, and the test decides some of them
    assert 0.016 * n < n_borderline < 0.96 * n


@given(segments(2), st.sampled_from([1.25, 2.5, 4.5]))
def test_any_pair_is_decided_as_by_rationals(pair, limit):
    assert decide(*pair.tolist(), limit) in (None, closer_than(*pair, limit))
    assert_within_the_bound(*pair.tolist())


def test_almost_collinear_segments_do_not_cross():
    """The signs of all orientations of collinear segments are rounding errors, by which some pairs would cross."""
    n, rng = 60_000, np.random.default_rng(4)
    angle, along = rng.uniform(0, 2 * np.pi, n), np.cumsum(rng.uniform(1, 10, (4, n)), axis=0)
    x, y = (
        start + along * u for start, u in zip(rng.uniform(-1, 1, (2, n)), (np.cos(angle), np.sin(angle)), strict=True)
    )

    def turn(a, b, p):
        return (x[b] - x[a]) * (y[p] - y[a]) - (y[b] - y[a]) * (x[p] - x[a])

    assert ((turn(0, 1, 2) * turn(0, 1, 3) < 0) & (turn(2, 3, 0) * turn(2, 3, 1) < 0)).any()
    segments, squared = np.hstack([[x[0], y[0], x[1], y[1]], [x[2], y[2], x[3], y[3]]]), np.empty(n)
    reference.all_pairs(segments, np.arange(n), np.arange(n, 2 * n), squared)
    np.testing.assert_allclose(np.sqrt(squared), along[2] - along[1], rtol=1e-12)


def test_the_largest_error_that_was_found():
    """The segments barely cross. Their true distance is 0, and the orientation of one end is uncertain."""
    first = (0.18889802440087516, 0.8021520411840636, 0.6890731994393491, 0.29378029915802245)
    second = (0.6876219460278843, 0.29525533482897737, 0.15479771473589315, 0.39529346736581467)
    assert squared_distance(first, second) == 0
    got = np.sqrt(collisions.segments_squared(*first, *second))
    assert 6 < got / (collisions.UNIT * longest_difference(first, second)) < 20


def test_segments_too_short_to_square_are_not_lost():
    assert decide((0, 0, 2e-162, 0), (0, 4.25, 0, 5), 4.5) is True
    assert decide((0, 4.25, 0, 5), (0, 0, 2e-162, 0), 4.5) is True


WITHOUT_SEPARATION = [
    ((0.5, -1, 0.5, 1), True),
    ((0, -1, 0, 1), True),
    ((1, 0, 2, 0), True),
    ((0.25, 0, 0.75, 0), True),
    ((0.5, 0, 0.5, 0), True),
    ((0.5, 5e-324, 0.5, 1), False),
    ((1 + 2**-52, 0, 2, 0), False),
    ((0, 1, 1, 1), False),
]


@pytest.mark.parametrize(("second", "expected"), WITHOUT_SEPARATION)
def test_without_a_separation_segments_that_touch_or_cross_collide(second, expected):
    """Regression: no segments were closer than 0, not even those that cross."""
    assert closer_exactly((0, 0, 1, 0), second, 0.0) is expected
    assert closer_exactly(second, (1, 0, 0, 0), 0.0) is expected


@pytest.mark.parametrize("part", [0.0, 0.03, 0.5, 1.0])
def test_runs_of_neighbors_are_searched_without_omissions(rng, part):
    """The search skips groups of eight pairs that are far apart; runs have all lengths from 1 to 40."""
    for n in range(1, 41):
        far = rng.random(n) >= part
        x = np.concatenate([rng.random(n), rng.random(n) + 100.0 * far])
        arms = np.array([x, np.zeros(2 * n), x, np.ones(2 * n)])
        halves, runs = np.empty_like(arms), np.array([[0, n, n]])
        collisions.halve(arms, halves)
        first, second, squared = np.full(n + 1, -7), np.full(n + 1, -7), np.empty(n)
        limits = collisions.limits(5.0, 1.0, 200.0)
        m = collisions.near_pairs(halves, runs, limits, first[:n], second[:n])
        np.testing.assert_array_equal(first[:m], np.flatnonzero(~far))
        np.testing.assert_array_equal(second[:m], np.flatnonzero(~far) + n)
        assert collisions.colliding_pairs(arms, halves, runs, limits, first[:n], second[:n], squared)[0] == m
        assert first[n] == second[n] == -7
