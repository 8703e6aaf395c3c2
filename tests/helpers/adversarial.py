"""Pairs of segments with a limit of their distance, easy and difficult (name, generator of (first, second, limit))."""

import numpy as np

__all__ = ["ADVERSARIAL", "random_pairs"]


def random_pairs(rng, n):
    """Return the arms and limits of typical instruments."""
    for _ in range(n):
        a, b = rng.uniform(-20, 20, (2, 2))
        u, v = (rng.uniform(1, 18) * unit(rng.uniform(0, 2 * np.pi)) for _ in range(2))
        yield (*a, *(a + u)), (*b, *(b + v)), rng.uniform(0.5, 8)


def unit(angle):
    return np.array([np.cos(angle), np.sin(angle)])


def nudged(rng, value):
    """Change a number by a few units in the last place, change it by slightly more, or do not change it."""
    return float(value + rng.integers(-4, 5) * np.spacing(value) * rng.choice([1, 1e2, 1e3, 1e5]))


def tiny(rng):
    return float(rng.choice([0.0, 1e-18, 1e-16, 1e-15, 1e-12, 1e-9, 1e-6]) * rng.choice([-1, 1]))


def turned(rng, *points):
    """Rotate and shift points; rounding then moves most of them from their exact positions."""
    angle = float(rng.choice([0.0, np.pi / 2, rng.uniform(0, 2 * np.pi)]))
    shift = rng.choice([0.0, 1.0, 300.0]) * rng.uniform(-1, 1, 2)
    c, s = np.cos(angle), np.sin(angle)
    return [float(v) for x, y in points for v in (c * x - s * y + shift[0], s * x + c * y + shift[1])]


def pair(rng, *points, limit):
    values = turned(rng, *points)
    return tuple(values[:4]), tuple(values[4:]), limit


def parallel(rng):
    """Return segments beside each other that are almost parallel, at a distance of almost D."""
    d, length = rng.uniform(1, 8), rng.uniform(5, 18)
    gap, x = nudged(rng, d), rng.uniform(-4, 4)
    return pair(rng, (0, 0), (length, 0), (x, gap), (x + length, gap + tiny(rng)), limit=d)


def collinear(rng):
    """Return collinear segments that overlap or are separated by almost D."""
    d, length = rng.uniform(1, 8), rng.uniform(5, 18)
    gap = nudged(rng, d) if rng.random() < 0.7 else -rng.uniform(0, length)
    return pair(rng, (0, 0), (length, tiny(rng)), (length + gap, tiny(rng)), (2 * length + gap, 0), limit=d)


def tee(rng):
    """Return a segment whose end has a distance of almost D from the interior of the other segment."""
    d, length = rng.uniform(1, 8), rng.uniform(5, 18)
    x, gap = rng.uniform(0, length), nudged(rng, d)
    return pair(rng, (0, 0), (length, 0), (x, gap), (x + rng.uniform(-5, 5), gap + rng.uniform(1, 15)), limit=d)


def corner(rng):
    """Return segments whose ends have a distance of almost D, and which otherwise point away from each other."""
    d, angle = rng.uniform(1, 8), rng.uniform(-1.4, 1.4)
    gap = nudged(rng, d)
    ends = gap * np.cos(angle), gap * np.sin(angle)
    return pair(rng, (0, 0), (-rng.uniform(5, 18), 0), ends, (ends[0] + rng.uniform(5, 18), ends[1]), limit=d)


def barely_crossing(rng):
    """Return a segment that ends on the other segment, before it or just behind it, with limits down to rounding
    errors.
    """
    length, angle = rng.uniform(5, 18), rng.choice([np.pi / 2, 1.0, 1e-3, 1e-8])
    x, beyond = rng.uniform(0, length), tiny(rng)
    foot = np.array([x, 0.0]) - beyond * unit(angle)
    return pair(
        rng,
        (0, 0),
        (length, 0),
        foot,
        foot + rng.uniform(5, 18) * unit(angle),
        limit=float(rng.choice([1e-15, 1e-14, 1e-12, 1e-6, 3.0])),
    )


def points(rng):
    """Return segments with a length of zero or almost zero."""
    d, e = rng.uniform(1, 8), abs(tiny(rng))
    if rng.random() < 0.5:
        return pair(rng, (0, 0), (e, 0), (nudged(rng, d), 0), (nudged(rng, d), e), limit=d)
    x = rng.uniform(-3, 15)
    return pair(rng, (x, nudged(rng, d)), (x, nudged(rng, d)), (0, 0), (12, 0), limit=d)


def grid(rng):
    """Return segments on a coarse grid, where many distances are exactly the limit, or 0."""
    values = (1.25 * rng.integers(-4, 5, 8)).tolist()
    return tuple(values[:4]), tuple(values[4:]), float(rng.choice([1.25, 2.5, 3.75, 5.0, 6.25]))


def far_away(rng):
    """Return a pair of another kind at a distance of a million millimeters from the origin."""
    first, second, limit = ADVERSARIAL[rng.choice(["parallel", "collinear", "tee", "barely_crossing"])](rng)
    shift = rng.choice([-1e6, 1e6, 1e6 / 3, 0.0], 2).tolist() * 2
    moved = [tuple(v + s for v, s in zip(row, shift, strict=True)) for row in (first, second)]
    return *moved, limit


ADVERSARIAL = {f.__name__: f for f in (parallel, collinear, tee, corner, barely_crossing, points, grid, far_away)}
