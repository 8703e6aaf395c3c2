"""Augmenting paths: networks without collisions have a maximum flow, and plans with collisions remain valid."""

import numpy as np
import pytest
from scipy.sparse import csr_array

from rfpsurvey._assignment.weighted import TileCandidates, TileRules, no_rules
from rfpsurvey._survey.joint.fixed import JointOptions
from rfpsurvey._survey.joint.network import Patches, Paths, make_network
from rfpsurvey._survey.joint.search import Search


def random_network(rng, collisions):
    """Return a network of several tiles whose targets require one visit each, and the candidates of idle arms."""
    n_targets, n_classes = int(rng.integers(4, 60)), int(rng.integers(1, 4))
    tiles, slots = [], []
    for _ in range(int(rng.integers(1, 5))):
        n = int(rng.integers(2, 15))
        slot = np.sort(rng.permutation(n_targets)[: rng.integers(3, n_targets + 1)])
        size = rng.integers(0, min(4, len(slot)) + 1, n)
        parts = [np.append(rng.permutation(len(slot))[:k], -1) for k in size]
        target, start = np.concatenate(parts), np.concatenate([[0], np.cumsum(size + 1)])
        cliques = [np.flatnonzero(target == t) for t in range(len(slot)) if (target == t).sum() > 1]
        own = np.repeat(np.arange(n), size + 1)
        for _ in range(collisions):
            a, b = np.sort(rng.integers(0, len(target), 2))
            if own[a] != own[b] and target[a] >= 0 and target[b] >= 0:
                cliques.append(np.array([a, b]))
        indptr = np.concatenate([[0], np.cumsum([len(one) for one in cliques])]).astype(np.int64)
        column = np.concatenate([np.empty(0, np.int32), *cliques]).astype(np.int32)
        real = np.flatnonzero(target >= 0)
        pairs = own[real].astype(np.int32), target[real].astype(np.int32)
        side = np.ones(len(target), np.int8)
        tiles.append(
            TileCandidates(start, target, side, indptr, column, np.zeros(n, bool), pairs, no_rules(len(target)))
        )
        slots.append(slot)
    visits = np.ones(n_targets, np.int64)
    network = make_network(tiles, slots, visits, rng.integers(0, n_classes, n_targets), n_classes)
    return network, network.start[1:] - 1


def is_valid(network, chosen):
    """Return whether a plan has no collisions, and no target with more visits than requested or two per tile."""
    x = np.zeros(len(network.target))
    x[chosen] = 1.0
    real = np.flatnonzero(network.target[chosen] >= 0)
    target = network.target[chosen[real]]
    number = np.bincount(target, minlength=len(network.slot))
    pairs = list(zip(np.searchsorted(network.first, real, side="right"), target, strict=True))
    inside = (chosen >= network.start[:-1]) & (chosen < network.start[1:])
    sets = network.matrix @ x <= network.most + 0.5
    return bool(inside.all() and sets.all() and len(set(pairs)) == len(pairs) and (number <= network.visits).all())


def follow(network, chosen, seed=0):
    return Paths(network).improve(chosen, np.random.default_rng(seed), lambda: False, network.rule_most)


@pytest.mark.parametrize("seed", range(60))
def test_without_collisions_the_visits_of_each_class_are_those_of_a_maximum_flow(seed):
    network, idle = random_network(np.random.default_rng(seed), collisions=0)
    found = follow(network, idle)
    assert is_valid(network, found)
    counts = np.cumsum(network.counts(found)[:-1])
    assert counts.tolist() == [network.matching(level, 10**6) for level in range(network.n_classes)]


@pytest.mark.parametrize("seed", range(60))
def test_plans_with_collisions_remain_valid_and_do_not_become_worse(seed):
    network, chosen = random_network(np.random.default_rng(seed), collisions=30)
    gained = 0
    for repeat in range(3):
        before = tuple(network.counts(chosen))
        chosen = follow(network, chosen, repeat)
        assert is_valid(network, chosen)
        assert tuple(network.counts(chosen)) >= before
        gained += network.counts(chosen)[:-1].sum()
    assert gained > 0
    # no single positioner can add a visit, or replace one by a visit to a better class
    used = np.bincount(chosen, minlength=len(network.target))
    left = network.visits - np.bincount(
        network.target[chosen][network.target[chosen] >= 0], minlength=len(network.slot)
    )
    for c in np.flatnonzero((network.target >= 0) & (used == 0)):
        old = chosen[network.positioner[c]]
        if left[network.target[c]] > 0 and network.rank[c] < network.rank[old]:
            new = chosen.copy()
            new[network.positioner[c]] = c
            assert not is_valid(network, new)


def test_no_path_is_followed_after_the_time_is_over():
    network, idle = random_network(np.random.default_rng(1), collisions=5)
    found = Paths(network).improve(idle, np.random.default_rng(0), lambda: True, network.rule_most)
    assert (found == idle).all()


def test_patches_of_a_tile_that_are_solved_at_the_same_time_keep_its_rules():
    """Each of two positioners may leave its sky position, but the tile requires one of the two."""
    target, start = np.array([0, 2, -1, 1, 3, -1]), np.array([0, 3, 6])
    sky = csr_array(np.where(target >= 2, -1.0, 0.0)[None])
    rules = TileRules(sky, np.array([-1.0]), np.array([True]), np.ones(6, bool))
    pairs = np.array([0, 0, 1, 1]), np.array([0, 2, 1, 3])
    none = np.zeros(1, np.int64), np.empty(0, np.int32)
    tile = TileCandidates(start, target, np.ones(6, np.int8), *none, np.zeros(2, bool), pairs, rules)
    network = make_network([tile], [np.arange(4)], np.ones(4, np.int64), np.array([0, 0, 1, 1]), 1)
    search = Search(network, np.array([1, 4]), np.eye(3)[:2], JointOptions(), 0)
    search._replan(Patches(network, np.array([0, 1])), None, np.zeros(6), lambda _: True)
    assert (search.visits.tolist(), network.counts(search.chosen).tolist()) == ([1], [1, 1])
    search._follow_paths()
    assert search.visits.tolist() == [1]
