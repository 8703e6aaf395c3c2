"""Blank sky in gaps between the targets: its positions, and the positioners that observe it."""

from dataclasses import replace

import astropy.units as u
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial import cKDTree

import flat
import rfpsurvey as rs
from scenes import both_hands, lamost_like, sdss_like, two_fibers, with_troubles

MM = u.mm
FILLING = ["lamost_rule", "network_flow", "optimal", "repair"]
UNIT = rs.Positioner(8.25 * MM, 8.25 * MM, 2.25 * MM)
LIMITED = {"theta_range": [-120, 130] * u.deg, "phi_range": [20, 140] * u.deg}
PLANES = {
    "equal arms": lamost_like(),
    "unequal arms": sdss_like(),
    "joint limits": sdss_like(**LIMITED),
    "left with joint limits": lamost_like(handedness="left", phi_range=[-150, -30] * u.deg, home=[0, -150] * u.deg),
    "both hands": both_hands(),
    "troubles": with_troubles(lamost_like()),
    "units of their own": with_troubles(sdss_like()),
}


def targets(rng, n, half=85):
    xy = rng.uniform(-half, half, (n, 2))
    xy[: n // 20] = np.nan
    return xy


def blank_of(found):
    """Return the positioners that observe blank sky, and the rows of these positions among the targets."""
    own = np.flatnonzero(found.target_of_positioner >= found.n_given)
    return own, found.target_of_positioner[own]


def check_columns(found, xy):
    """Check that the rows of blank sky follow the given rows, and that each of them is assigned once."""
    own, rows = blank_of(found)
    n = len(xy)
    assert found.n_given == n
    assert len(found.xy) == len(found.positioner_of_target) == n + len(own)
    np.testing.assert_array_equal(found.xy[:n].value, xy)
    assert sorted(rows) == list(range(n, n + len(own)))
    used, expected = np.flatnonzero(found.target_of_positioner >= 0), np.full(n + len(own), -1)
    expected[found.target_of_positioner[used]] = used
    np.testing.assert_array_equal(found.positioner_of_target, expected)
    np.testing.assert_array_equal(found.tips[used].value, found.xy[found.target_of_positioner[used]].value)
    assert np.isnan(found.tips[found.target_of_positioner < 0].value).all()


@pytest.mark.parametrize("method", FILLING)
@pytest.mark.parametrize("name", PLANES)
def test_found_sky_is_blank_and_in_reach(name, method, rng):
    plane = PLANES[name]
    xy, separation = targets(rng, {"lamost_rule": 150, "network_flow": 60}.get(method, 100)), 4.0
    found = flat.allocate(plane, xy * MM, method, requirements="sky=20", sky_separation=separation * MM)
    check_columns(found, xy)
    own, rows = blank_of(found)
    stuck = plane.arrays.is_stuck[own]
    assert len(own) >= 10
    tree, points = cKDTree(xy[np.isfinite(xy[:, 0])]), found.xy[rows].to_value(MM)
    assert tree.query(points)[0].min() >= separation
    r = np.hypot(*(points - plane.arrays.xy[own]).T)
    l1 = np.full(37, plane.positioner.central_arm.value)
    l2 = plane.positioner.eccentric_arm.value if plane.eccentric_arm is None else plane.eccentric_arm.value
    inner, outer = (np.abs(l1 - l2) * np.ones(37))[own], (l1 + l2)[own]
    assert (r <= outer * (1 + 1e-12)).all()
    assert (r[~stuck] >= inner[~stuck]).all()
    assert not plane.disabled[own].any()
    assert plane.reachable(found.xy).toarray()[own[~stuck], rows[~stuck]].all()
    posed, unit = found.place_arms(plane), plane.positioner
    if unit.phi_range is not None:
        low, high = unit.phi_range.to_value(u.rad)
        assert ((posed.phi[own] >= low - 1e-9) & (posed.phi[own] <= high + 1e-9)).all()
    if unit.theta_range is not None:
        low, high = unit.theta_range.to_value(u.rad)
        turned = (posed.theta[own] - low) % (2 * np.pi)
        assert ((turned <= high - low + 1e-9) | (turned >= 2 * np.pi - 1e-9)).all()
    np.testing.assert_allclose(posed.tip[own], points, atol=1e-9)
    rs.find_collisions(plane, found)


@given(st.integers(0, 10**6), st.integers(0, 60), st.floats(0.1, 40), st.sampled_from(sorted(PLANES)))
def test_whatever_the_separation_it_is_kept(seed, n, separation, name):
    rng = np.random.default_rng(seed)
    xy = rng.uniform(-60, 60, (n, 2)).round(int(rng.integers(0, 3)))
    found = flat.allocate(PLANES[name], xy * MM, "lamost_rule", requirements="sky=37", sky_separation=separation * MM)
    check_columns(found, xy)
    own, rows = blank_of(found)
    if n and len(own):
        assert cKDTree(xy).query(found.xy[rows].to_value(MM))[0].min() >= separation * (1 - 1e-12)
    n_able = 37 - PLANES[name].disabled.sum()
    assert (len(own) > 25) | (n * separation > 20)
    assert len(own) <= n_able


@pytest.mark.parametrize("separation", [2.0, 6.0, 11.0])
def test_gaps_are_found_where_there_are_any(separation, rng):
    """A dense sample of a patrol area shows whether it contains a sufficiently wide gap."""
    plane, xy = lamost_like(), rng.uniform(-85, 85, (180, 2))
    found = flat.allocate(plane, xy * MM, "lamost_rule", requirements="sky=37", sky_separation=separation * MM)
    sees = set(blank_of(found)[0].tolist())
    grid = np.stack(np.meshgrid(*2 * [np.arange(-16.4, 16.5, 0.4)]), axis=-1).reshape(-1, 2)
    grid = grid[np.hypot(*grid.T) < 16.4]
    part = np.array([(cKDTree(xy).query(grid + c)[0] > separation).mean() for c in plane.arrays.xy])
    assert all(i in sees for i in np.flatnonzero(part > 0.06))
    assert not any(
        i in sees
        for i in np.flatnonzero(part == 0)
        if (cKDTree(xy).query(grid + plane.arrays.xy[i])[0].max() < separation - 0.3)
    )
    assert 37 >= len(sees) >= (part > 0.06).sum() > 0 or separation > 10


@pytest.mark.filterwarnings("ignore:sky_separation has no effect")
@pytest.mark.parametrize("method", FILLING)
@pytest.mark.parametrize("requirements", [None, "standard=3", "sky=0", "sky=-5", "sky_boss=3", "science=3"])
def test_nothing_is_found_that_nobody_asks_for(requirements, method, rng):
    xy, options = targets(rng, 20), {"method": method, "requirements": requirements}
    found = flat.allocate(two_fibers(), xy * MM, sky_separation=3 * MM, **options)
    without = flat.allocate(two_fibers(), xy * MM, **options)
    assert len(found.xy) == found.n_given == 20
    np.testing.assert_array_equal(found.target_of_positioner, without.target_of_positioner)


@pytest.mark.parametrize("method", FILLING)
def test_without_a_separation_nothing_is_invented(method, rng):
    xy = targets(rng, 30)
    found = rs.allocate(lamost_like(), xy * MM, allocator=rs.AllocationOptions(method, requirements="sky=20"))
    assert len(found.xy) == 30
    assert [str(s) for s in found.unmet] == ["sky targets: 0 of 20, 20 missing; none is in reach"]


@pytest.mark.parametrize("separation", [0 * MM, -1 * MM, np.nan * MM, 3, [1, 2] * MM, 3 * u.s])
def test_a_separation_is_a_length(separation):
    with pytest.raises(rs.InputError, match="sky_separation.* must"):
        flat.allocate(lamost_like(), [[0, 0]] * MM, "balanced", requirements="sky=1", sky_separation=separation)


@pytest.mark.parametrize("method", FILLING)
def test_sky_that_is_given_counts_and_found_sky_adds_to_it(method):
    plane = rs.FocalPlane([[0, 0], [40, 0], [80, 0]] * MM, UNIT)
    xy = [[5, 0], [45, 0], [3, 3], [85, 0]] * MM
    found = rs.allocate(
        plane,
        xy,
        allocator=rs.AllocationOptions(method, requirements="sky=2", sky_separation=2 * MM),
        kind=["science", "science", "sky", "science"],
        priority=[3, 2, 0, 1],
        forbidden=[[0, 2]],
    )
    assert (found.unmet, found.target_of_positioner[0]) == ((), 0)
    assert sorted(found.target_of_positioner[1:]) == [4, 5]
    found = flat.allocate(
        plane, xy, method, requirements="sky=3", sky_separation=2 * MM, kind=["sky", "sky", "sky", "sky"]
    )
    assert (found.unmet, found.n_assigned) == ((), 3)


@pytest.mark.parametrize("method", FILLING)
def test_each_fiber_type_has_sky_of_its_own(method, rng):
    plane = replace(two_fibers(), fiber_type=["B+A"] * 12 + ["A"] * 13 + ["B"] * 12)
    xy, fiber = targets(rng, 80), rng.choice(["A", "B", ""], 80)
    found = flat.allocate(
        plane, xy * MM, method, requirements=["sky@A=7", "sky@B=8"], sky_separation=2 * MM, fiber_type=fiber
    )
    check_columns(found, xy)
    assert found.unmet == ()
    own, rows = blank_of(found)
    wanted = found.target_fiber_type[rows]
    np.testing.assert_array_equal(found.fiber_type[own], wanted)
    assert all(name in plane.fiber_type[i].split("+") for i, name in zip(own, wanted, strict=True))
    assert (wanted == "A").sum() >= 7
    assert (wanted == "B").sum() >= 8
    np.testing.assert_array_equal(found.target_fiber_type[:80], fiber)


@pytest.mark.parametrize("method", FILLING)
def test_spectrographs_of_their_own_get_sky_of_their_own(method, rng):
    plane = replace(two_fibers(), spectrograph=np.column_stack([np.arange(37) % 2, np.arange(37) % 3]))
    xy, requirements = targets(rng, 60), ["sky@A=2/spectrograph", "sky@B=3/spectrograph"]
    found = flat.allocate(plane, xy * MM, method, requirements=requirements, sky_separation=2 * MM)
    own, rows = blank_of(found)
    columns = plane.spectrograph[own, [plane.fiber_types.index(name) for name in found.target_fiber_type[rows]]]
    counts = {
        (name, place): int(((found.target_fiber_type[rows] == name) & (columns == place)).sum())
        for name in "AB"
        for place in range(3)
    }
    lacking = {(s.requirement.fiber_type, s.spectrograph): s.found for s in found.unmet}
    for (name, place), n in counts.items():
        assert n == lacking[name, place] if (name, place) in lacking else n >= {"A": 2, "B": 3}[name]
    # fiber type B belongs only to spectrographs 0 and 1
    assert (set(lacking), lacking["B", 2]) == ({("B", 2)}, 0)


def one_stuck(theta=30, phi=100):
    """Return two positioners, the first of which is stuck, and the position of its fiber."""
    theta, phi = np.deg2rad([theta, phi])
    tip = 8.25 * np.array([np.cos(theta) + np.cos(theta + phi), np.sin(theta) + np.sin(theta + phi)])
    stuck = [[np.rad2deg(theta), np.rad2deg(phi)], [np.nan, np.nan]] * u.deg
    return rs.FocalPlane([[0, 0], [60, 0]] * MM, UNIT, stuck=stuck, spectrograph=[1, 2]), tip


@pytest.mark.parametrize("method", ["balanced", "nearest", *FILLING])
def test_a_stuck_fiber_that_looks_at_blank_sky_is_a_sky_fiber(method):
    plane, tip = one_stuck()
    xy = [tip + [0, 2.01], [62, 0]] * MM
    found = rs.allocate(plane, xy, allocator=rs.AllocationOptions(method, requirements="sky=1", sky_separation=2 * MM))
    assert (found.target_of_positioner.tolist(), found.unmet) == ([2, 1], ())
    np.testing.assert_allclose(found.tips[0].value, tip, atol=1e-12)
    check_columns(found, xy.value)
    again = flat.allocate(plane, xy, method, requirements="sky=1/spectrograph", sky_separation=2 * MM)
    if method in FILLING:
        assert (sorted(again.target_of_positioner), again.unmet) == ([2, 3], ())
    else:
        assert again.target_of_positioner.tolist() == [2, 1]
        assert [(s.spectrograph, s.found) for s in again.unmet] == [(2, 0)]


@pytest.mark.parametrize("method", FILLING)
def test_a_stuck_fiber_that_looks_at_a_target_is_none(method):
    plane, tip = one_stuck()
    xy = [tip + [0, 1.99], [61, 0]] * MM
    found = rs.allocate(
        plane, xy, allocator=rs.AllocationOptions(method, requirements="sky=1/spectrograph", sky_separation=2 * MM)
    )
    assert found.target_of_positioner.tolist() == [-1, 2]
    assert [str(s) for s in found.unmet] == ["sky targets in spectrograph 1: 0 of 1, 1 missing; none is in reach"]
    alone = replace(plane, stuck=[[30, 100], [0, 180]] * u.deg)
    found = rs.allocate(alone, xy, allocator=rs.AllocationOptions(method, requirements="sky=2", sky_separation=2 * MM))
    assert found.target_of_positioner.tolist() == [-1, -1]
    found = flat.allocate(alone, xy[:1], method, requirements="sky=2", sky_separation=2 * MM)
    assert [str(s) for s in found.unmet] == ["sky targets: 1 of 2, 1 missing; only 1 is in reach"]


@pytest.mark.parametrize("method", FILLING)
def test_a_stuck_fiber_serves_one_fiber_type(method):
    plane = rs.FocalPlane([[0, 0], [60, 0]] * MM, UNIT, stuck=[[0, 90], [90, 90]] * u.deg, fiber_type=["A+B", "B"])
    found = flat.allocate(
        plane, np.empty((0, 2)) * MM, method, requirements=["sky@A=1", "sky@B=2"], sky_separation=2 * MM
    )
    assert found.fiber_type.tolist() == ["A", "B"]
    assert [str(s) for s in found.unmet] == ["sky targets for B: 1 of 2, 1 missing; only 1 is in reach"]


def test_found_sky_counts_where_the_given_sky_has_a_category_of_that_name():
    found = rs.allocate(
        lamost_like(rings=1),
        [[5, 0], [900, 0]] * MM,
        allocator=rs.AllocationOptions("network_flow", requirements="sky=3", sky_separation=2 * MM),
        kind=["science", "sky"],
        category=["galaxy", "sky"],
    )
    assert found.unmet == ()


def test_found_sky_does_not_hide_sky_of_the_catalog():
    plane = rs.FocalPlane([[0, 0], [25.6, 0]] * MM, rs.Positioner(8.25 * MM, 8.25 * MM, 2.25 * MM))
    options = {"kind": ["sky", "sky"], "category": ["sky_a", "sky_a"], "requirements": ["sky=1-1"]}
    found = flat.allocate(plane, [[3, 3], [28, 3.0]] * MM, allocator="optimal", sky_separation=1 * MM, **options)
    assert found.n_assigned == 1


def test_a_separation_that_nobody_needs_is_said():
    plane = rs.FocalPlane([[0, 0]] * MM, rs.Positioner(8.25 * MM, 8.25 * MM, 2.25 * MM))
    with pytest.warns(
        rs.RfpsurveyWarning, match="sky_separation has no effect because no requirement counts sky positions"
    ):
        rs.allocate(plane, [[3, 3]] * MM, allocator=rs.AllocationOptions("balanced", sky_separation=1 * MM))
