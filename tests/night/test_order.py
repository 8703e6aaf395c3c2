"""Orders of tiles, compared with all orders of a few tiles."""

from functools import cache

import numpy as np
import pytest

from rfpsurvey._survey.night.order import METHODS, NightProblem, exact, greedy, postponed


def random_problem(seed, n_tiles=8, n_slots=8):
    """Return tiles with windows of different lengths; some exposures depend on the slot."""
    rng = np.random.default_rng([seed, 3])
    length = np.zeros((n_tiles, n_slots), dtype=np.int32)
    for tile in range(n_tiles):
        for _ in range(rng.integers(0, 3)):
            low, high = np.sort(rng.integers(0, n_slots + 1, 2))
            length[tile, low:high] = np.clip(rng.integers(1, 4) + rng.integers(-1, 2, high - low), 1, 4)
    merit = rng.integers(1, 5, n_tiles).astype(float) if seed % 2 else rng.uniform(0.5, 4, n_tiles)
    return NightProblem(length, merit, rng.uniform(0, 1, n_tiles))


def best_of_all(problem):
    n_tiles, n_slots = problem.length.shape

    @cache
    def best(slot, used):
        if slot >= n_slots:
            return 0.0
        values = [best(slot + 1, used)]
        for tile in range(n_tiles):
            if problem.length[tile, slot] and not used >> tile & 1:
                values.append(problem.merit[tile] + best(slot + int(problem.length[tile, slot]), used | 1 << tile))
        return max(values)

    return best(0, 0)


def check(problem, order):
    """Return the merit of an order, after a check that each tile can be observed, and that no two overlap."""
    length = problem.length[order.tile, order.slot]
    assert (length > 0).all()
    assert len(set(order.tile.tolist())) == len(order.tile)
    assert (order.slot[:-1] + length[:-1] <= order.slot[1:]).all()
    return problem.merit[order.tile].sum()


@pytest.mark.few(40)
@pytest.mark.parametrize("seed", range(400))
def test_orders_are_compared_with_all_orders(seed):
    problem = random_problem(seed)
    best = best_of_all(problem)
    for name, method in METHODS.items():
        order = method.function(problem, 60.0)
        value = check(problem, order)
        assert value <= best + 1e-9, name
        later = postponed(problem, order)
        assert check(problem, later) == value
        times = [problem.length[one.tile, one.slot] for one in (order, later)]
        assert (times[1] <= times[0]).all()
        assert order.bound >= best - 1e-9, name
        assert not order.is_optimum or value == pytest.approx(best, rel=1e-5), name
    assert exact(problem).is_optimum


def test_larger_nights_are_proven_and_better_than_greedy():
    problems = [random_problem(seed, 60, 80) for seed in range(6)]
    found = [(check(p, greedy(p)), check(p, exact(p, 30.0)), exact(p, 30.0).is_optimum) for p in problems]
    assert all(first <= second for first, second, _ in found)
    assert any(first < second for first, second, _ in found)
    assert all(is_optimum for *_, is_optimum in found)


def test_without_time_the_order_of_greedy_is_kept():
    problem = random_problem(4, 60, 80)
    order = exact(problem, 0.0)
    assert check(problem, order) >= check(problem, greedy(problem))
    assert order.bound >= exact(problem, 30.0).bound - 1e-6


def test_nights_without_tiles_and_slots():
    for shape in ((0, 5), (3, 0), (3, 5)):
        problem = NightProblem(np.zeros(shape, dtype=np.int32), np.ones(shape[0]), np.zeros(shape[0]))
        for method in METHODS.values():
            order = method.function(problem, 1.0)
            assert (len(order.tile), order.bound, order.is_optimum) == (0, 0.0, True)
