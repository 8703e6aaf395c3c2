"""The sum of the subpriorities of the science targets is the last objective, with a value and an upper bound."""

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.table import QTable

import flat
import rfpsurvey as rs
from integer_program import LexicographicProgram
from rfpsurvey._assignment.objectives import _Pursuit
from rfpsurvey._field.facts import tile_objectives
from rule_scenes import CENTER, Scene
from scenes import random_scene

MM = u.mm
ERROR = (
    3e-6  # per positioner, relative to the range: subpriorities are rounded, and the solver ignores small differences
)
PLANS = (("optimal", 60), ("optimal", 1e-6), ("repair", 60), ("network_flow", 60))


def sum_of_science(plan, kind, subpriority):
    used = plan.target_of_positioner[plan.target_of_positioner >= 0]
    is_science = np.array(["science" in name.split("+") for name in kind[used].tolist()], dtype=bool)
    return subpriority[used][is_science].sum()


@pytest.mark.few(2)
@pytest.mark.parametrize("chunk", range(4))
def test_no_plan_with_the_same_numbers_of_targets_exceeds_the_bound(chunk):
    """An integer program gives the largest sum, also if the time limit ends the search at once."""
    n_compared = n_unproven = 0
    for seed in range(1000 + 15 * chunk, 1015 + 15 * chunk):
        plane, xy, options, rng = random_scene(seed)
        subpriority = rng.normal(0, 100, len(xy))
        required = np.isin(np.arange(len(xy)), options["required"])
        oracle = LexicographicProgram(plane, xy, subpriority, **{**options, "required": required})
        oracle.goals = np.delete(oracle.goals, -2, axis=0)  # without the collisions of idle arms
        best, error = oracle.best(), ERROR * len(plane) * np.ptp(subpriority)
        for allocator, limit in PLANS:
            # the first time limit of a process includes the time in which kernels are compiled
            given = {
                **options,
                "subpriority": subpriority,
                **({} if allocator == "repair" else {"time_limit": limit * u.s}),
            }
            own, others = flat.split(allocator, given, flat.NAMES - {"required", "keep_out", "subpriority"})
            plan, name = rs.allocate(plane, xy * MM, allocator=own, **others), (seed, allocator, limit)
            last, value, bound = plan.levels[-1]
            assert last == "subpriorities", name
            assert value == pytest.approx(sum_of_science(plan, options["kind"], subpriority), abs=1e-9), name
            assert bound >= value, name
            assert not plan.gap > 0 or any(level.bound > level.value for level in plan.levels), name
            assert plan.gap != 0 or bound == value, name
            if allocator == "network_flow":
                assert bound == value, name
                continue
            values = oracle.values(plan.target_of_positioner)
            if (values[:2] == best[:2]).all():  # the variables of missing fibers are the smallest possible ones
                most = oracle.best(values[:-1])[-1]
                assert bound >= most - error, name
                assert plan.gap != 0 or value >= most - error, name
                assert (allocator, limit) != ("optimal", 60) or bound == value, name
                n_compared, n_unproven = n_compared + 1, n_unproven + (bound > value)
    assert n_compared > 20
    assert n_unproven > 0


@pytest.mark.filterwarnings("ignore:the rules on the distribution of fibers cost")
@pytest.mark.filterwarnings("ignore:no target of the highest priority")
def test_the_sum_is_the_largest_of_plans_that_follow_rules_on_the_distribution_of_fibers():
    n_searched = 0
    for seed in range(12):
        scene = Scene(seed)
        worth, plans = rs.allocation.subpriorities(scene.sky.id, 1), []
        for limit in (60, 1e-6):
            allocator = scene.options("optimal", subpriority=1, time_limit=limit * u.s)
            tile = rs.plan_tile(scene.sky, scene.instrument, CENTER, allocator=allocator)
            plans.append(tile.summary["objectives"])
            used = np.isin(scene.sky.id, tile["target_id"][tile["status"] == "assigned"]) & (scene.kind == "science")
            assert plans[-1][-1][1] == pytest.approx(worth[used].sum()), seed
            n_searched += tile.summary["search"]["model"] == "integer program"
        best = dict(zip([*scene.names, "subpriorities"], scene.best(worth), strict=True))
        names = [name for name, _, _ in plans[0]]
        error = ERROR * len(scene.plane) + 1e-4  # the values of the oracle are rounded
        assert [value for _, value, _ in plans[0]] == pytest.approx([best.get(name, 0.0) for name in names], abs=error)
        assert plans[0][-1][1] == plans[0][-1][2], seed
        if [one[1] for one in plans[0][:-1]] == [one[1] for one in plans[1][:-1]]:
            assert plans[1][-1][2] >= best["subpriorities"] - error, seed
    assert n_searched > 3


@pytest.fixture
def scene():
    rng = np.random.default_rng(1)
    plane = rs.FocalPlane.hexagonal(rs.Positioner(6 * MM, 6 * MM, 1.2 * MM), rings=6, pitch=10 * MM)
    n = 3 * len(plane)
    xy, subpriority = rng.uniform(-66, 66, (n, 2)) * MM, rng.random(n)
    kind = np.where(rng.random(n) < 0.2, "sky", "science")
    return plane, xy, {"subpriority": subpriority, "kind": kind}


