"""Regression tests of the search for the best plan, and plans whose search reaches the time limit."""

from collections import Counter
from itertools import combinations, product

import astropy.units as u
import numpy as np
import pytest
from outlined import capsule

import flat
import rfpsurvey as rs
from brute import edges_alone
from rfpsurvey._assignment.candidates import reduced
from rfpsurvey._kernels import conflicts

MM = u.mm
EXHAUSTIVE = pytest.mark.exhaustive


def dense_plane(rings=16):
    return rs.FocalPlane.hexagonal(rs.Positioner(8.25 * MM, 8.25 * MM, 2.25 * MM), rings=rings, pitch=19 * MM)


def sparse_targets(plane, seed):
    rng = np.random.default_rng(seed)
    m = int(len(plane) * rng.uniform(0.4, 1.2))
    return plane.arrays.xy[rng.integers(len(plane), size=m)] + rng.normal(size=(m, 2)) * rng.choice([3, 6]), rng


@pytest.mark.few(4)
@pytest.mark.parametrize("seed", [324, 5, 11])
@pytest.mark.parametrize("milliseconds", [1e-6, 1, 5, 50])
def test_a_bound_is_a_bound_when_time_is_up(seed, milliseconds):
    """Regression: bounds of parts without remaining time were omitted, and the plan was reported as proven."""
    plane = dense_plane()
    xy, rng = sparse_targets(plane, seed)
    options = {"method": "optimal", "priority": rng.integers(0, rng.integers(1, 3), len(xy))}
    best = flat.allocate(plane, xy * MM, **options)
    assert best.gap == 0
    found = flat.allocate(plane, xy * MM, time_limit=milliseconds * u.ms, **options)
    for first, second in zip(best.levels, found.levels, strict=True):
        assert second.value <= second.bound
        if second.value != first.value:
            assert second.value < first.value <= second.bound
            assert found.gap > 0
            break
    assert len(rs.find_collisions(plane, found).pairs) == 0


UNPROVEN_PLANS = [
    (3, "priority", 0),
    (3, "count", 0),
    (40, "count", 0),
    pytest.param(40, "priority", 0, marks=EXHAUSTIVE),
    *(pytest.param(n, objective, 1, marks=EXHAUSTIVE) for n in (3, 40) for objective in ("priority", "count")),
]


@pytest.mark.few(1)
@pytest.mark.parametrize(("n_classes", "objective", "seed"), UNPROVEN_PLANS)
def test_unproven_plans_are_honest(n_classes, objective, seed):
    unit = rs.Positioner(7.4 * MM, 15 * MM, 2.5391 * MM)
    plane = rs.FocalPlane.hexagonal(unit, rings=9, pitch=22.4 * MM)
    rng = np.random.default_rng(seed)
    xy = rng.uniform(-200, 200, (500, 2)) * MM
    options = {"method": "optimal", "priority": rng.integers(0, n_classes, 500), "objective": objective}
    best = flat.allocate(plane, xy, **options)
    assert best.gap == 0
    values = [level.value for level in best.levels]
    for seconds in (0.05, 0.3):
        found = flat.allocate(plane, xy, time_limit=seconds * u.s, **options)
        assert len(rs.find_collisions(plane, found).pairs) == 0
        assert [level.value for level in found.levels] <= values
        for value, level in zip(values, found.levels, strict=True):
            assert level.bound >= value
            if value != level.value:
                break
        assert found.n_assigned > 0.8 * best.n_assigned


@pytest.mark.few(6)
@pytest.mark.parametrize("parked", [True, False])
@pytest.mark.parametrize("seed", range(12))
def test_larger_fields_against_a_plain_integer_program(seed, parked):
    """Regression: if the reduced candidates did not contain the idle arm, a plan with a repeated target was reported as
    proven.
    """
    plane = dense_plane(rings=3)
    xy, _ = sparse_targets(plane, seed)
    found = rs.allocate(plane, xy * MM, allocator=rs.AllocationOptions("optimal", parked_obstacles=parked))
    assert (found.n_assigned, found.gap) == (edges_alone(plane, xy, parked), 0)
    wide = rs.FocalPlane.hexagonal(rs.Positioner(7.4 * MM, 15 * MM, 2.5 * MM), rings=3, pitch=22.4 * MM)
    xy, _ = sparse_targets(wide, seed + 100)
    assert rs.allocate(wide, xy * MM, allocator="optimal").n_assigned == edges_alone(wide, xy, True)


