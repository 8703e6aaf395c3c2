"""Arms without a path: locked arms, and verdicts on pairs of arms."""

import astropy.units as u
import numpy as np
import pytest
import shapely
from moving import ends
from path_scenes import DEG, MM, SEGMENT
from scipy.ndimage import label

import rfpsurvey as rs
from rfpsurvey._instruments import find_paths as planning
from rfpsurvey._instruments.find_paths import _Planner
from rfpsurvey._instruments.path_arms import arms_of
from rfpsurvey.collision import find_paths
from rfpsurvey.positioner import JointMotion

LOCKED = "locked by obstacles and joint limits"


def flooded(plane, i, theta, phi, sign, size=0.5):
    """Return whether cells of the angles (deg) of an arm are connected with folded cells, by plain shapes.

    The arm keeps the clearance plus ``sign`` times the largest distance of a point of the arm from its position in the
    center of its cell. The last theta is connected with the first if it differs by a full rotation.
    """
    unit, (x, y) = plane.positioner, plane.xy[i].to_value(MM)
    l1, l2 = unit.central_arm.to_value(MM), unit.eccentric_arm.to_value(MM)
    a = np.arange(theta[0], theta[1] + size / 2, size)
    b = np.arange(0.0, 180 + size / 2, size)
    grid = np.deg2rad(np.stack(np.meshgrid(a, b, indexing="ij")))
    elbow = x + l1 * np.cos(grid[0]), y + l1 * np.sin(grid[0])
    lines = shapely.linestrings(ends(*elbow, grid[0] + grid[1], 0.0, l2))
    slack, clearance = np.deg2rad(0.5 * size) * (l1 + 2 * l2), unit.clearance.to_value(MM)
    free = np.ones(lines.shape, dtype=bool)
    for cx, cy, radius in plane.obstacles.to_value(MM):
        free &= shapely.distance(lines, shapely.Point(cx, cy)) - radius >= clearance + sign * slack
    seen = np.zeros_like(free)
    seen[np.abs(a - phi[0]).argmin(), np.abs(b - phi[1]).argmin()] = True
    for _ in range(free.size):
        grown = seen.copy()
        grown[1:] |= seen[:-1]
        grown[:-1] |= seen[1:]
        grown[:, 1:] |= seen[:, :-1]
        grown[:, :-1] |= seen[:, 1:]
        grown = grown & free | seen
        if (grown == seen).all():
            break
        seen = grown
    return seen[:, -1].any()


@pytest.mark.parametrize("seeds", [range(10), pytest.param(range(10, 80), marks=pytest.mark.exhaustive)])
def test_arms_are_locked_as_in_a_slow_flood_of_their_angles(seeds):
    """Fiducials around an arm with a narrow range of theta leave a path to the folded pose, or none."""
    n_locked = n_arriving = 0
    for seed in seeds:
        rng = np.random.default_rng([3, seed])
        width, turn = rng.uniform(15, 120), rng.uniform(-150, 150)
        unit = rs.Positioner(
            8 * MM, 14 * MM, 1 * MM, theta_range=[turn, turn + width] * DEG, home=[turn + width / 2, 180] * DEG
        )
        for _ in range(100):
            n = rng.integers(2, 5)
            r, angle = rng.uniform(6, 18, n), np.deg2rad(rng.uniform(turn, turn + 300, n))
            circles = np.column_stack([r * np.cos(angle), r * np.sin(angle), rng.uniform(0.5, 2.5, n)])
            plane = rs.FocalPlane([[0, 0], [200, 0]] * MM, unit, obstacles=circles * MM)
            pose = [turn + width * rng.random(), 90.0 * rng.random()]
            arms = rs.collision.place_arms(plane, theta=[pose[0], np.nan] * DEG, phi=[pose[1], np.nan] * DEG)
            if len(rs.find_collisions(plane, arms).obstacle_pairs) == 0:
                break
        else:
            continue
        paths = find_paths(plane, arms, motion=JointMotion(phi_range=[0, 180] * DEG))
        possible, certain = (flooded(plane, 0, (turn, turn + width), pose, sign) for sign in (-1, 1))
        locked = [reason for ids, reason in paths.groups if ids == ["0"]] == [LOCKED]
        assert not (locked and certain), seed
        assert not (paths.arrives[0] and not possible), seed
        assert paths.arrives[0] or not certain, seed
        columns, motion = plane.arrays, JointMotion(phi_range=[0, 180] * DEG)
        prepared = arms_of(columns, arms, motion, 0.05)
        proven = _Planner(columns, prepared, np.deg2rad(1), rng)._is_locked(0)  # the planner asks only if it fails
        assert not (proven and certain), seed
        if not flooded(plane, 0, (turn, turn + width), pose, -3):
            assert locked, seed
            assert proven, seed
        n_locked, n_arriving = n_locked + locked, n_arriving + bool(paths.arrives[0])
    assert n_locked > len(seeds) / 8
    assert n_arriving > len(seeds) / 8


