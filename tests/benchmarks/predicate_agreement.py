"""Compare the test of pairs with exact rational arithmetic, for more pairs than in the tests.

Run ``python tests/benchmarks/predicate_agreement.py [random pairs] [adversarial pairs]``; the defaults are 1,000,000
and 100,000. The exit code is 1 if a decision is wrong for a pair that the test did not mark as borderline.
"""

import sys
from concurrent.futures import ProcessPoolExecutor
from itertools import repeat
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "helpers"))
from adversarial import ADVERSARIAL, random_pairs
from oracles import closer_than
from pair_test import decide

TASK = 5000


def compare(name, seed, n):
    """Return the numbers of collisions, borderline pairs and wrong decisions among n pairs of a family."""
    rng = np.random.default_rng([seed, 11])
    pairs = random_pairs(rng, n) if name == "random" else (ADVERSARIAL[name](rng) for _ in range(n))
    counts = np.zeros(3, dtype=int)
    for first, second, limit in pairs:
        got, expected = decide(first, second, limit), closer_than(first, second, limit)
        counts += expected, got is None, got is not None and got != expected
    return counts


if __name__ == "__main__":
    n_random, n_adversarial = (*map(int, sys.argv[1:]), *(1_000_000, 100_000)[len(sys.argv) - 1 :])
    sizes = {"random": n_random, **dict.fromkeys(ADVERSARIAL, n_adversarial // len(ADVERSARIAL))}
    n_wrong = 0
    print(f"{'family':<18}{'pairs':>10}{'colliding':>11}{'borderline':>12}{'wrong':>7}")
    with ProcessPoolExecutor() as pool:
        for name, n in sizes.items():
            tasks = [min(TASK, n - k) for k in range(0, n, TASK)]
            colliding, borderline, wrong = sum(pool.map(compare, repeat(name), range(len(tasks)), tasks))
            print(f"{name:<18}{n:>10}{colliding:>11}{borderline:>12}{wrong:>7}", flush=True)
            n_wrong += wrong
    sys.exit(1 if n_wrong else 0)
