"""Plans with requirements and subpriorities from linear programs, compared with an independent integer program."""

import astropy.units as u
import numpy as np
import pytest
from scipy.optimize import Bounds, LinearConstraint, milp

import rfpsurvey as rs
from integer_program import LexicographicProgram
from rfpsurvey._assignment import objectives, relaxed, search
from rfpsurvey._assignment.relaxed import GAP

MM = u.mm
SEEDS = [range(24), *(pytest.param(range(k, k + 23), marks=pytest.mark.exhaustive) for k in range(24, 300, 23))]


def crowded_scene(seed):
    """Return a focal plane with close positioners, targets of all kinds, and requirements that compete for fibers."""
    rng = np.random.default_rng(seed)
    unit = rs.Positioner(8.25 * MM, 8.25 * MM, 2.25 * MM)
    plane = rs.FocalPlane.hexagonal(unit, rings=2, pitch=rng.uniform(13, 20) * MM)
    plane = rs.FocalPlane(plane.xy, unit, spectrograph=rng.integers(0, 2, len(plane)))
    m = int(rng.integers(15, 60))
    xy = plane.arrays.xy[rng.integers(len(plane), size=m)] + rng.uniform(-14, 14, (m, 2))
    requirements = []
    for what in rng.choice(["sky", "standard", "good"], rng.integers(1, 4), replace=False).tolist():
        low = int(rng.integers(1, 5))
        most = None if rng.random() < 0.5 else low + int(rng.integers(0, 3))
        requirements.append(rs.Requirement(what, low, most, str(rng.choice(["tile", "spectrograph"]))))
    options = {
        "priority": rng.integers(0, rng.integers(1, 4), m).astype(float),
        "kind": rng.choice(["science", "science", "science+standard", "standard", "sky"], m),
        "category": rng.choice(["good", "poor"], m),
    }
    return plane, xy, options, requirements, rng.random(m) if seed % 3 else rng.integers(0, seed % 4 + 1, m)


def optimum(program, goal):
    """Return the largest value of a goal over all plans of a program."""
    matrix, low, high = program.rows
    limits = LinearConstraint(matrix.toarray(), low, high)  # older versions of scipy refuse sparse 64-bit indices
    answer = milp(-goal, constraints=limits, integrality=np.ones(program.n), bounds=Bounds(0, program.most))
    assert answer.status == 0
    return -answer.fun


@pytest.mark.parametrize("seeds", SEEDS)
def test_bounds_are_valid_and_plans_are_as_good_as_their_gap_states(seeds, monkeypatch):
    n_found = {"whole": 0, "integer": 0, "best": 0}

    def relax(program, deadline):
        found = relaxed.relax(program, deadline)
        for k, bound in enumerate(found.sums):
            assert bound >= optimum(program, program.goal(0, found.weights(k))) - 1e-6
        goal = found.ratio * program.goal(0, found.weights(len(found.sums) - 1)) - program.costs
        assert found.last >= optimum(program, goal) - 1e-6
        n_found["best" if found.is_best else "whole" if not found.integral else "integer"] += 1
        return found

    monkeypatch.setattr(search, "LARGE", 0)
    monkeypatch.setattr(search, "relax", relax)
    for seed in seeds:
        plane, xy, options, requirements, subpriority = crowded_scene(seed)
        columns = {**options, "requirements": requirements, "required": np.zeros(len(xy), dtype=bool)}
        oracle = LexicographicProgram(plane, xy, subpriority, **columns)
        oracle.goals = np.delete(oracle.goals, -2, axis=0)  # without the collisions of idle arms
        best = oracle.best()
        allocator = rs.AllocationOptions("optimal", requirements=requirements)
        plan = rs.allocate(plane, xy * MM, allocator=allocator, subpriority=subpriority, **options)
        values = oracle.values(plan.target_of_positioner)
        np.testing.assert_array_equal(values[:-1], best[:-1], err_msg=str(seed))
        error = 1e-6 * len(plane) * np.ptp(subpriority)  # subpriorities are rounded to one millionth of their range
        assert best[-1] - error - GAP * abs(best[-1]) <= values[-1] <= best[-1] + 1e-6, seed
        level = plan.levels[-1]
        assert level.value == pytest.approx(values[-1], abs=1e-9), seed
        assert level.bound >= best[-1] - 4 * error, seed
    assert n_found["whole"] > 0


@pytest.mark.parametrize("seeds", [range(12), pytest.param(range(12, 100), marks=pytest.mark.exhaustive)])
def test_objectives_that_linear_programs_prove_do_not_change_plans(seeds, monkeypatch):
    """Without subpriorities, plans are those of the integer programs of all objectives."""
    n_proven = n_fewer = 0
    monkeypatch.setattr(search, "LARGE", 0)
    monkeypatch.setattr(objectives, "LARGE", 0)
    monkeypatch.setattr(objectives, "LARGEST", 1.0)  # each objective has its own program
    for seed in seeds:
        plane, xy, options, requirements, _ = crowded_scene(seed)
        plans = []
        for function in (relaxed.proven_values, lambda *_: []):
            monkeypatch.setattr(search, "proven_values", function)
            allocator = rs.AllocationOptions("optimal", requirements=requirements)
            plans.append(rs.allocate(plane, xy * MM, allocator=allocator, **options))
        assert plans[0].target_of_positioner.tolist() == plans[1].target_of_positioner.tolist(), seed
        assert plans[0].handedness.tolist() == plans[1].handedness.tolist(), seed
        assert plans[0].levels == plans[1].levels, seed
        n_fewer += plans[1].meta["n_programs"] - plans[0].meta["n_programs"]
        n_proven += all(level.bound == level.value for level in plans[0].levels)
    assert n_proven == len(seeds)
    assert n_fewer > 0
