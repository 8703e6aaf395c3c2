"""``optimal`` with subpriorities and touching idle arms, compared with an independent integer program."""

import astropy.units as u
import numpy as np
import pytest

import flat
import rfpsurvey as rs
from integer_program import LexicographicProgram
from scenes import SEVERAL, random_scene

MM = u.mm
N_SCENES, CHUNK = 300, 20
EXHAUSTIVE = pytest.mark.exhaustive


@pytest.mark.few(1)
@pytest.mark.parametrize("chunk", [0, 1, *(pytest.param(k, marks=EXHAUSTIVE) for k in range(2, N_SCENES // CHUNK))])
def test_no_objective_is_worse_than_in_the_best_plan(chunk):
    """A step that separated idle arms once kept the numbers of targets, but lost the sum of their subpriorities.

    The sum of the subpriorities takes precedence over the collisions of idle arms.
    """
    for seed in range(CHUNK * chunk, CHUNK * (chunk + 1)):
        plane, xy, options, rng = random_scene(seed)
        subpriority = rng.random(len(xy))
        required = np.isin(np.arange(len(xy)), options["required"])
        oracle = LexicographicProgram(plane, xy, subpriority, **{**options, "required": required})
        found = flat.allocate(plane, xy * MM, "optimal", **options)
        best = oracle.best()
        np.testing.assert_array_equal(oracle.values(found.target_of_positioner)[:-1], best[:-1], err_msg=str(seed))
        allocator, others = flat.split("optimal", dict(options), flat.NAMES - {"required", "keep_out", "subpriority"})
        found = rs.allocate(plane, xy * MM, allocator=allocator, subpriority=subpriority, **others)
        oracle.goals[-2:] = oracle.goals[[-1, -2]]
        best, tolerance = oracle.best(), np.zeros(len(best))
        tolerance[-2] = 1e-6 * len(plane)  # subpriorities are rounded to one millionth of their range
        values = oracle.values(found.target_of_positioner)
        assert (np.abs(values - best) <= tolerance).all(), (seed, values, best)


@pytest.mark.few(1)
@pytest.mark.parametrize("chunk", [0, 1, *(pytest.param(k, marks=EXHAUSTIVE) for k in range(2, N_SCENES // CHUNK))])
def test_targets_count_toward_the_requirements_on_all_of_their_roles(chunk):
    """A target had one kind: required standards were missing although science targets that are standards had fibers."""
    n_both = 0
    for seed in range(CHUNK * chunk, CHUNK * (chunk + 1)):
        plane, xy, options, _ = random_scene(seed, SEVERAL)
        required = np.isin(np.arange(len(xy)), options["required"])
        oracle = LexicographicProgram(plane, xy, np.zeros(len(xy)), **{**options, "required": required})
        found = flat.allocate(plane, xy * MM, "optimal", **options)
        best = oracle.best()
        np.testing.assert_array_equal(oracle.values(found.target_of_positioner), best, err_msg=str(seed))
        bounds = {level.name: level.bound for level in found.levels}
        if "requirements" in bounds:
            assert bounds["requirements"] <= -best[1], seed
        for allocator in ("repair", "lamost_rule", "network_flow"):
            other = flat.allocate(plane, xy * MM, allocator, **options)
            fibers = other.target_of_positioner[other.target_of_positioner >= 0]
            for one in options["requirements"]:
                names = options["category"] if (options["category"] == one.what).any() else options["kind"]
                n = sum(one.what in name.split("+") for name in names[fibers].tolist())
                stated = [s.found for s in other.unmet if s.requirement == one]
                assert (stated or [n]) == [n], (seed, allocator, one)
                if allocator in ("repair", "network_flow") and one.maximum is not None:
                    assert n <= one.maximum, (seed, allocator, one)
            if allocator == "repair":
                values = oracle.values(other.target_of_positioner)
                assert tuple(values[:2]) <= tuple(best[:2]), seed
        n_both += np.char.find(options["kind"][found.target_of_positioner[found.target_of_positioner >= 0]], "+").max(
            initial=0
        )
    assert n_both > 0


@pytest.mark.parametrize("chunk", [0, *(pytest.param(k, marks=EXHAUSTIVE) for k in range(1, N_SCENES // CHUNK))])
def test_a_plan_with_late_targets_changes_as_few_fibers_as_possible(chunk):
    """Regression: with few fibers, a plan changed an idle fiber although it could change only a used fiber."""
    n_changed = 0
    for seed in range(CHUNK * chunk, CHUNK * (chunk + 1)):
        plane, xy, options, rng = random_scene(seed)
        late = np.flatnonzero(rng.random(len(xy)) < 0.2)
        forbidden = [(i, t) for i in range(len(plane)) for t in late.tolist()]
        before = flat.allocate(plane, xy * MM, "optimal", forbidden=forbidden, **options)
        required = np.isin(np.arange(len(xy)), options["required"])
        oracle = LexicographicProgram(plane, xy, np.zeros(len(xy)), **{**options, "required": required})
        for (i, k), column in oracle.column.items():
            old, new = before.target_of_positioner[i], oracle.choices[i][k][0] if k else -1
            oracle.goals[-1, column] = -float(old != new)
        found = flat.allocate(plane, xy * MM, "optimal", start=before, **options)
        np.testing.assert_array_equal(oracle.values(found.target_of_positioner), oracle.best(), err_msg=str(seed))
        changed = found.target_of_positioner != before.target_of_positioner
        assert found.meta["n_changed"] == changed.sum() == -oracle.best()[-1]
        n_changed += found.meta["n_changed"]
    assert n_changed > 5
