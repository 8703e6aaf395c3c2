"""Augmenting paths in a plan of many tiles, and prices of cliques of candidates, which give upper bounds.

A candidate is an assignment that a plan may use: a positioner with a target, or with its idle arm. A path begins at a
target that requires a visit. A positioner that has another target is moved to this target, so that its previous target
loses a visit. Another positioner, of any tile, is then moved to the previous target, and so on. The path ends with a
positioner that had no target, or whose previous target is less important than the target at which the path begins.

A candidate is an assignment that a plan may use: a positioner with a target, or with its idle arm. A clique is a set of
candidates; a plan uses at most one candidate of each clique. Each clique has a price of at least 0. The value of a
candidate is its weight minus the prices of its cliques. The weight is 1 if the candidate counts for the objective, and
0 otherwise. The weight of a plan is the sum of the weights of its candidates. An upper bound of this weight is the sum
of all prices plus the sum, over all positioners, of the largest value of the candidates of the positioner.
"""

import math
from typing import NamedTuple

import numpy as np

from rfpsurvey._kernels.jit import kernel

TOLERANCE = 1e-6
"""Rounding error of the sum of a rule over the candidates in use."""


class Links(NamedTuple):
    """The candidates of all positioners."""

    owner: np.ndarray  # positioner of each candidate
    target: np.ndarray  # -1 if its visits do not count, as those of an idle arm or of a sky position
    rank: np.ndarray  # class of the target of each candidate; smaller numbers are more important
    t_indptr: np.ndarray
    t_candidate: np.ndarray  # candidates of each target, as compressed rows
    indptr: np.ndarray
    clique: np.ndarray  # cliques of each candidate, as compressed rows; a plan uses at most one candidate of each
    r_indptr: np.ndarray
    rule: np.ndarray
    share: np.ndarray  # rules of each candidate, as compressed rows, and its share in the sum of each rule
    room: np.ndarray  # for each rule, its limit minus its sum over the candidates in use


@kernel
def exchange(old, new, links):
    """Update the rules for the use of candidate ``new`` in place of ``old``; return whether all rules are kept."""
    for k in range(links.r_indptr[old], links.r_indptr[old + 1]):
        links.room[links.rule[k]] += links.share[k]
    kept = True
    for k in range(links.r_indptr[new], links.r_indptr[new + 1]):
        links.room[links.rule[k]] -= links.share[k]
        kept &= links.room[links.rule[k]] > -TOLERANCE
    # shares in minima are negative, so that giving up a candidate can violate a rule, too
    for k in range(links.r_indptr[old], links.r_indptr[old + 1]):
        kept &= links.room[links.rule[k]] > -TOLERANCE
    return kept


@kernel
def swap(c, links, chosen, load):
    """Use candidate c for its positioner, and update the number of used candidates of each clique (``load``)."""
    i = links.owner[c]
    old = chosen[i]
    for k in range(links.indptr[old], links.indptr[old + 1]):
        load[links.clique[k]] -= 1
    for k in range(links.indptr[c], links.indptr[c + 1]):
        load[links.clique[k]] += 1
    exchange(old, c, links)
    chosen[i] = c


@kernel
def is_free(c, links, chosen, load):
    """Return whether candidate c may replace that of its positioner: no other arm collides, and all rules are kept."""
    old = chosen[links.owner[c]]
    for k in range(links.indptr[old], links.indptr[old + 1]):
        load[links.clique[k]] -= 1
    free = True
    for k in range(links.indptr[c], links.indptr[c + 1]):
        free &= load[links.clique[k]] == 0
    for k in range(links.indptr[old], links.indptr[old + 1]):
        load[links.clique[k]] += 1
    if free and links.room.size > 0:
        free = exchange(old, c, links)
        exchange(c, old, links)  # undoes the first exchange
    return free


@kernel
def last_step(t, level, replace, links, chosen, load):
    """Return a candidate of target t with which a path can end, or -1 if there is none.

    The positioner of this candidate has no target. If ``replace`` is true, the positioner may also have a target whose
    class is less important than the class ``level``.
    """
    for k in range(links.t_indptr[t], links.t_indptr[t + 1]):
        c = links.t_candidate[k]
        old = chosen[links.owner[c]]
        ends = links.target[old] < 0 or (replace and links.rank[old] > level)
        if ends and is_free(c, links, chosen, load):
            return c
    return -1


