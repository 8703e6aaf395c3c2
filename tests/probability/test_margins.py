from dataclasses import replace

import astropy.units as u
import numpy as np
import pytest

import rfpsurvey as rs
from flat import collision_probability

ROBOT = rs.Positioner(3 * u.mm, 3 * u.mm, 0.9 * u.mm)
PLANE = rs.FocalPlane.hexagonal(ROBOT, rings=2, pitch=10.4 * u.mm)
MARGINS = rs.Margins(outer=0.6 * u.mm, inner=1 * u.mm)


def tips_of(plane):
    """Return the distances of the points of the quadrature from the nearest centers."""
    found = []

    def density(points):
        xy = points.to_value(u.mm)
        found.append(np.hypot(*(xy[:, None] - plane.xy.value).transpose(2, 0, 1)).min(axis=1))
        return np.ones(len(xy))

    rs.collision_probability(plane, method="quadrature", density=density)
    return np.concatenate(found)


def test_quadrature_integrates_over_the_area_inside_the_margins():
    r = tips_of(replace(PLANE, margins=MARGINS))
    assert 1 <= r.min() < 1.01
    assert 5.39 < r.max() <= 5.4


@pytest.mark.parametrize("margins", [MARGINS, rs.Margins(outer=0.6 * u.mm, broken=0.7 * u.mm)])
def test_methods_agree_with_margins(margins):
    """Simulation of one configuration after the other, and expectation over all targets of each positioner."""
    disabled = np.arange(len(PLANE)) % 6 == 1
    plane = replace(PLANE, margins=margins, disabled=disabled)
    options = {"targets": "uniform", "n_targets": 400, "precision": 0.002}
    one = collision_probability(plane, method="monte_carlo", rng=1, **options)
    two = collision_probability(plane, method="conditional", rng=2, **options)
    error = np.hypot(one.standard_error, two.standard_error)
    assert abs(one.value - two.value) < 4 * error
    plain = collision_probability(replace(plane, margins=None), method="conditional", rng=2, **options)
    assert two.value < plain.value - 4 * error


def test_circles_do_not_change_probabilities():
    plane = replace(PLANE, disabled=np.arange(len(PLANE)) == 3, hidden=[[0, 0, 2]] * u.mm)
    with_circles = replace(plane, margins=rs.Margins(outer=0.6 * u.mm, broken_factor=0.5, hidden_factor=2.0))
    without = replace(plane, hidden=None, margins=rs.Margins(outer=0.6 * u.mm))
    values = [rs.collision_probability(one, method="quadrature").value for one in (with_circles, without)]
    assert values[0] == values[1] > 0


@pytest.mark.parametrize("method", ["overlap_ratio", "close_pair"])
def test_formulas_use_the_radii_inside_the_margins(method):
    """A margin of the outer edges acts like shorter arms in formulas that depend only on the radii."""
    margined = replace(PLANE, margins=rs.Margins(outer=0.6 * u.mm))
    shorter = replace(PLANE, positioner=replace(ROBOT, central_arm=2.7 * u.mm, eccentric_arm=2.7 * u.mm))
    values = [rs.collision_probability(one, method=method).value for one in (margined, shorter, PLANE)]
    assert values[0] == pytest.approx(values[1], rel=1e-12)
    assert values[0] != values[2]


@pytest.mark.parametrize(
    ("method", "margins"), [("closed_form", {"outer": 0.1 * u.mm}), ("overlap_ratio", {"broken": 0.2 * u.mm})]
)
def test_formulas_refuse_margins_that_they_do_not_contain(method, margins):
    with pytest.raises(rs.InputError, match=f"must be 0 for the method '{method}'.*use the method quadrature"):
        rs.collision_probability(replace(PLANE, margins=rs.Margins(**margins)), method=method)


def test_the_closed_form_contains_the_margin_of_arms():
    robot = replace(ROBOT, clearance=1.2 * u.mm)
    one, two = replace(PLANE, margins=rs.Margins(arms=0.3 * u.mm)), replace(PLANE, positioner=robot)
    values = [rs.collision_probability(plane, method="closed_form").value for plane in (one, two)]
    assert values[0] == pytest.approx(values[1], rel=1e-12)
