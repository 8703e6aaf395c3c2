"""Plans that follow rules on the distribution of fibers, compared with an independent integer program."""

from itertools import pairwise, product

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.table import QTable
from scipy.optimize import Bounds, LinearConstraint, milp

import rfpsurvey as rs
from brute import best_plan, bodies_of, conflicts_of, options_of
from rfpsurvey.allocation import _clusters, _search, _spread
from rfpsurvey.allocation._candidates import find_candidates
from rfpsurvey.allocation._clusters import program_of
from rfpsurvey.allocation._distribution import drop_neighbors
from rfpsurvey.allocation._local_search import repair_collisions, stand
from rfpsurvey.constraints import BrightStars, Distribution, MagnitudeLimits

MM = u.mm
CENTER = SkyCoord("6h20m +23d")
CHUNK, N_SCENES = 25, 500
EXHAUSTIVE = pytest.mark.exhaustive


class Scene:
    """A small focal plane with groups, targets with magnitudes, and rules of all kinds, from a seed."""

    def __init__(self, seed, rings=None):
        self.seed, rng = seed, np.random.default_rng(seed)
        rings = int(rng.integers(1, 3)) if rings is None else rings
        shape = rng.choice(["equal", "unequal", "both", "fibers"])
        units = {
            "equal": lambda: rs.Positioner(8.25 * MM, 8.25 * MM, 2.25 * MM),
            "unequal": lambda: rs.Positioner(7.4 * MM, 15 * MM, 2.5 * MM),
            "both": lambda: rs.Positioner(8 * MM, 8 * MM, 2 * MM, handedness="both", theta_range=[-120, 150] * u.deg),
            "fibers": lambda: rs.Positioner(7.4 * MM, 15 * MM, 2 * MM),
        }
        n = 3 * rings * (rings + 1) + 1
        columns = {"groups": {"petal": rng.integers(0, 3, n)}}
        if rng.random() < 0.3:
            columns["disabled"] = rng.random(n) < 0.15
        if rng.random() < 0.3:
            stuck = np.full((n, 2), np.nan)
            stuck[rng.integers(n)] = rng.uniform(-180, 180), rng.uniform(20, 90)
            columns["stuck"] = stuck * u.deg
        if shape == "fibers":
            columns["fiber_type"] = np.where(np.arange(n) % 3, "A+B", "B")
        pitch = 22.4 if shape in ("unequal", "fibers") else 25.0
        plane = rs.FocalPlane.hexagonal(units[shape](), rings=rings, pitch=pitch * MM, **columns)
        self.instrument = rs.Instrument("scene", plane, plate_scale=200 * MM / u.deg)
        self.plane, self.both = plane, shape == "both"
        m = int(rng.integers(2, 4) * n)
        sky = rs.synthetic_catalog("uniform", CENTER, self.instrument.field_radius, n_targets=m, rng=seed)
        self.kind = rng.choice(["science", "sky", "standard"], m, p=rng.choice([[0.7, 0.2, 0.1], [0.85, 0.1, 0.05]]))
        self.mag = rng.uniform(8, 20, m)
        self.priority = rng.integers(0, rng.integers(1, 4), m).astype(float)
        self.fiber = rng.choice(["A", "B", ""], m) if shape == "fibers" else None
        self.sky = rs.Catalog(
            sky.coord, kind=self.kind, priority=self.priority, fiber_type=self.fiber, extra=QTable({"mag": self.mag})
        )
        self.coord = sky.coord
        self.xy = self.instrument.projection(CENTER).to_focal_plane(sky.coord).to_value(MM)
        fiber = str(rng.choice(["", "A", "B"])) if shape == "fibers" else ""
        self.rules = [
            Distribution("sky", int(rng.integers(1, 3)), float(rng.integers(2, 21) * 5), rng.uniform(15, 60), fiber)
        ]
        if rng.random() < 0.5:
            self.rules.append(Distribution("standard", 1, float(rng.integers(2, 20) * 5), rng.uniform(20, 90), fiber))
        self.counts = []
        if rng.random() < 0.6:
            low = int(rng.integers(0, 3))
            most = low + int(rng.integers(1, 3)) if rng.random() < 0.5 else None
            self.counts.append(rs.Requirement("sky", low, most, per="petal"))
        if rng.random() < 0.3:
            self.counts.append(rs.Requirement("standard", int(rng.integers(1, 4))))
        self.limits = (9.0, float(rng.uniform(16, 19)))
        self.constraints = [
            *self.rules,
            *self.counts,
            MagnitudeLimits("mag", *self.limits, "science"),
            BrightStars("mag", [(10.0, 300.0)]),
        ]

    def keep(self, rows):
        """Remove all other targets."""
        for name in ("sky", "coord", "kind", "mag", "priority", "xy"):
            setattr(self, name, getattr(self, name)[rows])
        self.fiber = None if self.fiber is None else self.fiber[rows]

    def options(self, allocator, **others):
        return rs.AllocationOptions(allocator, constraints=self.constraints, **others)

    def allowed(self):
        """Return whether each target complies with the limits of magnitude and is not in the circle of a star."""
        low, high = self.limits
        found = (self.kind != "science") | ((self.mag > low) & (self.mag < high))
        for star in np.flatnonzero((self.kind != "sky") & (self.mag <= 10)):
            near = self.coord.separation(self.coord[star]).arcsec <= 300
            near[star] = False
            found &= ~near
        return found

    def choices(self):
        """Return the options of each positioner, without targets that are not allowed, and the pairs that collide."""
        allowed = self.allowed()
        forbidden = {(i, t) for i, t in product(range(len(self.plane)), np.flatnonzero(~allowed).tolist())}
        choices = options_of(self.plane, self.xy, self.fiber, self.both, forbidden)
        return choices, *conflicts_of(self.plane, bodies_of(self.plane, self.xy, choices, self.fiber, True))

    def fiber_of(self, i, t):
        """Return the fiber type with which a positioner observes a target."""
        return (self.fiber[t] if self.fiber is not None else "") or self.plane.fiber_type[i].split("+")[0]

    def is_member(self, rule, what, i, t):
        return self.kind[t] == what and rule.fiber_type in ("", self.fiber_of(i, t))

    def deficit(self, rule, plan):
        """Return how many more science fibers of a plan need neighbors, and the number of science fibers."""
        science = [t for i, t in plan if self.is_member(rule, "science", i, t)]
        near = [t for i, t in plan if self.is_member(rule, rule.what, i, t)]
        served = [t for t in science if sum(self.apart(t, s) <= rule.distance_mm for s in near) >= rule.k]
        return max(-(-round(rule.percent) * len(science) // 100) - len(served), 0), len(science)

    def apart(self, t, s):
        return np.sqrt(((self.xy[t] - self.xy[s]) ** 2).sum())

    def objectives(self, plan, possible):
        """Return the objectives of a plan, in order; None if the plan exceeds a maximum."""
        missing = sum(self.deficit(rule, plan)[0] for rule in possible)
        for one in self.counts:
            petal = self.plane.groups["petal"]
            for k in np.unique(petal) if one.per == "petal" else [None]:
                n = sum(self.kind[t] == one.what for i, t in plan if k in (None, petal[i]))
                missing += max(one.minimum - n, 0)
                if one.maximum is not None and n > one.maximum:
                    return None
        classes = sorted({*self.priority[self.kind == "science"].tolist()}, reverse=True)
        science = [self.priority[t] for _, t in plan if self.kind[t] == "science"]
        return (-missing, *(science.count(p) for p in classes), len(plan))

    def possible(self, choices):
        """Return the rules for which a science target in reach has enough neighbors in reach."""
        found = []
        pairs = {(i, o[0]) for i, mine in enumerate(choices) for o in mine[1:]}
        for rule in self.rules:
            science = {t for i, t in pairs if self.is_member(rule, "science", i, t)}
            near = {t for i, t in pairs if self.is_member(rule, rule.what, i, t)}
            if any(sum(self.apart(t, s) <= rule.distance_mm for s in near) >= rule.k for t in science):
                found.append(rule)
        return found

    @property
    def names(self):
        """Names of the objectives, in order."""
        classes = sorted({*self.priority[self.kind == "science"].tolist()}, reverse=True)
        numbers = ["science"] if len(classes) == 1 else [f"priority {p:.0f}" for p in classes]
        return ["requirements", *numbers, "any target"]

    def best(self):
        """Return the objectives of the best plan, from an integer program with a row for each definition."""
        choices, pairs, barred = self.choices()
        rules = self.possible(choices)
        keys = [(i, k) for i, mine in enumerate(choices) for k in range(len(mine))]
        column, names = {key: c for c, key in enumerate(keys)}, [("x", *key) for key in keys]
        target = {c: choices[i][k][0] for (i, k), c in column.items() if k}
        rows = []

        def new(*name):
            names.append(name)
            return len(names) - 1

        for i, mine in enumerate(choices):
            rows.append(([(column[i, k], 1) for k in range(len(mine))], 1, 1))
        for t in range(len(self.xy)):
            rows.append(([(c, 1) for c, one in target.items() if one == t], -np.inf, 1))
        rows += [([(column[a], 1), (column[b], 1)], -np.inf, 1) for a, b in pairs]
        rows += [([(column[key], 1)], 0, 0) for key in barred]
        missing = []
        petal = self.plane.groups["petal"]
        for one in self.counts:
            for k in np.unique(petal) if one.per == "petal" else [None]:
                held = [
                    (c, 1) for c, t in target.items() if self.kind[t] == one.what and k in (None, petal[keys[c][0]])
                ]
                missing.append(new("lack", one, k))
                rows.append(([*held, (missing[-1], 1)], one.minimum, np.inf))
                if one.maximum is not None:
                    rows.append((held, -np.inf, one.maximum))
        for rule in rules:
            science = [c for c, t in target.items() if self.is_member(rule, "science", keys[c][0], t)]
            near = [c for c, t in target.items() if self.is_member(rule, rule.what, keys[c][0], t)]
            missing.append(new("lack", rule))
            total = [(missing[-1], 100), *((c, -round(rule.percent)) for c in science)]
            for t in sorted({target[c] for c in science}):
                z = new("served", t)
                total.append((z, 100))
                rows.append(([(z, 1), *((c, -1) for c in science if target[c] == t)], -np.inf, 0))
                close = [(c, -1) for c in near if self.apart(t, target[c]) <= rule.distance_mm]
                rows.append(([(z, rule.k), *close], -np.inf, 0))
            rows.append((total, 0, np.inf))
        matrix = np.zeros((len(rows), len(names)))
        for r, (terms, _, _) in enumerate(rows):
            for c, value in terms:
                matrix[r, c] += value
        low, high = (np.array([row[k] for row in rows], dtype=float) for k in (1, 2))
        most = np.ones(len(names))
        most[missing] = np.inf
        goals = [-np.isin(np.arange(len(names)), missing).astype(float)]
        for p in sorted({*self.priority[self.kind == "science"].tolist()}, reverse=True):
            goals.append(np.zeros(len(names)))
            goals[-1][[c for c, t in target.items() if self.kind[t] == "science" and self.priority[t] == p]] = 1
        goals.append(np.zeros(len(names)))
        goals[-1][[*target]] = 1
        found = []
        for goal in goals:
            answer = milp(
                -goal,
                constraints=LinearConstraint(matrix, low, high),
                bounds=Bounds(0, most),
                integrality=np.ones(len(most)),
                options={"mip_rel_gap": 0.0},
            )
            assert answer.status == 0
            found.append(round(float(goal @ answer.x)))
            matrix, low, high = np.vstack([matrix, goal]), np.append(low, found[-1] - 0.5), np.append(high, np.inf)
        return tuple(found)


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
    few = np.random.default_rng(seed).permutation(len(scene.kind))[:12]
    scene.keep(few)
    choices, pairs, barred = scene.choices()
    possible = scene.possible(choices)

    def value(options):
        plan = [(i, o[0]) for i, o in enumerate(options) if o is not None]
        return scene.objectives(plan, possible)

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


@pytest.mark.parametrize("allocator", ["repair", "optimal"])
def test_a_rule_that_no_plan_can_follow_changes_nothing(field, small, allocator):
    """Otherwise, ``optimal`` would assign no science targets, because a rule on no fibers is met."""
    kind = np.where(np.arange(len(field)) == np.flatnonzero(field.kind == "sky")[0], "sky", "science")
    sky = rs.Catalog(field.coord, kind=kind)
    found = []
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
    catalog = rs.Catalog(sky.coord, kind=kind, priority=rng.integers(0, 3, 12_000))
    found = {}
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
        chosen = repair_collisions(everything, first)[0]
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
