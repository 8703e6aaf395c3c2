from dataclasses import replace
from fractions import Fraction

import astropy.units as u
import numpy as np
import pytest
import shapely
from outlined import DESI_LIKE, capsule, placed
from raising import refused

import rfpsurvey as rs
from flat import allocate
from rfpsurvey.allocation import METHODS

EQUAL = rs.Positioner(3 * u.mm, 3 * u.mm, 0.9 * u.mm)
UNEQUAL = rs.Positioner(7.4 * u.mm, 15 * u.mm, 2 * u.mm)
TIP = rs.Positioner(3 * u.mm, 3 * u.mm, 0.9 * u.mm, arm_model="fiber_tip")
CAPSULE = capsule(-3, 3)
HEXAGON = [[0, 0], [1, 0], [-1, 0], [0.5, 0.866], [-0.5, 0.866], [0.5, -0.866], [-0.5, -0.866]]


def scene(robot, **columns):
    """Return seven positioners, whose first one is stuck and whose second one is disabled, and 400 points."""
    pitch = 1.75 * robot.outer_radius.value if robot.equal_arms else robot.outer_radius.value
    n = len(HEXAGON)
    stuck = np.full((n, 2), np.nan)
    stuck[0] = 40, 65
    disabled = np.arange(n) == 1
    plane = rs.FocalPlane(pitch * np.array(HEXAGON) * u.mm, robot, disabled=disabled, stuck=stuck * u.deg, **columns)
    return plane, (np.random.default_rng(5).uniform(-1, 1, (400, 2)) * 2 * pitch)


def pairs_of(plane, points, fiber_type=None):
    """Return the pairs (positioner, target) in reach as a set."""
    found = plane.reachable(points * u.mm, fiber_type).tocoo()
    return set(zip(found.row.tolist(), found.col.tolist(), strict=True))


def arm(plane, own, point, hand="right", kind=None):
    """Return the center, the elbow and the tip of an arm at a point, from the cosine rule."""
    center = plane.xy[own].to_value(u.mm)
    l1, l2 = (getattr(plane.positioner, name).to_value(u.mm) for name in ("central_arm", "eccentric_arm"))
    r, direction = np.hypot(*(point - center)), np.arctan2(*(point - center)[::-1])
    bend = np.arccos(np.clip((l1**2 + r**2 - l2**2) / (2 * l1 * r), -1, 1))
    theta = direction - bend if hand == "right" else direction + bend
    elbow, tip = center + l1 * np.array([np.cos(theta), np.sin(theta)]), np.array(point)
    if plane.positioner.arm_model == "capsule":
        turn = plane.positioner.arm_angle[kind].to_value(u.rad) + np.arctan2(*(tip - elbow)[::-1])
        tip = elbow + plane.positioner.arm_length.value * np.array([np.cos(turn), np.sin(turn)])
    return center, elbow, tip


def gap(robot, first, second):
    """Return the distance between two arms, computed by shapely."""
    if robot.arm_model == "outline":
        (a, b), (c, d) = placed(robot, *first), placed(robot, *second)
        tested = [(p, q) for p in a for q in c + d] + [(p, q) for p in b for q in c]
        return min(p.distance(q) - r - s for (p, r), (q, s) in tested)
    if robot.arm_model == "fiber_tip":
        return np.hypot(*(first[2] - second[2]))
    return shapely.LineString(first[1:]).distance(shapely.LineString(second[1:]))


def gaps_to_broken(plane, own, point, hand="right", kind="A"):
    """Return the smallest distance of an arm at a point from the arms of the two broken positioners."""
    robot, found = plane.positioner, []
    for k, (theta, phi) in enumerate(((40, 65), np.rad2deg(robot.numbers.home))):
        a, b = np.deg2rad(theta), np.deg2rad(theta + phi)
        elbow = plane.xy[k].value + robot.central_arm.value * np.array([np.cos(a), np.sin(a)])
        tip = elbow + robot.eccentric_arm.value * np.array([np.cos(b), np.sin(b)])
        if robot.arm_model == "capsule":
            b += robot.arm_angle["A"].to_value(u.rad)  # idle arms have the direction of their first fiber
            tip = elbow + robot.arm_length.value * np.array([np.cos(b), np.sin(b)])
        found.append(gap(robot, arm(plane, own, point, hand, kind), (plane.xy[k].value, elbow, tip)))
    return min(found)


