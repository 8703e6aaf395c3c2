"""Agreement of outlines with shapely and rational numbers, and the time of their kernel.

Run ``python tests/benchmarks/outline_figures.py agreement [pairs]`` (by default, 1,000,000 pairs) to compare the
verdicts; the exit code is 1 if one is wrong. Run ``python tests/benchmarks/outline_figures.py speed`` to compare the
times per pair of the kernels for outlines and for capsules, with the outlines of DESI's arms on DESI's focal plane.
Both kernels process the pairs that remain after the broad phase for outlines. The repeats alternate between them.

Error bound of the gap of outlines
----------------------------------

An outline consists of convex polygons with radii (`rfpsurvey.positioner.ArmOutline`). The *gap* of two polygons is
their distance or, if they overlap, minus the length of the shortest displacement that separates them. Two positioners
collide if the gap between a polygon of the eccentric arm of one positioner and any polygon of the other positioner is
less than the sum of the minimum separation D and the radii of both polygons or, if D is 0, equal to this sum (they
touch). The *kernel*, a compiled function, tests each pair of positioners in the following order:

1. A rectangle contains all polygons of an arm, including the points within their radii. If the rectangles of two arms
   are separated by more than D, the arms do not collide.
2. A circle contains a polygon and all points within its radius. If the circles of two polygons are separated by more
   than D, the polygons do not collide.
3. If two polygons are separated along the normal of an edge by more than the sum of D and both radii, the polygons do
   not collide. If two polygons are not separated along the normal of any edge, they overlap.
4. The distance of two polygons that do not overlap is the least distance between a vertex of one polygon and an edge of
   the other polygon.

If the gap of a pair of polygons differs from the sum of D and both radii by less than the error bound of the kernel,
rational arithmetic decides whether the pair collides.

**Definitions.** Let u = 2^-53, and let S be the largest distance between any two of the vertices, elbows and centers of
a pair of positioners. The frame of an arm has its origin at the elbow (eccentric arm) or at the center of the
positioner (central arm). The computed direction (c, s) of the x axis of a frame has a length between 1 - 4 u and 1 + 4
u. The *exact polygons* have the vertices (c x - s y, s x + c y) relative to the origin, where (x, y) are the
coordinates of a vertex in the frame of its arm. The *placed polygons* have the same vertices after rounding to double
precision; the kernel decides whether the convex hulls of the placed polygons collide. The *core* of an arm is a segment
from the elbow along the eccentric arm. Let r be the ``offset`` of the outline, which is the largest possible difference
between the distance of the cores of two arms and the gap of their outlines. Let Z be the sum of three numbers: the sum
of the distances along x and along y between the origins of two frames; twice the largest distance of a vertex from the
origin of its frame; and r. Z is at most 3.42 S + r.

**Claim.** A computed gap differs from the gap of the placed polygons by at most 1280 u (S + r), or both gaps are
negative. The bound of 1280 u (S + r) does not depend on the position in the focal plane.

*Continuity.* The gap is the largest separation of two polygons along any direction. If the points of one polygon move
by at most e, and the points of the other polygon by at most f, the gap therefore changes by at most e + f. The
separation along a given normal, and the least distance between vertices and edges, also change by at most e + f.

*Placed polygons.* Rounding moves each vertex by at most 2.42 u times its distance from the origin. The gaps of the
exact and of the placed polygons differ by at most 2.5 u Z.

*Relative frames.* The kernel converts the vertices of one polygon to the frame of the other polygon. The lengths of the
two directions, which are not exactly 1, contribute an error of 8 u Z. The rounding of the position of the origin
contributes 3.5 u Z, and the rounding of the rotation contributes 2.9 u Z. The position of the first frame in the second
frame is computed from the relative origin and rotation. The length of the direction of this rotation is between 1 - 11
u and 1 + 11 u, which contributes 22 u Z, and rounding contributes 2.5 u Z. The sum of all contributions for two frames
is less than 39 u Z.

*Separation along a normal.* The computed unit normal of an edge has an error of 4 u, and the products and sums
contribute 9 u Z. The separation of the exact polygons along the normal differs from the computed separation by at most
52 u Z.

*Distance between a vertex and an edge.* In addition to the relative frames, four quantities contribute to the error of
the distance: the position of the vertex (4.5 u Z), the components of this position along and across the edge (8.6 u Z),
the length of the edge (4 u Z), and the squares, the square root and the radii (4 u Z in total). The least distance of
the exact polygons differs from the computed least distance by at most 61 u Z.

*Both cases.* Let e = 64 u Z. If all computed separations along the normals of the edges are less than -e, the exact
polygons overlap by more than 12 u Z, and the placed polygons overlap too: both gaps are negative. Otherwise, the kernel
uses the distance d between a vertex and an edge. If the exact polygons do not overlap, their gap is the least such
distance, and the computed d differs from the gap of the placed polygons by at most 61 u Z + 2.5 u Z < e. If the exact
polygons overlap, the shortest displacement that separates them is along the normal of an edge, and its length is at
most 64 u Z + 52 u Z < 2 e. After this displacement, the polygons touch along the line of that edge, at a point or along
a segment. This point, or each end of this segment, is a vertex of one polygon and lies on an edge of the other polygon.
Before the displacement, the distance between this vertex and this edge is at most 2 e. Hence the computed d is between
0 and 3 e, the gap is between -2 e and 0, and the difference is at most 5 e = 320 u Z.

*Sum.* The kernel returns the square of the sum of the gap and r. The computation of this square contributes an error of
4 u (S + r). The total error of the square root of the returned value is at most 320 u (3.42 S + r) + 4 u (S + r) < 1280
u (S + r). Distances and lengths are assumed to be 0 or more than 10^-140 mm.

The directions of the rectangles are approximate. To compensate for this error, the rectangles are enlarged by 10^-6 of
the size of the outline. The tests with circles and with normals allow for an error of e. Therefore, the tests with
rectangles, circles and normals discard no pair that collides.
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
