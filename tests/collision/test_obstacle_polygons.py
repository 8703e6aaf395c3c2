"""Polygons of the focal plane that no arm may touch, compared with shapely, for all arm models."""

from dataclasses import replace

import astropy.units as u
import numpy as np
import pytest
import shapely
from outlined import DESI_LIKE, placed
from raising import refused

import rfpsurvey as rs
from rfpsurvey.collision import place_arms

POLYGONS = (
    [[-3, -3], [4, -2], [3, 4], [-4, 3]] * u.mm,
    [[12, -30], [14, 30], [12.5, 30]] * u.mm,  # a sliver
    [[-30, 14], [-26, 8], [-19, 14]] * u.mm,  # clockwise
    [[-31, -31], [31, -31], [31, -22], [-31, -22]] * u.mm,
)
SEGMENT = rs.Positioner(3 * u.mm, 3 * u.mm, 0.9 * u.mm)
CAPSULE = replace(SEGMENT, arm_model="capsule", arm_length=3.8 * u.mm, arm_angle=5 * u.deg)
THIN = replace(SEGMENT, clearance=0 * u.mm)
TIP = replace(THIN, arm_model="fiber_tip")
UNITS = {"segment": SEGMENT, "capsule": CAPSULE, "no clearance": THIN, "points": TIP, "outline": DESI_LIKE}


def plane_of(unit: rs.Positioner) -> rs.FocalPlane:
    plane = rs.FocalPlane.hexagonal(unit, rings=4, pitch=9.5 * u.mm)
    return replace(plane, obstacles=[[20, 5, 1]] * u.mm, obstacle_polygons=POLYGONS)


def targets_of(plane: rs.FocalPlane, seed: int, n: int = 300) -> u.Quantity:
    return np.random.default_rng(seed).uniform(-45, 45, (n, 2)) * u.mm


def shape_gap(unit, center, elbow, tip, segment, obstacle) -> float:
    """Return the distance between the shape of an arm and an obstacle; negative if they overlap."""
    if unit.arm_model == "outline":
        shapes = [one for arm in placed(unit, center, elbow, tip) for one in arm]
    else:
        shapes = [(shapely.LineString(segment.reshape(2, 2)), 0.0)]
    return min(-1.0 if core.intersects(obstacle) else core.distance(obstacle) - radius for core, radius in shapes)


@pytest.mark.parametrize("name", UNITS)
def test_arms_touch_polygons_as_in_shapely(name):
    unit, n_hits = UNITS[name], 0
    plane, clearance = plane_of(unit), unit.clearance.to_value(u.mm)
    obstacles = [shapely.Polygon(one.to_value(u.mm)) for one in POLYGONS]
    for seed in range(3):
        plan = rs.allocate(plane, targets_of(plane, seed), allocator="balanced")
        arms, report = place_arms(plane, plan.tips), rs.find_collisions(plane, plan)
        expected = {}
        for i in np.flatnonzero(arms.present):
            one = plane.arrays.xy[i], arms.elbow[i], arms.tip[i], arms.segments[i]
            gaps = [shape_gap(unit, *one, obstacle) for obstacle in obstacles]
            expected |= {(int(i), 1 + j): max(gap, 0.0) for j, gap in enumerate(gaps) if gap < clearance}
        found = report.obstacle_pairs[:, 1] > 0
        assert [tuple(pair) for pair in report.obstacle_pairs[found].tolist()] == sorted(expected)
        distances = [expected[pair] for pair in sorted(expected)]
        np.testing.assert_allclose(report.obstacle_distances[found].to_value(u.mm), distances, atol=1e-9)
        counts = rs.collision.count_collisions(plane, plan.tips[None])
        assert counts.n_obstacle_pairs.tolist() == [len(report.obstacle_pairs)]
        n_hits += len(expected)
    assert n_hits > 20


@pytest.mark.parametrize("name", ["segment", "outline"])
@pytest.mark.parametrize("allocator", ["repair", "optimal"])
def test_plans_without_collisions_touch_no_polygon(name, allocator):
    plane = plane_of(UNITS[name])
    plan = rs.allocate(plane, targets_of(plane, 5), allocator=allocator)
    moved = np.flatnonzero(plan.target_of_positioner >= 0)
    assert not np.isin(rs.find_collisions(plane, plan).obstacle_pairs[:, 0], moved).any()
    assert len(moved) > 20


def test_touching_a_polygon_is_decided_exactly():
    """The arm ends at a distance of exactly the clearance, or one unit in the last place closer."""
    unit = rs.Positioner(4 * u.mm, 4 * u.mm, 0.5 * u.mm)
    for x, touches in ((8.5, False), (np.nextafter(8.5, 0), True)):
        wall = [[x, -3], [12, -3], [12, 3], [x, 3]] * u.mm
        plane = rs.FocalPlane([[0, 0]] * u.mm, unit, obstacle_polygons=[wall])
        report = rs.find_collisions(plane, [[8, 0]] * u.mm)
        assert (len(report.obstacle_pairs) == 1) == touches
        assert report.n_borderline == 1


def test_methods_of_probability_agree_near_polygons():
    plane, targets = plane_of(SEGMENT), rs.probability.RandomTargets(number=150)
    found = [
        rs.collision_probability(plane, targets=targets, method=method, precision=0.004, rng=2)
        for method in ("conditional", "monte_carlo")
    ]
    assert abs(found[0].value - found[1].value) < 4 * np.hypot(*(one.standard_error for one in found))
    bare = rs.collision_probability(
        replace(plane, obstacle_polygons=None), targets=targets, method="conditional", precision=0.004, rng=2
    )
    assert found[0].value > bare.value + 0.02


def test_polygons_survive_tables_and_pickles(tmp_path):
    plane = plane_of(SEGMENT)
    again = rs.FocalPlane.from_table(plane.to_table())
    for one, other in zip(plane.arrays.obstacle_polygons, again.arrays.obstacle_polygons, strict=True):
        np.testing.assert_array_equal(one, other)
    assert len(again.arrays.obstacle_polygons) == 4
    assert repr(plane) == "<FocalPlane of 61 positioners, 5 obstacles>"


BAD_POLYGONS = [
    ([[[0, 0], [1, 0]] * u.mm], r"obstacle_polygons\[0\] must have at least three vertices"),
    ([[[0, 0], [4, 0], [1, 1], [0, 4]] * u.mm], r"obstacle_polygons\[0\] must be a convex polygon"),
    ([[[0, 0], [4, 0], [1, 1]]], "unit"),
    ([[0, 0], [4, 0], [1, 1]] * u.mm, "obstacle_polygons must be a list of polygons"),
]


@pytest.mark.parametrize(("polygons", "sentence"), BAD_POLYGONS)
def test_bad_polygons_are_refused(polygons, sentence):
    refused(sentence, rs.FocalPlane, [[0, 0]] * u.mm, SEGMENT, obstacle_polygons=polygons)
