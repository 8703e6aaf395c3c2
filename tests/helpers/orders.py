"""All orders in which the targets of a few tiles can be served, planned one after the other in plain Python."""

from collections import defaultdict
from itertools import permutations, product

import numpy as np

from oracles import collisions_of, in_annulus, squared_apart, standing_arms


def nearest(xy, centers, reaches, order, priority):
    """Serve the targets in order; each is assigned to its closest free positioner."""
    target_of = [-1] * len(centers)
    for value in sorted(set(priority), reverse=True):
        for t in (t for t in order if priority[t] == value):
            free = [i for i in range(len(centers)) if reaches[i][t] and target_of[i] < 0]
            if free:
                target_of[min(free, key=lambda i: (squared_apart(xy[t], centers[i]), i))] = t
    return [(target_of, 1.0)]


def lamost(xy, centers, reaches, order, priority):
    """Let each free positioner nominate its first unassigned target of the class, until there are no nominations."""
    n, open_targets = len(centers), list(order)
    target_of, taken = [-1] * n, set()
    for value in sorted(set(priority), reverse=True):
        while True:
            nominations = {}
            for i in range(n):
                mine = [t for t in order if reaches[i][t] and t not in taken and priority[t] == value]
                if target_of[i] < 0 and mine:
                    nominations.setdefault(mine[0], []).append(i)
            if not nominations:
                break
            choices = [sum(reaches[i][t] and t not in taken for t in open_targets) for i in range(n)]
            for t, rivals in nominations.items():
                winner = min(rivals, key=lambda i: (choices[i], squared_apart(xy[t], centers[i]), i))
                target_of[winner] = t
                taken.add(t)
    return [(target_of, 1.0)]


def balanced(xy, centers, reaches, order, priority):
    """Add the targets to queues in order; each combination of one target of each queue has the same probability."""
    queues = [[] for _ in centers]
    for t in order:
        can = [i for i in range(len(centers)) if reaches[i][t]]
        if can:
            best = min(can, key=lambda i: (len(queues[i]), squared_apart(xy[t], centers[i]), i))
            queues[best].append(t)
    plans = list(product(*(queue or [-1] for queue in queues)))
    return [(list(plan), 1.0 / len(plans)) for plan in plans]


RULES = {"nearest": nearest, "lamost_rule": lamost, "balanced": balanced}


def reaches_of(plane, xy):
    """Return whether positioner i reaches target t, by exact arithmetic."""
    l1, l2 = (length.to_value("mm") for length in (plane.positioner.central_arm, plane.positioner.eccentric_arm))
    return [[in_annulus(point, center, l1, l2) for point in xy] for center in plane.xy.to_value("mm")]


def lost_of(plane, xy, target_of):
    """Return the targets of positioners in collision."""
    tips = [xy[t] if t >= 0 else (np.nan, np.nan) for t in target_of]
    pairs, _ = collisions_of(plane, standing_arms(plane, tips)[0])
    return {target_of[i] for pair in pairs for i in pair if target_of[i] >= 0}


def observed_sets(plane, tiles, rule, visits, priority, *, lost_in_collision=True):
    """Return the probability of each set of observed targets.

    ``tiles`` contains the positions of all targets on the focal plane in each tile. All orders of the targets have the
    same probability.
    """
    found, centers = defaultdict(float), plane.xy.to_value("mm").tolist()
    reaches = [reaches_of(plane, xy) for xy in tiles]
    lost = {}

    def go(k, order, left, weight):
        if k == len(tiles):
            found[frozenset(t for t in order if left[t] < visits[t])] += weight
            return
        mine = [t for t in order if left[t] > 0]
        for target_of, chance in RULES[rule](tiles[k], centers, reaches[k], mine, priority):
            after, key = list(left), (k, tuple(target_of))
            if key not in lost:
                lost[key] = lost_of(plane, tiles[k], target_of) if lost_in_collision else set()
            for t in target_of:
                if t >= 0 and t not in lost[key]:
                    after[t] -= 1
            go(k + 1, order, after, weight * chance)

    orders = list(permutations(range(len(visits))))
    for order in orders:
        go(0, order, list(visits), 1.0 / len(orders))
    return dict(found)


def pair_chances(sets, n):
    """Return the probability that both targets of each pair are observed; those of single targets are the diagonal."""
    chances = np.zeros((n, n))
    for observed, chance in sets.items():
        mine = np.isin(np.arange(n), list(observed))
        chances += chance * np.outer(mine, mine)
    return chances
