"""Prices of cliques of candidates, which give an upper bound of the number of assigned targets.

A candidate is an assignment that a plan may use: a positioner with a target, or with its idle arm. A clique is a set of
candidates; a plan uses at most one candidate of each clique. Each clique has a price of at least 0. The value of a
candidate is its weight minus the prices of its cliques. The weight is 1 if the candidate counts for the objective, and
0 otherwise. The weight of a plan is the sum of the weights of its candidates. An upper bound of this weight is the sum
of all prices plus the sum, over all positioners, of the largest value of the candidates of the positioner.
"""

import math

import numpy as np

from rfpsurvey._jit import kernel


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