def test_a_stuck_fiber_of_another_type_is_somewhere_else():
    """Regression: the arm of a stuck positioner was rotated to its second fiber, and then collided."""
    unit = capsule(2, -3, length=14.5)
    stuck = [[0, 90], [np.nan, np.nan]] * u.deg
    plane = rs.FocalPlane([[0, 0], [20, 0]] * MM, unit, fiber_type=["B+A"] * 2, stuck=stuck)
    options = {"method": "optimal", "kind": ["science"], "fiber_type": ["B"], "sky_separation": 0.5 * MM}
    found = flat.allocate(plane, [[11.0, 8.1]] * MM, requirements="sky@A=1", **options)
    assert len(rs.find_collisions(plane, found).pairs) == 0
    assert found.target_of_positioner[0] == -1
    found = flat.allocate(plane, [[11.0, 8.1]] * MM, requirements="sky@B=1", **options)
    assert found.target_of_positioner[0] >= found.n_given
    assert found.unmet == ()


@pytest.mark.parametrize("seed", range(6))
def test_the_bound_of_a_repair_is_what_arms_could_reach_that_pass_through_each_other(seed):
    plane = dense_plane(rings=3)
    xy, rng = sparse_targets(plane, seed)
    options = {"priority": rng.integers(0, 2, len(xy)), "required": np.flatnonzero(rng.random(len(xy)) < 0.2)}
    blind = flat.allocate(plane, xy * MM, allocator="network_flow", **options)
    repaired = flat.allocate(plane, xy * MM, allocator="repair", **options)
    for level, best in zip(repaired.levels, blind.levels, strict=True):
        assert (level.name, level.bound) == (best.name, best.value)
        assert level.value <= level.bound
        if level.value < level.bound:
            break


@pytest.mark.few(6)
@pytest.mark.parametrize("largest", [10, 1e6])
@pytest.mark.parametrize("steep", [1.0, 8.0])
@pytest.mark.parametrize("seed", range(4))
def test_how_aims_are_put_together_does_not_matter(monkeypatch, seed, steep, largest):
    """If an objective has too little weight in a sum of objectives, the search detects it."""
    unit = rs.Positioner(7.4 * MM, 15 * MM, 2.5391 * MM)
    plane = rs.FocalPlane.hexagonal(unit, rings=3, pitch=22.4 * MM)
    rng = np.random.default_rng(seed)
    xy = rng.uniform(-75, 75, (60, 2)) * MM
    options = {
        "method": "optimal",
        "priority": rng.integers(0, 5, 60),
        "objective": "count" if seed % 2 else "priority",
    }
    usual = flat.allocate(plane, xy, **options)
    for name, value in {"LARGE": 0, "STEEP": steep, "LARGEST": largest}.items():
        monkeypatch.setattr(f"rfpsurvey._assignment.objectives.{name}", value)
    found = flat.allocate(plane, xy, **options)
    assert (found.levels, found.gap) == (usual.levels, 0)


def random_conflicts(rng):
    """Return candidates of a few positioners that exclude each other at random, which real arms cannot do."""
    n = int(rng.integers(2, 6))
    own, target, pairs = [], [], []
    for i in range(n):
        mine = rng.choice(6, rng.integers(0, 4), replace=False)
        own += [i] * (len(mine) + 1)
        target += [*mine.tolist(), -1]
    own, target = np.array(own), np.array(target)
    for a in range(len(own)):
        for b in range(a):
            if own[a] != own[b] and (target[a] >= 0 or target[b] >= 0) and rng.random() < 0.25:
                pairs.append((b, a))
    pairs = np.array(pairs, dtype=np.int64).reshape(-1, 2).T.copy()
    rank = np.append(rng.integers(0, 3, 6), 4)[target]
    key = np.append(rng.integers(0, 2, 6), 2)[target]
    as_good = np.array([[True, False, rng.random() < 0.5], [False, True, True], [False, False, True]])
    rows = np.flatnonzero(target >= 0)
    rows = rows[np.argsort(target[rows], kind="stable")]
    indptr, other = np.empty(len(own) + 1, np.int64), np.empty(2 * pairs.shape[1], np.int64)
    conflicts.adjacency(pairs[0], pairs[1], indptr, other)
    cost = rng.integers(0, 3, 6).astype(float)[target]
    return conflicts.Options(
        np.searchsorted(own, np.arange(n + 1)),
        own,
        target,
        rank,
        cost,
        key,
        as_good,
        np.concatenate([[0], np.cumsum(np.bincount(target[rows], minlength=6))]),
        rows,
        indptr,
        other,
    ), pairs


