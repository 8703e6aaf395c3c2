"""Plans with the constraint ``motion paths``: the arm of each target has a planned path."""

import itertools
from types import SimpleNamespace

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from path_scenes import SMALL, dense_plane
from raising import refused

import rfpsurvey as rs
from rfpsurvey._assignment import path_rounds
from rfpsurvey._assignment.allocate import TargetColumns, assign
from rfpsurvey._instruments import path_report
from rfpsurvey._instruments.path_report import paths_to
from rfpsurvey.constraints import Distribution, Motion, as_constraints

CENTER = SkyCoord("06h20m +23d")


@pytest.fixture(scope="module")
def sky():
    return rs.example_catalog("anticenter")


def options(allocator="optimal", **others):
    return rs.AllocationOptions(allocator, constraints="motion paths", **others)


def test_the_text_form_contains_no_law_of_time():
    (paths,) = as_constraints("motion paths")
    assert (paths, str(paths), paths.motion_law) == (Motion("paths"), "motion paths", "paths")
    assert options().record["constraints"] == ["motion paths"]
    refused("a law of time can be given only with the motion fold", as_constraints, "motion paths same_speed")
    with pytest.raises(rs.errors.InputError, match="the same kind and law of time, got same_duration, paths"):
        _ = rs.AllocationOptions(constraints=["motion fold", "motion paths"]).motion_law


@pytest.mark.parametrize("allocator", ["optimal", "repair"])
def test_a_plan_without_late_arms_does_not_change(sky, allocator):
    plain = rs.plan_tile(sky, "sdss_apo", CENTER, allocator=allocator)
    tile = rs.plan_tile(sky, "sdss_apo", CENTER, allocator=options(allocator))
    assert (tile.table["target_id"] == plain.table["target_id"]).all()
    assert tile.summary["objectives"] == plain.summary["objectives"]
    assert (tile.summary["n_without_path"], tile.table["without_path"].sum()) == (0, 0)
    assert "n_needs_planner" not in tile.summary
    assert "without_path" not in plain.table.colnames
    (row,) = tile.rules
    assert (row["rule"], row["number"], row["verdict"]) == ("motion paths", 0, "pass")
    assert tile.paths().n_arriving == tile.summary["n_assigned"]


def test_a_tile_returns_the_paths_of_its_plan(monkeypatch, tmp_path):
    """In crowded planes, rounding errors of the angles change which arms arrive."""
    instrument = rs.Instrument("dense", dense_plane(5)[0], plate_scale=200 * u.mm / u.deg)
    field = rs.synthetic_catalog("uniform", CENTER, 0.4 * u.deg, n_targets=70, rng=1)
    reports, report_paths = [], path_report.report_paths
    monkeypatch.setattr(path_rounds, "report_paths", lambda *given: reports.append(report_paths(*given)) or reports[-1])
    tile = rs.plan_tile(field, instrument, CENTER, allocator=options("repair"))
    tile.write(tmp_path / "tile.fits")
    for each in (tile, rs.Tile.read(tmp_path / "tile.fits")):
        paths = each.paths(instrument)
        assert paths.n_arriving == tile.summary["n_assigned"]
        assert np.array_equal(paths.theta, reports[-1].paths.theta)


def test_a_score_counts_the_positioners_without_a_path(sky):
    rule = rs.plan_tile(sky, "sdss_apo", CENTER, allocator="lamost_rule")
    scored = rs.score_tile(rule.table, "sdss_apo", constraints="motion paths")
    n = scored.summary["n_without_path"]
    # without arms that collide at their targets, all others arrive
    assert n == scored.table["without_path"].sum() == scored.summary["n_colliding"] > 0
    assert scored.summary["unmet"] == [f"motion paths: {n} positioners have no planned path"]
    assert scored.rules["verdict"][0] == "fail"


def test_rules_of_assignment_are_only_checked(sky):
    with pytest.warns(rs.errors.RfpsurveyWarning, match="except that plans are checked; optimal, repair can honor"):
        tile = rs.plan_tile(sky, "sdss_apo", CENTER, allocator=options("lamost_rule"))
    plain = rs.plan_tile(sky, "sdss_apo", CENTER, allocator="lamost_rule")
    assert (tile.table["target_id"] == plain.table["target_id"]).all()
    assert tile.summary["n_without_path"] > 0


@pytest.mark.parametrize("allocator", ["repair", "joint"])
def test_surveys_plan_paths_and_have_their_number(sky, allocator, tmp_path):
    chosen = options() if allocator == "joint" else options(allocator)
    if allocator == "joint":
        chosen = rs.JointOptions(iterations=1, allocator=chosen)
    tiles = SkyCoord([95, 95.7] * u.deg, [23, 23] * u.deg)
    survey = rs.plan_survey(sky, "sdss_apo", tiles, allocator=chosen, folder=tmp_path / "s")
    assert (survey.tiles["n_without_path"].tolist(), survey.summary["n_without_path"]) == ([0, 0], 0)
    assert (survey.tiles["n_assigned"] > 200).all()
    assert survey.tiles["n_unmet"].tolist() == [0, 0]


