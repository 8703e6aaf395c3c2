"""Gaps of outlines, compared with shapely and with rational numbers."""

from fractions import Fraction
from itertools import pairwise

import astropy.units as u
import numpy as np
import pytest
from outline_pairs import PLACES, SHAPES, closer, count, decide, exact_points, gaps, make_pairs, place_all, sizes

import rfpsurvey as rs
from rfpsurvey._instruments.collision_methods import outlines_closer_exactly
from rfpsurvey._instruments.outline import make_outline
from rfpsurvey._kernels import outlines
from rfpsurvey._kernels.collisions import segments_squared


@pytest.mark.few(4)
@pytest.mark.parametrize(("draws", "n"), [(2, 100), pytest.param(20, 600, marks=pytest.mark.exhaustive)])
@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("shape", SHAPES)
def test_pairs_are_decided_as_by_shapely_and_rationals(shape, place, draws, n):
    total = sum(count(make_pairs(np.random.default_rng([draws, seed]), shape, place, n)) for seed in range(draws))
    n_pairs, colliding, borderline, by_rationals, wrong = total
    assert wrong == 0
    assert 0.2 * n_pairs < colliding < 0.9 * n_pairs
    assert 0 < borderline < 0.25 * n_pairs
    assert by_rationals > 0.02 * n_pairs


def two(parts, *, separation=0.0, distance=10.0, turned=False, central=(), arm=3.0):
    """Return the verdicts of the kernel and of exact arithmetic for two positioners with arms along the x axis.

    The elbows are at the origin and at the distance along x; the second arm can point back at the first one.
    """
    shape = rs.positioner.ArmOutline(
        [part * u.mm for part in np.array(parts, dtype=float)], [p * u.mm for p in central]
    )
    elbows = np.array([[0.0, 0.0], [distance, 0.0]])
    outline = make_outline(shape, elbows - [arm, 0.0], np.full(2, arm))
    length = shape.length.value * np.array([1.0, -1.0 if turned else 1.0])
    cores = np.column_stack([elbows, elbows + np.column_stack([length, [0.0, 0.0]])])
    squared = outlines.outlines_squared(outline, separation + outline.offset, 0, 1, *cores[0], *cores[1])
    return np.sqrt(squared) - outline.offset, outlines_closer_exactly(outline, 0, 1, *cores, separation)


def test_polygons_that_touch_collide_without_a_separation():
    square = [[-1, -1], [1, -1], [1, 1], [-1, 1]]
    gap, collide = two([square], distance=2.0, central=[])
    assert gap == pytest.approx(0, abs=1e-14)
    assert collide
    assert not two([square], distance=np.nextafter(2.0, 3), central=[])[1]
    assert two([square], distance=np.nextafter(2.0, 0), central=[])[1]
    assert two([square], separation=1e-300, distance=2.0)[1]


def test_polygons_at_the_minimum_separation_do_not_collide():
    square = [[-1, -1], [1, -1], [1, 1], [-1, 1]]
    assert not two([square], separation=0.5, distance=2.5)[1]
    assert two([square], separation=np.nextafter(0.5, 1), distance=2.5)[1]


@pytest.mark.parametrize("distance", [5.0, -1.0])
def test_the_gap_of_points_is_their_distance(distance):
    gap, collide = two([[[1, 0]]], separation=3.5, distance=distance, turned=True)
    assert gap == pytest.approx(3, abs=1e-12)
    assert collide


