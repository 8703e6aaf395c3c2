"""Poses of arms and their collisions, compared with a slow computation that tests each arm against all other arms."""

import pickle

import astropy.units as u
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from raising import refused

import rfpsurvey as rs
from oracles import collisions_of, standing_arms
from rfpsurvey._kernels import collisions
from rfpsurvey.collision import place_arms
from scenes import MM, SCENES, random_tips


@pytest.mark.parametrize("name", SCENES)
def test_arms_and_collisions_are_those_of_slow_geometry(name, rng):
    plane, options = SCENES[name]
    n_pairs = n_hits = 0
    for _ in range(8):
        tips = random_tips(plane, rng, 0.8)
        expected, assigned, counted = standing_arms(plane, tips.value, **options)
        posed = place_arms(plane, tips, **options)
        np.testing.assert_array_equal(posed.assigned, assigned)
        np.testing.assert_array_equal(posed.parked, counted & ~assigned)
        turn = np.exp(1j * np.array([posed.theta, posed.theta + posed.phi]))
        tip = plane.arrays.xy @ [1, 1j] + plane.arrays.central_arm * turn[0] + plane.arrays.eccentric_arm * turn[1]
        np.testing.assert_allclose(posed.tip @ [1, 1j], tip, atol=1e-6)  # idle arms also have angles
        np.testing.assert_array_equal(posed.present, [arm is not None for arm in expected])
        for segment, arm in zip(posed.segments, expected, strict=True):
            if arm is not None:
                np.testing.assert_allclose(segment, [arm[0].real, arm[0].imag, arm[1].real, arm[1].imag], atol=2e-7)
        equal = posed.parked & plane.arrays.equal_arms & (plane.positioner.numbers.home[1] == np.pi)
        np.testing.assert_array_equal(posed.tip[equal], plane.arrays.xy[equal])  # the positions are exactly equal
        pairs, hits = collisions_of(plane, expected)
        again = {k: v for k, v in options.items() if k != "handedness"}
        for report in (
            rs.find_collisions(plane, tips, **options),
            rs.find_collisions(plane, posed),
            rs.find_collisions(
                plane,
                theta=np.where(assigned, posed.theta, np.nan) * u.rad,
                phi=np.where(assigned, posed.phi, np.nan) * u.rad,
                **again,
            ),
        ):
            assert (report.pairs.tolist(), report.obstacle_pairs.tolist()) == (pairs, hits)
            np.testing.assert_array_equal(report.assigned, assigned)
            np.testing.assert_array_equal(report.counted, counted)
            assert np.flatnonzero(report.in_collision).tolist() == sorted({*np.ravel(pairs), *(i for i, _ in hits)})
        n_pairs, n_hits = n_pairs + len(pairs), n_hits + len(hits)
    assert n_pairs > 2
    assert bool(n_hits) == (plane.obstacles is not None)


def test_tips_of_units_that_take_none_do_not_matter(rng):
    """The pose of a disabled or stuck positioner does not change if its row contains a target far out of reach."""
    plane, _ = SCENES["troubles"]
    tips = random_tips(plane, rng)
    before = rs.find_collisions(plane, tips)
    tips[~plane.arrays.usable] += 500 * MM
    np.testing.assert_array_equal(rs.find_collisions(plane, tips).pairs, before.pairs)
    counts = [
        rs.collision.count_collisions(plane, t[None])
        for t in (tips, np.where(plane.arrays.usable[:, None], tips, np.nan))
    ]
    assert counts[0].n_pairs == counts[1].n_pairs == [len(before.pairs)]
    turned = rs.find_collisions(plane, theta=np.zeros(len(plane)) * u.rad, phi=np.zeros(len(plane)) * u.rad)
    np.testing.assert_array_equal(turned.assigned, plane.arrays.usable)


def test_arms_of_another_focal_plane_are_refused():
    plane, _ = SCENES["equal arms"]
    posed = place_arms(plane, plane.xy)
    elsewhere = rs.FocalPlane(plane.xy + 30 * MM, plane.positioner)
    refused("the arms belong to another focal plane: 37 elbows", rs.find_collisions, elsewhere, posed)
    with pytest.raises(
        rs.InputError, match="the arms must belong to the 7 positioners of the focal plane, got the arms of 37"
    ):
        rs.find_collisions(rs.FocalPlane.hexagonal(plane.positioner, rings=1, pitch=25.6 * MM), posed)


@given(st.integers(0, 2**32 - 1))
def test_runs_are_the_neighbors_and_nothing_else(seed):
    rng, unit = np.random.default_rng(seed), rs.Positioner(8 * MM, 8 * MM, 2 * MM)
    n = int(rng.integers(1, 40))
    xy = np.unique(rng.integers(0, 12, (n, 2)), axis=0) * rng.choice([9.0, 15.0, 25.0])
    plane = rs.FocalPlane(xy * MM, unit)
    runs = [(i + k, j + k) for i, j, length in plane.arrays.runs.tolist() for k in range(length)]
    apart = np.hypot(*(xy[:, None] - xy[None]).transpose(2, 0, 1))
    expected = [(i, j) for i in range(len(xy)) for j in range(i + 1, len(xy)) if apart[i, j] < 36 + 1e-9]
    assert sorted(runs) == expected == [tuple(p) for p in plane.arrays.neighbors.tolist()]


@given(st.floats(0.1, 50), st.floats(0.1, 50), st.floats(0, 1e6))
def test_limits_leave_room_for_the_proven_error(separation, length, extent):
    limits = collisions.limits(separation, length, extent)
    u, size = 2.0**-53, 2 * length + separation
    error = 20 * u * size
    assert limits.band >= (separation + error) ** 2 - separation**2
    assert limits.band < 4 * error * (separation + error)
    # each midpoint has rounding errors of two ends, their sum and their difference, in x and y
    assert limits.slack > 6 * u * (extent + size)
    assert limits.near >= length + separation + limits.slack


def test_joint_angles_are_computed_on_first_use_and_survive_pickling(small):
    plane = small.focal_plane
    tips = plane.xy + [5, 0] * u.mm
    tips[3] = np.nan
    posed = place_arms(plane, tips)
    tips[0] = np.nan  # has no effect on the result
    assert "_angles" not in vars(posed)
    copy = pickle.loads(pickle.dumps(posed))
    assert copy.find_angles is None
    for arms in (posed, copy):
        theta, phi = plane.arrays.home[:, 3]
        assert (arms.theta[3], arms.phi[3]) == (theta, phi)
        again = place_arms(plane, theta=arms.theta * u.rad, phi=arms.phi * u.rad)
        np.testing.assert_allclose(again.tip[:3], posed.tip[:3], atol=1e-9)
        np.testing.assert_array_equal(again.theta, arms.theta)
