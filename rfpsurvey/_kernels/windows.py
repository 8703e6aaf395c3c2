"""Sequences of visits that complete the epochs of cadences, and local moves in a plan of dated tiles.

A *place* is a pair of a target and a tile that can observe it. A *sequence* is a list of places of a target that
completes its first epochs, in the order of time. A candidate is a positioner with a target or with its idle arm.
"""

from typing import NamedTuple

import numpy as np

from rfpsurvey._kernels.batch import mix
from rfpsurvey._kernels.jit import kernel
from rfpsurvey._kernels.paths import TOLERANCE, is_free, swap

# Factor of the random costs of places, which are smaller than 2^16; the costs of all visits sum to less than 1e-3.
TIE = 1e-3 / (255 * 2**16)
# Largest number of targets that a move removes from the plan.
MOST_REMOVED = 6


class Dates(NamedTuple):
    """The cadences of targets, and the times of tiles; tiles are in the order of time."""

    cadence: np.ndarray  # of each target
    e_indptr: np.ndarray  # first epoch of each cadence
    low: np.ndarray  # limits of the time since the previous epoch, for each epoch
    high: np.ndarray
    n: np.ndarray  # number of exposures of each epoch
    limit: np.ndarray  # largest brightness of each epoch
    p_indptr: np.ndarray
    p_tile: np.ndarray  # tiles of the places of each target, as compressed rows
    c_indptr: np.ndarray
    candidate: np.ndarray  # candidates of each place, as compressed rows
    k_indptr: np.ndarray
    member: np.ndarray  # candidates of each clique, as compressed rows
    usable: np.ndarray  # whether moves may use each candidate
    idle: np.ndarray  # idle candidate of each positioner
    rank: np.ndarray  # class of each target
    day: np.ndarray
    brightness: np.ndarray
    night: float  # largest time between the exposures of an epoch
    skipped: np.ndarray  # number of epochs of each target that were completed before
    made: np.ndarray  # number of exposures of each target in the epoch that was begun before
    begun: np.ndarray  # time of the first of these exposures; NaN for none
    previous: np.ndarray  # time of the last completed epoch; NaN for none


class Work(NamedTuple):
    """Arrays for `best_sequence`, with one element for each epoch, first place and last place."""

    value: np.ndarray
    back: np.ndarray
    taken: np.ndarray


@kernel
def cheapest_between(p, i, k, number, limit, cost, dates, taken):
    """Mark the ``number`` cheapest places between the places i and k of a target; return their cost (inf if too few).

    ``p`` is the first place of the target.
    """
    total = 0.0
    for j in range(i + 1, k):
        taken[j] = False
    for _ in range(number):
        best = -1
        for j in range(i + 1, k):
            fits = not taken[j] and dates.brightness[dates.p_tile[p + j]] <= limit
            if fits and (best < 0 or cost[p + j] < cost[p + best]):
                best = j
        if best < 0:
            return np.inf
        taken[best] = True
        total += cost[p + best]
    return total


@kernel
def is_within(since, low, high):
    """Return whether a time since the previous epoch is within its limits; NaN if there is no previous epoch."""
    return not (since < low or (high >= 0 and since > high))


