"""Random scenes with rules of observatories, and the best plan from an independent integer program."""

from itertools import product

import astropy.units as u
import numpy as np
from astropy.coordinates import SkyCoord
from astropy.table import QTable
from scipy.optimize import Bounds, LinearConstraint, milp

import rfpsurvey as rs
from brute import bodies_of, conflicts_of, options_of
from rfpsurvey.constraints import BrightStars, Distribution, MagnitudeLimits

MM = u.mm
CENTER = SkyCoord("6h20m +23d")


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

    def best(self, worth=None):
        """Return the objectives of the best plan, from an integer program with a row for each definition.

        If the subpriorities ``worth`` are given, the last objective is their sum over the science targets.
        """
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
        if worth is not None:
            goals.append(np.zeros(len(names)))
            goals[-1][[*target]] = [worth[t] * (self.kind[t] == "science") for t in target.values()]
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
            found.append(round(float(goal @ answer.x), 4))
            matrix, low, high = np.vstack([matrix, goal]), np.append(low, found[-1] - 0.5), np.append(high, np.inf)
        return tuple(found)