def test_an_arm_that_is_locked_by_obstacles_takes_another_target():
    """The wall around the first target leaves only a gap through which the stretched arm cannot fold."""
    unit = rs.Positioner(8 * u.mm, 17 * u.mm, 2 * u.mm)
    walls = [[[10, y], [24, y], [24, y + 0.5], [10, y + 0.5]] * u.mm for y in (-3.5, 3)]
    plane = rs.FocalPlane([[0, 0], [60, 0]] * u.mm, unit, obstacle_polygons=walls)
    targets = [[24.9, 0], [0, 20], [62, 14]] * u.mm
    plain = rs.allocate(plane, targets, priority=[2, 1, 1], allocator="optimal")
    assert plain.target_of_positioner.tolist() == [0, 2]
    assert rs.collision.find_paths(plane, plain).groups == ((["0"], "locked by obstacles and joint limits"),)
    plan = rs.allocate(plane, targets, priority=[2, 1, 1], allocator=options())
    assert plan.target_of_positioner.tolist() == [1, 2]
    assert (plan.meta["n_path_rounds"], plan.meta["n_lost_to_paths"]) == (1, 0)
    assert [(level.value, level.bound) for level in plan.levels] == [(0, 1), (2, 2)]
    plan = rs.allocate(plane, targets[[0, 2]], allocator=options())
    assert plan.target_of_positioner.tolist() == [-1, 1]


class Pretended:
    """A report of paths in which given pairs of assignments have no path; no paths are planned."""

    def __init__(self, barred):
        self.barred = barred

    def __call__(self, plane, arms, motion):
        tips, groups = np.round(arms.tip, 9), []
        for pair in self.barred:
            if all(arms.assigned[i] and tuple(tips[i]) == xy for i, xy in pair):
                groups.append(([str(plane.id[i]) for i, _ in pair], "no path was found"))
        late = np.isin(plane.id.astype(str), [ids[0] for ids, _ in groups])
        return SimpleNamespace(paths=SimpleNamespace(groups=groups), without_path=late, n_failing=int(late.sum()))


