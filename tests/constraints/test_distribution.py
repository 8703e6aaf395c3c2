"""Plans that follow rules on the distribution of fibers, compared with an independent integer program."""

import warnings
from itertools import pairwise

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord

import rfpsurvey as rs
from brute import best_plan
from rfpsurvey._assignment import clusters as _clusters
from rfpsurvey._assignment import search as _search
from rfpsurvey._assignment import spread as _spread
from rfpsurvey._assignment.candidates import find_candidates
from rfpsurvey._assignment.clusters import program_of
from rfpsurvey._assignment.distribution import drop_neighbors
from rfpsurvey._assignment.local_search import repair_collisions, stand
from rule_scenes import CENTER, MM, Scene

CHUNK, N_SCENES = 15, 150
pytestmark = [
    pytest.mark.filterwarnings("ignore:the rules on the distribution of fibers cost"),
    pytest.mark.filterwarnings("ignore:no target of the highest priority"),
]


def checked(scene, tile):
    """Return the objectives of a plan, after a test that the plan has no collisions and follows the other rules."""
    assert not tile.table["in_collision"][tile.table["status"] == "assigned"].any()
    names = scene.sky.id.tolist()
    plan = [(i, names.index(t)) for i, t in enumerate(tile.table["target_id"].tolist()) if t is not None]
    assert len({t for _, t in plan}) == len(plan)
    assert scene.allowed()[[t for _, t in plan]].all()
    verdicts = dict(zip(tile.rules["rule"], tile.rules["verdict"], strict=True))
    for rule in scene.rules:
        lack, n = scene.deficit(rule, plan)
        assert verdicts[str(rule)] == ("not checkable" if n == 0 else "fail" if lack else "pass")
    choices, _, _ = scene.choices()
    return scene.objectives(plan, scene.possible(choices))


def compare(scene, tile, values, best):
    """Test that the values that a tile states are those of the plan, and that no bound is too small."""
    assert values <= best, scene.seed
    rows = {name: (value, bound) for name, value, bound in tile.summary["objectives"]}
    # without goals that can be met, and without other targets than science targets, there are fewer objectives
    assert len(scene.names) - 2 <= len(rows)
    assert {*rows} <= {*scene.names}
    for k, name in enumerate(scene.names):
        value, bound = rows.get(name, (values[k], values[k]))
        assert value == values[k], (scene.seed, name)
        assert values[:k] != best[:k] or bound >= best[k], (scene.seed, name, bound)
    proven = all(value == bound for value, bound in rows.values())
    assert proven == (tile.summary["gap"] == 0)
    assert not proven or values == best, (scene.seed, values, best)


