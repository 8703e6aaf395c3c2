"""Compare the test of pairs with exact rational arithmetic, for more pairs than in the tests.

Run ``python tests/benchmarks/predicate_agreement.py [random pairs] [adversarial pairs]``; the defaults are 1,000,000
and 100,000. The exit code is 1 if a decision is wrong for a pair that the test did not mark as borderline.

Error bound of the pair test
----------------------------

Let u = 2^-53 (the largest relative rounding error in double precision), and let S be the longest of the six distances
between the four ends of a pair of segments. If the broad phase does not reject the pair, S is at most 2 L + D for arms
of length L.

**Claim.** The computed distance differs by at most 20 u S from the exact distance between the segments with the stored
coordinates.

*Differences* of coordinates have a relative error of at most u, even if all coordinates have an offset of 10^6 mm. *A
point p and the segment a-b*: let v = p - a and w = b - a. Rounding the vectors v and w is equivalent to moving the
points p and b by u |v| and u |w|, which changes the distance by at most 2 u S. For the moved points, the parameter
along the segment, t = v·w / w·w, has an error of at most 5 u |v| / |w|, and clamping it to [0, 1] does not increase the
error. The error of t contributes 5 u S. The product t w and its subtraction from v contribute u S each; the squares,
their sum and the root contribute 2 u S. The total error of the distance is at most 11 u S. *The distance between two
segments* that do not cross is the smallest of the four distances between an end of one segment and the other segment.
The error of the smallest distance is at most the largest error of the four distances.

*Crossing segments* have the distance 0. An orientation (the side of a line on which a point lies) has a certain sign if
it exceeds 4 u times the sum of the magnitudes of its two products [Shewchuk]. A crossing is reported only if all four
orientations are certain, so every reported crossing exists. Suppose that the segments a-b and c-d cross at X and that
the orientation of an end c is not certain. The end c then lies within 8 u S of the line a-b. If the foot of the
perpendicular from c lies on the segment a-b, the distance of c from this segment is at most 8 u S. Otherwise the foot
lies beyond one end of the segment, for example b. The lines intersect at X, and X-b is shorter than X-c; the end b is
therefore closer to the line c-d than c is to the line a-b. The foot of the perpendicular from b lies between X and c,
hence on the segment c-d, and the distance of b from this segment is at most 8 u S. In both cases, the reported
distance, which is the smallest of the four computed distances, is at most 8 u S + 11 u S instead of 0. The proof
assumes that no intermediate result underflows, that is, that all lengths are 0 or greater than 10^-140 mm.

**Consequence.** If the squared distance differs from D^2 by more than 2 E (D + E), where E = 24 u S, the pair is
classified correctly. All other pairs are *borderline*. ``report.n_borderline`` is the number of borderline pairs. In
``find_collisions``, the methods exact and ``cuda`` use integer arithmetic to decide whether these pairs collide. The
borderline range of distances is about 10^-13 mm wide. Random configurations practically never have borderline pairs,
but configurations whose positions lie on a regular grid can have borderline pairs.

*The broad phase* rejects a pair if the midpoints of its arms are too far apart for a collision, or if the arms are
separated along one of three axes (the line between the midpoints and the normals of both arms). To allow for rounding,
the broad phase keeps all pairs that are within 64 u (S + the largest coordinate) of these limits.

In a search over pairs that are difficult to classify, the largest error of a computed distance was 6.5 u S, for
segments that barely cross.

[Shewchuk] J. R. Shewchuk, "Adaptive Precision Floating-Point Arithmetic and Fast Robust Geometric Predicates", Discrete
& Computational Geometry 18, 305 (1997).
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
