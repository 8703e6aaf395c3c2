"""The order in which tiles are planned, which consists of rounds of tiles that do not overlap."""

import tracemalloc

import numpy as np

from rfpsurvey.survey._order import ORDERS, make_rounds


def test_rounds_keep_neighbors_apart(rng):
    vectors = rng.normal(size=(300, 3))
    vectors /= np.linalg.norm(vectors, axis=1, keepdims=True)
    passes = rng.integers(0, 3, 300)
    reach = 0.3
    close = np.arccos(np.clip(vectors @ vectors.T, -1, 1)) < reach
    for name in ORDERS:
        rounds = make_rounds(vectors, reach, passes, name)
        assert np.array_equal(np.sort(np.concatenate(rounds)), np.arange(300))
        round_of = np.empty(300, dtype=int)
        for k, tiles in enumerate(rounds):
            round_of[tiles] = k
        i, j = np.nonzero(np.triu(close, 1))
        assert (round_of[i] != round_of[j]).all()
        if name == "given":
            assert (round_of[i] < round_of[j]).all()
        else:
            assert (np.sign(round_of[i] - round_of[j]) == np.sign(passes[i] - passes[j]))[passes[i] != passes[j]].all()


def test_rounds_are_those_of_a_greedy_coloring_and_of_longest_chains(rng):
    vectors = rng.normal(size=(200, 3))
    vectors /= np.linalg.norm(vectors, axis=1, keepdims=True)
    passes = rng.integers(0, 3, 200)
    near = np.arccos(np.clip(vectors @ vectors.T, -1, 1)) < 0.4
    color, level = [], []
    for k in range(200):
        before = [m for m in range(k) if near[k, m]]
        taken = {color[m] for m in before if passes[m] == passes[k]}
        color.append(min(set(range(201)) - taken))
        level.append(max((level[m] for m in before), default=-1) + 1)
    for name, number in (("color", list(zip(passes.tolist(), color, strict=True))), ("given", level)):
        rounds = make_rounds(vectors, 0.4, passes, name)
        groups = {key: [m for m in range(200) if number[m] == key] for key in sorted(set(number))}
        assert [sorted(tiles.tolist()) for tiles in rounds] == list(groups.values())


def test_rounds_of_many_tiles_on_one_another_take_little_memory():
    """Regression: the neighbors of every tile were listed, which took half a gigabyte for 10,000 tiles within 3 deg."""
    rng = np.random.default_rng(0)
    z, angle = 1 - rng.random(5000) * (1 - np.cos(0.03)), 2 * np.pi * rng.random(5000)
    vectors = np.column_stack([np.sqrt(1 - z**2) * np.cos(angle), np.sqrt(1 - z**2) * np.sin(angle), z])
    make_rounds(vectors[:10], 0.06, np.zeros(10, int), "given")
    tracemalloc.start()
    rounds = make_rounds(vectors, 0.06, np.zeros(5000, int), "given")
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert len(rounds) == 5000  # all tiles overlap
    assert peak < 5e6


def test_no_tiles_have_no_rounds():
    assert make_rounds(np.empty((0, 3)), 0.1, np.empty(0, dtype=int), "given") == []