def plans(options, pairs, alive):
    """Yield all plans of some candidates with their values: classes, keys and cost."""
    mine = [[c for c in range(*options.start[i : i + 2]) if alive[c]] for i in range(len(options.start) - 1)]
    bad = {tuple(p) for p in pairs.T.tolist()}
    for plan in product(*mine):
        used = [options.target[c] for c in plan if options.target[c] >= 0]
        if len(set(used)) == len(used) and not any(p in bad for p in combinations(plan, 2)):
            classes = tuple(sum(options.rank[c] == k for c in plan) for k in range(3))
            yield (
                plan,
                classes,
                Counter(options.key[c] for c in plan),
                -sum(options.cost[c] for c in plan if options.target[c] >= 0),
            )


@pytest.mark.parametrize("seeds", [range(500), pytest.param(range(500, 1500), marks=pytest.mark.exhaustive)])
def test_reduction_keeps_a_best_plan_and_leaves_nothing_that_decided_ones_exclude(seeds):
    for seed in seeds:
        options, pairs = random_conflicts(np.random.default_rng(seed))
        # without requirements, all keys are equivalent
        free = options._replace(key=np.zeros_like(options.key), as_good=np.ones((1, 1), bool))
        for case, with_keys in ((free, False), (options, True)):
            before = list(plans(case, pairs, np.ones(len(options.owner), bool)))
            if not before:
                continue
            alive = reduced(case)
            after, weigh = list(plans(case, pairs, alive)), [lambda p: (p[1], p[3])]
            if with_keys:  # for any requirement on one key
                weigh = [lambda p, k=k, s=s: (s * p[2][k], p[1]) for k in (0, 1) for s in (1,) if case.as_good[k, 2]]
            for worth in weigh:
                assert max(map(worth, after)) == max(map(worth, before)), seed
            n_left = np.add.reduceat(alive, options.start[:-1])
            decided = set(np.flatnonzero(alive & (n_left == 1)[options.owner]).tolist())
            for a, b in pairs.T.tolist():
                assert not (alive[a] and alive[b] and (a in decided or b in decided)), seed
            for a in decided:
                rivals = (options.target == options.target[a]) & (options.owner != options.owner[a]) & alive
                assert options.target[a] < 0 or not rivals.any(), seed


def test_classes_after_required_targets_may_be_larger_than_in_a_matching():
    """Regression: a matching without required targets gave a wrong upper limit of 23 for a class."""
    plane = rs.FocalPlane.hexagonal(rs.Positioner(8.25 * MM, 8.25 * MM, 3 * MM), rings=7, pitch=18 * MM)
    n, rng = len(plane), np.random.default_rng(2)
    xy = plane.arrays.xy[rng.integers(n, size=2 * n)] + rng.uniform(-12, 12, (2 * n, 2))
    options = {"priority": rng.integers(0, 4, 2 * n), "required": np.flatnonzero(rng.random(2 * n) < 0.5)}
    found = flat.allocate(plane, xy * MM, allocator="optimal", parked_obstacles=False, **options)
    assert found.levels[-1].value == found.levels[-1].bound == 27


@pytest.mark.parametrize("options", [{"method": "optimal", "time_limit": 1 * u.ns}, {"method": "repair"}])
def test_sky_of_stuck_fibers_counts_toward_a_maximum(options):
    unit = rs.Positioner(8.25 * MM, 8.25 * MM, 2.25 * MM)
    stuck = [[0, 90], [10, 90], [np.nan, np.nan]] * u.deg
    plane = rs.FocalPlane([[0, 0], [60, 0], [120, 0]] * MM, unit, stuck=stuck)
    xy = [[123, 3.0]] * MM
    if options["method"] == "repair":
        options = {**options, "start": rs.allocate(plane, xy, allocator="network_flow", kind=["sky"])}
    found = flat.allocate(plane, xy, requirements=["sky=1-2"], sky_separation=1 * MM, kind=["sky"], **options)
    assert (found.n_assigned, found.unmet) == (2, ())


