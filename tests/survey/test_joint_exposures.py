"""Joint plans of several exposures of the same fields: kernels, bounds, and plans of chosen targets."""

from dataclasses import replace

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.table import QTable
from joint_program import finished_by_class, plans_of, program_of, survey_with, with_finished
from scipy.optimize import Bounds, LinearConstraint, milp

import rfpsurvey as rs
from rfpsurvey._kernels import exposures as kernels
from rfpsurvey._survey.joint import exposures

pytestmark = pytest.mark.filterwarnings("ignore::rfpsurvey.RfpsurveyWarning")


def starts_of(index, n):
    return np.concatenate([[0], np.cumsum(np.bincount(index, minlength=n))])


def random_pairs(rng, n_targets=30, n_fibers=8, n_exposures=5, most_visits=4):
    """Return pairs, the visits that each target needs, and the exposures of each fiber."""
    reach = rng.random((n_targets, n_fibers)) < 0.25
    target, fiber = np.nonzero(reach)
    needed = rng.integers(1, most_visits + 1, n_targets)
    by_fiber = np.argsort(fiber, kind="stable")
    starts = starts_of(target, n_targets), starts_of(fiber, n_fibers)
    most = np.minimum(needed[target], n_exposures)
    return kernels.Pairs(starts[0], fiber, target, starts[1], by_fiber, most), needed, np.full(n_fibers, n_exposures)


def optimum(pairs, needed, room, group=None, scale=None):
    """Return the largest number of finished targets, or the largest value of the smallest fraction of the groups."""
    n, m = len(pairs.fiber), len(needed)
    matrix = np.zeros((len(room) + m, n + m + 1))
    matrix[pairs.fiber, np.arange(n)] = 1
    matrix[len(room) + pairs.target, np.arange(n)] = -1
    matrix[len(room) + np.arange(m), n + np.arange(m)] = needed
    high = np.append(room, np.zeros(m))
    goal = np.append(np.zeros(n), np.ones(m + 1))
    goal[-1] = 0
    if group is not None:
        rows = np.zeros((len(scale), n + m + 1))
        rows[group, n + np.arange(m)] = -1
        rows[:, -1] = scale
        matrix, high, goal = np.vstack([matrix, rows]), np.append(high, np.zeros(len(scale))), np.zeros(n + m + 1)
        goal[-1] = 1
    most = np.concatenate([pairs.most, np.ones(m), [1.0]])
    integral = np.append(np.ones(n + m), 0)
    result = milp(
        -goal, constraints=LinearConstraint(matrix, -np.inf, high), bounds=Bounds(0, most), integrality=integral
    )
    return -result.fun


def check_uses(pairs, needed, room, uses, left, finished):
    spent = np.bincount(pairs.fiber, uses, len(room))
    assert (uses >= 0).all()
    assert (uses <= pairs.most).all()
    assert np.array_equal(room - spent, left)
    assert (left >= 0).all()
    assert np.array_equal(np.bincount(pairs.target, uses, len(needed)), np.where(finished, needed, 0))


@pytest.mark.parametrize("most_visits", [1, 4])
def test_uses_finish_targets(most_visits):
    """With one visit each, the number of finished targets is the largest possible one."""
    ratio = []
    for seed in range(30):
        rng = np.random.default_rng(seed)
        pairs, needed, room = random_pairs(rng, n_exposures=int(rng.integers(2, 6)), most_visits=most_visits)
        uses, left, finished = np.zeros(len(pairs.fiber), np.int64), room.copy(), np.zeros(len(needed), bool)
        order, done = np.argsort(needed, kind="stable"), np.zeros(1, np.int64)
        one_list = order, np.array([0, len(order)]), np.ones(1)
        kernels.finish_targets(*one_list, done, needed, pairs, uses, left, finished)
        check_uses(pairs, needed, room, uses, left, finished)
        assert done[0] == finished.sum()
        best = optimum(pairs, needed, room)
        ratio.append(done[0] / max(best, 1))
        assert done[0] <= best + 1e-6
    assert min(ratio) == 1 if most_visits == 1 else np.mean(ratio) > 0.97


