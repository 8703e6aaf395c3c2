"""The convex parts of a polygon: their union is the polygon, and each part is a valid part of an outline."""

import astropy.units as u
import numpy as np
import pytest
import shapely
from raising import refused

import rfpsurvey as rs


def random_polygon(rng, n: int) -> np.ndarray:
    """Return the vertices of a star-shaped polygon around the origin, most of which is not convex."""
    angle, radius = np.sort(rng.uniform(0, 2 * np.pi, n)), rng.uniform(0.3, 3, n)
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])


@pytest.mark.parametrize("seed", range(60))
def test_the_union_of_the_parts_is_the_polygon(seed):
    rng = np.random.default_rng(seed)
    points = random_polygon(rng, int(rng.integers(3, 25)))
    if np.diff(np.arctan2(*points.T[::-1])).max(initial=0) > 3:
        points = points[:, ::-1]
    polygon = shapely.Polygon(points)
    assert polygon.is_valid
    parts = rs.positioner.divide_polygon((points if seed % 2 else points[::-1]) * u.mm)
    shapes = [shapely.Polygon(part.to_value(u.mm)) for part in parts]
    assert sum(shape.area for shape in shapes) == pytest.approx(polygon.area, rel=1e-12)
    assert shapely.union_all(shapes).symmetric_difference(polygon).area < 1e-12
    for shape in shapes:
        assert shape.convex_hull.area == pytest.approx(shape.area, rel=1e-12)
    outline = rs.positioner.ArmOutline([part + [5, 0] * u.mm for part in parts])
    assert len(outline.parts) == len(parts) <= len(points) - 2


def test_a_convex_polygon_remains_one_part():
    angle = np.arange(12) * np.pi / 6
    (part,) = rs.positioner.divide_polygon(np.column_stack([np.cos(angle), np.sin(angle)]) * u.cm)
    assert part.unit == u.mm
    assert shapely.Polygon(part.value).area == pytest.approx(300)


def test_a_closed_polygon_with_straight_angles_is_divided():
    shape = [[0, 0], [2, 0], [4, 0], [4, 1], [1, 1], [1, 2], [1, 3], [0, 3], [0, 0]] * u.mm
    parts = rs.positioner.divide_polygon(shape)
    assert shapely.union_all([shapely.Polygon(part.value) for part in parts]).area == pytest.approx(6)


@pytest.mark.parametrize(
    "vertices",
    [[[0, 0], [1, 1], [1, 0], [0, 1]], [[0, 0], [1, 1]], [[0, 0], [1, 0], [2, 0]], [[0, 0], [1, np.nan], [1, 1]]],
)
def test_other_vertices_are_refused(vertices):
    refused("vertices must", rs.positioner.divide_polygon, vertices * u.mm)


def test_a_mirrored_outline_has_the_opposite_y():
    outline = rs.positioner.ArmOutline([[[0, -1], [3, -1], [3, 2]] * u.mm], [([[1, 2]] * u.mm, 1 * u.mm)])
    mirror = outline.mirrored()
    assert mirror.to_dict()["central"] == [{"vertices": [[1.0, -2.0]], "radius": 1.0}]
    assert sorted(mirror.parts[0][0].tolist()) == [[0.0, 1.0], [3.0, -2.0], [3.0, 1.0]]
    assert mirror.mirrored().to_dict() == outline.to_dict()
