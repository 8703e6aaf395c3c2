import astropy.units as u
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from raising import refused

import rfpsurvey as rs
from oracles import tip_and_elbow
from strategies import angles, lengths

MM = u.mm


def robot(l1=7.4, l2=15.0, **options):
    return rs.Positioner(l1 * MM, l2 * MM, 2 * MM, **options)


@given(lengths, lengths, angles, st.floats(0, np.pi))
def test_forward_agrees_with_complex_numbers(l1, l2, theta, phi):
    tip, _ = tip_and_elbow((0, 0), l1, l2, theta, phi)
    got = robot(l1, l2).forward([theta] * u.rad, [phi] * u.rad)[0].value
    np.testing.assert_allclose(got, [tip.real, tip.imag], atol=1e-13)


@given(lengths, lengths, angles, st.floats(0, 1), st.sampled_from(["right", "left"]))
def test_inverse_then_forward_comes_back(l1, l2, alpha, part, side):
    unit = robot(l1, l2, handedness=side)
    inner, outer = unit.inner_radius.value, unit.outer_radius.value
    r = inner + part * (outer - inner)
    xy = [[r * np.cos(alpha), r * np.sin(alpha)]] * MM
    theta, phi = unit.inverse(xy)
    assert np.isfinite(theta.value).all()
    low, high = (0, 180) if side == "right" else (-180, 0)
    assert low <= phi[0].value <= high
    np.testing.assert_allclose(unit.forward(theta, phi).value, xy.value, atol=1e-11)


def test_edges_are_in_reach_and_beyond_is_not():
    unit = robot()
    outer, inner = 22.4, 7.6
    theta, phi = unit.inverse([[outer, 0], [0, inner], [outer + 1e-9, 0], [inner - 1e-9, 0], [0, 0]] * MM)
    assert np.isfinite(theta.value).tolist() == [True, True, False, False, False]
    np.testing.assert_allclose(phi[:2].value, [0, 180], atol=1e-5)


def test_equal_arms_reach_their_center_at_home():
    unit = robot(8.25, 8.25, home=[30, 180] * u.deg)
    theta, phi = unit.inverse([[0, 0]] * MM)
    assert (theta[0].value, phi[0].value) == pytest.approx((30, 180))
    assert unit.equal_arms
    assert unit.inner_radius == 0 * MM
    assert not robot().equal_arms


def test_left_is_the_mirror_image_of_right():
    xy = np.array([[10.0, 5.0], [-12, 3], [0, -20]])
    theta_r, phi_r = robot().inverse(xy * MM)
    theta_l, phi_l = robot(handedness="left").inverse(xy * [1, -1] * MM)
    np.testing.assert_allclose(theta_l.value, -theta_r.value)
    np.testing.assert_allclose(phi_l.value, -phi_r.value)


def test_joint_limits_cut_the_patrol_area_and_both_hands_widen_it():
    theta, phi = robot(phi_range=[30, 180] * u.deg).inverse([[22.3, 0], [15, 0]] * MM)
    assert np.isnan(theta[0].value)
    assert phi[1].value >= 30
    quarter, xy = {"theta_range": [-10, 100] * u.deg}, [[0, 15.0], [15, 0], [-15, 0]] * MM
    right, left, both = (robot(handedness=h, **quarter).inverse(xy)[0].value for h in ("right", "left", "both"))
    np.testing.assert_array_equal(np.isfinite(both), np.isfinite(right) | np.isfinite(left))
    assert np.isfinite(right).tolist() == [True, False, False]
    assert np.isfinite(left).tolist() == [False, True, False]
    assert ((both[:2] >= -10) & (both[:2] <= 100)).all()


def test_joint_limits_hold_up_to_whole_turns():
    unit = robot(theta_range=[350, 380] * u.deg)
    theta, _ = unit.inverse(unit.forward([-5, 15, 25] * u.deg, [90, 90, 90] * u.deg))
    np.testing.assert_allclose(theta[:2].value, [-5, 15], atol=1e-9)
    assert np.isnan(theta[2].value)


def test_home_is_folded_or_as_near_as_the_joints_allow():
    assert robot().numbers.home.tolist() == [0, np.pi]
    limited = robot(theta_range=[20, 300] * u.deg, phi_range=[-150, 140] * u.deg)
    np.testing.assert_allclose(np.rad2deg(limited.numbers.home), [20, -150])
    with pytest.raises(rs.InputError, match=r"theta and phi must have the shape \(n,\), got \(2,\) and \(3,\)"):
        robot().forward([1, 2] * u.deg, [1, 2, 3] * u.deg)


def test_safe_distance():
    """The minimum separation (7.4 + 15) sin(0.2 deg) + 5 mm is the published value of 5.078 mm."""
    unit = rs.Positioner(7.4 * MM, 15 * MM, 2.5 * MM, step=0.1 * u.deg)
    assert unit.min_separation.value == pytest.approx(5.0782, abs=5e-5)
    assert rs.Positioner(8.25 * MM, 8.25 * MM, 2.25 * MM).min_separation == 4.5 * MM
    assert rs.Positioner(8 * MM, 9 * MM, 2 * MM, displacement=0.5 * MM).min_separation == 4.5 * MM


BAD_INPUT = [
    ({"central_arm": 7.4}, "central_arm must be a Quantity with a unit convertible to mm, got 7.4"),
    ({"central_arm": 7.4 * u.deg}, "central_arm must have a unit convertible to mm, got deg"),
    ({"eccentric_arm": 0 * MM}, "eccentric_arm must be one finite value above 0 mm and below 1e.06 mm, got 0"),
    ({"clearance": -1 * MM}, r"clearance must be one finite value of at least 0 mm and below 1e\+06 mm, got -1"),
    ({"clearance": np.nan * MM}, r"clearance must be one finite value of at least 0 mm and below 1e\+06 mm, got nan"),
    ({"step": 50 * u.deg}, "step must be one finite value of at least 0 rad and below 0.785398 rad"),
    ({"handedness": "rigth"}, "unknown handedness 'rigth'.* Did you mean 'right'"),
    ({"theta_range": [3, 1] * u.deg}, "theta_range must be .low, high."),
    ({"home": 5 * u.deg}, "home must be two finite angles"),
    ({"home": [0, 180] * u.deg, "phi_range": [0, 90] * u.deg}, "home must lie within the joint limits"),
    ({"arm_model": "capsule"}, "arm_length must be given for the arm model 'capsule'"),
    ({"arm_length": 5 * MM}, "arm_length must be given for the arm model 'capsule'"),
    ({"arm_angle": 5 * u.deg}, "arm_angle must be given only for the arm model"),
]


@pytest.mark.parametrize(("arguments", "message"), BAD_INPUT)
def test_bad_input_is_named(arguments, message):
    good = {"central_arm": 7.4 * MM, "eccentric_arm": 15 * MM, "clearance": 2 * MM}
    refused(message, lambda: rs.Positioner(**{**good, **arguments}))


def test_bad_points_are_named():
    refused(r"xy must have the shape \(n, 2\), got \(2,\)", lambda: robot().inverse([1, 2] * MM))
    refused("xy must be a Quantity", lambda: robot().inverse([[1, 2]]))