@pytest.mark.filterwarnings("ignore:no target of the catalog is")
@pytest.mark.few(1)
@pytest.mark.parametrize("chunk", range(-(-N_SCENES // CHUNK)))
def test_optimal_is_as_good_as_an_independent_integer_program(chunk):
    """Where the plan is proven, it is equal; otherwise, the bound is valid. The plan of ``repair`` is never better."""
    n_changed = n_proven = 0
    for seed in range(CHUNK * chunk, min(CHUNK * (chunk + 1), N_SCENES)):
        scene = Scene(seed)
        tile = rs.plan_tile(scene.sky, scene.instrument, CENTER, allocator=scene.options("optimal"))
        values, best = checked(scene, tile), scene.best()
        assert values is not None, seed
        compare(scene, tile, values, best)
        n_proven += tile.summary["gap"] == 0
        quick = rs.plan_tile(scene.sky, scene.instrument, CENTER, allocator=scene.options("repair"))
        local = checked(scene, quick)
        assert local is not None, seed
        assert local <= values, seed
        free = rs.AllocationOptions("optimal", constraints=scene.constraints[len(scene.rules) :])
        without = rs.plan_tile(scene.sky, scene.instrument, CENTER, allocator=free)
        n_changed += list(without.table["target_id"]) != list(tile.table["target_id"])
    assert n_changed > CHUNK // 4
    assert n_proven > 0.9 * CHUNK


@pytest.mark.filterwarnings("ignore:no target of the catalog is")
@pytest.mark.parametrize("seed", range(8))
def test_optimal_is_the_best_of_all_plans(seed):
    scene = Scene(seed, rings=1)
    scene.keep(np.random.default_rng(seed).permutation(len(scene.kind))[:12])
    choices, pairs, barred = scene.choices()
    possible = scene.possible(choices)

    def value(options):
        return scene.objectives([(i, o[0]) for i, o in enumerate(options) if o is not None], possible)

    best = best_plan(choices, pairs, barred, value, lambda _: 0)[0]
    tile = rs.plan_tile(scene.sky, scene.instrument, CENTER, allocator=scene.options("optimal"))
    assert checked(scene, tile) == best == scene.best()
    assert tile.summary["gap"] == 0


@pytest.mark.filterwarnings("ignore:no target of the catalog is")
@pytest.mark.parametrize("largest", [20_000, 0])
def test_bounds_are_valid_if_the_program_is_divided(monkeypatch, largest):
    """The program of all positioners is not solved if ``largest`` is 0, as in large fields."""
    monkeypatch.setattr(_spread, "SMALL", 0)
    monkeypatch.setattr(_clusters, "SIZE", 40)
    monkeypatch.setattr(_clusters, "LARGEST", 40)
    n_best = 0
    for seed in range(12, 24):
        scene = Scene(seed)
        with monkeypatch.context() as patch:
            patch.setattr(_search, "LARGEST", largest)
            tile = rs.plan_tile(scene.sky, scene.instrument, CENTER, allocator=scene.options("optimal"))
        values, best = checked(scene, tile), scene.best()
        compare(scene, tile, values, best)
        n_best += values == best
        if largest:
            assert values == best
    assert n_best > 8


@pytest.fixture(scope="module")
def field(small):
    """Return science targets of which few are close to one of the sky positions of the catalog."""
    sky = rs.synthetic_catalog("uniform", CENTER, small.field_radius, n_targets=400, rng=3)
    kind = np.where(
        np.random.default_rng(4).random(400) < np.where(sky.coord.ra > CENTER.ra, 0.3, 0.02), "sky", "science"
    )
    return rs.Catalog(sky.coord, kind=kind)


@pytest.mark.parametrize("allocator", ["repair", "optimal"])
def test_added_sky_positions_are_neighbors_in_tiles_and_surveys(field, small, allocator):
    science = field[field.kind == "science"]
    rules, where = ["distribution sky 1 90 30"], {"sky_separation": 10 * u.arcsec}
    asked = rs.AllocationOptions(allocator, constraints=rules, **where)
    tile = rs.plan_tile(science, small, CENTER, allocator=asked)
    survey = rs.plan_survey(science, small, CENTER, allocator=asked)
    for table in (tile.table[tile.table["status"] == "assigned"], survey.tile(0)):
        coord, sky = SkyCoord(table["ra"], table["dec"]), ~np.isin(table["target_id"], science.id)
        xy = small.projection(CENTER).to_focal_plane(coord).to_value(MM)
        apart = np.hypot(*(xy[~sky][:, None] - xy[sky][None]).transpose(2, 0, 1)).min(axis=1)
        assert np.mean(apart <= 30) >= 0.9
        assert 2 < sky.sum() < 20
    assert tile.rules["verdict"].tolist() == ["pass"]
    assert survey.tiles["unmet"].tolist() == [""]


@pytest.mark.parametrize("allocator", ["nearest", "lamost_rule", "network_flow"])
def test_other_allocators_only_check_the_rule(field, small, allocator):
    """The plan is the same as without the rule, and a warning names the allocators that follow the rule."""
    rules = ["distribution sky 2 95 20"]
    with pytest.warns(rs.RfpsurveyWarning, match=r"except that plans are checked; optimal, repair can honor it"):
        tile = rs.plan_tile(field, small, CENTER, allocator=rs.AllocationOptions(allocator, constraints=rules))
    free = rs.plan_tile(field, small, CENTER, allocator=allocator)
    assert tile.table["target_id"].tolist() == free.table["target_id"].tolist()
    assert tile.rules["verdict"].tolist() == ["fail"]
    (limit,), n = tile.rules["limit"].tolist(), tile.summary["kinds"]["science"]["n_assigned"]
    assert limit == f"at least 95 % of {n} fibers with 2 sky within 20 mm"


@pytest.mark.parametrize("allocator", ["repair", "optimal"])
def test_a_rule_that_no_plan_can_follow_changes_nothing(field, small, allocator):
    """Otherwise, ``optimal`` would assign no science targets, because a rule on no fibers is met."""
    kind = np.where(np.arange(len(field)) == np.flatnonzero(field.kind == "sky")[0], "sky", "science")
    sky, found = rs.Catalog(field.coord, kind=kind), []
    for rules in (["distribution sky 2 50 60"], []):
        options = rs.AllocationOptions(allocator, constraints=[*rules, "sky=1"])
        found.append(rs.plan_tile(sky, small, CENTER, allocator=options))
    assert found[0].table["target_id"].tolist() == found[1].table["target_id"].tolist()
    assert found[0].rules["verdict"].tolist() == ["pass", "fail"]
    assert found[0].summary["gap"] == found[1].summary["gap"]


def test_the_rule_is_followed_in_crowded_fields(small):
    """Candidates are omitted, and the bounds are those of the plan without the rule."""
    sky = rs.synthetic_catalog("uniform", CENTER, small.field_radius, n_targets=12_000, rng=3)
    rng = np.random.default_rng(4)
    kind = np.where(rng.random(12_000) < 0.01, "sky", "science")
    catalog, found = rs.Catalog(sky.coord, kind=kind, priority=rng.integers(0, 3, 12_000)), {}
    for rules in ([], ["distribution sky 1 95 30"]):
        options = rs.AllocationOptions("optimal", constraints=rules, time_limit=5 * u.s)
        found[len(rules)] = rs.plan_tile(catalog, small, CENTER, allocator=options)
    assert found[1].rules["verdict"].tolist() == ["pass"]
    free, rows = found[0].summary["objectives"], found[1].summary["objectives"]
    assert rows[0] == ["requirements", 0.0, 0.0]
    for (name, value, bound), (_, _, most) in zip(rows[1:2], free, strict=False):
        assert value <= bound <= most, name


@pytest.mark.filterwarnings("ignore:no target of the catalog is")
def test_programs_of_some_positioners_count_the_neighbors_of_all_fibers():
    """Science fibers outside of a program can have neighbors in it, and the other way around."""
    found = set()

    def allocator(problem):
        everything = find_candidates(problem)
        options, rng = everything.options, np.random.default_rng(seed)
        first = np.array([rng.integers(a, b) for a, b in pairwise(options.start)])
        chosen = repair_collisions(everything, first)
        if rng.random() < 0.5:
            chosen = drop_neighbors(everything, chosen)
        members = np.flatnonzero(rng.random(len(chosen)) < rng.choice([0.2, 0.5, 1.0]))
        state = stand(everything, chosen)
        if problem.distributions and (state[1][chosen] == 0).all() and len(members):
            program = program_of(everything, members, *state, np.inf)
            x = program.variables(chosen[members])
            missing = program.reaches(x)[0]
            assert program.holds(x)
            assert missing == problem.level_values(options.target[chosen])[0], seed
            if missing < 0:  # one missing fiber fewer is not possible
                x[program.short[np.argmax(x[program.short])]] -= 1
                assert not program.holds(x)
            found.add((len(members) == len(chosen), missing == 0, program.spreads[0].is_fixed.any()))
        return np.full(len(chosen), -1)

    allocator.distribution = "goal"
    for seed in range(60):
        scene = Scene(seed)
        scene.constraints = [*scene.rules, "sky=0-90"]
        rs.plan_tile(scene.sky, scene.instrument, CENTER, allocator=scene.options(allocator))
    assert len(found) > 4


@pytest.mark.filterwarnings("ignore:no target of the catalog is", "ignore:.*required")
def test_neighbors_of_violated_rules_are_dropped_unless_they_are_required():
    n_dropped = n_kept = 0

    def allocator(problem):
        nonlocal n_dropped, n_kept
        everything, rng = find_candidates(problem), np.random.default_rng(seed)
        options, idle = everything.options, everything.options.start[1:] - 1
        chosen = np.array([rng.integers(a, b) for a, b in pairwise(options.start)])
        target = options.target[chosen]
        again = np.isin(np.arange(len(target)), np.unique(target, return_index=True)[1], invert=True)
        chosen = np.where(again, idle, chosen)  # each target has at most one positioner
        row = np.hypot(*(problem.xy[:, None] - scene.xy).T).argmin(axis=0)
        plan = [(i, int(row[t])) for i, t in enumerate(options.target[chosen].tolist()) if t >= 0]
        expected = chosen.copy()
        for rule in [spread.rule for spread in everything.spreads]:  # without rules that no plan can follow
            for i, t in plan if scene.deficit(rule, plan)[0] else ():
                if scene.is_member(rule, rule.what, i, t):
                    expected[i] = chosen[i] if t in required else idle[i]
                    n_kept += t in required
                    n_dropped += t not in required
        np.testing.assert_array_equal(drop_neighbors(everything, chosen), expected, err_msg=str(seed))
        return np.full(len(chosen), -1)

    allocator.distribution = "goal"
    for seed in range(40):
        scene = Scene(seed)
        required = np.flatnonzero(scene.kind != "science")[::2].tolist()
        scene.constraints = [*scene.rules, rs.Required(tuple(scene.sky.id[required].tolist()))]
        rs.plan_tile(scene.sky, scene.instrument, CENTER, allocator=scene.options(allocator))
    assert min(n_dropped, n_kept) > 10


def first_class(scene, constraints):
    """Return how many targets of the first class a plan has, and the bound that it states."""
    scene.constraints = constraints
    tile = rs.plan_tile(scene.sky, scene.instrument, CENTER, allocator=scene.options("optimal"))
    return next(row[1:] for row in tile.summary["objectives"] if row[0] == scene.names[1])


@pytest.mark.filterwarnings("ignore:no target of the catalog is")
def test_the_bound_of_the_first_class_is_at_most_that_of_a_plan_without_rules(monkeypatch):
    """The integer program with the rules finds no plan in time."""
    monkeypatch.setattr(_spread, "_solve", lambda *_: None)
    n_changed = 0
    for seed in range(12):
        scene = Scene(seed)
        value, bound = first_class(scene, scene.rules)
        free_value, free_bound = first_class(scene, [])
        assert value <= bound <= free_bound, seed
        n_changed += value < free_value
    assert n_changed > 2


@pytest.mark.filterwarnings("ignore:no target of the catalog is")
def test_a_plan_without_time_is_valid_and_states_its_gap():
    gaps = []
    for seed in range(24, 30):
        scene = Scene(seed)
        options = scene.options("optimal", time_limit=1e-9 * u.s)
        tile = rs.plan_tile(scene.sky, scene.instrument, CENTER, allocator=options)
        compare(scene, tile, checked(scene, tile), scene.best())
        gaps.append(tile.summary["gap"])
    assert max(gaps) > 0


def two_sky_positions(rings, n, width):
    """Return an instrument, and a catalog with two sky positions, which cannot serve 95 % of the field."""
    unit = rs.Positioner(8 * u.mm, 8 * u.mm, 0.5 * u.mm)
    plane = rs.FocalPlane.hexagonal(unit, rings=rings, pitch=20 * u.mm)
    offsets = np.random.default_rng(1).uniform(-width, width, (n, 2)) * u.deg
    kind = np.where(np.arange(n) < 2, "sky", "science")
    catalog = rs.Catalog(SkyCoord(30 * u.deg + offsets[:, 0], offsets[:, 1]), kind=kind)
    return rs.Instrument("small", plane, plate_scale=100 * u.mm / u.deg), catalog


@pytest.mark.filterwarnings("default:the rules on the distribution of fibers cost")
@pytest.mark.parametrize("allocator", ["repair", "optimal"])
def test_a_plan_states_the_targets_that_rules_cost(allocator):
    """``optimal`` gives up nearly all science targets."""
    instrument, catalog = two_sky_positions(5, 400, 1.05)
    options = rs.AllocationOptions(allocator, constraints=["distribution sky 1 95 20"])
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        tile = rs.plan_tile(catalog, instrument, SkyCoord(30, 0, unit="deg"), allocator=options)
    free = rs.plan_tile(catalog, instrument, SkyCoord(30, 0, unit="deg"), allocator=allocator)
    n, most = (one.summary["kinds"]["science"]["n_assigned"] for one in (tile, free))
    assert tile.summary.get("n_lost_to_rules", 0) == most - n
    texts = [str(one.message) for one in found if "cost" in str(one.message)]
    text = f"the rules on the distribution of fibers cost {most - n} of the {most} science targets"
    assert len(texts) == (most - n > 0.03 * most)
    assert all(one.startswith(text) for one in texts)
    assert allocator == "repair" or texts


@pytest.mark.filterwarnings("default:the rules on the distribution of fibers cost")
def test_a_survey_states_the_targets_that_rules_cost(tmp_path):
    """The first tile uses the visits of all targets that it observes; the numbers are those of single tiles."""
    instrument, catalog = two_sky_positions(3, 90, 0.7)
    tiles = SkyCoord([30, 30.1], [0, 0], unit="deg")
    options = rs.AllocationOptions("optimal", constraints=["distribution sky 1 95 20"])

    def survey(options, **where):
        return rs.plan_survey(catalog, instrument, tiles, allocator=options, **where)

    with pytest.warns(rs.errors.RfpsurveyWarning, match="the rules on the distribution of fibers cost") as found:
        planned = survey(options, folder=tmp_path / "survey")
    first = rs.plan_tile(catalog, instrument, tiles[0], allocator=options).summary
    assert planned.tiles["n_lost_to_rules"][0] == first["n_lost_to_rules"] > 0
    n_lost, n_science = planned.tiles["n_lost_to_rules"].sum(), planned.tiles["n_science"].sum()
    assert planned.summary["n_lost_to_rules"] == n_lost
    texts = [str(one.message) for one in found]
    assert sum(f"cost {n_lost} of the {n_lost + n_science} science" in text for text in texts) == 1
    assert rs.Survey.read(tmp_path / "survey").summary["n_lost_to_rules"] == n_lost
    (tmp_path / "survey" / "tiles.fits").unlink()
    again = survey(options, folder=tmp_path / "survey", resume=True)
    assert again.tiles["n_lost_to_rules"].tolist() == planned.tiles["n_lost_to_rules"].tolist()
    for other in (rs.JointOptions(allocator=options), "optimal"):
        assert "n_lost_to_rules" not in survey(other).summary
