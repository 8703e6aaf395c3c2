"""Paths of all arms: replayed with shapely, written and read, and damaged on purpose."""

from dataclasses import replace

import astropy.units as u
import numpy as np
import pytest
from astropy.table import vstack
from path_scenes import CLUSTERED, DEG, MM, SEGMENT, SMALL, Replay, targets
from raising import refused

import rfpsurvey as rs
from rfpsurvey.collision import Paths, find_paths
from rfpsurvey.positioner import JointMotion
from scenes import random_tips

MOTION = JointMotion(theta_speed=10 * DEG / u.s, phi_speed=20 * DEG / u.s)
LOCKED = "locked by obstacles and joint limits"


def plan_of(plane, seed=1, n=60):
    rng = np.random.default_rng(seed)
    tips = np.concatenate([random_tips(plane, rng).value for _ in range(1 + n // len(plane))])
    return rs.allocate(plane, tips[np.isfinite(tips).all(axis=1)] * MM)


def check_paths(plane, plan, paths, motion, *, n=400):
    """Check everything that paths must have: separation, ends, reversal, joint ranges, speeds and broken arms."""
    fold, unfold = Replay(plane, paths.table), Replay(plane, paths.table, "unfold")
    separation = plane.positioner.min_separation.to_value(MM)
    apart = fold.closest(n if plane.positioner.outline is None else n // 4)
    least = min(apart.values())
    assert least >= separation - 1e-12
    expected = paths.smallest_distance.to_value(MM)
    assert min(expected, separation + 0.4) <= least + 1e-9
    if least < separation + 0.4:
        assert expected >= least - 1e-3 - 1e-6
    assert fold.to_obstacles() >= plane.positioner.clearance.to_value(MM)
    broken = np.isfinite(plane.stuck).any(axis=1) if plane.stuck is not None else np.zeros(len(plane), bool)
    broken = broken | (plane.disabled if plane.disabled is not None else False)
    sides = {"right": (1,), "left": (-1,), "both": (1, -1)}[plane.positioner.handedness]
    for i in fold.present:
        name = str(plane.id[i])
        row, back = fold.rows[name], unfold.rows[name]
        for column in ("theta", "phi"):
            np.testing.assert_array_equal(row[column], back[column][::-1])
        np.testing.assert_allclose(row["time"], (paths.duration - back["time"])[::-1], atol=1e-12 * u.s)
        assert (row["time"][0], back["time"][0]) == (0 * u.s, 0 * u.s)
        assert row["time"][-1] == back["time"][-1] == paths.duration
        if plan.target_of_positioner[i] >= 0:
            np.testing.assert_allclose(fold.tip(i, np.zeros(1))[0], plan.tips[i].to_value(MM), atol=1e-6)
        if broken[i]:
            assert np.ptp(row["theta"]) == np.ptp(row["phi"]) == 0
            continue
        rates = fold.rates(i)
        for rate, speed in zip(rates, (motion.theta_speed, motion.phi_speed), strict=True):
            assert rate <= speed.to_value(u.rad / u.s) * (1 + 1e-9)
        for column, given in (("theta", motion.theta_range), ("phi", motion.phi_range)):
            own = getattr(plane, f"{column}_range")
            limits = given if own is None else own[i]
            low, high = (-np.inf, np.inf) if limits is None else limits.to_value(DEG)
            axis = np.rad2deg(fold.axis[i]) if own is None and column == "phi" else 0.0
            angles = row[column].to_value(DEG) + axis
            assert low - 2 <= angles[0] <= high + 2  # the range is extended to a pose of the plan that exceeds it
            assert min(low, angles[0]) - 1e-6 <= angles.min() <= angles.max() <= max(high, angles[0]) + 1e-6
        if paths.arrives[i] and plane.phi_range is None and plane.positioner.phi_range is None:
            end = np.deg2rad(row["phi"][-1].to_value(DEG)) + fold.axis[i]
            home = plane.positioner.numbers.home[1]  # the direction of the axis of the arm, as the joint ranges
            assert np.sign(end) in sides
            assert min(abs(abs(end) - np.pi), abs(abs(end) - home)) < 1e-5


@pytest.fixture(scope="module")
def sdss(presets):
    return presets["sdss_apo"]


@pytest.mark.few(1)
@pytest.mark.parametrize("name", CLUSTERED)
def test_paths_of_sdss_keep_the_separation_the_joint_ranges_and_the_speeds(sdss, name):
    plane = sdss.focal_plane
    plan = rs.allocate(plane, targets(plane, name))
    paths = find_paths(plane, plan, motion=sdss.motion)
    check_paths(plane, plan, paths, sdss.motion, n=500)
    assert paths.n_arriving >= plan.n_assigned - 1
    assert np.sum(~paths.arrives) <= sum(len(ids) for ids, _ in paths.groups)


@pytest.mark.few(13)
@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("name", SMALL)
def test_paths_of_small_planes(name, seed):
    plane = SMALL[name]()
    plan = plan_of(plane, seed)
    paths = find_paths(plane, plan, motion=MOTION)
    check_paths(plane, plan, paths, MOTION)
    assert paths.n_arriving >= 15
    again = find_paths(plane, plan, motion=MOTION)
    for column in ("time", "theta", "phi"):
        np.testing.assert_array_equal(getattr(paths, column), getattr(again, column))


def test_folded_arms_that_touch_each_other_end_in_one_direction():
    plane = SMALL["crowded"]()
    tips = np.full((19, 2), np.nan) * MM
    tips[7] = plane.xy[7] + [5, 20] * MM
    paths = find_paths(plane, tips)
    assert paths.arrives.all()
    theta, phi = (angle[paths.start[1:] - 1].to_value(DEG) for angle in (paths.theta, paths.phi))
    np.testing.assert_allclose(np.cos(np.deg2rad(theta - theta[0])), 1, atol=1e-12)
    np.testing.assert_allclose(phi, 180)


@pytest.mark.parametrize("name", ["troubles", "outlines", "capsules"])
def test_the_same_seed_gives_the_same_paths(name):
    plane = SMALL[name]()
    plan = plan_of(plane, 1)
    found = [find_paths(plane, plan, rng=seed) for seed in (1, 1, np.random.default_rng(1), 2)]
    seeds = [paths.meta["seed"] for paths in found]
    assert [*seeds[:2], seeds[3]] == [1, 1, 2]
    found.append(find_paths(plane, plan, rng=seeds[2]))
    np.testing.assert_array_equal(found[2].theta, found[4].theta)
    for name in ("time", "theta", "phi"):
        for paths in found[1:3]:
            np.testing.assert_array_equal(getattr(paths, name), getattr(found[0], name))


@pytest.fixture(scope="module")
def planned():
    plane = SMALL["troubles"]()
    return plane, find_paths(plane, plan_of(plane, 0), motion=MOTION)


@pytest.mark.parametrize("suffix", ["ecsv", "fits"])
def test_paths_that_are_written_and_read_are_the_same(planned, suffix, tmp_path):
    plane, paths = planned
    paths.write(tmp_path / f"paths.{suffix}")
    refused("exists", paths.write, tmp_path / f"paths.{suffix}")
    again = Paths.read(tmp_path / f"paths.{suffix}", plane)
    for name in ("start", "time", "theta", "phi", "arrives", "fiber"):
        found, expected = (np.asarray(getattr(one, name)) for one in (again, paths))
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12)
    assert again.smallest_distance == paths.smallest_distance
    assert [([str(key) for key in ids], reason) for ids, reason in paths.groups] == list(again.groups)
    assert len(again.groups) == 1
    again.write(tmp_path / f"again.{suffix}")
    assert Paths.read(tmp_path / f"again.{suffix}", plane).groups == again.groups


def test_fiber_types_and_absent_arms_are_read(tmp_path):
    plane = SMALL["capsules"]()
    paths = find_paths(plane, plan_of(plane, 2))
    gone = slice(*paths.start[3:5])
    theta, phi = paths.theta.copy(), paths.phi.copy()
    theta[gone] = phi[gone] = np.nan
    with pytest.raises(rs.InputError, match="or all NaN for an absent arm without a target"):
        replace(paths, theta=theta, phi=phi)
    others = np.arange(len(plane)) != 3
    flags = {"arrives": paths.arrives & others, "assigned": paths.assigned & others}
    paths = replace(paths, theta=theta, phi=phi, **flags)
    paths.write(tmp_path / "paths.ecsv")
    again = Paths.read(tmp_path / "paths.ecsv", plane)
    np.testing.assert_array_equal(again.fiber, paths.fiber)
    assert set(again.fiber) == {0, 1}
    assert np.isnan(again.theta[slice(*again.start[3:5])]).all()
    assert not again.arrives[3]


def rows_of(table, motion, key):
    return np.flatnonzero((table["motion"] == motion) & (table["positioner"] == key))


def set_one(table, column, value, k=1):
    table[column][rows_of(table, "fold", 3)[k]] = value
    return table


def set_both(table, column, value):
    table[column][rows_of(table, "fold", 3)[1]] = value
    table[column][rows_of(table, "unfold", 3)[-2]] = value
    return table


def without(table, motion, k):
    keep = np.ones(len(table), dtype=bool)
    keep[rows_of(table, motion, 3)[k]] = False
    return table[keep]


def moved_stuck(table):
    for motion in ("fold", "unfold"):
        table["theta"][rows_of(table, motion, 4)] = -60 * DEG
    return table


REVERSAL, TIMES = "the motion unfold must be the exact reversal", "the times of each positioner must increase from 0 s"
NOT_FINITE = "36000 deg, or all NaN for an absent arm without a target, but those of 1 positioner.*the positioner 3$"
DAMAGE = {
    "another angle": (lambda t: set_one(t, "theta", 1 * DEG), REVERSAL),
    "another time": (lambda t: set_one(t, "time", 0.01 * u.s), REVERSAL),
    "another angle twice": (lambda t: set_both(t, "phi", -1000 * DEG), "must not collide, but [0-9]+ pairs? of arms"),
    "NaN": (lambda t: set_one(t, "theta", np.nan * DEG), NOT_FINITE),
    "NaN twice": (lambda t: set_both(t, "theta", np.nan * DEG), NOT_FINITE),
    "infinity twice": (lambda t: set_both(t, "phi", np.inf * DEG), NOT_FINITE),
    "huge angle twice": (lambda t: set_both(t, "theta", 1e15 * DEG), NOT_FINITE),
    "time NaN": (lambda t: set_one(t, "time", np.nan * u.s), TIMES),
    "time 0 twice": (lambda t: set_one(t, "time", 0 * u.s), TIMES),
    "negative time": (lambda t: set_one(t, "time", -1 * u.s), TIMES),
    "other last time": (lambda t: set_one(t, "time", 500 * u.s, -1), TIMES),
    "row removed": (lambda t: without(t, "fold", 1), REVERSAL),
    "last row removed": (lambda t: without(t, "fold", -1), TIMES),
    "positioner removed": (lambda t: t[t["positioner"] != 3], "must contain all positioners; 3 are missing"),
    "fold only": (lambda t: t[t["motion"] == "fold"], "must have rows with the motion 'unfold', got none"),
    "unfold only": (lambda t: t[t["motion"] == "unfold"], "must have rows with the motion 'fold', got none"),
    "empty": (lambda t: t[:0], "must have rows with the motion 'fold', got none"),
    "no angles": (lambda t: t["motion", "positioner", "time", "phi"], "must have the column 'theta'"),
    "stuck arm moved": (moved_stuck, "the arms of broken positioners must remain in their poses.*the positioner 4$"),
    "twice": (lambda t: vstack([t, t], metadata_conflicts="silent"), TIMES),
}


@pytest.mark.parametrize("name", DAMAGE)
def test_damaged_tables_are_refused(planned, name):
    plane, paths = planned
    damage, sentence = DAMAGE[name]
    refused(sentence, Paths.from_table, damage(paths.table.copy()), plane)


def test_paths_of_another_focal_plane_are_refused(planned):
    plane, paths = planned
    larger = rs.FocalPlane.hexagonal(SEGMENT, rings=3, pitch=22.4 * MM)
    refused("must contain all positioners; .* are missing", Paths.from_table, paths.table, larger)
    names = replace(plane, id=[f"P{k}" for k in range(19)])
    refused("which has no positioners", Paths.from_table, paths.table, names)
    thick = replace(plane, positioner=replace(SEGMENT, clearance=4 * MM))
    refused("must not collide", Paths.from_table, paths.table, thick)
    ranges = np.tile([-1.0, 1.0], (19, 1))
    refused("within the joint limits", Paths.from_table, paths.table, replace(plane, theta_range=ranges * DEG))
    wall = replace(plane, obstacles=np.append(plane.obstacles.value, [[0, 0, 0.1]], axis=0) * MM)
    refused("must not touch obstacles", Paths.from_table, paths.table, wall)


BAD = {
    "step 0": ({"step": 0 * DEG}, "step must be one finite value of at least 0.01 deg"),
    "step NaN": ({"step": np.nan * DEG}, "step must be one finite value"),
    "step of a length": ({"step": 1 * MM}, "step must have a unit convertible to deg"),
    "negative margin": ({"margin": -1 * MM}, "margin must be one finite value of at least 0 mm"),
    "margin NaN": ({"margin": np.nan * MM}, "margin must be one finite value"),
    "motion": ({"motion": "fast"}, "motion must be a JointMotion, got str"),
    "seed": ({"rng": "one"}, "rng must be a seed"),
    "arms of another length": ({"arms": np.zeros((3, 2)) * MM}, "must have a row for each of the 19 positioners"),
    "out of reach": ({"arms": np.full((19, 2), 1e3) * MM}, "out of reach"),
    "no plane": ({"focal_plane": 3}, "focal_plane must be"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_input_is_refused(planned, name):
    options, sentence = BAD[name]
    plane, _ = planned
    refused(sentence, find_paths, **({"focal_plane": plane, "arms": np.full((19, 2), np.nan) * MM} | options))


@pytest.mark.parametrize("trouble", ["two stuck arms", "a stuck arm and an obstacle"])
def test_broken_arms_that_collide_do_not_prevent_paths(trouble):
    unit = rs.Positioner(7.4 * MM, 15 * MM, 1.5 * MM)
    stuck = [[0, 20], [180, 20] if trouble == "two stuck arms" else [np.nan] * 2, [np.nan] * 2] * DEG
    obstacles = None if trouble == "two stuck arms" else [[12, 2, 2]] * MM
    plane = rs.FocalPlane([[0, 0], [22, 0], [70, 0]] * MM, unit, stuck=stuck, obstacles=obstacles)
    paths = find_paths(plane, [[np.nan] * 2, [np.nan] * 2, [80, 5]] * MM)
    assert paths.arrives[2]


SQUARE = np.array([[6, -1], [8, -1], [8, 1], [6, 1]])
RING = [[7 * np.cos(angle), 7 * np.sin(angle), 2] for angle in np.arange(0, 6, 0.5)]


@pytest.mark.parametrize("shapes", [{"obstacles": [[7, 0, 1]] * MM}, {"obstacle_polygons": [SQUARE * MM]}])
def test_arms_without_a_target_avoid_obstacles(shapes):
    plane = rs.FocalPlane([[0, 0], [70, 0]] * MM, rs.Positioner(8 * MM, 14 * MM, 1 * MM), **shapes)
    paths = find_paths(plane, [[np.nan] * 2, [80, 5]] * MM)
    assert paths.arrives.all()
    assert Replay(plane, paths.table).to_obstacles() >= 1


def test_obstacles_that_arms_touch_in_the_poses_of_the_plan_are_reported():
    unit = rs.Positioner(8 * MM, 14 * MM, 1 * MM)
    plane = rs.FocalPlane([[0, 0], [70, 0]] * MM, unit, obstacles=RING * MM)
    paths = find_paths(plane, [[np.nan] * 2, [80, 5]] * MM)
    assert paths.groups == ((["0"], "an arm without a target collides in all poses"),)
    assert paths.arrives.tolist() == [False, True]
    refused("the arm of the positioner 0 is not farther from an obstacle", find_paths, plane, [[9, 0], [80, 5]] * MM)


def test_an_arm_that_turns_freely_is_not_locked_by_the_assumed_range():
    circles = [[3.46, -9.17, 0.51], [-2.24, -6.21, 1.94], [11.31, -9.7, 1.79]] * MM
    plane = rs.FocalPlane([[0, 0], [200, 0]] * MM, rs.Positioner(8 * MM, 14 * MM, 1 * MM), obstacles=circles)
    arms = rs.collision.place_arms(plane, theta=[-159.378, np.nan] * DEG, phi=[43.045, np.nan] * DEG)
    assert LOCKED not in [reason for _, reason in find_paths(plane, arms).groups]


@pytest.mark.parametrize("groups", [5, ["a"], [[1]]])
def test_damaged_groups_are_refused(groups):
    plane = SMALL["segments"]()
    table = find_paths(plane, plan_of(plane, 1)).table
    table.meta["groups"] = groups
    refused("the entry groups of the paths must be lists", Paths.from_table, table, plane)


def test_plans_that_collide_or_belong_to_another_focal_plane_are_refused():
    plane = rs.FocalPlane([[0, 0], [22, 0]] * MM, SEGMENT)
    refused("the positioners 0 and 1 collide, or are closer", find_paths, plane, [[12, 0], [12, 1]] * MM)
    refused("", find_paths, SMALL["outlines"](), plan_of(SMALL["segments"]()))
