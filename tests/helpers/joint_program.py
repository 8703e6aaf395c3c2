"""Random small surveys, and an integer program that contains all tiles of a survey."""

from dataclasses import replace

import astropy.units as u
import numpy as np
from astropy.coordinates import SkyCoord
from scipy.optimize import Bounds, LinearConstraint, milp

import rfpsurvey as rs
from brute import bodies_of, conflicts_of, options_of
from rfpsurvey._sky.arrays import has_role
from scenes import random_plane

MM = u.mm
SCALE = 200 * MM / u.deg


def random_survey(seed):
    """Return an instrument with few positioners, overlapping tiles, targets and options."""
    rng = np.random.default_rng(seed)
    plane = random_plane(rng)
    instrument = rs.Instrument("small", plane, plate_scale=SCALE)
    m, n = int(rng.integers(5, 31)), int(rng.integers(2, 4))
    center = SkyCoord(10 * u.deg, 40 * u.deg)
    xi, eta = rng.uniform(-32, 32, (2, m)) * MM / SCALE
    sky = center.spherical_offsets_by(xi, eta)
    xi, eta = rng.uniform(-14, 14, (2, n)) * MM / SCALE
    tiles = center.spherical_offsets_by(xi, eta)
    columns = {"priority": rng.integers(0, rng.integers(1, 4), m).astype(float), "visits": rng.integers(0, 4, m)}
    if plane.fiber_types != ("",):
        columns["fiber_type"] = rng.choice(["", *plane.fiber_types], m)
    options = rs.AllocationOptions("optimal", parked_obstacles=bool(rng.random() < 0.5))
    return instrument, tiles, rs.Catalog(sky, **columns), options


KINDS = {
    "kinds": (["science", "standard", "sky"], [0.5, 0.25, 0.25]),
    "several": (["science", "science+standard", "science+sky", "standard", "sky"], [0.3, 0.4, 0.1, 0.1, 0.1]),
}
NEEDS = [rs.Requirement.parse(text) for text in ("standard=2", "sky=1-2", "science=0-3")]


def survey_with(seed, roles):
    """Return a survey whose targets are science targets, have one of three kinds, or several roles; and requirements.

    Not all requirements can be met.
    """
    instrument, tiles, catalog, options = random_survey(seed)
    if roles == "science":
        return instrument, tiles, catalog, options, []
    rng, (names, fractions) = np.random.default_rng([seed, 1 if roles == "kinds" else 3]), KINDS[roles]
    kind = rng.choice(names, len(catalog), p=fractions)
    if roles == "kinds":
        low = rng.integers(0, 4, 2)
        high = [None if rng.random() < 0.5 else int(k) + int(rng.integers(0, 2)) for k in low]
        needs = [rs.Requirement(*row) for row in zip(("sky", "standard"), low.tolist(), high, strict=True)]
    else:
        needs = [one for one in NEEDS if rng.random() < 0.8] or NEEDS[:1]
    return instrument, tiles, replace(catalog, kind=kind), replace(options, requirements=needs), needs


def plans_of(cases, **options):
    """Yield seed, scene, program and plans (tile after tile, and joint) of each case that requests visits.

    ``cases`` yields a seed and a scene, as `survey_with` returns it; an option can be a function of the seed. No arms
    of the joint plan collide, and each requirement is met at least as well as in the first plan.
    """
    for seed, scene in cases:
        instrument, tiles, catalog, allocator, needs = scene
        science = np.ones(len(catalog), bool) if catalog.kind is None else has_role(catalog.kind, "science")
        if not catalog.visits[science].any():
            continue
        own = {name: value(seed) if callable(value) else value for name, value in options.items()}
        first, survey = (
            rs.plan_survey(catalog, instrument, tiles, allocator=one)
            for one in (allocator, rs.JointOptions(**own, allocator=allocator))
        )
        before, after = (np.array(counts_by_tile(one, needs)) for one in (first, survey))
        centers = tiles if isinstance(tiles, SkyCoord) else SkyCoord(tiles["ra"], tiles["dec"])
        assert (after >= np.minimum([need.minimum for need in needs], before)).all(), seed
        assert (after <= [np.inf if need.maximum is None else need.maximum for need in needs]).all(), seed
        assert not any(np.asarray(part["in_collision"]).any() for part in survey), seed
        yield seed, scene, program_of(instrument, centers, catalog, allocator, needs, before), first, survey


