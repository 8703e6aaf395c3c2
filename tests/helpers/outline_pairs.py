"""Pairs of positioners with outlines, easy and difficult, and independent decisions by shapely and rational numbers."""

from fractions import Fraction
from math import lcm
from typing import NamedTuple

import astropy.units as u
import numba
import numpy as np
import shapely

import rfpsurvey as rs
from rfpsurvey._instruments.collision_methods import outlines_closer_exactly
from rfpsurvey._instruments.outline import make_outline
from rfpsurvey._kernels import outlines
from rfpsurvey._kernels.outlines import RADIUS, outlines_squared, place_outline

CLEAR = 1e-9
# Smaller than all positive differences of distances of points whose coordinates are sums of two floats.
LEAST = Fraction(1, 2**400)
"""Distances by shapely that differ from a limit by less than this are not used, relative to the size of the scene."""


class Pairs(NamedTuple):
    """Positioners 2k and 2k + 1 are a pair with its own minimum separation."""

    outline: outlines.Outline
    cores: np.ndarray
    separation: np.ndarray


@numba.njit
def gaps_plus_offset(outline, separation, cores):
    out = np.empty(separation.size)
    for k in range(out.size):
        a, b = cores[2 * k], cores[2 * k + 1]
        total = separation[k] + outline.offset
        squared = outlines_squared(outline, total, 2 * k, 2 * k + 1, a[0], a[1], a[2], a[3], b[0], b[1], b[2], b[3])
        out[k] = np.sqrt(squared)
    return out


@numba.njit
def place_all(outline, cores):
    out = np.empty((len(cores), 4, outline.n_vertices))
    for k in range(len(cores)):
        place_outline(outline, k, cores[k, 0], cores[k, 1], cores[k, 2], cores[k, 3], out[k])
    return out


def sizes(pairs, placed):
    """Return an upper limit of the distances between the vertices, elbows and centers of each pair."""
    n = len(pairs.separation)
    xy = np.concatenate([placed[:, :2] + placed[:, 2:], placed[:, :2]], axis=2)
    xy = np.concatenate([xy, pairs.cores[:, :2, None], pairs.outline.centers[:, :2, None]], axis=2)
    xy = xy.reshape(n, 2, 2, -1)
    return np.hypot(*np.ptp(xy.transpose(0, 2, 1, 3).reshape(n, 2, -1), axis=2).T)


def decide(pairs):
    """Return 1 (colliding), 0 or -1 (borderline) for each pair, by the kernel and its error bound."""
    size = sizes(pairs, place_all(pairs.outline, pairs.cores))
    error = 1.2 * outlines.OUTLINE_ERROR * (size + pairs.outline.offset)
    total, limit = (
        gaps_plus_offset(pairs.outline, pairs.separation, pairs.cores),
        pairs.separation + pairs.outline.offset,
    )
    return np.where(np.abs(total - limit) <= error, -1, total < limit)


def gaps(pairs):
    """Return the gaps computed by the kernel."""
    many = np.full(len(pairs.separation), 1e9)
    return gaps_plus_offset(pairs.outline, many, pairs.cores) - pairs.outline.offset


def geometries(points):
    """Return shapely's geometries of convex polygons with the same number of vertices, shape (n, k, 2)."""
    if points.shape[1] == 1:
        return shapely.points(points[:, 0])
    return shapely.linestrings(points) if points.shape[1] == 2 else shapely.polygons(points)