@kernel
def best_sequence(t, cost, per_visit, per_whole, dates, work, picked):
    """Find the sequence of target t with the largest value, and return the value, visits, and whether it is complete.

    The value is ``per_visit`` for each visit and ``per_whole`` for a complete cadence, minus the ``cost`` of the
    places, which is infinite for places that cannot be used. ``picked`` marks the places of the target in use.
    """
    p, m = dates.p_indptr[t], dates.p_indptr[t + 1] - dates.p_indptr[t]
    first = dates.e_indptr[dates.cadence[t]] + dates.skipped[t]
    n_epochs = dates.e_indptr[dates.cadence[t] + 1] - first
    begun, night = dates.begun[t], dates.night
    # dynamic program: ``value[e, i, k]`` is the largest value of sequences whose epoch e has the first place i and the
    # last place k, and ``back`` contains these places of the preceding epoch
    value, back, taken = work
    best, at_e, at_i, at_k = 0.0, -1, -1, -1
    for e in range(n_epochs):
        low, high, n, limit = dates.low[first + e], dates.high[first + e], dates.n[first + e], dates.limit[first + e]
        gain, is_possible = per_visit * n + (per_whole if e == n_epochs - 1 else 0.0), False
        for i in range(m):
            for k in range(i, m):
                value[e, i, k] = -np.inf
            day = start = dates.day[dates.p_tile[p + i]]
            needed = n
            if e == 0 and day - begun <= night:  # this place continues the epoch that was begun before
                start, needed = begun, n - dates.made[t]
            elif e == 0 and not is_within(day - dates.previous[t], low, high):
                continue
            if cost[p + i] == np.inf or dates.brightness[dates.p_tile[p + i]] > limit:
                continue
            before, where = 0.0, -1
            if e > 0:
                before = -np.inf
                for a in range(i):
                    day_before = dates.day[dates.p_tile[p + a]]
                    if e == 1 and day_before - begun <= night:
                        day_before = begun
                    if not is_within(day - day_before, low, high):
                        continue
                    for b in range(a, i):
                        if dates.day[dates.p_tile[p + b]] - day_before > night:
                            break
                        if value[e - 1, a, b] > before:
                            before, where = value[e - 1, a, b], a * m + b
            if before == -np.inf:
                continue
            for k in range(i, m):
                if dates.day[dates.p_tile[p + k]] - start > night or (needed == 1 and k > i):
                    break
                if (needed > 1 and k == i) or cost[p + k] == np.inf or dates.brightness[dates.p_tile[p + k]] > limit:
                    continue
                visits_cost = cost[p + i] + (cost[p + k] if k > i else 0.0)
                if needed > 2:
                    visits_cost += cheapest_between(p, i, k, needed - 2, limit, cost, dates, taken)
                total = before + gain - visits_cost
                value[e, i, k], back[e, i, k] = total, where
                is_possible |= total > -np.inf
                if total > best:
                    best, at_e, at_i, at_k = total, e, i, k
        if not is_possible:
            break
    picked[:m] = False
    visits, whole = 0, at_e == n_epochs - 1
    while at_e >= 0:
        n = dates.n[first + at_e]
        visits += n
        if at_e == 0 and dates.day[dates.p_tile[p + at_i]] - begun <= night:
            n -= dates.made[t]
        picked[at_i] = picked[at_k] = True
        if n > 2:
            cheapest_between(p, at_i, at_k, n - 2, dates.limit[first + at_e], cost, dates, taken)
            for j in range(at_i + 1, at_k):
                picked[j] |= taken[j]
        where = back[at_e, at_i, at_k]
        at_e -= 1
        at_i, at_k = where // m, where % m
    return best, visits, whole


@kernel
def change(c, links, chosen, load, journal):
    """Use candidate c, and add the previous candidate of its positioner to the journal."""
    journal.append(chosen[links.owner[c]])
    swap(c, links, chosen, load)


@kernel
def remove(t, links, dates, chosen, load, used, done, journal, places):
    """Remove all visits of target t."""
    for p in range(dates.p_indptr[t], dates.p_indptr[t + 1]):
        if used[p] >= 0:
            change(dates.idle[links.owner[used[p]]], links, chosen, load, journal)
            places.append((p, used[p]))
            used[p] = -1
    done[t, 0] = done[t, 1] = 0


@kernel
def insert(t, turn, links, dates, chosen, load, used, done, cost, candidate, work, picked, journal, places):
    """Add the best sequence of target t, which has no visits, on positioners without targets.

    The number ``turn`` determines the candidate of each place that is tried first.
    """
    first, last = dates.p_indptr[t], dates.p_indptr[t + 1]
    for p in range(first, last):
        cost[p], candidate[p] = np.inf, -1
        begin, size = dates.c_indptr[p], dates.c_indptr[p + 1] - dates.c_indptr[p]
        for k in range(size):
            c = dates.candidate[begin + (turn + k) % size]
            if not dates.usable[c]:
                continue
            if links.target[chosen[links.owner[c]]] < 0 and is_free(c, links, chosen, load):
                # sequences of equal value are tried in turn
                cost[p], candidate[p] = TIE * (mix(np.uint64(turn) + np.uint64(p)) >> np.uint64(48)), c
                break
    _, visits, whole = best_sequence(t, cost, 1.0, 1000.0, dates, work, picked)
    for p in range(first, last):
        if picked[p - first]:
            change(candidate[p], links, chosen, load, journal)
            places.append((p, -1))
            used[p] = candidate[p]
    done[t, 0], done[t, 1] = int(whole), visits


@kernel
def blockers(t, n, links, dates, chosen, load, out):
    """Add targets whose visits prevent visits of target t to the first n targets of ``out``; return the new number."""
    for p in range(dates.p_indptr[t], dates.p_indptr[t + 1]):
        for k in range(dates.c_indptr[p], dates.c_indptr[p + 1]):
            c = dates.candidate[k]
            n = add(links.target[chosen[links.owner[c]]], t, n, out)
            for r in range(links.indptr[c], links.indptr[c + 1]):
                clique = links.clique[r]
                if load[clique] > 0:
                    for q in range(dates.k_indptr[clique], dates.k_indptr[clique + 1]):
                        rival = dates.member[q]
                        if chosen[links.owner[rival]] == rival:
                            n = add(links.target[rival], t, n, out)
    return n