def test_crossing_lines_without_a_radius_overlap():
    """Crossing lines overlap, as thin polygons do; parallel lines touch, which is a collision without a separation."""
    cross = np.array([[[0, -2], [4, 2]]])
    gap, collide = two(cross, distance=0.5, turned=True)
    assert not collide
    gap, collide = two(cross, distance=4.0, turned=True)  # the second line is the first one
    assert gap == pytest.approx(0, abs=1e-14)
    assert collide
    tilted = make_outline(rs.positioner.ArmOutline([cross[0] * u.mm]), np.zeros((2, 2)), np.ones(2))
    first, second = [0.0, 0.0, 4.0, 0.0], [0.0, 0.0, 4 * np.cos(0.1), 4 * np.sin(0.1)]
    assert outlines_closer_exactly(tilted, 0, 1, first, second, 0.0)
    assert outlines.outlines_squared(tilted, tilted.offset, 0, 1, *first, *second) < tilted.offset**2


def test_central_parts_do_not_collide_with_each_other():
    small, large = [[0, 0], [1, 0]], np.array([[-9, -9], [9, -9], [9, 9], [-9, 9]])
    gap, collide = two([small], distance=5.0, central=[large])
    assert gap < 0
    assert collide
    # the eccentric arms are far from the central parts, which overlap
    gap, collide = two([small], distance=5.0, central=[large - [100, 0]])
    assert np.isinf(gap)
    assert not collide


@pytest.mark.exhaustive
def test_both_orders_give_the_same_verdict():
    rng = np.random.default_rng(4)
    for shape in SHAPES:
        pairs = make_pairs(rng, shape, "anywhere", 200)
        swap = np.arange(400).reshape(-1, 2)[:, ::-1].ravel()
        centers = np.ascontiguousarray(pairs.outline.centers[swap])
        other = pairs._replace(outline=pairs.outline._replace(centers=centers), cores=pairs.cores[swap])
        first, second = decide(pairs), decide(other)
        assert (first[(first >= 0) & (second >= 0)] == second[(first >= 0) & (second >= 0)]).all()


@pytest.mark.parametrize("seeds", [range(2), pytest.param(range(2, 6), marks=pytest.mark.exhaustive)])
def test_the_error_is_within_the_bound_and_the_bound_is_not_idle(seeds):
    """The largest error of a positive gap is at most the bound, and at least 0.01% of it."""
    worst = 0.0
    for seed in seeds:
        pairs = make_pairs(np.random.default_rng([8, seed]), "convex", "far_away", 60)
        outline, placed, spans = pairs.outline, place_all(pairs.outline, pairs.cores), pairs.outline.start.tolist()
        size = sizes(pairs, placed)
        for k, gap in enumerate(gaps(pairs)):
            if not 1e-3 < gap < 10:
                continue
            bound, n = outlines.OUTLINE_ERROR * (size[k] + outline.offset), outline.n_eccentric
            parts = [[exact_points(placed[2 * k + side], *span) for span in pairwise(spans)] for side in (0, 1)]

            def within(limit, parts=parts, n=n):
                tests = ((p, q) for p in range(len(parts[0])) for q in range(len(parts[0])) if p < n or q < n)
                return any(closer(parts[0][p], parts[1][q], limit) for p, q in tests)

            assert within(Fraction(gap + bound))
            assert not within(Fraction(gap - bound))
            if not within(Fraction(gap + 1e-4 * bound)) or within(Fraction(gap - 1e-4 * bound)):
                worst = 1.0
    assert worst == 1.0


def test_no_outline_has_no_parts():
    empty = make_outline(None, np.zeros((3, 2)), np.ones(3))
    assert (empty.start.size, empty.offset) == (1, 0.0)


def test_the_offset_is_the_difference_of_the_broad_phase():
    """Cores are never farther apart than the smallest gap plus the offset."""
    for shape in SHAPES:
        pairs = make_pairs(np.random.default_rng(6), shape, "anywhere", 300)
        gap = gaps(pairs)
        cores = [np.sqrt(segments_squared(*a, *b)) for a, b in zip(pairs.cores[::2], pairs.cores[1::2], strict=True)]
        clear = gap > 0  # the gap of overlapping outlines is not the smallest one
        assert clear.sum() > 30
        assert (np.array(cores)[clear] <= gap[clear] + pairs.outline.offset + 1e-12).all()
