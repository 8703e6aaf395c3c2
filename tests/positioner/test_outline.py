"""The shapes of arms: normalization of polygons, and errors."""

import astropy.units as u
import numpy as np
import pytest
from raising import refused

import rfpsurvey as rs

SQUARE = np.array([[0, 0], [2, 0], [2, 2], [0, 2]], dtype=float)


def vertices(part, **options):
    return rs.positioner.ArmOutline([part * u.mm], **options).parts[0][0]


@pytest.mark.parametrize("order", [[0, 1, 2, 3], [3, 2, 1, 0], [2, 3, 0, 1], [0, 1, 2, 3, 0]])
def test_polygons_become_counter_clockwise(order):
    np.testing.assert_array_equal(vertices(SQUARE[order]), SQUARE)


def test_vertices_on_straight_edges_and_repeated_vertices_are_left_out():
    found = vertices([[0, 0], [1, 0], [2, 0], [2, 1e-12], [2, 2], [0, 2]])
    np.testing.assert_allclose(found, SQUARE, atol=1e-11)
    np.testing.assert_array_equal(vertices([[0, 0], [1, 0], [3, 0]]), [[0, 0], [3, 0]])
    np.testing.assert_array_equal(vertices([[1, 0], [1, 0]]), [[1, 0]])


NOT_CONVEX = [
    SQUARE[[0, 2, 1, 3]],
    [[0, 0], [4, 0], [4, 4], [2, 1], [0, 4]],
    [[0, 0], [4, 0], [2, 1e-6], [0, 4]],
    [[0, 1], [4, 2], [0, 3], [3, 0], [3, 4]],
    [[0, 0], [3, 0], [1, 0], [2, 0]],
]


@pytest.mark.parametrize("part", NOT_CONVEX)
def test_a_part_that_is_not_convex_is_refused(part):
    with pytest.raises(rs.InputError, match=r"central\[1\] must be a convex polygon.*divide_polygon divides other"):
        rs.positioner.ArmOutline([SQUARE * u.mm], central=[SQUARE * u.mm, np.array(part) * u.mm])


WRONG_PARTS = [
    (([],), "eccentric must contain at least one part"),
    ((SQUARE * u.mm,), "eccentric must be a list of parts"),
    (([SQUARE],), r"eccentric\[0\] must be a Quantity"),
    (([SQUARE * u.s],), r"eccentric\[0\] must have a unit"),
    (([np.zeros((0, 2)) * u.mm],), r"eccentric\[0\] must be finite vertices"),
    (([SQUARE[:, :1] * u.mm],), r"eccentric\[0\] must have the shape"),
    (([SQUARE * np.nan * u.mm],), r"eccentric\[0\] must be finite vertices"),
    (([SQUARE * 1e6 * u.mm],), "below 1e\\+06 mm"),
    (([(SQUARE * u.mm, -1 * u.mm)],), r"the radius of eccentric\[0\]"),
    (([(SQUARE * u.mm, 1.0)],), r"the radius of eccentric\[0\] must be a Quantity"),
    (([(SQUARE - [5, 0]) * u.mm],), "a vertex with x above 0"),
    (([SQUARE * u.mm], [SQUARE]), r"central\[0\] must be a Quantity"),
]


@pytest.mark.parametrize(("arguments", "message"), WRONG_PARTS)
def test_wrong_parts_are_refused(arguments, message):
    refused(message, lambda: rs.positioner.ArmOutline(*arguments))


def test_units_and_radii():
    outline = rs.positioner.ArmOutline([(SQUARE * u.cm, 100 * u.um)], [([[0, 0]] * u.mm, 1 * u.cm)])
    assert outline.parts[0][0].max() == 20
    assert [radius for _, radius in outline.parts] == pytest.approx([0.1, 10])
    assert outline.length == 20 * u.mm
    assert repr(outline) == "<ArmOutline: 1 eccentric part, 1 central part, length 20 mm>"


def test_the_offset_contains_the_central_parts_for_all_lengths_of_the_central_arm():
    from rfpsurvey._instruments.outline import make_outline

    outline = rs.positioner.ArmOutline([[[0, -1], [4, 0], [0, 1]] * u.mm], central=[[[-1, 0], [0, 0]] * u.mm])
    made = make_outline(outline, np.zeros((2, 2)), np.array([3.0, 5.0]))
    assert made.offset == pytest.approx(1 + 6, rel=1e-9)
