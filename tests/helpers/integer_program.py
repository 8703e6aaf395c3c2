"""An independent integer program for plans without collisions: one row per conflict, and objectives in strict order."""

from itertools import combinations

import numpy as np
from scipy.optimize import Bounds, LinearConstraint, milp

from brute import bodies_of, conflicts_of, options_of

__all__ = ["LexicographicProgram", "counts", "groups_of"]


def groups_of(plane, requirements):
    """Return each requirement with each spectrograph to which it applies; None is the whole tile."""
    spectrographs = np.unique(plane.spectrograph).tolist()
    return [(one, place) for one in requirements for place in ([None] if one.per == "tile" else spectrographs)]


def counts(plane, one, place, i, t, *, kind, category, fiber_type=None):
    """Return whether a fiber of positioner i on target t counts toward a requirement in a spectrograph."""
    fiber = ("" if fiber_type is None else fiber_type[t]) or plane.fiber_type[i].split("+")[0]
    spectrograph = plane.spectrograph[i]
    if np.ndim(spectrograph):
        spectrograph = spectrograph[plane.fiber_types.index(fiber)]
    names = category if (category == one.what).any() else kind
    return one.what in names[t].split("+") and one.fiber_type in ("", fiber) and place in (None, spectrograph)


class LexicographicProgram:
    """All plans of a small scene; `best` returns the values of the objectives of the best plan, and `values` of a plan.

    The objectives are the required targets, the missing fibers of requirements, the targets of each class, all targets,
    the collisions of idle arms, and the sum of the subpriorities of the science targets.
    """

    def __init__(
        self, plane, xy, subpriority, *, priority, kind, category, requirements, required, parked=True, fiber_type=None
    ):
        self.choices = options_of(plane, xy, fiber_type, both=False)
        bodies = bodies_of(plane, xy, self.choices, fiber_type, parked)
        pairs, barred = conflicts_of(plane, bodies)
        keys = [(i, k) for i, mine in enumerate(self.choices) for k in range(len(mine))]
        self.column = {key: c for c, key in enumerate(keys)}
        target = np.array([-1 if k == 0 else self.choices[i][k][0] for i, k in keys])
        separation = plane.positioner.numbers.separation
        touching = [
            (i, j)
            for i, j in combinations(range(len(plane)), 2)
            if bodies[i][0] is not None
            and bodies[j][0] is not None
            and bodies[i][0].distance(bodies[j][0]) < separation
        ]
        columns = {"kind": kind, "category": category, "fiber_type": fiber_type}
        n, m = len(keys), len(groups := groups_of(plane, requirements))
        self.n, size = n, n + m + len(touching)
        rows, low, high = [], [], []

        def add(columns, lowest, highest, extra=()):
            row = np.zeros(size)
            row[list(columns)] = 1.0
            for column, value in extra:
                row[column] = value
            rows.append(row)
            low.append(lowest)
            high.append(highest)

        for i, mine in enumerate(self.choices):
            add([self.column[i, k] for k in range(len(mine))], 1, 1)
        for t in range(len(xy)):
            add(np.flatnonzero(target == t), -np.inf, 1)
        for a, b in pairs:
            add([self.column[a], self.column[b]], -np.inf, 1)
        for key in barred:
            add([self.column[key]], 0, 0)
        for r, (one, place) in enumerate(groups):
            fibers = zip(keys, target.tolist(), strict=True)
            held = [c for c, ((i, _), t) in enumerate(fibers) if t >= 0 and counts(plane, one, place, i, t, **columns)]
            add(held, one.minimum, np.inf, [(n + r, 1.0)])
            if one.maximum is not None:
                add(held, -np.inf, one.maximum)
        for p, (i, j) in enumerate(touching):
            add([self.column[i, 0], self.column[j, 0]], -np.inf, 1, [(n + m + p, -1.0)])
        self.soft = [r for r, row in enumerate(rows) if row[n:].any()]  # rows with a variable that measures a violation
        self.rows, self.low, self.high = np.array(rows), np.array(low, float), np.array(high, float)
        science = np.array(["science" in name.split("+") for name in kind.tolist()], dtype=bool)
        used = np.append(np.where(target >= 0, 1.0, 0.0), np.zeros(size - n))

        def counted(mask):
            return np.append(np.where(target >= 0, mask[target], False).astype(float), np.zeros(size - n))

        lack, touch = np.zeros(size), np.zeros(size)
        lack[n : n + m], touch[n + m :] = -1.0, -1.0
        classes = [counted(science & (priority == p)) for p in sorted(set(priority[science]), reverse=True)]
        worth = counted(science) * np.append(subpriority[target], np.zeros(size - n))
        self.goals = np.array([counted(required), lack, *classes, used, touch, worth])

    def best(self, known=()):
        """Return the values of the objectives of the best plan, among plans with ``known`` values of the first ones."""
        rows, low, high, found = self.rows, self.low, self.high, []
        most = np.append(np.ones(self.n), np.full(rows.shape[1] - self.n, np.inf))
        for k, goal in enumerate(self.goals):
            if k < len(known):
                rows, low, high = np.vstack([rows, goal]), np.append(low, known[k]), np.append(high, known[k])
                found.append(known[k])
                continue
            limits = LinearConstraint(rows, low, high)
            settings = {"bounds": Bounds(0, most), "integrality": np.ones(len(most)), "options": {"mip_rel_gap": 0.0}}
            answer = milp(-goal, constraints=limits, **settings)
            assert answer.status == 0
            value = goal @ np.round(answer.x)
            found.append(value)
            rows, low, high = np.vstack([rows, goal]), np.append(low, value - 1e-6), np.append(high, np.inf)
        return np.array(found)

    def values(self, target_of):
        """Return the values of the objectives of a plan, after a test that the plan has no collisions."""
        x = np.zeros(self.rows.shape[1])
        for i, t in enumerate(target_of.tolist()):
            k = next(k for k, option in enumerate(self.choices[i]) if (-1 if option is None else option[0]) == t)
            x[self.column[i, k]] = 1.0
        for row, lowest in zip(self.rows[self.soft], self.low[self.soft], strict=True):
            column = self.n + np.flatnonzero(row[self.n :])[0]
            total = row[: self.n] @ x[: self.n]
            x[column] = max(total - 1, 0) if row[column] < 0 else max(lowest - total, 0)
        total = self.rows @ x
        for r, (value, lowest, highest) in enumerate(zip(total, self.low, self.high, strict=True)):
            assert lowest - 1e-9 <= value <= highest + 1e-9, r
        return self.goals @ x