def visits_by_class(survey, catalog, classes):
    rows = np.concatenate([np.asarray(part["target_row"])[np.asarray(part["observed"])] for part in survey])
    rows = rows if catalog.kind is None else rows[catalog.kind[rows] == "science"]
    return np.array([(catalog.priority[rows] == p).sum() for p in classes])


class JointProgram:
    """The plans of all tiles: constraints of binary variables, the candidates, and the visits of each priority.

    ``target`` and ``tile`` are the target of each candidate (-1 for none) and its tile.
    """

    def __init__(self, instrument, tiles, catalog, parked):
        plane = instrument.focal_plane
        both = plane.positioner.handedness == "both"
        self.rows, self.low, self.high, self.target, self.tile, of_target = [], [], [], [], [], {}
        science = np.ones(len(catalog), bool) if catalog.kind is None else np.char.find(catalog.kind, "science") >= 0
        for number, tile in enumerate(tiles):
            place = np.deg2rad([tile.ra.deg, tile.dec.deg, 0.0])
            types = catalog.fiber_type
            xy = instrument.field_projection(*place, None).project(catalog.arrays.vectors, types)
            choices = options_of(plane, xy, types, both)
            pairs, barred = conflicts_of(plane, bodies_of(plane, xy, choices, types, parked))
            index, here = {}, {}
            for i, mine in enumerate(choices):
                for k, option in enumerate(mine):
                    index[i, k] = len(self.target)
                    self.target.append(-1 if option is None else option[0])
                    self.tile.append(number)
                    if option is not None:
                        here.setdefault(option[0], []).append(index[i, k])
                self.add([index[i, k] for k in range(len(mine))], 1, 1)
            for a, b in pairs:
                self.add([index[a], index[b]], 1)
            for a in barred:
                self.add([index[a]], 0)
            for t, indices in here.items():
                self.add(indices, 1 if catalog.visits[t] > 0 else 0)
                of_target.setdefault(t, []).extend(indices)
        for t, indices in of_target.items():
            if science[t]:
                self.add(indices, catalog.visits[t])
        self.target, self.tile = np.array(self.target), np.array(self.tile)
        self.classes = np.unique(catalog.priority[(catalog.visits > 0) & science])[::-1]
        priority = np.append(np.where(science, catalog.priority, np.nan), np.nan)[self.target]
        self.hits = (priority == self.classes[:, None]).astype(float)

    def add(self, indices, most, least=-np.inf, values=1.0):
        """Limit the sum of some variables, which are multiplied by values."""
        self.rows.append((indices, values))
        self.high.append(most)
        self.low.append(least)

    def is_feasible(self):
        """Return whether there is a plan that satisfies all constraints."""
        return self._solve(np.zeros(len(self.target))).success

    def maximize(self, weights):
        """Return the variables with the largest sum of weights."""
        found = self._solve(weights)
        assert found.success
        return np.round(found.x)

    def _solve(self, weights):
        matrix = np.zeros((len(self.rows), len(self.target)))
        for k, (indices, values) in enumerate(self.rows):
            matrix[k, indices] = values
        constraints = LinearConstraint(matrix, self.low, self.high)
        return milp(-weights, constraints=constraints, integrality=1, bounds=Bounds(0, 1), options={"mip_rel_gap": 0})

    def extend(self, number):
        """Add variables that are no candidates, and return their indices."""
        first = len(self.target)
        self.target = np.append(self.target, np.full(number, -1))
        self.tile = np.append(self.tile, np.full(number, -1))
        return np.arange(first, first + number)

    def best(self):
        """Return the largest lexicographic numbers of visits by priority."""
        return self.hits @ self.maximize(64.0 ** np.arange(len(self.classes) - 1, -1, -1) @ self.hits)

    def sums(self):
        """Return the largest number of visits of each priority and all higher priorities."""
        levels = [self.hits[: k + 1].sum(axis=0) for k in range(len(self.classes))]
        return np.array([weights @ self.maximize(weights) for weights in levels])