def count(pairs):
    """Return the numbers of pairs, of collisions, of borderline pairs, of decisions by rationals, and of errors."""
    outline, separation = pairs.outline, pairs.separation
    got = decide(pairs)
    placed = place_all(outline, pairs.cores)
    margin = CLEAR * (sizes(pairs, placed) + outline.offset)
    spans = list(zip(outline.start[:-1].tolist(), outline.start[1:].tolist(), strict=True))
    xy = (placed[:, :2] + placed[:, 2:]).transpose(0, 2, 1)
    shapes = [geometries(xy[:, a:b]) for a, b in spans]
    certain, unclear = np.zeros(len(separation), dtype=bool), []
    for p in range(len(spans)):
        for q in range(len(spans)):
            if p >= outline.n_eccentric and q >= outline.n_eccentric:
                continue
            limit = separation + outline.parts[RADIUS, p] + outline.parts[RADIUS, q]
            distance = shapely.distance(shapes[p][::2], shapes[q][1::2])
            certain |= distance < limit - margin
            unclear += [(k, p, q) for k in np.flatnonzero(np.abs(distance - limit) <= margin)]
    expected = certain.copy()
    by_rationals = set()
    for k, p, q in unclear:
        if not expected[k]:
            by_rationals.add(k)
            a, b = (exact_points(placed[2 * k + side], *spans[part]) for side, part in ((0, p), (1, q)))
            radii = sum(Fraction(float(outline.parts[RADIUS, part])) for part in (p, q))
            # parts that touch collide if the minimum separation is 0
            expected[k] = closer(a, b, Fraction(float(separation[k])) + radii + (separation[k] == 0) * LEAST)
    borderline = np.flatnonzero(got < 0)
    for k in borderline:
        got[k] = outlines_closer_exactly(
            outline, 2 * k, 2 * k + 1, pairs.cores[2 * k], pairs.cores[2 * k + 1], float(separation[k])
        )
    wrong = np.count_nonzero(got != expected)
    return np.array([len(got), np.count_nonzero(expected), len(borderline), len(by_rationals), wrong])


def exact_points(placed, first, last):
    return [
        (Fraction(x) + Fraction(dx), Fraction(y) + Fraction(dy)) for x, y, dx, dy in placed[:, first:last].T.tolist()
    ]


def closer(first, second, limit):
    """Return whether two convex polygons are closer than a limit, or overlap, from the differences of their points.

    The hull of all differences contains the origin in its interior if and only if no line separates the polygons. If it
    does not, its distance from the origin is that of the polygons.
    """
    scale = lcm(*(v.denominator for point in (*first, *second) for v in point), limit.denominator)
    a, b = ([(int(x * scale), int(y * scale)) for x, y in points] for points in (first, second))
    limit = int(limit * scale)
    hull = gift_wrapping({(x - p, y - q) for x, y in b for p, q in a})
    edges = list(zip(hull, hull[1:] + hull[:1], strict=True))
    if len(hull) > 2 and all(p[0] * q[1] - p[1] * q[0] > 0 for p, q in edges):
        return True
    return any(origin_closer(p, q, limit) for p, q in edges)


def gift_wrapping(points):
    """Return the convex hull in counter-clockwise order, by a search for the next vertex from each vertex."""
    start = min(points)
    hull = [start]
    while True:
        x, y = hull[-1]
        best = None
        for p, q in points:
            if (p, q) != (x, y):
                if best is None:
                    best = (p, q)
                    continue
                bend = (best[0] - x) * (q - y) - (best[1] - y) * (p - x)
                farther = (p - x) ** 2 + (q - y) ** 2 > (best[0] - x) ** 2 + (best[1] - y) ** 2
                if bend < 0 or (bend == 0 and farther):
                    best = (p, q)
        if best is None or best == start:
            return hull
        hull.append(best)


def origin_closer(p, q, limit):
    """Return whether the origin is closer than ``limit`` to the segment p-q, in integers."""
    dx, dy = q[0] - p[0], q[1] - p[1]
    length2, along = dx * dx + dy * dy, -(p[0] * dx + p[1] * dy)
    if length2 and 0 < along < length2:
        return (p[0] * q[1] - p[1] * q[0]) ** 2 < limit**2 * length2
    x, y = p if along <= 0 else q
    return x * x + y * y < limit**2


def polygon(rng, k, size):
    """Return k points on an ellipse, which are the vertices of a convex polygon."""
    angles = np.sort(rng.uniform(0, 2 * np.pi, k))
    points = np.column_stack([np.cos(angles), np.sin(angles)]) * size * rng.uniform(0.2, 1, 2)
    c, s = np.cos(angles[0]), np.sin(angles[0])
    return points @ [[c, s], [-s, c]]


def rectangle(x0, y0, x1, y1):
    return [[x0, y0], [x1, y0], [x1, y1], [x0, y1]]


def rounded(rng):
    """Return parts with a radius: a disc, capsules, and an inflated polygon."""
    parts = [[[0, 0]], [[0, 0], [rng.uniform(2, 6), 0]], rectangle(0, -1, 4, 1)]
    return [(part, rng.choice([0.5, 1.0, rng.uniform(0.1, 2)])) for part in parts[: rng.integers(1, 4)] + parts[1:2]], [
        ([[0, 0], [3, 0]], rng.uniform(0.1, 2))
    ]