@pytest.mark.parametrize("seed", range(8))
def test_combinations_without_paths_are_avoided_as_well_as_possible(seed, monkeypatch):
    """The value is compared with all plans of three positioners."""
    rng = np.random.default_rng(seed)
    plane = rs.FocalPlane([[0, 0], [20, 0], [40, 0]] * u.mm, rs.Positioner(8 * u.mm, 12 * u.mm, 1 * u.mm))
    xy = np.round(rng.uniform([-12, -14], [52, 14], (6, 2)), 3)
    able = [[t for t in range(6) if 4 < np.hypot(*(xy[t] - center)) < 20] for center in plane.xy.value]
    pairs = [((i, tuple(xy[a])), (j, tuple(xy[b]))) for i, j in ((0, 1), (1, 2)) for a in able[i] for b in able[j]]
    barred = [pairs[k] for k in rng.choice(len(pairs), len(pairs) // 3, replace=False)]
    monkeypatch.setattr(path_rounds, "report_paths", Pretended(barred))
    plan = rs.allocate(plane, xy * u.mm, allocator=options())
    best = 0
    for chosen in itertools.product(*([-1, *targets] for targets in able)):
        used = [t for t in chosen if t >= 0]
        tips = np.where(np.array(chosen)[:, None] < 0, np.nan, xy[list(chosen)])
        places = {(i, tuple(tip)) for i, tip in enumerate(tips)}
        if len(set(used)) == len(used) and not any(set(pair) <= places for pair in barred):
            best = max(best, len(used) * (not len(rs.find_collisions(plane, tips * u.mm).pairs)))
    assert not any(all(tuple(np.round(plan.tips_mm[i], 9)) == tip for i, tip in pair) for pair in barred)
    assert best - 1 <= plan.n_assigned <= best <= plan.bound
    plain = rs.allocate(plane, xy * u.mm, allocator="optimal")
    assert plan.bound == plain.bound


def test_arms_that_arrive_keep_their_targets_beside_arms_without_a_target_that_do_not(monkeypatch):
    plane = rs.FocalPlane([[0, 0], [60, 0], [120, 0]] * u.mm, rs.Positioner(8 * u.mm, 12 * u.mm, 1 * u.mm))

    def report_paths(plane, arms, motion):
        late = arms.assigned & (np.arange(3) == 2)
        groups = ((["0", "1"], "no path was found"), *((["2"], "no path was found") for _ in range(late.sum())))
        return SimpleNamespace(paths=SimpleNamespace(groups=groups), without_path=late, n_failing=int(late.sum()))

    monkeypatch.setattr(path_rounds, "report_paths", report_paths)
    plan = rs.allocate(plane, [[75, 0], [135, 0]] * u.mm, allocator=options())
    assert plan.target_of_positioner.tolist() == [-1, 0, -1]
    assert plan.meta["n_lost_to_paths"] == 1


@pytest.mark.parametrize("allocator", ["optimal", "repair"])
@pytest.mark.parametrize("seed", [1, pytest.param(3, marks=pytest.mark.exhaustive)])
def test_dense_planes_keep_only_targets_with_paths(allocator, seed):
    plane, xy, priority = dense_plane(seed)
    plain, plan = (
        rs.allocate(plane, xy, priority=priority, allocator=chosen) for chosen in (allocator, options(allocator))
    )
    late = rs.collision.find_paths(plane, plain)
    assert late.n_arriving < plain.n_assigned
    paths = rs.collision.find_paths(plane, plan)
    assert paths.n_arriving == plan.n_assigned
    assert not len(rs.find_collisions(plane, plan.place_arms(plane)).pairs)
    assert plan.n_assigned >= late.n_arriving
    assert plan.meta["n_lost_to_paths"] == plain.n_assigned - plan.n_assigned
    assert 0 < plan.meta["n_path_rounds"] <= 10
    # the bounds are those of plans without the constraint
    first = plan.levels[0]
    assert first.value <= first.bound
    if allocator == "optimal":
        assert first.bound == plain.levels[0].bound
    for level, values in zip(plan.levels, np.unique(-priority), strict=True):
        used = plan.target_of_positioner[plan.target_of_positioner >= 0]
        assert level.value == (priority[used] == -values).sum()


def random_scene(seed):
    """Return a small plane of one of many kinds, with targets, priorities, kinds of targets, and options."""
    rng, names = np.random.default_rng(seed), [*SMALL]
    plane = SMALL[names[seed % len(names)]]()
    xy = plane.xy.to_value(u.mm)
    radius = plane.arrays.outer_radius.max() + np.hypot(*(xy - xy.mean(axis=0)).T).max()
    n = int(rng.choice([1, 2, 4]) * len(plane))
    points = xy.mean(axis=0) + rng.uniform(-radius, radius, (n, 2))
    kind = rng.choice(["science", "science", "sky"], n)
    fibers = {"fiber_type": None}
    if plane.fiber_types != ("",):
        fibers["fiber_type"] = rng.choice([*plane.fiber_types, ""], n)
    return plane, points * u.mm, {"priority": rng.integers(1, 4, n), "kind": kind, **fibers}


@pytest.mark.few(26)
@pytest.mark.parametrize("seed", range(300))
def test_plans_of_random_scenes_have_paths_and_meet_requirements(seed):
    plane, xy, columns = random_scene(seed)
    allocator = ("optimal", "repair")[seed % 2]
    rules = [Distribution("sky", 1, 50, 2 * plane.arrays.outer_radius.max())] if seed % 3 == 0 else []
    plain, chosen = (
        rs.AllocationOptions(allocator, constraints=[*rules, *given], requirements=["sky=3"], time_limit=5 * u.s)
        for given in ([], ["motion paths"])
    )
    columns = TargetColumns(**columns)
    given = plane, xy.to_value(u.mm), columns
    plain, plan = (assign(*given, chosen, np.random.default_rng(0)) for chosen in (plain, chosen))
    arms = plan.place_arms(plane)
    report = rs.find_collisions(plane, arms)
    assigned = plan.target_of_positioner >= 0
    assert not (report.in_collision & assigned & plane.arrays.usable).any()
    paths = paths_to(plane, arms, None)
    assert (paths.assigned | ~assigned | ~plane.arrays.usable).all()
    assert (paths.arrives | ~assigned | ~plane.arrays.usable).all()
    if not plan.meta.get("n_lost_to_paths"):
        assert len(plan.unmet) <= len(plain.unmet)
    if "n_path_rounds" not in plan.meta:
        assert (plan.target_of_positioner == plain.target_of_positioner).all()


def test_the_measured_fraction_of_arms_without_a_path_is_included(monkeypatch):
    plane, seen = dense_plane(0)[0], []

    def paths_to(plane, arms, motion):
        late = np.flatnonzero(arms.assigned)[:1]
        seen.append(arms.assigned.sum())
        return SimpleNamespace(assigned=arms.assigned, arrives=~np.isin(np.arange(len(plane)), late))

    monkeypatch.setattr(path_report, "paths_to", paths_to)
    options = {"method": "monte_carlo", "rng": 3, "targets": rs.probability.RandomTargets(number=12)}
    found = rs.collision_probability(plane, dynamic="paths", **options)
    rate = len(seen) / sum(seen)
    assert (len(seen), found.meta["n_paths"], found.meta["dynamic"]) == (4, sum(seen), rate)
    assert found.value == rs.collision_probability(plane, dynamic=rate, **options).value
    refused(
        "dynamic='paths' requires the estimand 'allocated'",
        rs.collision_probability,
        plane,
        method="quadrature",
        dynamic="paths",
    )