def test_fractions_of_lists_are_balanced():
    n_best = 0
    for seed in range(30):
        rng = np.random.default_rng([seed, 1])
        pairs, needed, room = random_pairs(rng, n_targets=40, n_exposures=3)
        group = rng.permutation(np.repeat([0, 1, 2], [24, 12, 4]))
        scale = np.bincount(group, minlength=3) * np.array([1.0, 1.0, 2.0])
        uses, left, finished = np.zeros(len(pairs.fiber), np.int64), room.copy(), np.zeros(len(needed), bool)
        lists, done = np.argsort(group, kind="stable"), np.zeros(3, np.int64)
        given = lists, starts_of(group, 3), scale, done
        state = needed, pairs, uses, left, finished
        kernels.finish_targets(*given, *state)
        before = (done / scale).min()
        kernels.balance(*given, group, *state)
        check_uses(pairs, needed, room, uses, left, finished)
        assert np.array_equal(done, np.bincount(group[finished], minlength=3))
        after, best = (done / scale).min(), optimum(pairs, needed, room, group, scale)
        assert before <= after <= best + 1e-6, seed
        n_best += after > best - (1 / scale).max() - 1e-6
    assert n_best >= 26  # the exchanges are a heuristic


def test_all_uses_are_scheduled_if_no_arms_collide():
    """The edges of a bipartite graph can be colored with as many colors as the largest degree (Koenig)."""
    for seed in range(40):
        rng = np.random.default_rng([seed, 2])
        n_exposures, n_fibers = int(rng.integers(2, 8)), 6
        # the sum of random permutations has equal degrees
        uses = sum(np.eye(n_fibers, dtype=int)[rng.permutation(n_fibers)] for _ in range(n_exposures))
        fiber, target = np.nonzero(uses)
        n = len(fiber)
        nothing = np.zeros(n + 1, np.int64), np.empty(0, np.int64)
        poses = kernels.Poses(fiber, target, *nothing)
        plan, load = np.full((n_exposures, n_fibers), kernels.FREE), np.zeros((n_exposures, 0), np.int32)
        given = rng.permutation(n), uses[fiber, target], np.arange(n + 1), np.arange(n), poses, np.zeros(2, np.int64)
        kernels.schedule(*given, np.full(plan.shape, -1), plan, load)
        assert (plan >= 0).all(), seed
        assert np.array_equal(fiber[plan], np.tile(np.arange(n_fibers), (n_exposures, 1)))
        assert all(len(np.unique(row)) == n_fibers for row in target[plan])
        assert np.array_equal(np.bincount(plan.ravel(), minlength=n), uses[fiber, target])


def test_arms_that_collide_are_in_different_exposures():
    """Cliques that at least one schedule keeps: the exposures of a given schedule, in another order for each fiber."""
    n_kept = 0
    for seed in range(40):
        rng = np.random.default_rng([seed, 3])
        n_exposures, n_fibers = 6, 5
        n = n_exposures * n_fibers  # each fiber observes a target of its own in each exposure
        fiber, target = np.repeat(np.arange(n_fibers), n_exposures), np.arange(n)
        hidden = np.array([rng.permutation(n_exposures) for _ in range(n_fibers)]).ravel()
        a, b = rng.integers(0, n, (2, 60))
        keep = (fiber[a] != fiber[b]) & (hidden[a] != hidden[b])
        pairs = np.unique(np.sort(np.column_stack([a, b])[keep][:12], axis=1), axis=0)
        row, clique = pairs.ravel(), np.repeat(np.arange(len(pairs)), 2)
        order = np.argsort(row, kind="stable")
        poses = kernels.Poses(fiber, target, starts_of(row, n), clique[order])
        plan, load = np.full((n_exposures, n_fibers), kernels.FREE), np.zeros((n_exposures, len(pairs)), np.int32)
        # one fiber of one exposure is not available, and the arm there collides with nothing
        given = np.arange(n), np.ones(n, np.int64), np.arange(n + 1), np.arange(n), poses, rng.integers(0, 6, 30)
        kernels.schedule(*given, np.full(plan.shape, -1), plan, load)
        used = np.zeros((n_exposures, n), bool)
        np.put_along_axis(used, plan, True, axis=1)
        assert np.array_equal(load, used[:, pairs[:, 0]] + used[:, pairs[:, 1]].astype(int))
        dropped = np.zeros(n, bool)
        kernels.drop_collisions(np.zeros(n, np.int64), 1, poses, plan, load, dropped)
        assert load.max(initial=0) <= 1
        assert (plan < 0).sum() == dropped.sum()
        n_kept += not dropped.any()
    assert n_kept >= 38


def repeated(seed, roles):
    """Return a survey with up to six exposures of up to three fields; some targets need more visits than that."""
    (instrument, tiles, catalog, options, needs), rng = survey_with(seed, roles), np.random.default_rng([seed, 4])
    number = rng.integers(0, len(tiles), rng.integers(1, 7)) * int(rng.integers(0, 2))
    tiles = QTable({"ra": tiles.ra[number], "dec": tiles.dec[number], "pass": 1 + np.arange(len(number))})
    catalog = replace(catalog, visits=rng.integers(0, rng.integers(2, 8), len(catalog)))
    return instrument, tiles, catalog, options, needs


