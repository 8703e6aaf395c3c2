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

# POOL is the largest number of candidates that are considered for the extension of a clique. A clique is not extended
# if the product of its size and the smallest number of collisions of its members is larger than MOST.
POOL, MOST = 4096, 200_000


@kernel
def excludes(a, b, options):
    """Return whether two candidates exclude each other, so that no plan can use both candidates."""
    own, target, indptr, other = options.own, options.target, options.indptr, options.other
    if own[a] == own[b] or (target[a] >= 0 and target[a] == target[b]):
        return True
    if indptr[a + 1] - indptr[a] > indptr[b + 1] - indptr[b]:
        a, b = b, a
    found = False
    for k in range(indptr[a], indptr[a + 1]):
        found |= other[k] == b
    return found


@kernel
def collect(lo, hi, column, options, alive, pool):
    """Write the candidates that exclude every member of a clique to ``pool``, and return the number of candidates."""
    start, indptr, target = options.start, options.indptr, options.target
    best = column[lo]
    for k in range(lo + 1, hi):
        if indptr[column[k] + 1] - indptr[column[k]] < indptr[best + 1] - indptr[best]:
            best = column[k]
    n = 0
    for part in range(3):
        if part == 0:
            first, last = indptr[best], indptr[best + 1]
        elif part == 1:
            first, last = start[options.own[best]], start[options.own[best] + 1]
        elif target[best] >= 0:
            first, last = options.t_indptr[target[best]], options.t_indptr[target[best] + 1]
        else:
            first, last = 0, 0
        for m in range(first, last):
            c = m
            if part == 0:
                c = options.other[m]
            elif part == 2:
                c = options.t_candidate[m]
            fits = alive[c]
            k = lo
            while fits and k < hi:
                fits = column[k] != c and excludes(c, column[k], options)
                k += 1
            for k in range(n):
                fits &= pool[k] != c
            if fits and n < pool.size:
                pool[n] = c
                n += 1
    return n


@kernel
def extend_cliques(indptr, column, options, alive, row_start, out, most_work):
    """Extend cliques until no candidate can be added to any clique, and sort the members of each clique.

    The function ends when ``out`` is full or after about ``most_work`` comparisons of candidates, and returns the index
    of the first clique that was not extended.
    """
    pool = np.empty(POOL, np.int64)
    m = work = 0
    for r in range(indptr.size - 1):
        lo, hi = indptr[r], indptr[r + 1]
        degree = options.indptr[column[lo] + 1] - options.indptr[column[lo]]
        for k in range(lo + 1, hi):
            degree = min(degree, options.indptr[column[k] + 1] - options.indptr[column[k]])
        n = 0
        if degree * (hi - lo) <= MOST:
            n = collect(lo, hi, column, options, alive, pool)
        if m + hi - lo + n > out.size or work > most_work:
            return r
        work += (degree + 16) * (degree + hi - lo + n * n)
        begin = m
        for k in range(lo, hi):
            out[m] = column[k]
            m += 1
        while n > 0:
            best, most = 0, -1
            for i in range(n):
                number = 0
                for j in range(n):
                    number += j != i and excludes(pool[i], pool[j], options)
                if number > most:
                    best, most = i, number
            c = pool[best]
            out[m] = c
            m += 1
            kept = 0
            for j in range(n):
                if j != best and excludes(c, pool[j], options):
                    pool[kept] = pool[j]
                    kept += 1
            n = kept
        out[begin:m].sort()
        row_start[r + 1] = m
    return indptr.size - 1


@kernel
def mark_repeated(order, row_start, column, repeated):
    """Mark cliques that repeat an earlier clique; equal cliques must follow one another in ``order``."""
    for k in range(1, order.size):
        a, b = order[k - 1], order[k]
        n = row_start[a + 1] - row_start[a]
        same = n == row_start[b + 1] - row_start[b]
        m = 0
        while same and m < n:
            same = column[row_start[a] + m] == column[row_start[b] + m]
            m += 1
        repeated[b] = same


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
def adjust_prices(start, own, row_start, column, value, price, most, width, begin, end, step):
    """Adjust the prices of the cliques from ``begin`` to ``end`` in turn, and update the values of the candidates.

    In the upper bound, the largest value of each positioner is replaced by a smooth maximum,
    ``width * log(sum(exp(value / width)))``. The share of a candidate is the derivative of this smooth maximum with
    respect to the value of the candidate. The new price of a clique minimizes the smooth bound: the shares of the
    members of the clique then sum to 1, or the price is 0. In place of a clique, row r of ``column`` can contain a set
    of which a plan uses at most ``most[r]`` members. The shares of these members then sum to ``most[r]``.
    """
    odds = np.empty(256)
    for r in range(begin, end, step):
        k, last = row_start[r], row_start[r + 1]
        if last - k > odds.size:
            odds = np.empty(last - k)
        n, total = 0, 0.0
        while k < last:
            i = own[column[k]]
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
        if total <= most[r] and price[r] == 0.0:
            continue
        # Newton's method with bisection; x is the decrease of the price in units of the width.
        low, high = -700.0, min(price[r] / width, 700.0)
        factor, total = math.exp(high), 0.0
        for m in range(n):
            total += odds[m] * factor / (1.0 + odds[m] * factor)
        x = high if total <= most[r] else 0.0  # at the upper end, the price is 0
        for _ in range(20):
            if total <= most[r]:
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
        new = max(price[r] - x * width, 0.0)
        for k in range(row_start[r], last):
            value[column[k]] += price[r] - new
        price[r] = new
