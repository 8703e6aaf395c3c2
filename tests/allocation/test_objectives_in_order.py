"""``optimal`` with subpriorities and touching idle arms, compared with an independent integer program."""

from dataclasses import replace

import astropy.units as u
import numpy as np
import pytest

import flat
import rfpsurvey as rs
from integer_program import LexicographicProgram, counts, groups_of
from scenes import KINDS, SEVERAL, random_scene

MM = u.mm
SEEDS = [range(10), *(pytest.param(range(k, k + 20), marks=pytest.mark.exhaustive) for k in range(0, 100, 20))]
in_chunks = pytest.mark.parametrize("seeds", SEEDS)


def scenes_of(seeds, kinds=KINDS):
    """Yield the scenes of some seeds, and the integer program of each scene, without subpriorities."""
    for seed in seeds:
        plane, xy, options, rng = random_scene(seed, kinds)
        yield seed, plane, xy, options, rng, program_of(plane, xy, options, np.zeros(len(xy)))


def program_of(plane, xy, options, subpriority):
    required = np.isin(np.arange(len(xy)), options["required"])
    return LexicographicProgram(plane, xy, subpriority, **{**options, "required": required})


@in_chunks
def test_no_objective_is_worse_than_in_the_best_plan(seeds):
    """A step that separated idle arms once kept the numbers of targets, but lost the sum of their subpriorities.

    The sum of the subpriorities takes precedence over the collisions of idle arms.
    """
    for seed, plane, xy, options, rng, _ in scenes_of(seeds):
        subpriority = rng.random(len(xy))
        oracle = program_of(plane, xy, options, subpriority)
        found, best = flat.allocate(plane, xy * MM, "optimal", **options), oracle.best()
        np.testing.assert_array_equal(oracle.values(found.target_of_positioner)[:-1], best[:-1], err_msg=str(seed))
        allocator, others = flat.split("optimal", dict(options), flat.NAMES - {"required", "keep_out", "subpriority"})
        found = rs.allocate(plane, xy * MM, allocator=allocator, subpriority=subpriority, **others)
        oracle.goals[-2:] = oracle.goals[[-1, -2]]
        best, tolerance = oracle.best(), np.zeros(len(best))
        tolerance[-2] = 1e-6 * len(plane)  # subpriorities are rounded to one millionth of their range
        values = oracle.values(found.target_of_positioner)
        assert (np.abs(values - best) <= tolerance).all(), (seed, values, best)


def divided_scene(seed):
    """Return a scene of targets with several roles, with requirements per spectrograph and on fiber types."""
    plane, xy, options, rng = random_scene(seed, SEVERAL)
    n, m = len(plane), len(xy)
    fibers = np.append(["A+B"], rng.choice(["A+B", "B+A", "B"], n - 1))
    plane = replace(plane, fiber_type=fibers, spectrograph=rng.integers(0, 2, (n, 2) if seed % 2 else n))
    requirements = []
    for what in rng.choice(["sky", "standard", "good", "science"], rng.integers(1, 4), replace=False).tolist():
        low = int(rng.integers(0, 4)) if what != "science" else 0
        most = None if rng.random() < 0.4 and what != "science" else low + int(rng.integers(0, 4))
        per, fiber = rng.choice(["tile", "spectrograph"]), rng.choice(["", "A", "B"])
        requirements.append(rs.Requirement(what, low, most, str(per), str(fiber)))
    return plane, xy, {**options, "requirements": requirements, "fiber_type": rng.choice(["A", "B", ""], m)}