@pytest.mark.parametrize("robot", [EQUAL, UNEQUAL])
@pytest.mark.parametrize(("outer", "inner"), [(0.2, 0.1), (0.1, 0.7), (1.5, 0.3), (0.0, 0.25), (0.3, 0.0)])
def test_edges_are_exact(robot, outer, inner):
    """The radii are rounded once, and targets at these radii are in reach; rational numbers confirm each point."""
    l1, l2 = Fraction(robot.central_arm.value), Fraction(robot.eccentric_arm.value)
    high = Fraction(float(l1 + l2 - Fraction(outer))) if outer else l1 + l2
    low = Fraction(float(abs(l1 - l2) + Fraction(inner))) if inner else abs(l1 - l2)
    plane = rs.FocalPlane([[0, 0]] * u.mm, robot, margins=rs.Margins(outer=outer * u.mm, inner=inner * u.mm))
    rng, points = np.random.default_rng(1), []
    for edge in (float(low), float(high)):
        steps = edge + np.arange(-3, 4) * np.spacing(edge)
        points += [(x, 0.0) for x in steps] + [(0.0, -x) for x in steps]
        angle = rng.uniform(0, 2 * np.pi, 100)
        points += list(zip(edge * np.cos(angle), edge * np.sin(angle), strict=True))
    expected = [low**2 <= Fraction(x) ** 2 + Fraction(y) ** 2 <= high**2 for x, y in points]
    assert plane.multiplicity(points * u.mm).astype(bool).tolist() == expected
    assert 0 < sum(expected) < len(expected)
    assert (plane.arrays.inner_radius[0], plane.arrays.outer_radius[0]) == (abs(float(l1) - float(l2)), float(l1 + l2))


def test_margins_of_edges_that_limits_of_phi_shorten():
    """The outer edge is at the smallest phi that the limits allow, by the cosine rule; the margin starts there."""
    robot = replace(EQUAL, phi_range=[50, 180] * u.deg)
    plane = rs.FocalPlane(
        [[0, 0]] * u.mm, robot, zero_points=[[0, 0]] * u.deg, margins=rs.Margins(outer=0.2 * u.mm, inner=0.1 * u.mm)
    )
    edge = np.sqrt(18 + 18 * np.cos(np.deg2rad(50)))
    r = np.array([0.099, 0.101, edge - 0.201, edge - 0.199, edge - 0.001])
    assert plane.multiplicity(np.column_stack([r, 0 * r]) * u.mm).tolist() == [0, 1, 1, 0, 0]
    assert replace(plane, margins=None).multiplicity([[edge - 0.001, 0]] * u.mm)[0] == 1


def test_circles_around_broken_positioners_and_hidden_circles():
    plane, points = scene(EQUAL, hidden=[[4, 3, 0.8], [-6, 2, 1.1]] * u.mm)
    margins = rs.Margins(broken_factor=0.9, hidden_factor=1.65)
    circles = [(*plane.xy[k].value, 0.9 * 6) for k in (0, 1)] + [(4, 3, 1.65 * 0.8), (-6, 2, 1.65 * 1.1)]
    inside = np.any([np.hypot(*(points - (x, y)).T) <= r for x, y, r in circles], axis=0)
    everywhere = pairs_of(replace(plane, hidden=None), points)
    expected = {(i, k) for i, k in everywhere if not inside[k]}
    assert pairs_of(replace(plane, margins=margins), points) == expected
    assert len(expected) < len(pairs_of(plane, points)) < len(everywhere)


@pytest.mark.few(3)
@pytest.mark.parametrize("handedness", ["right", "left", "both"])
@pytest.mark.parametrize("robot", [EQUAL, UNEQUAL, TIP, CAPSULE, DESI_LIKE], ids=lambda r: r.arm_model)
def test_planned_arms_keep_away_from_broken_arms(robot, handedness):
    """The margin removes exactly the pairs whose arm, according to shapely, is too close to a broken arm."""
    kinds = {"fiber_type": ["A+B"] * 7} if robot is CAPSULE else {}
    plane, points = scene(replace(robot, handedness=handedness), **kinds)
    types = np.where(np.arange(len(points)) % 2, "B", "A") if kinds else None
    limit = robot.min_separation.value + 0.4
    hands = ("right", "left") if handedness == "both" else (handedness,)
    everywhere, expected, borderline = pairs_of(plane, points, types), set(), 0
    for i, k in everywhere:
        gaps = [gaps_to_broken(plane, i, points[k], hand, "A" if types is None else types[k]) for hand in hands]
        borderline += min(abs(g - limit) for g in gaps) < 1e-9
        if max(gaps) > limit:
            expected.add((i, k))
    assert borderline == 0
    assert pairs_of(replace(plane, margins=rs.Margins(broken=0.4 * u.mm)), points, types) == expected
    assert 0 < len(expected) < len(everywhere)


