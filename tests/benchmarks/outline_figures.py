"""Agreement of outlines with shapely and rational numbers, and the time of their kernel.

Run ``python tests/benchmarks/outline_figures.py agreement [pairs]`` (by default, 1,000,000 pairs) to compare the
verdicts; the exit code is 1 if one is wrong. Run ``python tests/benchmarks/outline_figures.py speed`` to compare the
times per pair of the kernels for outlines and for capsules, with the outlines of DESI's arms on DESI's focal plane.
Both kernels process the pairs that remain after the broad phase for outlines. The repeats alternate between them.
"""

import sys
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from itertools import repeat
from pathlib import Path
from time import perf_counter

import astropy.units as u
import numba
import numpy as np
from scipy.spatial import cKDTree

sys.path.insert(0, str(Path(__file__).parents[1] / "helpers"))
from measure import alternated
from outline_pairs import PLACES, SHAPES, count, make_pairs

import rfpsurvey as rs
from rfpsurvey._instruments.outline import make_outline
from rfpsurvey._kernels import collisions
from rfpsurvey._kernels.outlines import outlines_squared

DRAW = 1000
REPEATS = 300

# Envelopes of DESI's arms (mm). The newer and the older drawing share the central polygon, which is not convex.
CENTRAL_X = [0.814, 2.083, 2.613, 4.194, 4.893, -1.902, -2.007, -1.139, -0.170]
CENTRAL_Y = [-3.236, -2.707, -2.665, -2.761, -1.168, -0.935, -2.665, -3.137, -3.332]
CENTRAL = np.column_stack([CENTRAL_X, CENTRAL_Y])
CENTRAL_PARTS = [CENTRAL[[0, 1, 5, 6, 7, 8]], CENTRAL[[1, 2, 5]], CENTRAL[[2, 3, 4, 5]]]
TIP = [[3.967, 0], [3.918, 1.014], [3.269, 1.583]]
UPPER = [[1.712, 1.391], [1.313, 1.959], [0, 2.395], [-1.324, 1.959], [-2.106, 0.848]]
OUTLINES = {
    "7 + 9 vertices": [[*TIP, [-1.172, 1.037], [-1.172, -1.037], [3.269, -1.583], [3.918, -1.014]]],
    "15 + 9 vertices": [
        [*TIP, [1.712, 1.391], [1.712, -1.391], [3.269, -1.583], [3.918, -1.014]],
        [*UPPER, *([x, -y] for x, y in UPPER[::-1])],
    ],
}


def compare(shape, place, seed, n):
    return count(make_pairs(np.random.default_rng([seed, 17]), shape, place, n))


def agreement(n):
    """Print a table of all kinds of pairs, and return the number of wrong verdicts."""
    total = np.zeros(5, dtype=int)
    print(f"{'shape':<10}{'place':<10}{'pairs':>9}{'colliding':>11}{'borderline':>12}{'rationals':>11}{'wrong':>7}")
    with ProcessPoolExecutor() as pool:
        for shape in SHAPES:
            for place in PLACES:
                seeds = range(-(-n // (len(SHAPES) * len(PLACES) * DRAW)))
                found = sum(pool.map(compare, repeat(shape), repeat(place), seeds, repeat(DRAW)))
                total += found
                print(f"{shape:<10}{place:<10}{found[0]:>9}{found[1]:>11}{found[2]:>12}{found[3]:>11}{found[4]:>7}")
                sys.stdout.flush()
    print(f"{'all':<20}{total[0]:>9}{total[1]:>11}{total[2]:>12}{total[3]:>11}{total[4]:>7}")
    return total[4]


@numba.njit
def capsules(segments, first, second, out):
    for k in range(out.size):
        out[k] = collisions.pair_squared(segments, first[k], second[k])


@numba.njit
def outlines(outline, separation, s, first, second, out):
    for k in range(out.size):
        i, j = first[k], second[k]
        out[k] = outlines_squared(
            outline, separation, i, j, s[0, i], s[1, i], s[2, i], s[3, i], s[0, j], s[1, j], s[2, j], s[3, j]
        )


def speed():
    """Print the times per pair, and their ratio."""
    columns = rs.Instrument.preset("desi").focal_plane.arrays
    xy, n, arm = columns.xy, len(columns.xy), columns.central_arm
    rng = np.random.default_rng(0)
    radius, angle = 2 * arm * np.sqrt(rng.random(n)), rng.uniform(0, 2 * np.pi, n)
    phi = 2 * np.arccos(radius / (2 * arm))
    elbows = xy + (arm * [np.cos(angle - phi / 2), np.sin(angle - phi / 2)]).T
    directions = np.column_stack([np.cos(angle + phi / 2), np.sin(angle + phi / 2)])
    neighbors = cKDTree(xy).query_pairs(25.0, output_type="ndarray")
    for name, eccentric in OUTLINES.items():
        shape = rs.positioner.ArmOutline([np.array(p) * u.mm for p in eccentric], [p * u.mm for p in CENTRAL_PARTS])
        outline = make_outline(shape, xy, arm)
        separation, length = 0.2 + outline.offset, shape.length.value
        segments = np.vstack([elbows.T, (elbows + length * directions).T])
        first, second = np.ascontiguousarray(neighbors.T)
        halves = np.empty_like(segments)
        collisions.halve(segments, halves)
        near = np.hypot(*(halves[:2, first] - halves[:2, second])) <= length + separation
        first, second = first[near], second[near]
        m = collisions.keep_near(halves, len(first), separation**2, first, second)
        first, second, out = first[:m], second[:m], np.empty(m)
        calls = (capsules, segments, first, second, out), (outlines, outline, separation, segments, first, second, out)
        times = alternated([partial(*call) for call in calls], REPEATS, perf_counter) / m * 1e9
        colliding = np.mean(out < separation**2)
        low, middle = times.min(axis=0), np.median(times, axis=0)
        ratio = np.median(times[:, 1] / times[:, 0])
        print(f"{name}: {m} pairs, {100 * colliding:.0f}% colliding")
        print(f"  shortest time per pair: {low[0]:.1f} ns (capsules), {low[1]:.1f} ns (outlines)")
        print(
            f"  median time per pair: {middle[0]:.1f} ns (capsules), {middle[1]:.1f} ns (outlines), ratio {ratio:.2f}"
        )


if __name__ == "__main__":
    if sys.argv[1:2] == ["speed"]:
        speed()
    else:
        sys.exit(int(agreement(int((sys.argv[2:] or [1_000_000])[0])) > 0))
