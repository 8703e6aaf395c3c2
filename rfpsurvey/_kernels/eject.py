"""Ejection moves: a positioner takes a better candidate, and the positioners that block it take other candidates.

Arms do not collide before and after each move. A move is undone if the plan gets worse.
"""

from typing import NamedTuple

import numpy as np

from rfpsurvey._kernels.batch import GOLDEN, mix
from rfpsurvey._kernels.jit import inner_kernel, kernel

NONE = np.int64(-1)
# Largest numbers of positioners that lose their candidates at the start of a move, and of steps of a move, and of
# positioners that are looked at, and of those that are tried, in order to meet requirements after a move.
MOST_BLOCKERS, MOST_STEPS = 4, 64
MOST_SCANNED, MOST_TRIED = 1000, 24
# Weight of a required target in comparisons of two candidates, which is larger than any number of requirements.
REQUIRED = 1 << 40
# Number of values of the random number that is compared with a probability.
MANY = np.int64(1 << 30)
# Differences of sums of subpriorities up to this number are rounding errors.
EQUAL = 1e-12


class Goals(NamedTuple):
    """What counts in a plan in addition to the classes of the targets, for each candidate and each requirement."""

    required: np.ndarray  # whether each candidate observes a required target
    worth: np.ndarray  # subpriority of the science target of each candidate; 0 for other candidates
    indptr: np.ndarray
    group: np.ndarray  # requirements toward which each candidate counts, as compressed rows
    least: np.ndarray  # smallest number of candidates of each requirement
    most: np.ndarray
    n_classes: int
    all_first: bool  # whether the number of science targets is more important than their classes
    science: np.ndarray  # whether each candidate is a science fiber of each distribution rule
    near: np.ndarray  # whether each candidate is a neighbor of each distribution rule
    close_indptr: np.ndarray
    close: np.ndarray  # for each rule and target, the targets within the distance of the rule, as compressed rows
    k: np.ndarray  # number of neighbors that each rule demands
    percent: np.ndarray  # percentage of the science fibers that need these neighbors


class Plan(NamedTuple):
    """A plan, as described for `repair.put`, and what its candidates count toward."""

    chosen: np.ndarray
    blocked: np.ndarray
    holder: np.ndarray
    count: np.ndarray  # number of candidates of each requirement
    n_near: np.ndarray  # number of neighbors of each target, for each rule
    is_used: np.ndarray  # whether each target is observed as a science target, for each rule
    n_science: np.ndarray  # number of science fibers of each rule
    n_served: np.ndarray  # number of these science fibers that have enough neighbors


class Move(NamedTuple):
    """The steps of a move, the changes that they make, and the positioners that block the new candidate."""

    n: np.ndarray  # number of steps, shape (1,)
    owner: np.ndarray
    before: np.ndarray  # candidate of the positioner of each step before the step
    # changes of: -excess over maxima, required targets, -lack, science targets, sum of subpriorities, sum of costs
    sums: np.ndarray
    ranks: np.ndarray  # number of changed classes, followed by these classes
    net: np.ndarray  # change of the number of targets of each class
    blockers: np.ndarray


def new_move(n_classes: int) -> Move:
    """Return a move without steps."""
    numbers = (np.zeros(n, dtype=np.int64) for n in (1, 2 * MOST_STEPS, 2 * MOST_STEPS))
    ranks, net, blockers = (np.zeros(n, dtype=np.int64) for n in (8 * MOST_STEPS, n_classes + 2, MOST_BLOCKERS))
    return Move(*numbers, np.zeros(6), ranks, net, blockers)


@inner_kernel
def step(i, c, options, goals, plan, move):
    """Assign candidate c to positioner i (none if c = -1), and update the plan and the changes of the move."""
    indptr, excluded, target, rank = options.indptr, options.excluded, options.target, options.rank
    holder, blocked, count, sums, net = plan.holder, plan.blocked, plan.count, move.sums, move.net
    old, n = plan.chosen[i], move.n[0]
    move.owner[n], move.before[n] = i, old
    move.n[0] += 1
    plan.chosen[i] = c
    if old >= 0 and target[old] >= 0 and holder[target[old]] == i:
        holder[target[old]] = NONE
    if c >= 0 and target[c] >= 0:
        holder[target[c]] = i
    for sign in (-1, 1):
        d = old if sign < 0 else c
        if d < 0:
            continue
        for k in range(indptr[d], indptr[d + 1]):
            blocked[excluded[k]] += sign
        for k in range(goals.indptr[d], goals.indptr[d + 1]):
            g = goals.group[k]
            low = min(count[g], count[g] + sign)  # the number changes between this number and the next one
            sums[0] -= sign * (low >= goals.most[g])
            sums[2] += sign * (low < goals.least[g])
            count[g] += sign
        if goals.k.size > 0 and target[d] >= 0:
            count_neighbors(d, target[d], sign, goals, plan, sums)
        sums[1] += sign * goals.required[d]
        sums[3] += sign * (rank[d] < goals.n_classes)
        sums[4] += sign * goals.worth[d]
        sums[5] += sign * options.cost[d]
        if rank[d] <= goals.n_classes:
            if net[rank[d]] == 0:
                move.ranks[0] += 1
                move.ranks[move.ranks[0]] = rank[d]
            net[rank[d]] += sign


