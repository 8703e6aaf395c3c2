"""Arms with outlines in the whole package: a capsule written as an outline gives the results of the capsule."""

from dataclasses import replace

import astropy.units as u
import numpy as np
import pytest
import shapely
from astropy.coordinates import SkyCoord
from matplotlib.figure import Figure
from outlined import DESI_LIKE, placed
from own_instrument import description, hexagon

import rfpsurvey as rs
from rfpsurvey._instruments.arms import nearest_distance
from rfpsurvey.collision import METHODS, place_arms

CAPSULE = rs.Positioner(
    7.4 * u.mm, 15 * u.mm, 2 * u.mm, arm_model="capsule", arm_length=14.7 * u.mm, arm_angle=-1.4 * u.deg
)


def as_outline(unit: rs.Positioner, radius: float = 0.0) -> rs.Positioner:
    """Return the same capsule as an outline, of which a part of the clearance may be the radius."""
    vertices = [[0, 0], [unit.arm_length.to_value(u.mm), 0]] * u.mm
    outline = rs.positioner.ArmOutline(eccentric=((vertices, radius * u.mm),))
    clearance = unit.clearance - radius * u.mm
    return replace(unit, arm_model="outline", arm_length=None, outline=outline, clearance=clearance)


def planes(rings: int = 6, radius: float = 0.0) -> tuple[rs.FocalPlane, rs.FocalPlane]:
    return tuple(
        rs.FocalPlane.hexagonal(unit, rings=rings, pitch=22.4 * u.mm) for unit in (CAPSULE, as_outline(CAPSULE, radius))
    )


def random_targets(plane: rs.FocalPlane, number: int, seed: int) -> u.Quantity:
    size = float(np.abs(plane.xy.value).max()) + 20
    return np.random.default_rng(seed).uniform(-size, size, (number, 2)) * u.mm


@pytest.mark.parametrize("radius", [0.0, 0.5, 2.0])
def test_capsule_as_outline_gives_the_same_collisions(radius):
    capsule, outline = planes(radius=radius)
    for seed in range(5):
        plan = rs.allocate(capsule, random_targets(capsule, 600, seed), allocator="balanced")
        expected, found = (rs.find_collisions(plane, plan) for plane in (capsule, outline))
        np.testing.assert_array_equal(found.pairs, expected.pairs)
        assert len(expected.pairs) > 0
        np.testing.assert_allclose(
            found.distances.value, np.maximum(expected.distances.value - 2 * radius, 0), atol=1e-12
        )
        poses = [place_arms(plane, plan.tips) for plane in (capsule, outline)]
        near = [nearest_distance(plane, arms) for plane, arms in zip((capsule, outline), poses, strict=True)]
        close = near[0] < 5
        np.testing.assert_allclose(near[1][close] + 2 * radius, np.maximum(near[0][close], 2 * radius), atol=1e-12)
        counts = [
            rs.collision.count_collisions(plane, plan, n_configurations=50, rng=seed) for plane in (capsule, outline)
        ]
        np.testing.assert_array_equal(counts[0].per_positioner, counts[1].per_positioner)


@pytest.mark.parametrize("allocator", ["repair", "optimal"])
def test_capsule_as_outline_gives_the_same_plan(allocator):
    capsule, outline = planes(rings=4, radius=1.0)
    targets = random_targets(capsule, 150, 3)
    expected, found = (rs.allocate(plane, targets, allocator=allocator) for plane in (capsule, outline))
    np.testing.assert_array_equal(found.target_of_positioner, expected.target_of_positioner)
    assert found.gap == expected.gap


@pytest.mark.parametrize("options", [{"method": "conditional"}, {"method": "monte_carlo"}, {"method": "quadrature"}])
def test_capsule_as_outline_gives_the_same_probability(options):
    expected, found = (
        rs.collision_probability(
            plane, precision=rs.probability.Precision(max_iterations=64, standard_error=None), rng=1, **options
        )
        for plane in planes(rings=3, radius=0.7)
    )
    assert found.value == pytest.approx(expected.value, rel=1e-12)
    assert expected.value > 0.01


def gap_of(first, second) -> float:
    """Return the distance between two arms, negative or 0 if they overlap."""
    pairs = [(0, 0), (0, 1), (1, 0)]
    return min(p.distance(q) - r - s for a, b in pairs for p, r in first[a] for q, s in second[b])


