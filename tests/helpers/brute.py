"""All plans of a few positioners, computed one after the other."""

from itertools import combinations, product

import astropy.units as u
import numpy as np
from scipy.optimize import Bounds, LinearConstraint, milp
from scipy.sparse import csr_array
from shapely import LineString, Point

from rfpsurvey.collision import place_arms

MM = u.mm


def options_of(plane, xy, fiber_type, both, forbidden=()):
    """Return the options of each positioner: None, and all targets that it can observe, as (target, elbow)."""
    elbows = ("right", "left") if both else (plane.positioner.handedness,)
    can = plane.reachable(xy * MM, fiber_type).toarray()
    found = []
    for i in range(len(plane)):
        mine = [None]
        for t in np.flatnonzero(can[i]):
            if (i, t) in forbidden:
                continue
            for elbow in elbows:
                angles = plane.positioner.inverse((xy[t] - plane.arrays.xy[i])[None] * MM, elbow)
                if np.isfinite(angles[0][0]):
                    mine.append((int(t), elbow))
        found.append(mine)
    return found


def bodies_of(plane, xy, options, fiber_type, parked):
    """Return, for each option, the segment that can collide (None if there is no arm)."""
    n = len(plane)
    bodies = [[None] * len(mine) for mine in options]
    for k in range(max(map(len, options))):
        tips, hand, types = np.full((n, 2), np.nan), np.full(n, "right"), np.full(n, "", dtype="U8")
        for i, mine in enumerate(options):
            if k < len(mine) and mine[k] is not None:
                tips[i], hand[i] = xy[mine[k][0]], mine[k][1]
                types[i] = "" if fiber_type is None else fiber_type[mine[k][0]]
        posed = place_arms(plane, tips * MM, handedness=hand, fiber_type=types, parked_obstacles=parked)
        for i, mine in enumerate(options):
            if k < len(mine) and np.isfinite(posed.segments[i]).all():
                bodies[i][k] = LineString(posed.segments[i].reshape(2, 2))
    return bodies


def conflicts_of(plane, bodies):
    """Return pairs ((i, k), (j, m)) of options that collide, and options (i, k) that touch an obstacle.

    Collisions between two idle arms, and between idle arms and obstacles, are not counted.
    """
    separation, clearance = plane.positioner.numbers.separation, plane.positioner.numbers.clearance
    pairs, barred = set(), set()
    for i, j in combinations(range(len(bodies)), 2):
        for (k, a), (m, b) in product(enumerate(bodies[i]), enumerate(bodies[j])):
            if (k or m) and a is not None and b is not None and a.distance(b) < separation:
                pairs.add(((i, k), (j, m)))
    for x, y, r in plane.arrays.obstacles.tolist():
        for i, mine in enumerate(bodies):
            for k, a in enumerate(mine):
                if k and a is not None and a.distance(Point(x, y)) < r + clearance:
                    barred.add((i, k))
    return pairs, barred


def best_plan(options, pairs, barred, value, cost):
    """Return the best (value, -cost) of all plans; ``value`` returns None for a plan that is not allowed."""
    best, n = None, len(options)
    partners = {}
    for a, b in pairs:
        partners.setdefault(b, set()).add(a)

    def go(i, taken, picked):
        nonlocal best
        if i == n:
            reached = value([options[j][k] for j, k in enumerate(picked)])
            if reached is not None:
                found = (reached, -cost([options[j][k] for j, k in enumerate(picked)]))
                best = found if best is None or found > best else best
            return
        for k, option in enumerate(options[i]):
            if (i, k) in barred or (option is not None and option[0] in taken):
                continue
            if any(picked[j] == m for j, m in partners.get((i, k), ())):
                continue
            go(i + 1, taken | ({option[0]} if option else set()), [*picked, k])

    go(0, frozenset(), [])
    return best


def edges_alone(plane, xy, parked, seconds=np.inf):
    """Return the number of targets in the best plan, from an integer program with one row for each conflict.

    The result is None if the program is not solved in time.
    """
    choices = options_of(plane, xy, None, both=False)
    pairs, barred = conflicts_of(plane, bodies_of(plane, xy, choices, None, parked))
    column = {(i, k): n for n, (i, k) in enumerate((i, k) for i, mine in enumerate(choices) for k in range(len(mine)))}
    rows = [[column[a], column[b]] for a, b in pairs]
    by_target = {}
    for i, mine in enumerate(choices):
        for k in range(1, len(mine)):
            by_target.setdefault(mine[k][0], []).append(column[i, k])
    rows += list(by_target.values())
    own = [[column[i, k] for k in range(len(mine))] for i, mine in enumerate(choices)]
    everything = rows + own
    indptr = np.cumsum([0, *map(len, everything)], dtype=np.int32)
    ones, indices = np.ones(indptr[-1]), np.concatenate(everything).astype(np.int32)
    matrix = csr_array((ones, indices, indptr), shape=(len(everything), len(column)))
    low = np.append(np.full(len(rows), -np.inf), np.ones(len(own)))
    most = np.ones(len(column))
    most[[column[c] for c in barred]] = 0
    worth = np.array([k > 0 for _, k in column], dtype=float)
    limits, options = Bounds(0, most), {"time_limit": seconds}
    found = milp(-worth, constraints=LinearConstraint(matrix, low, 1), bounds=limits, integrality=most, options=options)
    return round(-found.fun) if found.status == 0 else None
