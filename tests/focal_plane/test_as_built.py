"""Positioners with individual fiber positions, zero points and joint limits."""

from dataclasses import replace

import astropy.units as u
import numpy as np
import pytest
from raising import refused
from shapely import LineString

import rfpsurvey as rs
from oracles import in_annulus
from rfpsurvey.collision import place_arms

MM, DEG = u.mm, u.deg
APO = rs.Instrument.preset("sdss_apo")
N = len(APO.focal_plane)
PLACES = {"BOSS": [14.965, -0.376], "APOGEE": [14.965, 0.376]}


def same_as_preset(**columns):
    """Return the preset with fibers beside the axis of the arm; the preset itself has capsules beside the fibers."""
    plane = APO.focal_plane
    places = {name: np.tile(place, (N, 1)) * MM for name, place in PLACES.items()}
    places["APOGEE"][plane.fiber_type == "BOSS"] = np.nan
    unit = replace(plane.positioner, arm_angle=None)
    return replace(APO, focal_plane=replace(plane, positioner=unit, fiber_xy=places, **columns))


def random_plane(seed=0, n=60, **columns):
    """Return a small plane of positioners that all have different properties."""
    rng = np.random.default_rng(seed)
    x, y = np.meshgrid(np.arange(n // 6), np.arange(6))
    xy = 17 * np.column_stack([x.ravel(), y.ravel()]) + rng.uniform(-0.3, 0.3, (n, 2))
    places = {"A": rng.normal([15, 0.4], 0.1, (n, 2)) * MM, "B": rng.normal([14, -0.5], 0.1, (n, 2)) * MM}
    places["M"] = rng.normal([14.3, 0], 0.1, (n, 2)) * MM
    types = np.where(np.arange(n) % 5, "A+B", "B")
    places["A"][types == "B"] = np.nan
    options = {"arm_model": "capsule", "arm_length": 14.7 * MM, **columns.pop("unit", {})}
    unit = rs.Positioner(7.4 * MM, 15 * MM, 2 * MM, **options)
    return rs.FocalPlane(
        xy * MM,
        unit,
        fiber_type=types,
        central_arm=rng.normal(7.4, 0.05, n) * MM,
        fiber_xy=places,
        zero_points=rng.uniform(-180, 180, (n, 2)) * [1, 0.05] * DEG,
        **columns,
    )


def by_hand(plane, theta, phi, name):
    """Return the elbows, and the positions of given points of the arms, computed with complex numbers."""
    zero = np.deg2rad(plane.zero_points.value)
    a = np.deg2rad(theta) + zero[:, 0]
    elbow = (plane.xy.value[:, 0] + 1j * plane.xy.value[:, 1]) + plane.central_arm.value * np.exp(1j * a)
    place = plane.fiber_xy[name].value if isinstance(name, str) else np.broadcast_to(name, (len(plane), 2))
    return elbow, elbow + (place[:, 0] + 1j * place[:, 1]) * np.exp(1j * (a + np.deg2rad(phi) + zero[:, 1]))


@pytest.mark.parametrize("name", ["A", "B", "M"])
def test_positions_of_fibers_and_angles_back(name):
    plane, rng = random_plane(), np.random.default_rng(1)
    theta, phi = rng.uniform(-180, 180, len(plane)), rng.uniform(20, 160, len(plane))
    fiber = by_hand(plane, theta, phi, name)[1]
    xy, has = plane.forward(theta * DEG, phi * DEG, name), np.isfinite(fiber)
    np.testing.assert_allclose(xy.value, np.column_stack([fiber.real, fiber.imag]), atol=1e-11)
    back = plane.inverse(xy, name)
    np.testing.assert_allclose((back[0].value[has] - theta[has] + 180) % 360 - 180, 0, atol=1e-9)
    np.testing.assert_allclose(back[1].value[has], phi[has], atol=1e-9)
    assert np.isnan(back[0].value[~has]).all()
    assert np.isnan(plane.inverse(xy + 50 * MM, name)[0].value).all()
    left = plane.forward(theta * DEG, np.full(len(plane), -90) * DEG, name)
    np.testing.assert_allclose(plane.inverse(left, name, "left")[1].value[has], -90, atol=1e-9)
    assert (plane.inverse(left, name)[1].value[has] > 0).all()


def test_nominal_planes_have_the_kinematics_of_their_positioner():
    plane, rng = rs.Instrument.preset("lamost").focal_plane, np.random.default_rng(0)
    theta, phi = rng.uniform(-180, 180, len(plane)) * DEG, rng.uniform(1, 179, len(plane)) * DEG
    xy = plane.forward(theta, phi)
    np.testing.assert_allclose((xy - plane.xy).value, plane.positioner.forward(theta, phi).value, atol=1e-10)
    for found, expected in zip(plane.inverse(xy), (theta, phi), strict=True):
        np.testing.assert_allclose(found.value, expected.value, atol=1e-7)


def test_reach_of_each_fiber_type():
    plane, rng = random_plane(), np.random.default_rng(2)
    points, types = rng.uniform(-25, 180, (300, 2)), rng.choice(["A", "B", ""], 300)
    found, first = plane.reachable(points * MM, types).toarray(), plane.arrays.first_type
    for i, (center, l1, names) in enumerate(
        zip(plane.xy.value, plane.central_arm.value, plane.fiber_type.tolist(), strict=True)
    ):
        for j, (point, name) in enumerate(zip(points, types.tolist(), strict=True)):
            use = name or first[i]
            length = np.hypot(*plane.fiber_xy[use].value[i])
            expected = use in names.split("+") and in_annulus(point, center, l1, length)
            assert found[i, j] == expected, (i, j)
    assert found.sum() > 180


def test_collisions_of_arms_along_their_mechanical_axis():
    plane, rng = random_plane(), np.random.default_rng(3)
    n, types = len(plane), np.array([rng.choice(row.split("+")) for row in plane.fiber_type])
    n_found = 0
    for _ in range(20):
        theta, phi = rng.uniform(-180, 180, n), rng.uniform(0, 170, n)
        elbow, end = by_hand(plane, theta, phi, [14.7, 0.0])
        arms = [LineString([(a.real, a.imag), (b.real, b.imag)]) for a, b in zip(elbow, end, strict=True)]
        expected = {(i, j) for i in range(n) for j in range(i + 1, n) if arms[i].distance(arms[j]) < 4}
        n_found += len(expected)
        fibers = np.where(types == "A", by_hand(plane, theta, phi, "A")[1], by_hand(plane, theta, phi, "B")[1])
        tips = np.column_stack([fibers.real, fibers.imag]) * MM
        side = np.where(np.mod(phi + plane.zero_points.value[:, 1] + 5, 360) < 185, "right", "left")
        angle = plane.arrays.fibers.angle[plane.arrays.index_of(types), np.arange(n)]
        effective = np.mod(np.deg2rad(phi + plane.zero_points.value[:, 1]) + angle + np.pi, 2 * np.pi) - np.pi
        side = np.where(effective >= 0, "right", "left")
        for options in (
            {"theta": theta * DEG, "phi": phi * DEG, "fiber_type": types},
            {"tips": tips, "handedness": side, "fiber_type": types},
            {"theta": theta * DEG, "phi": phi * DEG},
        ):
            report = rs.find_collisions(plane, **options)
            assert {tuple(pair) for pair in report.pairs.tolist()} == expected
    assert n_found > 100


@pytest.mark.few(3)
@pytest.mark.parametrize("zero_points", [False, True])
@pytest.mark.parametrize("allocator", ["nearest", "balanced", "network_flow", "repair", "optimal"])
def test_tiles_are_those_of_the_same_instrument_without_columns(allocator, zero_points):
    zero = np.random.default_rng(0).uniform(-170, 170, (N, 2)) * [1, 0.01] * DEG if zero_points else None
    built, center = same_as_preset(zero_points=zero), rs.example_catalog("anticenter").coord[0]
    catalog = rs.synthetic_catalog("uniform", center, 1.5 * DEG, n_targets=700, rng=1)
    catalog = replace(catalog, fiber_type=np.random.default_rng(2).choice(["BOSS", "APOGEE", ""], len(catalog)))
    options = rs.AllocationOptions(allocator, requirements=["sky=5"], sky_separation=0.2 * u.arcmin)
    tiles = [rs.plan_tile(catalog, i, center, allocator=options) for i in (APO, built)]
    a, b = (tile.table for tile in tiles)
    assert np.ma.filled(a["target_id"], -1).tolist() == np.ma.filled(b["target_id"], -1).tolist()
    assert (a["in_collision"] == b["in_collision"]).all()
    assert tiles[0].summary["n_colliding"] == tiles[1].summary["n_colliding"]
    np.testing.assert_allclose(a["clearance"].value, b["clearance"].value, atol=1e-9)
    used = np.isfinite(a["theta"])
    lean = np.where(np.asarray(a["fiber_type"]) == "BOSS", -1, 1) * 1.4392704 * DEG
    shift = [a["theta"] - b["theta"], a["phi"] - lean - b["phi"]]
    if zero is not None:
        shift = [s - z for s, z in zip(shift, zero.T, strict=True)]
    for difference in shift:
        np.testing.assert_allclose((difference[used].value + 180) % 360 - 180, 0, atol=1e-6)


def test_counts_and_methods_agree_with_the_same_instrument_without_columns():
    built, rng = same_as_preset().focal_plane, np.random.default_rng(4)
    plane, r = APO.focal_plane, np.sqrt(rng.uniform(8**2, 22**2, (6, N)))
    angle = rng.uniform(0, 2 * np.pi, (6, N))
    tips = plane.xy.value + np.stack([r * np.cos(angle), r * np.sin(angle)], axis=-1)
    types = np.where(rng.random(N) < 0.5, plane.arrays.first_type, [row.split("+")[-1] for row in plane.fiber_type])
    counts = [rs.collision.count_collisions(p, tips * MM, fiber_type=types) for p in (plane, built)]
    np.testing.assert_array_equal(counts[0].n_in_collision, counts[1].n_in_collision)
    for method in ("exact", "sampled", "scipy"):
        reports = [rs.find_collisions(p, tips[0] * MM, fiber_type=types, method=method) for p in (plane, built)]
        np.testing.assert_array_equal(reports[0].pairs, reports[1].pairs)
    # the parked poses differ, because phi does not refer to the fiber; the areas contain the final poses
    swept = rs.find_collisions(built, tips[0] * MM, fiber_type=types, method="sweep")
    assert {*map(tuple, reports[1].pairs.tolist())} <= {*map(tuple, swept.pairs.tolist())}


@pytest.mark.parametrize("method", ["conditional", "monte_carlo", "quadrature", "closed_form"])
def test_probabilities_agree_with_the_same_instrument_without_columns(method):
    ring, values = np.hypot(*APO.focal_plane.xy.value.T) < 70, []
    for plane in (APO.focal_plane, same_as_preset().focal_plane):
        columns = {"fiber_type": plane.fiber_type[ring], "id": plane.id[ring]}
        places = plane.fiber_xy and {name: place[ring] for name, place in plane.fiber_xy.items()}
        part = rs.FocalPlane(plane.xy[ring], plane.positioner, fiber_xy=places, **columns)
        options = {} if method == "closed_form" else {"rng": 1, "precision": 0.02}
        options |= {} if method in ("conditional", "monte_carlo") else {"estimand": "independent"}
        values.append(rs.collision_probability(part, method=method, **options).value)
    assert values[0] == pytest.approx(values[1], rel=1e-9)


@pytest.mark.few(2)
@pytest.mark.parametrize("handedness", ["right", "left"])
@pytest.mark.parametrize("turn", [90, 179, 180])
def test_joint_limits_of_single_positioners(turn, handedness):
    """Limits of phi are limits of the distance if theta is free, and are otherwise tested for each target."""
    rng = np.random.default_rng(5)
    low = rng.uniform(0, 60, 60)
    limits = np.column_stack([low, low + 100]) * DEG
    limits[::4] = np.nan
    common = np.array([0, 170]) if handedness == "right" else np.array([-170, 0])
    limits = limits if handedness == "right" else -limits[:, ::-1]
    unit = {"phi_range": common * DEG, "theta_range": [-turn, turn] * DEG, "handedness": handedness}
    plane = random_plane(phi_range=limits, unit=unit)
    assert plane.arrays.joints_free == (turn == 180)
    points = rng.uniform(-20, 180, (600, 2)) * MM
    unit = replace(plane.positioner, phi_range=None, theta_range=None)
    free = replace(plane, phi_range=None, positioner=unit)
    for name in ("A", "B"):
        found = plane.reachable(points, np.full(600, name)).toarray()
        within = free.reachable(points, np.full(600, name)).toarray()
        for j in range(600):
            theta, phi = free.inverse(np.tile(points[j], (60, 1)), name)
            phi = np.mod(phi.value + 270, 360) - 270 if handedness == "left" else np.mod(phi.value + 90, 360) - 90
            ends = np.where(np.isfinite(limits.value), limits.value, common)
            expected = within[:, j] & (phi >= ends[:, 0]) & (phi <= ends[:, 1]) & (np.abs(theta.value) <= turn)
            np.testing.assert_array_equal(found[:, j], expected)
    assert not np.array_equal(found, within)


def test_angles_are_given_within_the_joint_limits():
    plane = random_plane(theta_range=np.tile([5.0, 365.0], (60, 1)) * DEG)
    xy = plane.forward(np.full(60, 364) * DEG, np.full(60, 90) * DEG, "B")
    np.testing.assert_allclose(plane.inverse(xy, "B")[0].value, 364, atol=1e-9)


def test_measured_arms_that_are_nominally_equal_are_parked():
    robot = rs.Positioner(3 * MM, 3 * MM, 0.5 * MM)
    l1, places = [3.02, 2.9, 3.5, 3.0] * MM, [[2.98, 0], [3.1, 0.05], [2.5, 0], [3, 0]] * MM
    plane = rs.FocalPlane([[0, 0], [7, 0], [14, 0], [21, 0]] * MM, robot, central_arm=l1, fiber_xy=places)
    assert rs.find_collisions(plane, np.full((4, 2), np.nan) * MM).counted.tolist() == [True, True, False, True]
    idle = plane.arrays.idle(True)
    elbow, tip = idle.segments.T[:, :2], idle.segments.T[:, 2:]
    np.testing.assert_allclose(np.hypot(*(elbow - plane.xy.value).T)[[0, 1, 3]], l1.value[[0, 1, 3]])
    # the tip of a folded arm is as near to the center as the arm lengths allow
    np.testing.assert_allclose(np.hypot(*(tip - plane.xy.value).T)[0], 0.04, atol=1e-12)
    np.testing.assert_allclose(tip[3], [21, 0], atol=0)


def test_home_and_stuck_poses_count_from_the_zero_points():
    robot = rs.Positioner(3 * MM, 3 * MM, 0.5 * MM, home=[10, 120] * DEG)
    plane = rs.FocalPlane(
        [[0, 0], [7, 0]] * MM, robot, zero_points=[[-90, 5], [30, 0]] * DEG, stuck=[[np.nan, np.nan], [60, 45]] * DEG
    )
    idle = plane.arrays.idle(True)
    np.testing.assert_allclose(np.rad2deg([idle.theta, idle.phi]), [[10, 60], [120, 45]])
    angle = np.deg2rad([[-80, 45], [90, 135]])  # directions of the arms
    for i, (a, b) in enumerate(angle):
        elbow = plane.xy.value[i] + 3 * np.array([np.cos(a), np.sin(a)])
        np.testing.assert_allclose(idle.segments[:2, i], elbow)
        np.testing.assert_allclose(idle.segments[2:, i], elbow + 3 * np.array([np.cos(b), np.sin(b)]), atol=1e-14)


def test_tables_keep_all_columns():
    plane = random_plane(phi_range=np.tile([5.0, 170.0], (60, 1)) * DEG)
    again = rs.FocalPlane.from_table(plane.to_table())
    assert list(again.fiber_xy) == ["A", "B", "M"]
    for name in again.fiber_xy:
        np.testing.assert_array_equal(again.fiber_xy[name].value, plane.fiber_xy[name].value)
    for name in ("zero_points", "phi_range"):
        np.testing.assert_allclose(getattr(again, name).to_value(DEG), getattr(plane, name).to_value(DEG), rtol=1e-15)
    assert again.theta_range is None


COLUMNS = [
    ({"eccentric_arm": np.ones(2) * MM}, "fiber_xy must be given without eccentric_arm"),
    ({"fiber_xy": {"A": np.ones((2, 2)) * MM}}, "fiber_xy must have the fiber type 'B', got 'A'"),
    ({"fiber_xy": np.ones((2, 2)) * MM}, "fiber_xy must be a dict with the fiber types A, B, got one array"),
    ({"fiber_xy": {"A": np.ones((3, 2)) * MM, "B": np.ones((2, 2)) * MM}}, "'A' must have the shape .2, 2."),
    ({"fiber_xy": {"A": np.ones((2, 2)) * MM, "B": np.zeros((2, 2)) * MM}}, "not \\(0, 0\\) mm .* positioner 0"),
    ({"zero_points": np.ones(2) * DEG}, "zero_points must have the shape .2, 2., got .2,."),
    ({"zero_points": [[0, 0], [0, np.nan]] * DEG}, "zero_points must be two finite angles .* for positioner 1"),
    ({"phi_range": [[0, 90], [90, 0]] * DEG}, "phi_range must be .low, high. with low < high, .* for positioner 1"),
    ({"theta_range": [[0, 90], [np.nan, 0]] * DEG}, "theta_range must be .low, high. with low < high"),
    ({"zero_points": np.ones((2, 2)) * MM}, "zero_points must have a unit convertible to rad"),
]


@pytest.mark.parametrize(("columns", "message"), COLUMNS)
def test_columns_that_are_refused(columns, message):
    given = {"fiber_xy": {"A": np.ones((2, 2)) * MM, "B": np.ones((2, 2)) * MM}} | columns
    robot = rs.Positioner(7 * MM, 8 * MM, 1 * MM)
    refused(message, lambda: rs.FocalPlane([[0, 0], [20, 0]] * MM, robot, fiber_type=["A+B", "B"], **given))


def test_kinematics_refuse_bad_input():
    plane, angles = random_plane(), np.zeros(60) * DEG
    with pytest.raises(rs.InputError, match="theta and phi must have the shape .60,., got .3,. and .60,."):
        plane.forward(np.zeros(3) * DEG, angles)
    refused("fiber type must be one of A, B, M|'C'", plane.forward, angles, angles, "C")
    refused("xy must have a row for each of the 60 positioners, got 1", plane.inverse, [[0, 0]] * MM)
    refused("fiber_type must be one name or have the shape .60,., got .2,.", plane.forward, angles, angles, ["A", "B"])


@pytest.mark.parametrize("allocator", ["optimal", "repair", "balanced"])
def test_plans_use_the_place_of_each_fiber(allocator):
    plane, rng = random_plane(), np.random.default_rng(6)
    points, types = rng.uniform(-20, 180, (300, 2)) * MM, rng.choice(["A", "B", ""], 300)
    n_sky = 0
    for kind in ("sky@A", "sky@B"):
        options = {"requirements": [f"{kind}=20"], "sky_separation": 3 * MM} if allocator != "balanced" else {}
        plan = rs.allocate(plane, points, fiber_type=types, allocator=rs.AllocationOptions(allocator, **options))
        used = np.flatnonzero(plan.target_of_positioner >= 0)
        n_sky += int((plan.target_of_positioner >= plan.n_given).sum())
        for i in used.tolist():
            name = str(plan.fiber_type[i])
            asked = plan.target_fiber_type[plan.target_of_positioner[i]]
            assert name == (asked or plane.arrays.first_type[i])
            length = np.hypot(*plane.fiber_xy[name].value[i])
            assert in_annulus(plan.tips.value[i], plane.xy.value[i], plane.central_arm.value[i], length)
        theta, phi = plane.inverse(plan.tips, np.where(plan.fiber_type == "", plane.arrays.first_type, plan.fiber_type))
        elbow, end = by_hand(plane, theta.value, phi.value, [14.7, 0.0])
        arms = [LineString([(elbow[i].real, elbow[i].imag), (end[i].real, end[i].imag)]) for i in used]
        hits = sum(a.distance(b) < 4 for k, a in enumerate(arms) for b in arms[:k])
        assert hits == len(rs.find_collisions(plane, plan).pairs)
        assert (hits == 0) == (allocator != "balanced")
    assert n_sky > 10 or allocator == "balanced"


def test_idle_arms_do_not_depend_on_the_fiber_type_that_is_named():
    angles = np.full((60, 2), np.nan) * DEG
    angles[7] = [20, 80] * DEG
    plane, nowhere = random_plane(stuck=angles), np.full((60, 2), np.nan) * MM
    for name in ("A", "B"):
        assert len(rs.find_collisions(plane, nowhere, fiber_type=np.full(60, name)).pairs) == 0
        posed = place_arms(plane, nowhere, fiber_type=np.full(60, name))
        _, end = by_hand(plane, *np.full((2, 60), [[20.0], [80.0]]), [14.7, 0.0])
        np.testing.assert_allclose(posed.segments[7, 2:], [end[7].real, end[7].imag], atol=1e-9)


def test_counts_of_configurations_with_other_fibers():
    plane, rng = random_plane(), np.random.default_rng(7)
    names = np.full(60, "B")
    tips = [plane.forward(rng.uniform(0, 360, 60) * DEG, rng.uniform(20, 160, 60) * DEG, "B") for _ in range(5)]
    counts = rs.collision.count_collisions(plane, u.Quantity(tips), fiber_type=names)
    assert counts.n_pairs.tolist() == [len(rs.find_collisions(plane, t, fiber_type=names).pairs) for t in tips]
    assert counts.n_pairs.sum() > 20
    nowhere = np.full((60, 2), np.nan) * [[20.0, 80.0]]
    nowhere[::3] = [20, 80]
    plane = random_plane(stuck=nowhere * DEG)
    tips = [np.where(np.isnan(nowhere[:, :1]), t.value, np.nan) * MM for t in tips]
    counts = rs.collision.count_collisions(plane, u.Quantity(tips), fiber_type=names)
    assert counts.n_pairs.tolist() == [len(rs.find_collisions(plane, t, fiber_type=names).pairs) for t in tips]


@pytest.mark.exhaustive
def test_limits_of_phi_give_the_same_probability_in_compiled_code():
    """The same limits are tested for each target if theta cannot make a full turn."""
    values = []
    for turn in (180, 180 - 1e-9):
        unit = {"theta_range": [-turn, turn] * DEG}
        plane = random_plane(phi_range=np.tile([20.0, 140.0], (60, 1)) * DEG, unit=unit)
        assert plane.arrays.joints_free == (turn == 180)
        precision = rs.probability.Precision(max_iterations=1000)
        values.append(rs.collision_probability(plane, precision=precision, rng=1))
    apart = values[0].value - values[1].value
    assert abs(apart) < 4 * np.hypot(values[0].standard_error, values[1].standard_error) < 0.06
    assert values[0].value > 0.1


@pytest.mark.parametrize("limits", [{"phi_range": [10, 60]}, {"theta_range": [0, 200]}, {"zero_points": [180, 0]}])
def test_positioners_with_other_joints_are_other_environments(limits):
    """The probability of each positioner is that of the same positioner in a plane where no other one is like it."""
    pair = [[0, 0], [9, 0]]
    unit = rs.Positioner(3 * MM, 4 * MM, 1 * MM, theta_range=[-90, 90] * DEG if "zero_points" in limits else None)
    ((name, value),) = limits.items()
    columns = np.full((6, 2), 0.0 if name == "zero_points" else np.nan)
    columns[1] = value
    xy = np.concatenate([np.add(pair, [0, 100 * k]) for k in range(3)]) * MM
    plane = rs.FocalPlane(xy, unit, **{name: columns * DEG})
    precision = rs.probability.Precision(standard_error=0.002)
    found = rs.collision_probability(plane, method="quadrature", precision=precision, rng=1).per_positioner
    alone = rs.FocalPlane(xy[:2], unit, **{name: columns[:2] * DEG})
    expected = rs.collision_probability(alone, method="quadrature", precision=precision, rng=2).per_positioner
    free = rs.FocalPlane(xy[2:4], unit)
    others = rs.collision_probability(free, method="quadrature", precision=precision, rng=3).per_positioner
    np.testing.assert_allclose(found[:2], expected, atol=0.01)
    np.testing.assert_allclose(found[2:], np.tile(others, 2), atol=0.01)
    assert np.abs(expected - others).max() > 0.015


def test_limits_of_the_other_elbow():
    """The limits of phi allow the left elbow at this point, but not the right one, which is the default."""
    robot = rs.Positioner(8 * MM, 10 * MM, 1 * MM)
    plane = rs.FocalPlane([[0, 0], [40, 0]] * MM, robot, phi_range=np.tile([-170, 90], (2, 1)) * DEG)
    tips = [[6, 0], [46, 0]] * MM
    assert np.isnan(plane.inverse(tips)[1].value).all()
    phi = plane.inverse(tips, handedness="left")[1]
    np.testing.assert_allclose(phi.value, -np.rad2deg(np.arccos((6**2 - 8**2 - 10**2) / 160)), atol=1e-9)
    assert rs.find_collisions(plane, tips, handedness="left").assigned.all()
    assert rs.collision.count_collisions(plane, tips[None], handedness="left").n_assigned.tolist() == [2]
    refused("out of reach", rs.find_collisions, plane, tips)