def check_counts(plane, options, found, seed, allocator):
    """Check the numbers of missing and excess targets that a plan states, and return how many requirements it misses.

    Of the allocators that are tested here, only ``lamost_rule`` ignores maxima.
    """
    columns = {name: options.get(name) for name in ("kind", "category", "fiber_type")}
    fibers = [(i, t) for i, t in enumerate(found.target_of_positioner.tolist()) if t >= 0]
    lacking = {}
    for one, place in groups_of(plane, options["requirements"]):
        n = sum(counts(plane, one, place, i, t, **columns) for i, t in fibers)
        if n < one.minimum:
            lacking[one, place] = one.minimum, n
        elif one.maximum is not None and n > one.maximum:
            assert allocator == "lamost_rule", (seed, allocator, one)
            lacking[one, place] = one.maximum, n
    stated = {(s.requirement, s.spectrograph): (s.requested, s.found) for s in found.unmet if s.requirement}
    assert stated == lacking, (seed, allocator)
    return len(stated)


@in_chunks
@pytest.mark.parametrize("divided", [False, True])
def test_targets_count_toward_the_requirements_on_all_of_their_roles(seeds, divided):
    """A target had one kind: required standards were missing although science targets that are standards had fibers.

    The bound of each objective holds for all plans with the same values of the earlier objectives. The requirements of
    divided scenes are per spectrograph and on fiber types.
    """
    n_both = n_short = n_lower = 0
    for seed in seeds:
        plane, xy, options = divided_scene(seed) if divided else random_scene(seed, SEVERAL)[:3]
        oracle = program_of(plane, xy, options, np.zeros(len(xy)))
        found, best = flat.allocate(plane, xy * MM, "optimal", **options), oracle.best()
        np.testing.assert_array_equal(oracle.values(found.target_of_positioner), best, err_msg=str(seed))
        is_science = np.char.find(options["kind"], "science") >= 0
        classes = np.unique(options["priority"][is_science])[::-1].tolist()
        names = [f"priority {p:g}" for p in classes] if len(classes) > 1 else ["science"] * len(classes)
        names = ["required targets", "requirements", *names, "any target"]
        for programs in (None, seed % 3):
            plan = flat.allocate(plane, xy * MM, "optimal", programs=programs, **options)
            check_counts(plane, options, plan, seed, "optimal")
            values = oracle.values(plan.target_of_positioner)
            for name, value, bound in plan.levels:
                k = names.index(name)
                most = oracle.best(values[:k])[k]
                assert value == values[k] <= most, (seed, name)
                assert np.isnan(bound) or bound >= most, (seed, name)
                n_lower += value < bound
        for allocator in ("repair", "lamost_rule", "network_flow"):
            other = flat.allocate(plane, xy * MM, allocator, **options)
            n_short += check_counts(plane, options, other, seed, allocator)
            if allocator == "repair":
                assert tuple(oracle.values(other.target_of_positioner)[:2]) <= tuple(best[:2]), seed
        kinds = options["kind"][found.target_of_positioner[found.target_of_positioner >= 0]]
        n_both += (np.char.find(kinds, "+") >= 0).sum()
    assert n_both > 0
    assert n_short > 0
    assert n_lower > 0


@in_chunks
def test_a_plan_with_late_targets_changes_as_few_fibers_as_possible(seeds):
    """Regression: with few fibers, a plan changed an idle fiber although it could change only a used fiber."""
    n_changed = 0
    for seed, plane, xy, options, rng, oracle in scenes_of(seeds):
        late = np.flatnonzero(rng.random(len(xy)) < 0.2)
        forbidden = [(i, t) for i in range(len(plane)) for t in late.tolist()]
        before = flat.allocate(plane, xy * MM, "optimal", forbidden=forbidden, **options)
        for (i, k), column in oracle.column.items():
            old, new = before.target_of_positioner[i], oracle.choices[i][k][0] if k else -1
            oracle.goals[-1, column] = -float(old != new)
        found = flat.allocate(plane, xy * MM, "optimal", start=before, **options)
        np.testing.assert_array_equal(oracle.values(found.target_of_positioner), oracle.best(), err_msg=str(seed))
        changed = found.target_of_positioner != before.target_of_positioner
        assert found.meta["n_changed"] == changed.sum() == -oracle.best()[-1]
        n_changed += found.meta["n_changed"]
    assert n_changed > 5