@kernel
def find_path(begin, level, replace, links, chosen, load, left, seen, stack):
    """Add a visit to the target ``begin`` along a path, and return whether such a path was found.

    A path has at most as many positioners as ``stack`` has rows. The plan is changed while the path is extended. If the
    path cannot be extended, the last change is undone, and another positioner is tried. Targets in ``seen`` are not
    tried again. ``left`` is the remaining number of visits of each target. `last_step` explains ``level`` and
    ``replace``.
    """
    seen[begin] = True
    depth = 0
    # rows: a target, the index of its next candidate (-1 if none was tried), and the candidate that lost this target
    stack[0] = begin, -1, -1
    while depth >= 0:
        t, k, _ = stack[depth]
        if k < 0:
            c = last_step(t, level, replace, links, chosen, load)
            if c >= 0:
                old = links.target[chosen[links.owner[c]]]
                swap(c, links, chosen, load)
                left[begin] -= 1
                if old >= 0:
                    left[old] += 1
                return True
            k = links.t_indptr[t]
        has_path = False
        while k < links.t_indptr[t + 1] and depth + 1 < stack.shape[0] and not has_path:
            c = links.t_candidate[k]
            k += 1
            old = chosen[links.owner[c]]
            h = links.target[old]
            if h < 0 or h == t or seen[h] or (replace and links.rank[old] > level):
                continue
            if is_free(c, links, chosen, load):
                seen[h] = has_path = True
                swap(c, links, chosen, load)
                stack[depth, 1] = k
                depth += 1
                stack[depth] = h, -1, old
        if not has_path:
            if depth > 0:
                swap(stack[depth, 2], links, chosen, load)
            depth -= 1
    return False


@kernel
def find_paths(order, level, replace, depth, links, chosen, load, left):
    """Add visits to the targets in ``order``, along paths of at most ``depth`` positioners; return the number added."""
    seen = np.zeros(left.size, np.bool_)
    stack = np.empty((depth, 3), np.int64)
    gained = 0
    for t in order:
        while left[t] > 0 and find_path(t, level, replace, links, chosen, load, left, seen, stack):
            gained += 1
    return gained


@kernel
def bound_of(start, value, price):
    """Return the upper bound of the weight of a plan, from the prices of cliques and the values of candidates."""
    total = price.sum()
    for i in range(start.size - 1):
        best = -np.inf
        for c in range(start[i], start[i + 1]):
            best = max(best, value[c])
        total += best
    return total


@kernel
def adjust_prices(start, owner, row_start, column, value, price, limits, width, begin, end, step):
    """Adjust the prices of the cliques from ``begin`` to ``end`` in turn, and update the values of the candidates.

    In the upper bound, the largest value of each positioner is replaced by a smooth maximum,
    ``width * log(sum(exp(value / width)))``. The share of a candidate is the derivative of this smooth maximum with
    respect to the value of the candidate. The new price of a clique minimizes the smooth bound: the shares of the
    members of the clique then sum to 1, or the price is 0. In place of a clique, row r of ``column`` can contain a set
    of which a plan uses at most ``most[r]`` members. The shares of these members then sum to ``most[r]``. The prices
    are between ``lowest`` and ``highest``: a set of which a plan uses at least ``most[r]`` members has a price of at
    most 0. ``limits`` contains ``most``, ``lowest`` and ``highest``.
    """
    most, lowest, highest = limits
    odds = np.empty(256)
    for r in range(begin, end, step):
        k, last = row_start[r], row_start[r + 1]
        if last - k > odds.size:
            odds = np.empty(last - k)
        n, total = 0, 0.0
        while k < last:
            i = owner[column[k]]
            best = -np.inf
            for c in range(start[i], start[i + 1]):
                best = max(best, value[c])
            inside = outside = 0.0
            for c in range(start[i], start[i + 1]):
                weight = math.exp((value[c] - best) / width)
                if k < last and column[k] == c:
                    inside += weight
                    k += 1
                else:
                    outside += weight
            odds[n] = min(inside / max(outside, 1e-300), 1e12)
            total += odds[n] / (1.0 + odds[n])
            n += 1
        if (total <= most[r] and price[r] == lowest[r]) or (total >= most[r] and price[r] == highest[r]):
            continue
        # Newton's method with bisection; x is the decrease of the price in units of the width.
        low, high = max((price[r] - highest[r]) / width, -700.0), min((price[r] - lowest[r]) / width, 600.0)
        x, done = 0.0, False
        for end in (low, high):  # at an end, the price is a limit, except at the lower end of a price without a limit
            if end == low and highest[r] > 0.0:
                continue
            factor, total = math.exp(end), 0.0
            for m in range(n):
                total += odds[m] * factor / (1.0 + odds[m] * factor)
            if (end == high and total <= most[r]) or (end == low and total >= most[r]):
                x, done = end, True
        for _ in range(20):
            if done:
                break
            factor, excess, slope = math.exp(x), -most[r], 0.0
            for m in range(n):
                a = odds[m] * factor
                excess += a / (1.0 + a)
                slope += a / ((1.0 + a) * (1.0 + a))
            if abs(excess) < 1e-6:
                break
            if excess > 0.0:
                high = x
            else:
                low = x
            x -= excess / max(slope, 1e-12)
            if x <= low or x >= high:
                x = 0.5 * (low + high)
        new = min(max(price[r] - x * width, lowest[r]), highest[r])
        for k in range(row_start[r], last):
            value[column[k]] += price[r] - new
        price[r] = new