def test_outlines_collide_as_in_shapely():
    plane = rs.FocalPlane.hexagonal(DESI_LIKE, rings=5, pitch=9.5 * u.mm)
    limit, n_pairs = DESI_LIKE.min_separation.to_value(u.mm), 0
    for seed in range(4):
        plan = rs.allocate(plane, random_targets(plane, 400, seed), allocator="balanced")
        arms, report = place_arms(plane, plan.tips), rs.find_collisions(plane, plan)
        shapes = {
            k: placed(DESI_LIKE, plane.arrays.xy[k], arms.elbow[k], arms.tip[k]) for k in np.flatnonzero(arms.present)
        }
        gaps = {
            (i, j): gap_of(shapes[i], shapes[j])
            for i in shapes
            for j in shapes
            if i < j and np.hypot(*(plane.arrays.xy[i] - plane.arrays.xy[j])) < 20
        }
        expected = sorted(pair for pair, gap in gaps.items() if gap < limit)
        assert report.pairs.tolist() == [list(pair) for pair in expected]
        distances = [max(gaps[pair], 0.0) for pair in expected]
        np.testing.assert_allclose(report.distances.to_value(u.mm), distances, atol=1e-9)
        near = nearest_distance(plane, arms)
        for k in shapes:
            own = [gap for pair, gap in gaps.items() if k in pair]
            if min(own) < 2:
                assert near[k] == pytest.approx(max(min(own), 0.0), abs=1e-9)
        n_pairs += len(expected)
    assert n_pairs > 50


@pytest.mark.parametrize("method", [name for name, one in METHODS.items() if not one.supports_outlines])
def test_other_methods_refuse_outlines(method):
    plane = rs.FocalPlane.hexagonal(DESI_LIKE, rings=1, pitch=9.5 * u.mm)
    with pytest.raises(rs.InputError, match=f"must be 'exact', got '{method}'"):
        rs.find_collisions(plane, np.zeros((7, 2)) * u.mm + plane.xy, method=method)


def test_outline_survives_tables_and_descriptions(tmp_path):
    plane = rs.FocalPlane.hexagonal(DESI_LIKE, rings=1, pitch=9.5 * u.mm)
    plane.to_table().write(tmp_path / "plane.ecsv")
    again = rs.FocalPlane.from_table(rs.FocalPlane.hexagonal(DESI_LIKE, rings=1, pitch=9.5 * u.mm).to_table())
    assert again.positioner.outline.to_dict() == DESI_LIKE.outline.to_dict()
    layout = "obstacle_polygons = { value = [[[0, 3], [1, 3], [1, 4]], [[9, 9], [9.5, 9], [9.5, 9.5], [9, 9.5]]], "
    layout += f'unit = "cm" }}\n{hexagon(2, 9.5)}'
    outline = """arm_model = { value = "outline" }
[positioner.outline]
unit = "cm"
value.eccentric = [{ vertices = [[0.0, -0.1], [0.3, -0.1], [0.3, 0.1], [0.0, 0.1]], radius = 0.01 }]
value.central = [{ vertices = [[0.3, 0.0]], radius = 0.2 }]
"""
    file = tmp_path / "mine.toml"
    file.write_text(description((3.0, 3.0), 0.0, layout, positioner=outline))
    plane = rs.Instrument.read(file).focal_plane
    assert [one.max() for one in plane.arrays.obstacle_polygons] == [40, 95]
    outline = plane.positioner.outline
    assert outline.to_dict() == {
        "eccentric": [{"vertices": [[0.0, -1.0], [3.0, -1.0], [3.0, 1.0], [0.0, 1.0]], "radius": 0.1}],
        "central": [{"vertices": [[3.0, 0.0]], "radius": 2.0}],
    }