def kinds_of(part):
    """Return the roles in which a tile observes its targets."""
    return np.asarray(part["kind"]) if "kind" in part.colnames else np.full(len(part), "science")


def counts_by_tile(survey, needs):
    return [[int(has_role(kinds_of(part), need.what).sum()) for need in needs] for part in survey]


def program_of(instrument, tiles, catalog, options, needs, counts):
    """Return the program with the requirements; minima that the counts of a plan miss are replaced by these counts.

    A copy of each target with several roles is not a science target, and spends no visits.
    """
    if catalog.kind is None:
        return JointProgram(instrument, tiles, catalog, options.parked_obstacles)
    several = has_role(catalog.kind, "science") & (catalog.kind != "science") & (catalog.visits > 0)
    rows = np.flatnonzero(several)
    both = catalog[np.append(np.arange(len(catalog)), rows)]
    kind = np.append(catalog.kind, [name.replace("science+", "") for name in catalog.kind[rows]])
    program = JointProgram(
        instrument, tiles, replace(both, kind=kind, id=np.arange(len(both))), options.parked_obstacles
    )
    for tile, row in enumerate(counts):
        here = program.tile == tile
        for k, target in enumerate(rows):
            program.add(np.flatnonzero(np.isin(program.target, [target, len(catalog) + k]) & here), 1)
        for need, n in zip(needs, row, strict=True):
            most = np.inf if need.maximum is None else need.maximum
            of_need = has_role(np.append(kind, "")[program.target], need.what) & here
            program.add(np.flatnonzero(of_need), most, min(need.minimum, n))
    return program


def finished_by_class(survey, catalog, classes):
    """Return the numbers of science targets of each priority with all requested visits, from the tiles."""
    times = np.zeros(len(catalog), dtype=int)
    for part in survey:
        counted = np.asarray(part["observed"]) & has_role(kinds_of(part), "science")
        np.add.at(times, np.asarray(part["target_row"])[counted], 1)
    done = (times >= catalog.visits) & (catalog.visits > 0)
    assert (times <= catalog.visits).all()
    return np.array([(done & (catalog.priority == one)).sum() for one in classes])


def with_finished(program, catalog):
    """Return, for each class, weights of the variables of a program that are 1 for finished targets of this class."""
    science = np.ones(len(catalog), bool) if catalog.kind is None else has_role(catalog.kind, "science")
    goals, first = goals_of(program, np.where(science, catalog.visits, 0))
    weights = np.zeros((len(program.classes), len(program.target)))
    for k, one in enumerate(program.classes):
        weights[k, first[catalog.priority[goals] == one]] = 1.0
    return weights


def with_categories(seed):
    """Return a survey whose targets have three categories."""
    instrument, tiles, catalog, options, _ = survey_with(seed, "science")
    category = np.random.default_rng([seed, 5]).choice(["a", "b", "c"], len(catalog), p=[0.5, 0.3, 0.2])
    return instrument, tiles, replace(catalog, category=category), options


def goals_of(program, needed):
    """Return the targets that need visits, and add a variable that is 1 if each of them receives these visits."""
    goals = np.flatnonzero(needed > 0)
    first = program.extend(len(goals))
    for t, y in zip(goals, first, strict=True):
        visits = np.flatnonzero(program.target == t)
        program.add([*visits, y], np.inf, 0, [1.0] * len(visits) + [-float(needed[t])])
    return goals, first
