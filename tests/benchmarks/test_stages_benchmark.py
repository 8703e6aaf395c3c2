"""Measure the stages of a LAMOST tile with 4000 positioners and 100,000 targets, after compilation."""

import astropy.units as u
import pytest

import rfpsurvey as rs
from rfpsurvey._instruments.arms import nearest_distance
from rfpsurvey.collision import find_collisions
from sky_center import CENTER


@pytest.fixture(autouse=True)
def _group(benchmark):
    benchmark.group = "stages"


def test_1_select(benchmark, lamost, stars):
    benchmark(lambda: stars.arrays.rows_within(CENTER, lamost.field_radius.to_value(u.rad)))


def test_2_projection(benchmark, lamost, stars):
    benchmark(lambda: lamost.projection(CENTER).to_focal_plane(stars))


def test_3_reach(benchmark, lamost, xy):
    points = xy.value
    benchmark(lambda: lamost.focal_plane.arrays.reach(points))


@pytest.mark.parametrize("method", ["balanced", "lamost_rule"])
def test_4_allocation_with_reach(benchmark, lamost, xy, method):
    benchmark(lambda: rs.allocate(lamost.focal_plane, xy, allocator=method))


def test_5_arms(benchmark, lamost, xy):
    allocation = rs.allocate(lamost.focal_plane, xy, allocator="balanced")
    benchmark(lambda: allocation.place_arms(lamost.focal_plane))


def test_6_collisions(benchmark, lamost, xy):
    arms = rs.allocate(lamost.focal_plane, xy, allocator="balanced").place_arms(lamost.focal_plane)
    benchmark(lambda: find_collisions(lamost.focal_plane, arms))


def test_7_clearances(benchmark, lamost, xy):
    arms = rs.allocate(lamost.focal_plane, xy, allocator="balanced").place_arms(lamost.focal_plane)
    benchmark(lambda: nearest_distance(lamost.focal_plane, arms))


def test_8_whole_tile(benchmark, lamost, stars):
    benchmark(lambda: rs.plan_tile(stars, lamost, CENTER, allocator="lamost_rule"))