ALONE, INTERLOCKED = "the two arms have a path without the other arms", "the two arms are interlocked"


@pytest.mark.parametrize("seeds", [range(25), pytest.param(range(25, 150), marks=pytest.mark.exhaustive)])
def test_verdicts_on_two_arms_agree_with_the_planner(seeds):
    """Pairs of arms with narrow ranges of theta, in poses in which many of them cross the path of the other."""
    found, n_missed, motion = [], 0, JointMotion(phi_range=[0, 180] * DEG)
    for seed in seeds:
        rng = np.random.default_rng([7, seed])
        for _ in range(100):
            low, width = rng.uniform(-90, 90, 2) + [0, 180], rng.uniform(5, 40, 2)
            theta, phi = low + width * rng.random(2), rng.uniform(20, 120, 2)
            plane = rs.FocalPlane(
                [[0, 0], [18, 0]] * MM,
                rs.Positioner(8 * MM, 14 * MM, 1 * MM),
                theta_range=np.column_stack([low, low + width]) * DEG,
            )
            arms = rs.collision.place_arms(plane, theta=theta * DEG, phi=phi * DEG)
            if len(rs.find_collisions(plane, arms).pairs) == 0:
                break
        arrives = find_paths(plane, arms, motion=motion, margin=0 * MM).arrives.all()
        columns = plane.arrays
        verdict = _Planner(columns, arms_of(columns, arms, motion, 0.0), 0.1, rng)._examine(np.array([0, 1]))
        assert not (arrives and verdict == INTERLOCKED), seed
        n_missed += not arrives and verdict == ALONE  # two random searches, of which only the second found a path
        found.append(verdict)
    assert n_missed <= 0.02 * len(seeds)
    assert found.count(INTERLOCKED) > 1
    assert found.count(ALONE) > len(seeds) / 2


def test_two_arms_that_only_other_arms_block_are_reported(monkeypatch):
    """All steps, and all searches beside other arms, are suppressed."""
    search = planning.path_search.search
    monkeypatch.setattr(planning, "STAGES", ())
    monkeypatch.setattr(
        planning.path_search, "search", lambda bodies, *rest: search(bodies, *rest)[: 99 * np.isnan(bodies.x).any()]
    )
    plane = rs.FocalPlane([[0, 0], [22, 0], [44, 0]] * MM, SEGMENT)
    targets = [[12, 0], [22, 12], [44, 12]] * MM
    assert {reason for _, reason in find_paths(plane, targets).groups} == {"no path was found"}
    assert {reason for _, reason in find_paths(plane, targets, examine=True).groups} == {ALONE}


@pytest.mark.parametrize(("x", "is_locked"), [(20.0, True), (42.0, False)])
def test_two_arms_that_block_each_other_are_interlocked(x, is_locked):
    """Each of two antiparallel arms would have to fold through the other one, as in a slow flood of their angles."""
    elbows, directions = np.array([[0, 0], [x, 4]]), np.deg2rad([-60, 120])
    centers = elbows - 8 * np.column_stack([np.cos(directions), np.sin(directions)])
    ranges = np.rad2deg(directions)[:, None] + [-0.2, 0.2]
    unit = rs.Positioner(8 * MM, 17 * MM, 1.8 * MM, phi_range=[59, 180] * DEG)
    plane = rs.FocalPlane(centers * MM, unit, theta_range=ranges * DEG)
    arms = rs.collision.place_arms(plane, theta=directions * u.rad, phi=[60, 60] * DEG)
    np.testing.assert_allclose(arms.segments, [[0, 0, 17, 0], [x, 4, x - 17, 4]], atol=1e-12)
    phi = np.deg2rad(np.arange(60, 181, 2.0))
    first, second = (
        shapely.linestrings(ends(*elbow, direction + phi, 0.0, 17.0))
        for elbow, direction in zip(elbows, directions, strict=True)
    )
    apart = shapely.distance(first[:, None], second[None])
    group = label(apart > (3.3 if is_locked else 3.9), np.ones((3, 3)))[0]  # the minimum separation is 3.6 mm
    assert (group[0, 0] != group[-1, -1], group[0, 0] > 0, group[-1, -1] > 0) == (is_locked, True, True)
    for examine, reason in ((False, "no path was found"), (True, "the two arms are interlocked")):
        paths = find_paths(plane, arms, examine=examine)
        assert list(paths.groups) == ([(["0", "1"], reason), (["1", "0"], reason)] if is_locked else [])
        assert paths.arrives.tolist() == [not is_locked] * 2
