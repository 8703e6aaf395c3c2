"""The order in which positioners lose their targets, against a slow program, and kinds of candidates."""

import numpy as np
import pytest

from rfpsurvey._assignment.candidates import _distinct
from rfpsurvey._kernels import conflicts, repair


def random_candidates(rng):
    """Return candidates with random conflicts, some of them with idle arms, and a plan in which arms collide."""
    n = int(rng.integers(2, 30))
    size = rng.integers(2, 6, n)
    start, own = np.concatenate([[0], np.cumsum(size)]), np.repeat(np.arange(n), size)
    n_targets, idle = 2 * n, start[1:] - 1
    target, rank = rng.integers(0, n_targets, len(own)), rng.integers(0, 3, len(own))
    target[idle], rank[idle] = -1, 4
    one, other = rng.integers(0, len(own), (2, int(len(own) * rng.uniform(0, 4))))
    is_idle = np.isin(np.arange(len(own)), idle)
    possible = (own[one] != own[other]) & ~(is_idle[one] & is_idle[other])
    possible &= ~(is_idle[one] | is_idle[other]) | (rng.random(len(one)) < rng.choice([0, 0.5]))
    pairs = np.unique(np.sort([one[possible], other[possible]], axis=0), axis=1)
    indptr, excluded = np.empty(len(own) + 1, dtype=np.int64), np.empty(2 * pairs.shape[1], dtype=np.int64)
    conflicts.adjacency(pairs[0].copy(), pairs[1].copy(), indptr, excluded)
    nothing = np.zeros(0, dtype=np.int64)
    alike = np.zeros(len(own), dtype=np.int64), np.ones((1, 1), dtype=bool)
    options = conflicts.Options(
        start, own, target, rank, rng.random(len(own)), *alike, nothing, nothing, indptr, excluded
    )
    plan, used = idle.copy(), set()
    for i in rng.permutation(n).tolist():
        c = int(rng.integers(start[i], start[i + 1]))
        if target[c] not in used:
            plan[i] = c
            used.add(target[c] if target[c] >= 0 else None)
    return options, plan, n_targets


def drop_slowly(options, order, plan):
    """Return the plan and the number of removed targets; all collisions are counted again before each decision."""
    excluded = [{*options.excluded[a:b].tolist()} for a, b in zip(options.indptr, options.indptr[1:], strict=False)]
    plan, stays, dropped = plan.tolist(), set(), 0
    while True:
        count = {i: len(excluded[plan[i]] & {*plan}) for i in order.tolist() if i not in stays}
        if not any(count.values()):
            return plan, dropped
        i = max(count, key=count.get)  # in a tie, the first positioner in the order
        dropped += int(options.target[plan[i]] >= 0)
        others = {*plan} - {plan[i]}
        held = {options.target[c] for c in others} - {-1}
        able = [c for c in range(options.start[i], options.start[i + 1]) if not excluded[c] & others]
        able = [c for c in able if options.target[c] not in held]
        if not able:
            stays.add(i)
        plan[i] = min(able, key=lambda c: (options.rank[c], options.cost[c]), default=int(options.start[i + 1]) - 1)


@pytest.mark.parametrize("seeds", [range(300), pytest.param(range(300, 2000), marks=pytest.mark.exhaustive)])
def test_targets_are_removed_in_the_order_of_collisions(seeds):
    n_dropped = n_idle_collide = 0
    for seed in seeds:
        rng = np.random.default_rng(seed)
        options, plan, n_targets = random_candidates(rng)
        order, fixed = rng.permutation(len(plan)), np.zeros(len(plan), dtype=bool)
        now, blocked = np.full(len(plan), -1), np.zeros(len(options.owner), dtype=np.int64)
        holder = np.full(n_targets, -1)
        repair.put_all(plan, options, now, blocked, holder)
        repair.drop(options, order, fixed, now, blocked, holder)
        expected, dropped = drop_slowly(options, order, plan)
        assert now.tolist() == expected, seed
        n_dropped += dropped
        n_idle_collide += int(fixed.sum())
    assert n_dropped > len(seeds)
    assert n_idle_collide > len(seeds) / 10


@pytest.mark.parametrize("n_flags", [1, 63, 64, 65, 336])
@pytest.mark.parametrize("share", [0.0, 0.002, 0.5])
def test_candidates_of_the_same_kind_have_the_same_key(n_flags, share, rng):
    flags = rng.random((n_flags, 5)) < share
    flags = flags[:, rng.integers(0, 5, 400)]
    first, kind = _distinct(flags)
    expected = np.unique(flags.T, axis=0, return_inverse=True)
    assert len(first) == len(expected[0])
    assert np.array_equal(kind[first], np.arange(len(first)))
    assert np.array_equal(flags[:, first][:, kind], flags)
    assert len(np.unique(np.column_stack([kind, expected[1].reshape(-1)]), axis=0)) == len(first)