@pytest.mark.parametrize("seeds", [[*range(10), 23], pytest.param(range(10, 60), marks=pytest.mark.exhaustive)])
@pytest.mark.parametrize("roles", ["science", "kinds", "several"])
@pytest.mark.parametrize("more", [100, 0])
def test_plans_of_chosen_targets(monkeypatch, roles, more, seeds):
    """The plans keep all limits, the bounds are those of all plans, and most plans are optimal or nearly so."""
    monkeypatch.setattr(exposures, "MOST_PAIRS", 0)
    monkeypatch.setattr(exposures, "FEW_EXPOSURES", 0)
    monkeypatch.setattr(exposures, "MORE", more)
    total, possible = 0, 0
    cases = ((seed, repeated(seed, roles)) for seed in seeds)
    for seed, (_, _, catalog, *_), program, _, survey in plans_of(cases, objective="finished", iterations=1):
        weights = with_finished(program, catalog)
        sums = [w @ program.maximize(w) for w in np.cumsum(weights, axis=0)]
        done = np.cumsum(finished_by_class(survey, catalog, program.classes))
        levels = survey.summary["joint"]["levels"]
        assert [level["n_complete"] for level in levels] == done.tolist(), seed
        assert (np.array([level["bound_complete"] for level in levels]) >= sums).all(), seed
        total, possible = total + done[-1], possible + sums[-1]
    assert total >= (0.95 if more else 0.8) * possible


@pytest.mark.parametrize("share", ["category", "b=2 a=0.5"])
def test_shares_of_chosen_targets(monkeypatch, share):
    monkeypatch.setattr(exposures, "MOST_PAIRS", 0)
    monkeypatch.setattr(exposures, "FEW_EXPOSURES", 0)
    for seed in range(12):
        instrument, tiles, catalog, options, _ = repeated(seed, "science")
        category = np.random.default_rng([seed, 5]).choice(["a", "b"], len(catalog))
        catalog = replace(catalog, category=category)
        if {*category[catalog.visits > 0]} != {"a", "b"}:
            continue
        joint = rs.JointOptions(objective="finished", share=share, iterations=1, allocator=options)
        chosen = rs.plan_survey(catalog, instrument, tiles, allocator=joint).summary["joint"]
        monkeypatch.setattr(exposures, "MOST_PAIRS", 10**9)
        proven = rs.plan_survey(catalog, instrument, tiles, allocator=joint).summary["joint"]
        monkeypatch.setattr(exposures, "MOST_PAIRS", 0)

        def smallest(summary):
            return min(row["fraction"] / row["weight"] for row in summary["shares"])

        assert smallest(chosen) <= smallest(proven) + 1e-9 <= chosen["bound_of_smallest"] + 2e-9, seed
        sizes = [{row["category"]: row["n_targets"] for row in one["shares"]} for one in (chosen, proven)]
        assert sizes[0] == sizes[1]


def test_visits_of_fixed_tiles(monkeypatch):
    """Visits of fixed exposures count, also of targets that are not listed otherwise, and if all tiles are fixed."""
    monkeypatch.setattr(exposures, "MOST_PAIRS", 0)
    monkeypatch.setattr(exposures, "FEW_EXPOSURES", 0)
    for seed in range(24):
        instrument, tiles, catalog, options, _ = repeated(seed, "science")
        if instrument.focal_plane.positioner.handedness == "both" or not catalog.visits.any():
            continue
        n_fixed = 1 + seed % len(tiles)
        before = rs.plan_survey(catalog, instrument, tiles[:n_fixed], allocator=options)
        joint = rs.JointOptions(objective="finished", iterations=1, allocator=options, fixed=before)
        survey = rs.plan_survey(catalog, instrument, tiles, allocator=joint)
        assert all(np.array_equal(survey.tile(k)["target_row"], before.tile(k)["target_row"]) for k in range(n_fixed))
        level, made = survey.summary["joint"]["levels"][-1], np.asarray(survey.outcomes["observed"])
        assert level["n_complete"] == ((made >= catalog.visits) & (catalog.visits > 0)).sum() <= level["bound_complete"]
        earlier, coord = np.asarray(before.outcomes["observed"]), SkyCoord(tiles["ra"], tiles["dec"])
        left, most = replace(catalog, visits=catalog.visits - earlier), 0
        if n_fixed < len(tiles) and left.visits.any():
            most = program_of(instrument, coord[n_fixed:], left, options, [], []).sums()[-1]
        assert level["n_visits"] == made.sum() <= earlier.sum() + most <= level["bound"], seed


