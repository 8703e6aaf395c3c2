"""What once went wrong in the search for the best plan, and plans that run out of time."""

import astropy.units as u
import numpy as np
import pytest
from scipy.optimize import Bounds, LinearConstraint, milp
from scipy.sparse import csr_array

import rfpsurvey as rs
from brute import bodies_of, conflicts_of, options_of

MM = u.mm


def dense_plane(rings=16):
    return rs.FocalPlane.hexagonal(rs.Positioner(8.25 * MM, 8.25 * MM, 2.25 * MM), rings=rings, pitch=19 * MM)


def sparse_targets(plane, seed):
    rng = np.random.default_rng(seed)
    m = int(len(plane) * rng.uniform(0.4, 1.2))
    return plane._xy_mm[rng.integers(len(plane), size=m)] + rng.normal(size=(m, 2)) * rng.choice([3, 6]), rng


@pytest.mark.parametrize("seed", [324, 5, 11])
@pytest.mark.parametrize("milliseconds", [1e-6, 1, 5, 50])
def test_a_bound_is_a_bound_when_time_is_up(seed, milliseconds):
    """The bounds of parts that had no time were left out, and what was found counted as proven."""
    plane = dense_plane()
    xy, rng = sparse_targets(plane, seed)
    options = {"method": "optimal", "priority": rng.integers(0, rng.integers(1, 3), len(xy))}
    best = rs.allocate(xy * MM, plane, **options)
    assert best.gap == 0
    found = rs.allocate(xy * MM, plane, time_limit=milliseconds * u.ms, **options)
    for first, second in zip(best.levels, found.levels, strict=True):
        assert second.value <= second.bound
        if second.value != first.value:
            assert second.value < first.value <= second.bound
            assert found.gap > 0
            break
    assert len(rs.find_collisions(plane, found).pairs) == 0


@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize("objective", ["priority", "count"])
@pytest.mark.parametrize("n_classes", [3, 40])
def test_unproven_plans_are_honest(n_classes, objective, seed):
    unit = rs.Positioner(7.4 * MM, 15 * MM, 2.5391 * MM)
    plane = rs.FocalPlane.hexagonal(unit, rings=9, pitch=22.4 * MM)
    rng = np.random.default_rng(seed)
    xy = rng.uniform(-200, 200, (500, 2)) * MM
    options = {"method": "optimal", "priority": rng.integers(0, n_classes, 500), "objective": objective}
    best = rs.allocate(xy, plane, **options)
    assert best.gap == 0
    values = [level.value for level in best.levels]
    for seconds in (0.05, 0.3):
        found = rs.allocate(xy, plane, time_limit=seconds * u.s, **options)
        assert len(rs.find_collisions(plane, found).pairs) == 0
        assert [level.value for level in found.levels] <= values
        for value, level in zip(values, found.levels, strict=True):
            assert level.bound >= value
            if value != level.value:
                break
        assert found.n_assigned > 0.8 * best.n_assigned


def edges_alone(plane, xy, parked):
    """Number of targets in the best plan, by an integer program with a row for each conflict."""
    choices = options_of(plane, xy, None, both=False)
    pairs, barred = conflicts_of(plane, bodies_of(plane, xy, choices, None, parked))
    column = {(i, k): n for n, (i, k) in enumerate((i, k) for i, mine in enumerate(choices) for k in range(len(mine)))}
    rows = [[column[a], column[b]] for a, b in pairs]
    by_target = {}
    for i, mine in enumerate(choices):
        for k in range(1, len(mine)):
            by_target.setdefault(mine[k][0], []).append(column[i, k])
    rows += list(by_target.values())
    own = [[column[i, k] for k in range(len(mine))] for i, mine in enumerate(choices)]
    everything = rows + own
    matrix = csr_array(
        (np.ones(sum(map(len, everything))), np.concatenate(everything), np.cumsum([0, *map(len, everything)])),
        shape=(len(everything), len(column)),
    )
    low = np.append(np.full(len(rows), -np.inf), np.ones(len(own)))
    most = np.ones(len(column))
    most[[column[c] for c in barred]] = 0
    worth = np.array([k > 0 for _, k in column], dtype=float)
    found = milp(-worth, constraints=LinearConstraint(matrix, low, 1), bounds=Bounds(0, most), integrality=most)
    return round(-found.fun)


@pytest.mark.parametrize("parked", [True, False])
@pytest.mark.parametrize("seed", range(12))
def test_larger_fields_against_a_plain_integer_program(seed, parked):
    """Reduced candidates need not contain the idle arm, and a plan with a target twice was taken for proven."""
    plane = dense_plane(rings=3)
    xy, _ = sparse_targets(plane, seed)
    found = rs.allocate(xy * MM, plane, method="optimal", parked_obstacles=parked)
    assert found.n_assigned == edges_alone(plane, xy, parked)
    assert found.gap == 0
    wide = rs.FocalPlane.hexagonal(rs.Positioner(7.4 * MM, 15 * MM, 2.5 * MM), rings=3, pitch=22.4 * MM)
    xy, _ = sparse_targets(wide, seed + 100)
    assert rs.allocate(xy * MM, wide, method="optimal").n_assigned == edges_alone(wide, xy, True)


def test_a_stuck_fiber_of_another_type_is_somewhere_else():
    """The arm of a stuck unit was turned to the second fiber, and then collided."""
    unit = rs.Positioner(
        7.4 * MM,
        15 * MM,
        2 * MM,
        arm_model="capsule",
        arm_length=14.5 * MM,
        arm_angle={"B": 2 * u.deg, "A": -3 * u.deg},
    )
    stuck = [[0, 90], [np.nan, np.nan]] * u.deg
    plane = rs.FocalPlane([[0, 0], [20, 0]] * MM, unit, fiber_type=["B+A"] * 2, stuck=stuck)
    options = {"method": "optimal", "kind": ["science"], "fiber_type": ["B"], "sky_separation": 0.5 * MM}
    found = rs.allocate([[11.0, 8.1]] * MM, plane, requirements="sky@A=1", **options)
    assert len(rs.find_collisions(plane, found).pairs) == 0
    assert found.target_of_positioner[0] == -1
    found = rs.allocate([[11.0, 8.1]] * MM, plane, requirements="sky@B=1", **options)
    assert found.target_of_positioner[0] >= found.n_given
    assert found.unmet == ()


@pytest.mark.parametrize("seed", range(6))
def test_the_bound_of_a_repair_is_what_arms_could_reach_that_pass_through_each_other(seed):
    plane = dense_plane(rings=3)
    xy, rng = sparse_targets(plane, seed)
    options = {"priority": rng.integers(0, 2, len(xy)), "required": rng.random(len(xy)) < 0.2}
    blind = rs.allocate(xy * MM, plane, method="sdss", **options)
    mended = rs.allocate(xy * MM, plane, method="repair", **options)
    for level, best in zip(mended.levels, blind.levels, strict=True):
        assert (level.name, level.bound) == (best.name, best.value)
        assert level.value <= level.bound
        if level.value < level.bound:
            break