@pytest.mark.parametrize("handedness", ["right", "both"])
@pytest.mark.parametrize("name", METHODS)
def test_no_allocator_violates_the_margins(name, handedness):
    plane, points = scene(replace(UNEQUAL, handedness=handedness))
    margins = rs.Margins(outer=0.5 * u.mm, inner=0.4 * u.mm, broken=0.6 * u.mm)
    plan = allocate(replace(plane, margins=margins), points * u.mm, allocator=name, rng=2)
    own = np.flatnonzero(plan.target_of_positioner >= 0)
    tips = points[plan.target_of_positioner[own]]
    r = np.hypot(*(tips - plane.xy[own].value).T)
    assert len(own) > 0
    assert r.min() >= 7.6 + 0.4
    assert r.max() <= 22.4 - 0.5
    limit = UNEQUAL.min_separation.value + 0.6
    assert all(gaps_to_broken(plane, i, p, plan.handedness[i]) > limit for i, p in zip(own, tips, strict=True))


@pytest.mark.parametrize("rows", [slice(80, 88), slice(160, 170), slice(240, 250)])
def test_the_optimum_is_that_of_the_problem_without_the_forbidden_pairs(rows):
    """An independent way to the same optimum: no margins, but a list of pairs that shapely forbids."""
    plane, points = scene(UNEQUAL)
    points, margined = points[rows], replace(plane, margins=rs.Margins(broken=2 * u.mm))
    limit = UNEQUAL.min_separation.value + 2
    forbidden = [(i, k) for i, k in sorted(pairs_of(plane, points)) if gaps_to_broken(plane, i, points[k]) <= limit]
    ways = ((margined, {}), (plane, {"forbidden": forbidden}), (plane, {}))
    plans = [rs.allocate(one, points * u.mm, allocator="optimal", **options) for one, options in ways]
    counts = [int((plan.target_of_positioner >= 0).sum()) for plan in plans]
    assert counts[0] == counts[1] < counts[2]


def test_margins_other_than_arms_change_no_collisions():
    """The poses and collisions of given tips depend on the margin ``arms``, and on no other margin."""
    plane, _ = scene(EQUAL)
    tips = plane.xy.value + [0, 5.9]
    tips[:2] = np.nan
    others = rs.Margins(outer=0.2 * u.mm, inner=0.1 * u.mm, broken=1 * u.mm, broken_factor=1.0, hidden_factor=2.0)
    reports = [rs.find_collisions(replace(plane, margins=m), tips * u.mm) for m in (None, others)]
    assert np.array_equal(reports[0].pairs, reports[1].pairs)
    assert np.array_equal(reports[0].distances, reports[1].distances)


@pytest.mark.few(1)
@pytest.mark.parametrize("robot", [EQUAL, DESI_LIKE], ids=lambda r: r.arm_model)
def test_the_margin_of_arms_is_added_to_the_clearance(robot):
    plane, points = scene(robot, obstacles=[[5, 0, 0.5], [-5, 4, 0.3]] * u.mm)
    wider = replace(plane, positioner=replace(robot, clearance=robot.clearance + 0.3 * u.mm))
    margined = replace(plane, margins=rs.Margins(arms=0.3 * u.mm))
    rng, found = np.random.default_rng(3), []
    own, tips = sorted(pairs_of(plane, points)), np.full((200, 7, 2), np.nan)
    for k in range(2, 7):
        tips[:, k] = points[rng.choice([t for i, t in own if i == k], 200)]
    for one in (wider, margined, plane):
        plan = rs.allocate(one, points * u.mm, allocator="optimal")
        reports = [rs.find_collisions(one, t * u.mm) for t in tips]
        counts = rs.collision.count_collisions(one, tips * u.mm)
        assert counts.n_pairs.tolist() == [len(r.pairs) for r in reports]
        assert counts.n_obstacle_pairs.tolist() == [len(r.obstacle_pairs) for r in reports]
        found.append([plan.target_of_positioner.tolist(), counts.n_pairs.tolist(), counts.n_obstacle_pairs.tolist()])
    assert found[0] == found[1]
    assert [sum(a) > sum(b) for a, b in zip(found[1][1:], found[2][1:], strict=True)] == [True, True]


