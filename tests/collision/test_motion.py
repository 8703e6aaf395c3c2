import numba
import numpy as np
import pytest
from moving import least_distance

from rfpsurvey._kernels.motion import TOLERANCE, segments_meet

N_BLOCK = 500


@numba.njit
def decide(one, two, separation, out):
    for k in range(len(separation)):
        a, b = one[k], two[k]
        out[k] = segments_meet(a[0], a[1], a[2], a[3], a[4], a[5], b[0], b[1], b[2], b[3], b[4], b[5], separation[k])


def random_arms(rng, n):
    length = rng.uniform(1, 20, n)
    inner = np.where(rng.random(n) < 0.3, length * np.minimum(rng.uniform(0, 2, n), 1), 0.0)
    turn = rng.uniform(0, np.pi, n) * rng.choice([-1, 1], n) * (rng.random(n) < 0.9)
    return np.column_stack([rng.uniform(-20, 20, (n, 2)), rng.uniform(-np.pi, np.pi, n), turn, inner, length])


def random_pairs(rng, n):
    """Return pairs of arms with minimum separations: random, in step, and close to the least distance."""
    one, two = random_arms(rng, n), random_arms(rng, n)
    in_step = rng.random(n) < 0.2  # parallel arms that rotate by the same angle have a constant distance of their ends
    two[in_step, 2:] = one[in_step, 2:]
    two[in_step, 2] += rng.choice([0.0, 0.0, 1e-9, 1e-4], in_step.sum())
    mirrored = ~in_step & (rng.random(n) < 0.1)
    two[mirrored, 2], two[mirrored, 3:] = np.pi - one[mirrored, 2], one[mirrored, 3:] * [-1, 1, 1]
    two[mirrored, 1] = one[mirrored, 1]
    offset = rng.uniform(-400, 400, (n, 2)) * (rng.random(n) < 0.5)[:, None]
    one[:, :2] += offset
    two[:, :2] += offset
    separation = rng.uniform(0, 6, n) * (rng.random(n) < 0.95)
    close = rng.random(n) < 0.5
    for k in np.flatnonzero(close):
        least = least_distance(one[k], two[k], n=200, rounds=2)
        separation[k] = max(least + rng.choice([-1, 1]) * 10.0 ** rng.uniform(-9, -2), 0.0)
    return one, two, separation


@pytest.mark.parametrize("block", [0, *(pytest.param(k, marks=pytest.mark.exhaustive) for k in range(1, 200))])
def test_arms_that_never_meet_keep_the_separation_and_others_miss_it_by_the_tolerance(block):
    rng = np.random.default_rng([7, block])
    one, two, separation = random_pairs(rng, N_BLOCK)
    meets = np.empty(N_BLOCK, dtype=bool)
    decide(one, two, separation, meets)
    assert 0.2 < meets.mean() < 0.8
    for a, b, limit, collides in zip(one, two, separation, meets, strict=True):
        least = least_distance(a, b)
        if collides and least > limit + TOLERANCE:
            least = least_distance(a, b, rounds=4)
        assert least <= limit + TOLERANCE + 1e-9 if collides else least >= limit, (a, b, limit)