@inner_kernel
def lack_of_rule(r, goals, plan):
    """Return how many more science fibers would need neighbors so that a plan complies with rule r."""
    # a product that rounding makes slightly larger than a whole number does not count as the next number
    return max(np.ceil(goals.percent[r] * plan.n_science[r] / 100 - 1e-9) - plan.n_served[r], 0.0)


@inner_kernel
def count_neighbors(d, t, sign, goals, plan, sums):
    """Update what candidate d, whose target is t, counts toward the rules on the distribution of fibers."""
    for r in range(goals.k.size):
        before = lack_of_rule(r, goals, plan)
        if goals.science[r, d]:
            plan.is_used[r, t] = sign > 0
            plan.n_science[r] += sign
            plan.n_served[r] += sign * (plan.n_near[r, t] >= goals.k[r])
        if goals.near[r, d]:
            for p in range(goals.close_indptr[r, t], goals.close_indptr[r, t + 1]):
                s = goals.close[p]
                low = min(plan.n_near[r, s], plan.n_near[r, s] + sign)
                plan.n_near[r, s] += sign
                plan.n_served[r] += sign * (plan.is_used[r, s] and low == goals.k[r] - 1)
        sums[2] += before - lack_of_rule(r, goals, plan)


@inner_kernel
def begin(move):
    """Forget the steps of the previous move."""
    for k in range(1, move.ranks[0] + 1):
        move.net[move.ranks[k]] = 0
    move.ranks[0] = move.n[0] = 0
    move.sums[:] = 0.0


@inner_kernel
def undo(options, goals, plan, move):
    """Undo all steps of a move."""
    n = move.n[0]
    for k in range(n - 1, -1, -1):
        move.n[0] = n
        step(move.owner[k], move.before[k], options, goals, plan, move)


@inner_kernel
def gain_of(goals, move):
    """Return a number above 0 if a move makes the plan better, below 0 if worse, and 0 if no objective changes."""
    sums, net, first = move.sums, move.net, np.int64(goals.n_classes + 1)
    for k in range(3 + goals.all_first):
        if sums[k] != 0:
            return sums[k]
    for k in range(1, move.ranks[0] + 1):
        if net[move.ranks[k]] != 0:
            first = min(first, move.ranks[k])
    if first <= goals.n_classes:
        return float(net[first])
    return sums[4] if abs(sums[4]) > EQUAL else 0.0


@inner_kernel
def filled(c, now, goals, count):
    """Return how many unmet requirements candidate c meets in place of candidate ``now``; -1 if it exceeds a maximum.

    Required targets count as many requirements.
    """
    n = REQUIRED * goals.required[c]
    for k in range(goals.indptr[c], goals.indptr[c + 1]):
        g = goals.group[k]
        n_after = count[g]
        if now >= 0:
            for m in range(goals.indptr[now], goals.indptr[now + 1]):
                n_after -= goals.group[m] == g
        if n_after >= goals.most[g]:
            return NONE
        n += n_after < goals.least[g]
    return n


@inner_kernel
def best_of(i, options, goals, plan):
    """Return the best candidate of positioner i that is not blocked and exceeds no maximum; -1 if there is none."""
    target, rank, cost, worth = options.target, options.rank, options.cost, goals.worth
    best, most = NONE, NONE
    for c in range(options.start[i], options.start[i + 1]):
        if plan.blocked[c] > 0 or (target[c] >= 0 and plan.holder[target[c]] >= 0 and plan.holder[target[c]] != i):
            continue
        n = filled(c, plan.chosen[i], goals, plan.count)
        better = n > most
        if n == most and best >= 0:
            better = rank[c] < rank[best]
            if rank[c] == rank[best]:
                better = worth[c] > worth[best] or (worth[c] == worth[best] and cost[c] < cost[best])
        if better:
            best, most = c, n
    return best


@inner_kernel
def draw(n, progress):
    """Return the next random whole number from 0 to n - 1."""
    progress[0] += GOLDEN
    return np.int64(((mix(progress[0]) >> np.uint64(32)) * np.uint64(n)) >> np.uint64(32))


@inner_kernel
def balance(least, fixed, options, goals, plan, move, progress):
    """Let positioners with less important targets than ``least`` take candidates that requirements need.

    Such a positioner can be anywhere in the focal plane. The search begins with a random positioner, and ends after
    MOST_SCANNED positioners, or MOST_TRIED of them that have less important targets.
    """
    sums, n, n_tried = move.sums, fixed.size, 0
    first = draw(n, progress)
    for k in range(min(n, MOST_SCANNED)):
        if (sums[0] >= 0 and sums[2] >= 0) or n_tried == MOST_TRIED or move.n[0] + 2 > MOST_STEPS:
            break
        j = first + k if first + k < n else first + k - n
        now = plan.chosen[j]
        if fixed[j] or options.rank[now] <= least:
            continue
        n_tried += 1
        before = sums[0] + sums[2]
        d = best_of(j, options, goals, plan)
        if d >= 0 and d != now:
            step(j, d, options, goals, plan, move)
            if sums[0] + sums[2] <= before:
                step(j, now, options, goals, plan, move)