@pytest.mark.parametrize("method", ["optimal", "repair"])
@pytest.mark.parametrize(("gap", "n"), [(4.5, 2), (np.nextafter(4.5, 0), 1), (np.nextafter(4.5, 5), 2)])
def test_arms_at_the_safe_distance_are_settled_exactly(method, gap, n):
    """Parallel stretched arms at the minimum separation do not collide. One rounding error nearer, they collide."""
    plane = rs.FocalPlane([[0, 0], [0, gap]] * MM, rs.Positioner(4 * MM, 4 * MM, 2.25 * MM))
    found = rs.allocate(plane, [[8, 0], [8, gap]] * MM, allocator=rs.AllocationOptions(method, parked_obstacles=False))
    assert found.n_assigned == n


@pytest.mark.parametrize("n_required", [0, 12])
@pytest.mark.parametrize("method", ["network_flow", "optimal"])
def test_programs_that_run_out_of_time_prove_nothing(monkeypatch, method, n_required):
    """The test replaces the solver by one that reports a timeout, since real times depend on the machine."""
    plane, n = dense_plane(rings=2), 120
    rng = np.random.default_rng(0)
    priority, kind = rng.integers(0, 2, n), rng.choice(["science", "sky"], n, p=[0.8, 0.2])
    xy = rng.uniform(-50, 50, (n, 2)) * MM
    xy[0], priority[0], kind[0] = 3 * MM, 1, "science"  # also if the first program has no time
    options = {"method": method, "priority": priority, "kind": kind, "requirements": "sky=4"}
    if n_required:
        options["required"] = np.flatnonzero(rng.permutation(n) < n_required)
    best = flat.allocate(plane, xy, **options)
    for module in ("milp", "solver"):
        monkeypatch.setattr(f"rfpsurvey._assignment.{module}.maximize", lambda *_, **__: (None, np.inf))
    # without prices of cliques, all bounds follow from a matching
    monkeypatch.setattr("rfpsurvey._assignment.search.MOST_BOUNDS", 0)
    found = flat.allocate(plane, xy, **options)
    assert best.gap == 0 < found.gap
    assert any(level.value < level.bound for level in found.levels)
    assert found.levels[0].bound >= best.levels[0].value
    # no plan has more targets than there are positioners
    first, second = (level for level in found.levels if level.name.startswith("priority"))
    assert first.bound == first.value + second.bound == len(plane)


@pytest.mark.few(1)
@pytest.mark.parametrize(("pitch", "expected"), [(25.6, True), (5.0, False)])
def test_presolve_which_looks_at_no_clock_is_left_out_of_dense_programs(monkeypatch, pitch, expected):
    """Regression: the presolve step took up to 400 s with a limit of 5 s, for arms of 16.5 mm at a pitch of 5 mm."""
    unit = rs.Positioner(8.25 * MM, 8.25 * MM, 2.25 * MM)
    plane, rng = rs.FocalPlane.hexagonal(unit, rings=5, pitch=pitch * MM), np.random.default_rng(5)
    r, angle = 1.3 * 5 * pitch * np.sqrt(rng.random(91)), 2 * np.pi * rng.random(91)
    said = []

    def answer(*_, presolve, **__):
        said.append(presolve)
        return None, np.inf

    monkeypatch.setattr("rfpsurvey._assignment.milp.maximize", answer)
    monkeypatch.setattr("rfpsurvey._assignment.search.improve_by_clusters", lambda _, chosen, *__: chosen)
    # the scene is dense enough to leave work to the solver
    plane = rs.FocalPlane(plane.xy, rs.Positioner(8.25 * MM, 8.25 * MM, 6 * MM)) if expected else plane
    xy = np.column_stack([r * np.cos(angle), r * np.sin(angle)]) * MM
    rs.allocate(plane, xy, allocator=rs.AllocationOptions("optimal", time_limit=5 * u.s))
    assert set(said) == {expected}