@kernel
def add(h, t, n, out):
    """Add target h to a list, unless it is target t, none, in the list, or the list is full; return the new length."""
    if h < 0 or h == t or n == out.size:
        return n
    for k in range(n):
        if out[k] == h:
            return n
    out[n] = h
    return n + 1


@kernel
def keeps_limits(links, chosen, load, journal):
    """Return whether the positioners of a journal collide with no other arm, and all rules are kept."""
    for old in journal:
        c = chosen[links.owner[old]]
        for r in range(links.indptr[c], links.indptr[c + 1]):
            if load[links.clique[r]] > 1:
                return False
    return links.room.size == 0 or links.room.min() > -TOLERANCE


@kernel
def move(order, rolls, links, dates, chosen, load, used, done, cost, candidate, work, picked, gain):
    """Try to complete the targets in ``order``: remove targets that prevent this, and add all of them again.

    A move is undone if the numbers of complete cadences and of visits are smaller than before, class by class.
    ``rolls`` contains ``MOST_REMOVED + 4`` random whole numbers for each target.
    """
    out, ranks = np.empty(64, np.int64), dates.rank
    for step in range(order.size):
        t, roll = order[step], rolls[step]
        n = blockers(t, 0, links, dates, chosen, load, out)
        if n > 0 and roll[1] % 2:  # also targets that prevent visits of one of these targets
            n = blockers(out[roll[2] % n], n, links, dates, chosen, load, out)
            for k in range(n):
                if out[k] == t:
                    n -= 1
                    out[k] = out[n]
                    break
        number = min(n, int(roll[0] % MOST_REMOVED) + 1)
        for k in range(number):  # the first elements become a random selection
            swapped = k + int(roll[k + 3] % (n - k))
            out[k], out[swapped] = out[swapped], out[k]
        # empty lists from which numba infers the types of their elements
        journal = [np.int64(0) for _ in range(0)]
        places = [(np.int64(0), np.int64(0)) for _ in range(0)]
        old = done[t].copy()
        before = [(done[out[k], 0], done[out[k], 1]) for k in range(number)]
        gain[:] = 0
        gain[ranks[t], 0] -= old[0]
        gain[ranks[t], 1] -= old[1]
        remove(t, links, dates, chosen, load, used, done, journal, places)
        for k in range(number):
            gain[ranks[out[k]], 0] -= before[k][0]
            gain[ranks[out[k]], 1] -= before[k][1]
            remove(out[k], links, dates, chosen, load, used, done, journal, places)
        for k in range(-1, number):
            h = t if k < 0 else out[k]
            turn = roll[k + 4]
            insert(h, turn, links, dates, chosen, load, used, done, cost, candidate, work, picked, journal, places)
            gain[ranks[h], 0] += done[h, 0]
            gain[ranks[h], 1] += done[h, 1]
        is_worse = False
        for value in gain.ravel():
            if value != 0:
                is_worse = value < 0
                break
        if not is_worse and keeps_limits(links, chosen, load, journal):
            continue
        for k in range(len(journal) - 1, -1, -1):
            swap(journal[k], links, chosen, load)
        for k in range(len(places) - 1, -1, -1):
            used[places[k][0]] = places[k][1]
        done[t] = old
        for k in range(number):
            done[out[k], 0], done[out[k], 1] = before[k]


@kernel
def use_prices(price, arm_price, per_visit, per_whole, links, dates, work, picked, cost, usage, arm_usage):
    """Return the sum over all targets of the largest value of a sequence, if each candidate has a price.

    The price of a candidate is the sum of the prices of its cliques and of its positioner. ``usage`` and ``arm_usage``
    receive the number of uses of each clique and each positioner.
    """
    total = 0.0
    for t in range(dates.p_indptr.size - 1):
        if per_visit[t] == 0.0 and per_whole[t] == 0.0:
            continue
        first, last = dates.p_indptr[t], dates.p_indptr[t + 1]
        for p in range(first, last):
            cost[p] = np.inf
            for k in range(dates.c_indptr[p], dates.c_indptr[p + 1]):
                cost[p] = min(cost[p], price_of(dates.candidate[k], price, arm_price, links))
        value, _, _ = best_sequence(t, cost, per_visit[t], per_whole[t], dates, work, picked)
        total += value
        for p in range(first, last):
            if picked[p - first]:
                for k in range(dates.c_indptr[p], dates.c_indptr[p + 1]):
                    c = dates.candidate[k]
                    if price_of(c, price, arm_price, links) == cost[p]:
                        arm_usage[links.owner[c]] += 1.0
                        for r in range(links.indptr[c], links.indptr[c + 1]):
                            usage[links.clique[r]] += 1.0
                        break
    return total


@kernel
def price_of(c, price, arm_price, links):
    """Return the price of a candidate."""
    total = arm_price[links.owner[c]]
    for r in range(links.indptr[c], links.indptr[c + 1]):
        total += price[links.clique[r]]
    return total