def test_the_sum_of_an_unfinished_search_is_not_reported_as_proven(scene):
    """Regression: plans of two time limits had different sums, although the gap of both plans was 0."""
    plane, xy, columns = scene
    best, n_unproven = None, 0
    for limit in (60, 0.4, 0.2, 0.1, 0.05):
        options = rs.AllocationOptions("optimal", time_limit=limit * u.s, requirements=["sky=10"])
        plan = rs.allocate(plane, xy, allocator=options, **columns)
        value = plan.levels[-1].value
        best = value if best is None else best
        assert value == pytest.approx(sum_of_science(plan, columns["kind"], columns["subpriority"]))
        n_unproven += plan.gap > 0
        assert plan.gap > 0 or value == pytest.approx(best, abs=ERROR * len(plane)), limit
    assert n_unproven > 0


def test_the_bound_of_the_solver_is_used_if_it_ends_before_the_best_plan(monkeypatch, rng):
    """The search is divided into independent parts; the last plan of the solver can be worse than the first one."""
    monkeypatch.setattr("rfpsurvey._assignment.search.SMALLEST", 1)
    unit, maximize = rs.Positioner(6 * MM, 6 * MM, 1.8 * MM), _Pursuit.maximize
    one = rs.FocalPlane.hexagonal(unit, rings=3, pitch=10 * MM).xy.to_value(MM)
    plane = rs.FocalPlane(np.concatenate([one, one + [200, 0]]) * MM, unit)
    n = 3 * len(plane)
    xy = (rng.uniform(-35, 35, (n, 2)) + 200 * np.column_stack([np.arange(n) % 2, np.zeros(n)])) * MM
    columns = {"kind": rng.choice(["science", "sky"], n, p=[0.8, 0.2]), "subpriority": rng.normal(0, 10, n)}

    def plan(answer):
        def stopped(self, goal, keep, deadline, gap=0.0):
            x, bound = maximize(self, goal, keep, deadline, gap)
            return answer(self, x, bound) if np.array_equal(goal, -self.program.costs) else (x, bound)

        monkeypatch.setattr(_Pursuit, "maximize", stopped)
        return rs.allocate(plane, xy, allocator="optimal", **columns)

    best, none = plan(lambda self, x, bound: (x, bound)), plan(lambda self, x, bound: (None, bound))
    worst = plan(lambda self, x, bound: (maximize(self, self.program.costs, self.solved, np.inf)[0], bound))
    assert best.gap == 0
    assert best.meta["n_parts"] > 1
    assert worst.levels[-1].value >= none.levels[-1].value
    for found in (none, worst):
        assert found.levels[:-1] == best.levels[:-1]
        assert found.gap > 0
        # costs are rounded to one millionth of the range
        error = ERROR * len(plane) * np.ptp(columns["subpriority"])
        assert 0 <= found.levels[-1].bound - best.levels[-1].value < error


def test_a_tile_and_a_joint_plan_of_one_tile_have_the_same_sum():
    """Regression: the subpriority of a sky position cost a science target its fiber in plans of single tiles."""
    center, rng = SkyCoord(150 * u.deg, 2 * u.deg), np.random.default_rng(6)
    plane = rs.FocalPlane.hexagonal(rs.Positioner(8.25 * MM, 8.25 * MM, 2.25 * MM), rings=3, pitch=16 * MM)
    instrument = rs.Instrument("small", plane, plate_scale=220 * MM / u.deg)
    tiling = QTable({"tile": [0], "ra": [150.0] * u.deg, "dec": [2.0] * u.deg})
    options = rs.AllocationOptions("optimal", requirements=["sky=5"], subpriority="random")
    coord = center.spherical_offsets_by(*rng.uniform(-0.25, 0.25, (2, 200)) * u.deg)
    kind, random = np.where(rng.random(200) < 0.3, "sky", "science"), {"random": rng.random(200)}
    catalog = rs.Catalog(coord, id=np.arange(200), priority=rng.integers(0, 3, 200), kind=kind, extra=random)
    tile = rs.plan_tile(catalog, instrument, center, allocator=options)
    name, value, bound = tile.summary["objectives"][-1]
    assert (name, bound) == ("subpriorities", value)
    assert tile_objectives(tile, 12)[-1] == ("sum of the subpriorities", float(f"{value:.6g}"), "")
    for allocator in (options, rs.JointOptions(allocator=options)):
        ids = np.asarray(rs.plan_survey(catalog, instrument, tiling, allocator=allocator).tile(0)["target_id"])
        chosen = np.isin(catalog.id, ids) & (kind == "science")
        assert random["random"][chosen].sum() == pytest.approx(value, abs=1e-5)


def test_an_allocator_may_return_the_plan_of_another_with_its_objectives():
    def borrowed(problem):
        return rs.allocation.METHODS["optimal"].function(problem)

    plane, rng = (
        rs.FocalPlane.hexagonal(rs.Positioner(8 * MM, 8 * MM, 2 * MM), rings=1, pitch=25 * MM),
        np.random.default_rng(0),
    )
    xy, subpriority = rng.uniform(-40, 40, (30, 2)) * MM, rng.random(30)
    levels = rs.allocate(plane, xy, allocator="optimal", subpriority=subpriority).levels
    assert rs.allocate(plane, xy, allocator=borrowed, subpriority=subpriority).levels == levels