@inner_kernel
def attempt(i, c, equal, fixed, options, goals, plan, move, progress):
    """Try to assign candidate c to positioner i, and return the gain of the move.

    The positioners that block the candidate take their best free candidates; then other positioners take the places and
    the targets that became free. The move is undone if the gain is negative, or if it is 0 and ``equal`` excludes the
    move.
    """
    chosen, blocked, holder, before, blockers = plan.chosen, plan.blocked, plan.holder, move.before, move.blockers
    rank, target, indptr, excluded, worth = options.rank, options.target, options.indptr, options.excluded, goals.worth
    m, t = 0, target[c]
    if t >= 0 and holder[t] >= 0 and holder[t] != i:
        blockers[0] = holder[t]
        m = 1
    for k in range(indptr[c], indptr[c + 1]):
        j = options.owner[excluded[k]]
        if chosen[j] != excluded[k] or (m > 0 and j == blockers[0]):
            continue
        if m == MOST_BLOCKERS:
            return -1.0
        blockers[m] = j
        m += 1
    for k in range(m):
        if fixed[blockers[k]]:
            return -1.0
    begin(move)
    for k in range(m):
        step(blockers[k], NONE, options, goals, plan, move)
    step(i, c, options, goals, plan, move)
    for k in range(m):
        d = best_of(blockers[k], options, goals, plan)
        if d < 0:
            undo(options, goals, plan, move)
            return -1.0
        step(blockers[k], d, options, goals, plan, move)
    for k in range(m + 1):
        old = before[k]
        if old < 0 or chosen[move.owner[k]] == old:
            continue
        t, n_places = target[old], indptr[old + 1] - indptr[old]
        n_both = n_places
        if t >= 0 and holder[t] < 0:
            n_both += options.t_indptr[t + 1] - options.t_indptr[t]
        for p in range(n_both):
            freed = p - n_places  # the target of the candidate
            d = excluded[indptr[old] + p] if freed < 0 else options.t_candidate[options.t_indptr[t] + freed]
            j = options.owner[d]
            now = chosen[j]
            if blocked[d] > 0 or target[d] < 0 or holder[target[d]] >= 0 or rank[d] > rank[now] or fixed[j]:
                continue
            if move.n[0] < MOST_STEPS and (rank[d] < rank[now] or worth[d] > worth[now]):
                e = best_of(j, options, goals, plan)
                if e >= 0 and e != now:
                    step(j, e, options, goals, plan, move)
    if move.sums[0] < 0 or move.sums[2] < 0:
        balance(rank[c], fixed, options, goals, plan, move, progress)
    gain = gain_of(goals, move)
    if gain < 0 or (gain == 0 and (equal == 0 or (equal == 1 and move.sums[5] >= 0))):
        undo(options, goals, plan, move)
    return gain


@kernel
def eject(n_rounds, patience, equal, fixed, options, goals, plan, move, order, progress):
    """Improve a plan without collisions by rounds of ejection moves, in place.

    In each round, each positioner, in random order, tries one random candidate that is better than its own or, with the
    probability ``equal``, equally good; if this is 0, only moves that make the plan better are kept; if it is 1, only
    these moves and those that reduce the cost of an equally good plan. The moves end after ``patience`` rounds without
    a better plan. ``progress`` contains the state of the random number generator, and the number of the last rounds
    without a better plan.
    """
    rank, cost, start, count = options.rank, options.cost, options.start, plan.count
    lack = 0.0
    for g in range(count.size):
        lack += max(goals.least[g] - count[g], 0)
    for _ in range(n_rounds):
        if progress[1] >= np.uint64(patience):
            break
        progress[1] += np.uint64(1)
        for k in range(order.size):
            m = k + draw(order.size - k, progress)
            i = order[m]
            order[m], order[k] = order[k], i
            if fixed[i]:
                continue
            now, picked, n = plan.chosen[i], NONE, 0
            last = rank[now] - 1 + (draw(MANY, progress) < equal * MANY)
            for c in range(start[i], start[i + 1]):
                if c == now or options.target[c] < 0:
                    continue
                if rank[c] == rank[now] and equal == 1 and cost[c] >= cost[now]:
                    continue
                if rank[c] <= last or (lack > 0 and filled(c, now, goals, count) > 0) or goals.required[c]:
                    n += 1
                    if draw(n, progress) == 0:
                        picked = c
            if picked >= 0 and attempt(i, picked, equal, fixed, options, goals, plan, move, progress) > 0:
                lack -= move.sums[2]
                progress[1] = np.uint64(0)
