"""Arms that touch or cross collide if the minimum separation is 0."""

import astropy.units as u
import numpy as np
import pytest

import rfpsurvey as rs
from rfpsurvey.collision import METHODS

LENGTH = 8.0
BASES = np.array([[0.0, 0.0], [20.0, 0.0]])


def plane(clearance):
    return rs.FocalPlane(BASES * u.mm, rs.Positioner(LENGTH * u.mm, LENGTH * u.mm, clearance * u.mm))


def turn(p, q, r):
    return np.sign((q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0]))


def cross(first, second):
    apart = turn(*first, second[0]) * turn(*first, second[1]) < 0
    return bool(apart and turn(*second, first[0]) * turn(*second, first[1]) < 0)


@pytest.fixture(scope="module")
def tips():
    rng = np.random.default_rng(1)
    near = np.column_stack([rng.uniform(5, 14, 400), rng.uniform(-5, 5, 400)])
    far = np.column_stack([20 - rng.uniform(5, 14, 400), rng.uniform(-5, 5, 400)])
    return np.stack([near, far], axis=1)


@pytest.fixture(scope="module")
def crossing(tips):
    found = []
    for both in tips:
        theta = plane(0).inverse(both * u.mm)[0].to_value(u.rad)
        elbows = BASES + LENGTH * np.column_stack([np.cos(theta), np.sin(theta)])
        found.append(cross((elbows[0], both[0]), (elbows[1], both[1])))
    return np.array(found)


@pytest.mark.parametrize("clearance", [0, 1e-9])
def test_arms_that_cross_collide(tips, crossing, clearance):
    """Regression: no arms were closer than 0, so that arms without a clearance never collided."""
    assert 20 < crossing.sum() < 100
    found = [len(rs.find_collisions(plane(clearance), both * u.mm).pairs) > 0 for both in tips]
    np.testing.assert_array_equal(found, crossing)


@pytest.mark.parametrize("clearance", [0, 1e-9])
def test_configurations_are_counted(tips, crossing, clearance):
    found = rs.collision.count_collisions(plane(clearance), tips * u.mm)
    np.testing.assert_array_equal(found.n_pairs, crossing)


def test_arms_whose_fibers_meet_collide():
    both = [[10.0, 0.0], [10.0, 0.0]] * u.mm
    assert rs.find_collisions(plane(0), both).pairs.tolist() == [[0, 1]]
    assert len(rs.find_collisions(plane(0), both + [[0, 0], [0, 2**-40]] * u.mm).pairs) == 0
    tip_only = rs.Positioner(LENGTH * u.mm, LENGTH * u.mm, 0 * u.mm, arm_model="fiber_tip")
    assert len(rs.find_collisions(rs.FocalPlane(BASES * u.mm, tip_only), both).pairs) == 1


@pytest.mark.parametrize("allocator", ["repair", "optimal"])
def test_plans_contain_no_arms_that_cross(tips, crossing, allocator):
    for both, crosses in zip(tips[:60], crossing[:60], strict=True):
        plan = rs.allocate(plane(0), both * u.mm, allocator=allocator)
        assert len(rs.find_collisions(plane(0), plan).pairs) == 0
        assert plan.target_of_positioner.min() >= 0 or crosses


@pytest.mark.parametrize("method", ["conditional", "monte_carlo", "quadrature"])
def test_the_collision_probability_is_the_limit_of_small_clearances(method):
    def value(clearance):
        arms = rs.Positioner(LENGTH * u.mm, LENGTH * u.mm, clearance * u.mm)
        lattice = rs.FocalPlane.hexagonal(arms, pitch=17 * u.mm, rings=1)
        return rs.collision_probability(lattice, method=method, rng=1, precision=0.02).value

    assert value(0) == pytest.approx(value(1e-9), abs=1e-12)
    assert value(0) > 0.005


def test_methods_that_sample_arms_are_unchanged(tips):
    assert {"sampled", "scipy"} < {*METHODS}
    for name in ("sampled", "scipy"):
        assert not any(len(rs.find_collisions(plane(0), both * u.mm, method=name).pairs) for both in tips[:30])