def test_blank_sky_keeps_the_margins_and_avoids_hidden_circles():
    """Blank sky positions were placed in hidden circles, where fibers receive no light."""
    plane, points = scene(EQUAL, hidden=[[9, 3, 5.0]] * u.mm)
    for margins in (rs.Margins(), rs.Margins(outer=1 * u.mm, inner=1.5 * u.mm, broken=0.5 * u.mm, broken_factor=0.7)):
        options = rs.AllocationOptions("repair", requirements=["sky=5"], sky_separation=0.4 * u.mm)
        plan = rs.allocate(replace(plane, margins=margins), points[:40] * u.mm, allocator=options)
        own = np.flatnonzero(plan.target_of_positioner >= 40)
        own = own[own > 0]  # the stuck fiber observes the sky where it is
        assert len(own) > 1
        tips = plan.tips.value[own]
        r = np.hypot(*(tips - plane.xy.value[own]).T)
        assert r.min() >= margins.inner.value
        assert r.max() <= 6 - margins.outer.value
        assert np.hypot(*(tips - (9, 3)).T).min() > 5
        if margins:
            assert min([np.hypot(*(tips - plane.xy[k].value).T).min() for k in (0, 1)]) > 0.7 * 6
            limit = EQUAL.min_separation.value + 0.5
            assert all(gaps_to_broken(plane, i, p) > limit for i, p in zip(own, tips, strict=True))


def test_a_focal_plane_with_margins_becomes_a_table_and_back():
    plain, points = scene(EQUAL)
    assert (bool(plain.margins), str(plain.margins)) == (False, "none")
    assert "margins" not in plain.to_table().meta
    assert plain.arrays.edges[1] is plain.arrays.outer_radius
    plane = replace(plain, margins=rs.Margins(outer=0.25 * u.mm, broken=200 * u.um, hidden_factor=1.65))
    again = rs.FocalPlane.from_table(plane.to_table())
    assert again.margins.record == {"outer_mm": 0.25, "broken_mm": 0.2, "hidden_factor": 1.65}
    assert pairs_of(again, points) == pairs_of(plane, points)


WRONG_MARGINS = [
    ({"outer": -1 * u.mm}, "the margin outer must be one finite value of at least 0 mm"),
    ({"inner": 1 * u.deg}, "the margin inner"),
    ({"broken": np.nan * u.mm}, "the margin broken must be one finite value"),
    ({"arms": 0.1}, "the margin arms"),
    ({"broken_factor": -0.1}, "the margin broken_factor must be a number of at least 0"),
    ({"hidden_factor": 0.9}, "the margin hidden_factor must be a number of at least 1"),
    ({"hidden_factor": True}, "the margin hidden_factor must be a number of at least 1"),
    ({"other": 1 * u.mm}, "other"),
]


@pytest.mark.parametrize(("margins", "text"), WRONG_MARGINS)
def test_values_that_are_not_margins(margins, text):
    refused(text, lambda: rs.Margins(**margins))


def test_margins_that_leave_no_patrol_area():
    zero, xy = [[0, 0], [0, 0]] * u.deg, [[0, 0], [40, 0]] * u.mm
    with pytest.raises(rs.InputError, match="area of positioner 0 is from 0 to 6 mm, got outer 4 mm, inner 2.5 mm"):
        rs.FocalPlane(xy, EQUAL, margins=rs.Margins(outer=4 * u.mm, inner=2.5 * u.mm))
    limits = [[150, 180], [np.nan, np.nan]] * u.deg
    columns = {"zero_points": zero, "phi_range": limits, "margins": rs.Margins(outer=1 * u.mm, inner=0.7 * u.mm)}
    refused("1 positioners have no area left", lambda: rs.FocalPlane(xy, EQUAL, **columns))
    rs.FocalPlane(xy, EQUAL, **columns, disabled=[True, False])
    with pytest.raises(rs.InputTypeError, match="margins must be Margins, got 0.2"):
        rs.FocalPlane(xy, EQUAL, margins=0.2)


@pytest.mark.parametrize("numbers", [{"outer": "0.2"}, {"width": 1}, [0.2]])
def test_tables_with_wrong_margins(numbers):
    table = scene(EQUAL)[0].to_table()
    table.meta["margins"] = numbers
    refused("margin", rs.FocalPlane.from_table, table)
