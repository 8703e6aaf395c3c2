"""The order in which positioners lose and receive targets, against slow programs, and kinds of candidates."""

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
        now, blocked, holder = repair.put_all(plan, options, n_targets)
        repair.drop(options, order, fixed, now, blocked, holder)
        expected, dropped = drop_slowly(options, order, plan)
        assert now.tolist() == expected, seed
        n_dropped += dropped
        n_idle_collide += int(fixed.sum())
    assert n_dropped > len(seeds)
    assert n_idle_collide > len(seeds) / 10


def fill_slowly(options, order, need, group, held, most, plan):
    """Return the plan after candidates of a group were assigned; all counts are made again before each decision."""
    excluded = [{*options.excluded[a:b].tolist()} for a, b in zip(options.indptr, options.indptr[1:], strict=False)]
    plan = plan.copy()
    for i in order.tolist():
        for c in range(options.start[i], options.start[i + 1]) if need > 0 else ():
            after = np.append(np.delete(plan, i), c)
            if options.target[c] in {*options.target[plan].tolist()} - {-1} or excluded[c] & {*plan.tolist()}:
                continue
            counts, before = held[:, after].sum(axis=1), held[:, plan].sum(axis=1)
            if held[group, c] and not ((counts > most) & (counts > before)).any():
                plan[i], need = c, need - 1
                break
    return plan


def test_candidates_of_a_group_are_assigned_without_collisions_and_within_all_maxima():
    n_filled, first_target_in_use = 0, 0
    for seed in range(200):
        rng = np.random.default_rng(seed)
        options, plan, n_targets = random_candidates(rng)
        held = rng.random((3, len(options.owner))) < 0.5
        held[:, options.target < 0] = False
        count = held[:, plan].sum(axis=1)
        most, need = count + rng.integers(0, 4, 3), int(rng.integers(1, 4))
        order = rng.permutation(np.flatnonzero(~held[0, plan]))
        now, blocked, holder = repair.put_all(plan, options, n_targets)
        repair.fill_group(order, need, 0, held, count, most, options, now, blocked, holder)
        expected = fill_slowly(options, order, need, 0, held, most, plan)
        assert now.tolist() == expected.tolist(), seed
        np.testing.assert_array_equal(count, held[:, now].sum(axis=1))
        n_filled += int((now != plan).sum())
        first_target_in_use += int((options.target[plan] == 0).any())
    assert n_filled > 100
    assert first_target_in_use > 20


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
