"""Numbers on the page on collisions that no command prints: ``python tests/benchmarks/accuracy_figures.py``.

Random targets are uniform in the patrol areas. SDSS-V is the geometry of Chen et al. (36 rings, D = 5.0782 mm).
"""

import astropy.units as u
import numpy as np
from measure import hexagon

import rfpsurvey as rs
from rfpsurvey._kernels import collisions
from rfpsurvey._studies.benchmark_probability import random_tips
from rfpsurvey.collision import place_arms

GEOMETRIES = {"LAMOST": (8.25, 8.25, 2.25, 25.6, 36), "SDSS-V": (7.4, 15.0, 2.5, 22.4, 36, 0.1)}


def kept(plane, rng):
    """Return the fractions of the pairs of neighbors that pass the test of midpoints, that pass the test of axes, and
    that collide.
    """
    tips = random_tips(plane, rng) * u.mm
    segments = place_arms(plane, tips).segments.T.copy()
    halves, columns, n = np.empty_like(segments), plane.arrays, len(plane.arrays.neighbors)
    collisions.halve(segments, halves)
    gap = np.hypot(*(halves[:2, plane.arrays.neighbors[:, 0]] - halves[:2, plane.arrays.neighbors[:, 1]]))
    rows = np.empty(n, np.int64), np.empty(n, np.int64)
    counts = (gap <= columns.limits.near).sum(), collisions.near_pairs(halves, columns.runs, columns.limits, *rows)
    return np.array([*counts, len(rs.find_collisions(plane, tips).pairs)]) / n


def naive_crossings(rng, n):
    """Return the fraction of collinear, separate segments that cross according to the computed signs of four
    orientations.
    """
    angle, along = rng.uniform(0, 2 * np.pi, n), np.cumsum(rng.uniform(1, 10, (4, n)), axis=0)
    x, y = rng.uniform(-1, 1, (2, 1, n)) + along * np.array([np.cos(angle), np.sin(angle)])[:, None]

    def turn(a, b, p):
        return (x[b] - x[a]) * (y[p] - y[a]) - (y[b] - y[a]) * (x[p] - x[a])

    return np.mean((turn(0, 1, 2) * turn(0, 1, 3) < 0) & (turn(2, 3, 0) * turn(2, 3, 1) < 0))


def moved_by_single_precision(plane, rng):
    """Return the largest shift (mm) of a fully stretched tip, and of its elbow, in single precision."""
    alpha = rng.uniform(0, 2 * np.pi, len(plane))
    tips = plane.arrays.xy + plane.arrays.outer_radius[:, None] * (1 - 1e-13) * np.column_stack(
        [np.cos(alpha), np.sin(alpha)]
    )
    rough = tips.astype(np.float32).astype(float)
    elbows = [place_arms(plane, t * u.mm, clip=True).elbow for t in (tips, rough)]
    return np.abs(rough - tips).max(), np.hypot(*(elbows[0] - elbows[1]).T).max()


if __name__ == "__main__":
    rng = np.random.default_rng(1)
    for name, geometry in GEOMETRIES.items():
        plane = hexagon(*geometry)
        middles, axes, colliding = np.mean([kept(plane, rng) for _ in range(20)], axis=0)
        print(f"{name}: neighbors let through by middles {middles:.3f}, by axes {axes:.3f}; colliding {colliding:.3f}")
        row = rs.benchmark.benchmark_collisions(
            plane, methods=["endpoints"], n_configurations=20, repeats=1, seconds=0
        )[0]
        print(f"{name}: colliding pairs that four ends miss {row['n_missed'] / row['n_colliding_true']:.4f}")
        tip, elbow = moved_by_single_precision(plane, rng)
        print(f"{name}: single precision moves tips by {tip:.1e} mm, elbows at full stretch by {elbow:.1e} mm")
    print(f"naive crossings of collinear segments: {naive_crossings(rng, 1_000_000):.1e}")
