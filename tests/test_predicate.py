"""The pair test against exact rational arithmetic, random and adversarial pairs."""

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from adversarial import ADVERSARIAL, random_pairs
from oracles import closer_than, squared_distance
from rfpsurvey._kernels import collisions
from rfpsurvey.collision._exactly import closer_exactly
from strategies import segments

RUN = np.array([[0, 1, 1]])


def decide(first, second, limit):
    """True, False, or None where the pair is in the band."""
    pair = np.array([first, second]).T.copy()
    halves, squared = np.empty((4, 2)), np.empty(2)
    collisions.halve(pair, halves)
    longest = float(np.hypot(pair[2] - pair[0], pair[3] - pair[1]).max())
    limits = collisions.limits(limit, longest * (1 + 1e-15), float(np.hypot(*np.abs(pair).reshape(2, -1).max(axis=1))))
    rows = np.empty(1, bool), np.empty(2, np.int64), np.empty(2, np.int64)
    n, borderline = collisions.colliding_pairs(pair, halves, RUN, limits, *rows, squared)
    return None if borderline else bool(n)


def longest_difference(first, second):
    ends = np.array([first[:2], first[2:], second[:2], second[2:]])
    return float(np.hypot(*(ends[:, None] - ends[None]).transpose(2, 0, 1)).max())


def assert_within_the_bound(first, second):
    """The computed distance is within 20 u S of the true one, in rational arithmetic."""
    got = Fraction(float(np.sqrt(collisions.segments_squared(*first, *second))))
    bound = Fraction(collisions.DISTANCE_ERROR) * Fraction(longest_difference(first, second) * (1 + 1e-15))
    true2 = squared_distance(first, second)
    assert max(got - bound, 0) ** 2 <= true2 <= (got + bound) ** 2


def test_random_pairs_are_decided_as_by_rationals():
    rng = np.random.default_rng(1)
    answers = [(decide(*p), closer_than(*p)) for p in random_pairs(rng, 10_000)]
    assert all(got == expected for got, expected in answers)
    assert np.mean([expected for _, expected in answers]) > 0.1


@pytest.mark.parametrize("name", ADVERSARIAL)
def test_adversarial_pairs_are_decided_as_by_rationals_or_borderline(name):
    rng = np.random.default_rng(2)
    n_borderline = 0
    for _ in range(1250):
        first, second, limit = ADVERSARIAL[name](rng)
        got = decide(first, second, limit)
        assert decide(second, first, limit) == got
        expected = closer_than(first, second, limit)
        assert closer_exactly(first, second, limit) == expected
        n_borderline += got is None
        assert got in (None, expected)
        assert_within_the_bound(first, second)
    # nasty enough to matter, and not all given up
    assert 20 < n_borderline < 1200


@given(segments(2), st.sampled_from([1.25, 2.5, 4.5]))
def test_any_pair_is_decided_as_by_rationals(pair, limit):
    got = decide(*pair.tolist(), limit)
    assert got in (None, closer_than(*pair, limit))
    assert_within_the_bound(*pair.tolist())


def test_the_error_bound_is_not_idle():
    """Errors of pairs that are easy to find are a twentieth of the proven bound or more."""
    rng = np.random.default_rng(3)
    worst = 0.0
    for _ in range(4000):
        first, second, _ = ADVERSARIAL["tee"](rng)
        got = Fraction(float(np.sqrt(collisions.segments_squared(*first, *second))))
        true2 = squared_distance(first, second)
        # d - d_true = (d^2 - d_true^2) / (d + d_true)
        error = float(abs(got**2 - true2)) / (2 * float(got))
        worst = max(worst, error / (collisions.UNIT * longest_difference(first, second)))
    assert 0.8 < worst < 20


def test_almost_collinear_segments_do_not_cross():
    """The signs of all four turns are rounding: segments 4 mm apart on one line must not count as crossing."""
    rng = np.random.default_rng(4)
    for _ in range(3000):
        u = np.array([np.cos(a := rng.uniform(0, 6.3)), np.sin(a)])
        base = rng.uniform(-300, 300, 2)
        ends = [base + t * u for t in (0, 8, 12, 20)]
        squared = collisions.segments_squared(*ends[0], *ends[1], *ends[2], *ends[3])
        assert squared == pytest.approx(16, rel=1e-9)


def test_a_limit_of_nothing_is_never_met():
    assert not closer_exactly((0, 0, 1, 0), (0, -1, 0, 1), 0.0)