def test_added_sky_positions(monkeypatch):
    """Regression: more added sky positions than targets led to an IndexError, or to plans with few targets."""
    results, finish = [], exposures.Exposures.finish
    monkeypatch.setattr(exposures.Exposures, "finish", lambda *args: results.append(finish(*args)) or results[-1])
    for seed in (5, 7, 9, 17, 18, 21):
        instrument, tiles, catalog, options, _ = repeated(seed, "science")
        options = replace(options, requirements=["sky=1"], sky_separation=0.3 * u.mm)
        joint = rs.JointOptions(objective="finished", iterations=2, allocator=options)
        survey = rs.plan_survey(catalog[:8], instrument, tiles, allocator=joint)
        n_finished = ((np.asarray(survey.outcomes["observed"]) >= catalog.visits[:8]) & (catalog.visits[:8] > 0)).sum()
        slots = np.concatenate([plan.slot[plan.slot >= 0] for plan in results[-1][0]])
        visits = np.bincount(slots, minlength=8)  # those of finished targets only
        assert n_finished == survey.summary["joint"]["levels"][-1]["n_complete"] == (visits > 0).sum(), seed
        assert not survey.tiles["n_unmet"].any()


def test_targets_that_need_more_visits_than_there_are_exposures(monkeypatch):
    """No bound counts them, although several fibers reach them, and they use no fibers in place of other targets."""
    monkeypatch.setattr(exposures, "MOST_PAIRS", 0)
    monkeypatch.setattr(exposures, "MORE", 0)
    for seed in range(8):
        instrument, tiles, catalog, options, _ = repeated(seed, "science")
        is_long = np.arange(len(catalog)) % 2 == 0
        visits = np.where(is_long, len(tiles) + 1, 1)
        catalog, numbers = replace(catalog, visits=visits, priority=is_long.astype(float)), []
        for some in (catalog, replace(catalog, visits=np.where(is_long, 0, visits))):
            for iterations in (0, 1):
                joint = rs.JointOptions(objective="finished", iterations=iterations, allocator=options)
                levels = rs.plan_survey(some, instrument, tiles, allocator=joint).summary["joint"]["levels"]
                numbers.append(levels[-1]["n_complete"])
            numbers.append(levels[-1]["bound_complete"])
        assert numbers[:3] == numbers[3:], seed


def test_the_time_limit_ends_the_first_plans(monkeypatch):
    """Regression: the first plans of finished targets were made up to 16 times for each field, whatever the limit."""
    n_schedules, schedule = [], exposures.Exposures._schedule
    monkeypatch.setattr(exposures.Exposures, "_schedule", lambda *args: n_schedules.append(1) or schedule(*args))
    instrument, tiles, catalog, options, _ = repeated(1, "science")
    for limit in (None, 1 * u.ns):
        joint = rs.JointOptions(objective="finished", iterations=0, allocator=options, time_limit=limit)
        rs.plan_survey(catalog, instrument, tiles, allocator=joint)
        n_schedules.append(0)
    unlimited = n_schedules.index(0)
    assert len(n_schedules) - unlimited - 2 == len(np.unique(tiles["ra"])) < unlimited


def test_bound_of_shares_if_no_target_can_be_finished(monkeypatch):
    """Regression: the bound was 0, although fixed tiles had finished targets of all categories."""
    monkeypatch.setattr(exposures, "MOST_PAIRS", -1)
    for seed in (0, 2, 4, 7):
        instrument, tiles, catalog, options, _ = repeated(seed, "science")
        category = np.where(np.arange(len(catalog)) % 2, "a", "b")
        catalog = replace(catalog, category=category, visits=np.ones(len(catalog), int))
        before = rs.plan_survey(catalog, instrument, tiles, allocator=options)
        joint = rs.JointOptions(objective="finished", share="category", iterations=1, allocator=options, fixed=before)
        summary = rs.plan_survey(catalog, instrument, tiles, allocator=joint).summary["joint"]
        is_done = np.asarray(before.outcomes["observed"]) > 0
        assert [row["n_complete"] for row in summary["shares"]] == [is_done[category == k].sum() for k in ("a", "b")]
        smallest = min(row["fraction"] for row in summary["shares"])
        assert 0 < smallest <= summary["bound_of_smallest"] < smallest + 0.01, seed