def test_parts_of_an_outline_are_one_path_per_arm():
    """Overlapping parts are filled once, and no edges between parts are visible."""
    plane = rs.FocalPlane.hexagonal(DESI_LIKE, rings=1, pitch=9.5 * u.mm)
    center = SkyCoord(10 * u.deg, 20 * u.deg)
    sky = center.directional_offset_by(np.arange(60) * u.deg, np.arange(60) * 4 * u.arcsec)
    catalog = rs.Catalog(sky)
    tile = rs.plan_tile(catalog, rs.Instrument("test", plane, plate_scale=60 * u.um / u.arcsec), center)
    rs.plot.plot_focal_plane(plane, ax=Figure().subplots())
    ax = Figure().subplots()
    rs.plot.plot_focal_plane(tile, ax=ax)
    elbows, tips = (np.column_stack([tile.table[f"{n}_x"].value, tile.table[f"{n}_y"].value]) for n in ("elbow", "tip"))
    shapes = [placed(DESI_LIKE, *ends) for ends in zip(plane.arrays.xy, elbows, tips, strict=True)]
    areas = [shapely.union_all([c.buffer(r + 0.1) for c, r in part]) for pair in shapes for part in pair]
    n_found = 0
    for collection in ax.collections:
        for path in collection.get_paths():
            rings = [shapely.Polygon(ring) for ring in path.to_polygons() if len(ring) > 3]
            if len(rings) == 2:
                assert collection.get_linewidth()[0] == 0
                assert all(ring.exterior.is_ccw for ring in rings)  # with one orientation, overlaps are filled once
                drawn = shapely.union_all(rings)
                n_found += any(drawn.symmetric_difference(area).area < 0.01 * area.area for area in areas)
    assert n_found == 14


def test_outlines_touch_obstacles_as_in_shapely(rng):
    circles = np.column_stack([rng.uniform(-30, 30, (12, 2)), rng.uniform(0.2, 1.5, 12)])
    plane = rs.FocalPlane.hexagonal(DESI_LIKE, rings=4, pitch=9.5 * u.mm)
    plane = replace(plane, obstacles=circles * u.mm)
    clearance, n_hits = DESI_LIKE.clearance.to_value(u.mm), 0
    for seed in range(4):
        plan = rs.allocate(plane, random_targets(plane, 300, seed), allocator="balanced")
        arms, report = place_arms(plane, plan.tips), rs.find_collisions(plane, plan)
        expected = {}
        for i in np.flatnonzero(arms.present):
            shapes = placed(DESI_LIKE, plane.arrays.xy[i], arms.elbow[i], arms.tip[i])
            for j, (x, y, r) in enumerate(circles):
                gap = min(core.distance(shapely.Point(x, y)) - radius for arm in shapes for core, radius in arm) - r
                if gap < clearance:
                    expected[int(i), j] = max(gap, 0.0)
        assert [tuple(pair) for pair in report.obstacle_pairs.tolist()] == sorted(expected)
        distances = [expected[pair] for pair in sorted(expected)]
        np.testing.assert_allclose(report.obstacle_distances.to_value(u.mm), distances, atol=1e-9)
        counts = rs.collision.count_collisions(plane, plan.tips[None])
        assert counts.n_obstacle_pairs.tolist() == [len(expected)]
        n_hits += len(expected)
    assert n_hits > 12
    free = rs.allocate(plane, random_targets(plane, 300, 1), allocator="optimal")
    moved = free.target_of_positioner >= 0
    assert not np.isin(rs.find_collisions(plane, free).obstacle_pairs[:, 0], np.flatnonzero(moved)).any()


@pytest.mark.parametrize("shape", ["circle", "polygon"])
def test_absent_arms_touch_no_obstacle(shape):
    circle, square = [[2, 0, 0.5]] * u.mm, [[1, -1], [3, -1], [3, 1], [1, 1]] * u.mm
    obstacles = {"obstacles": circle} if shape == "circle" else {"obstacle_polygons": [square]}
    plane = rs.FocalPlane([[0, 0], [30, 0]] * u.mm, DESI_LIKE, **obstacles)
    tips = [[np.nan, np.nan], [31, 3]] * u.mm
    assert len(rs.find_collisions(plane, tips, parked_obstacles=False).obstacle_pairs) == 0
    assert len(rs.collision.find_motion(plane, tips, parked_obstacles=False).obstacle_pairs) == 0
    assert len(rs.find_collisions(plane, [[3, 0], [31, 3]] * u.mm).obstacle_pairs) == 1


def test_probability_with_obstacles_is_that_of_capsules():
    capsule, outline = (replace(plane, obstacles=[[11, 6, 3], [-20, 5, 2]] * u.mm) for plane in planes(rings=2))
    options = {"precision": rs.probability.Precision(max_iterations=16, standard_error=None), "rng": 1}
    for method in ("conditional", "quadrature"):
        values = [rs.collision_probability(plane, method=method, **options).value for plane in (capsule, outline)]
        assert values[0] == pytest.approx(values[1], rel=1e-12)