def convex(rng):
    """Return convex polygons of 3 to 12 vertices."""
    parts = [(polygon(rng, rng.integers(3, 13), rng.uniform(1, 6)) + [2, 0], 0.0) for _ in range(3)]
    return parts[: rng.integers(1, 3)], parts[2:]


def boxes(rng):
    """Return rectangles with vertices on a grid, one within another."""
    x, y = rng.integers(2, 6), rng.integers(1, 3)
    return [(rectangle(-1, -y, x, y), 0.0), (rectangle(0, -0.5, x - 0.5, 0.5), 0.0)], [(rectangle(-2, -1, 3, 1), 0.0)]


def slivers(rng):
    """Return polygons that are so thin that rounding can turn them into segments, and almost straight edges."""
    width = 10.0 ** rng.uniform(-8.5, -2)
    bent = [[0, 0], [2, -width], [4, 0], [2, 1]]
    return [([[-1, 0], [5, -width], [5, width]], 0.0), (bent, 0.0)], [([[0, 0], [3, width], [0, width]], 0.0)]


def lines(rng):
    """Return segments and points without a radius."""
    return [([[0, 0], [5, 0]], 0.0), ([[1, 1]], 0.0), ([[0, -1], [4, 1]], 0.0)], [([[-1, 0], [3, 0]], 0.0)]


def arm(rng):
    """Return parts in the shape of DESI's arms."""
    eccentric = [[3.967, 0], [3.918, 1.014], [3.269, 1.583], [-1.172, 1.037], [-1.172, -1.037], [3.269, -1.583]]
    central = [[0.814, -3.236], [2.083, -2.707], [-1.902, -0.935], [-2.007, -2.665], [-1.139, -3.137]]
    return [([*eccentric, [3.918, -1.014]], 0.0)], [
        (central, 0.0),
        ([[2.083, -2.707], [4.194, -2.761], [4.893, -1.168]], 0.0),
    ]


SHAPES = {f.__name__: f for f in (arm, convex, rounded, boxes, slivers, lines)}
PLACES = ("anywhere", "grid", "far_away")


def make_pairs(rng, shape, place, n):
    """Return n pairs of positioners with one outline: anywhere, on a grid, or far from the origin."""
    parts = SHAPES[shape](rng)
    given = [[(np.array(part, dtype=float) * u.mm, radius * u.mm) for part, radius in group] for group in parts]
    outline = rs.positioner.ArmOutline(*given)
    length, arm_length = outline.length.value, float(rng.integers(1, 6))
    if place == "grid":
        turns = np.array([[1, 0], [0, 1], [-1, 0], [0, -1]], dtype=float)
        directions = turns[rng.integers(0, 4, (2, 2 * n))]
        centers = 0.5 * rng.integers(-8, 9, (2 * n, 2))
    else:
        angles = rng.uniform(0, 2 * np.pi, (2, 2 * n))
        close = rng.random((2, n)) < 0.2  # pairs of parallel arms
        angles[:, 1::2] = np.where(
            close, angles[:, ::2] + rng.choice([0.0, np.pi, 1e-15, 1e-9], (2, n)), angles[:, 1::2]
        )
        directions = np.stack([np.cos(angles), np.sin(angles)], axis=2)
        centers = rng.uniform(-6, 6, (2 * n, 2))
        centers[1::2] = np.where(rng.random((n, 1)) < 0.05, centers[::2], centers[1::2])
    if place == "far_away":
        centers += np.repeat(rng.choice([-1e3, 1e3, 1e6, 1e3 / 3], (n, 2)), 2, axis=0)
    elbows = centers + arm_length * directions[0]
    cores = np.hstack([elbows, elbows + length * directions[1]])
    pairs = Pairs(make_outline(outline, centers, np.full(2 * n, arm_length)), cores, rng.uniform(0, 4, n))
    near = gaps(pairs)
    ulps = rng.integers(-2, 3, n) * rng.choice([1, 1, 1e2, 1e4], n)
    contact = np.maximum(near + ulps * np.spacing(np.maximum(np.abs(near), 1e-3)), 0.0)
    choice = rng.random(n)
    grid = 0.5 * rng.integers(0, 6, n)
    separation = np.select([choice < 0.15, choice < 0.2], [contact, 0.0], grid if place == "grid" else pairs.separation)
    return pairs._replace(separation=separation)
