"""Candidates (the possible poses of each arm), pairs that exclude each other, and candidates that no optimum needs.

Candidates are sorted by positioner: the candidates of positioner i have the indices from ``start[i]`` up to, but not
including, ``start[i + 1]``. A plan uses exactly one candidate of each positioner.

A candidate is a positioner with one target and one elbow position, or a positioner without a target. A candidate
excludes all candidates with which its arm would collide, and all candidates of the same target.
"""

from typing import NamedTuple

import numpy as np

from rfpsurvey._kernels.collisions import keep_near, outlined_squared, pair_squared, project, squared_limit
from rfpsurvey._kernels.jit import kernel

# Number of candidate pairs that are tested together.
BATCH = 2048


class Options(NamedTuple):
    """Candidates with their classes, costs and collisions; the target of an idle arm is -1."""

    start: np.ndarray
    owner: np.ndarray
    target: np.ndarray
    rank: np.ndarray  # class of each candidate; 0 is the most important
    cost: np.ndarray  # preference among candidates of equal rank; lower costs are better
    key: np.ndarray  # candidates that count toward the same requirements have the same key
    as_good: np.ndarray  # as_good[key[a], key[b]]: candidate a meets the requirements at least as well as b
    t_indptr: np.ndarray
    t_candidate: np.ndarray  # candidates of each target, as compressed rows
    indptr: np.ndarray
    excluded: np.ndarray  # candidates that collide with each candidate, as compressed rows


@kernel
def list_conflicts(pairs, p, geometry, start, segments, halves, limits, first, second, borderline):
    """List the colliding candidates of each pair of neighboring positioners, beginning with the pair of index ``p``.

    Returns the number of listed candidate pairs, and the index of the first pair of neighbors for which there was no
    space in the lists. ``borderline`` marks the candidate pairs for which rounding errors could change the result. If
    the arms have outlines, all close candidate pairs are listed, and `keep_outlined` must test them.
    """
    n = 0
    touching, limit, band = limits.separation + limits.slack, squared_limit(limits), limits.band
    near2 = limits.near**2
    outlined = limits.outline.start.size > 1
    size = start[-1]
    ahead = np.empty(size)
    near = np.empty(size, np.int64)
    back, mid_x, mid_y = np.empty(size), np.empty(size), np.empty(size)
    marks = np.empty(size, np.bool_)
    firsts, seconds = np.empty(BATCH + size, np.int64), np.empty(BATCH + size, np.int64)
    while p < pairs.shape[0]:
        i, j = pairs[p, 0], pairs[p, 1]
        a0, a1, b0, b1 = start[i], start[i + 1], start[j], start[j + 1]
        if n + (a1 - a0) * (b1 - b0) > first.size:
            break
        p += 1
        if a0 == a1 or b0 == b1:
            continue
        foremost, hindmost = project(segments, a0, a1, b0, b1, geometry, i, j, ahead)
        if hindmost - foremost > touching:
            continue
        m = 0
        for b in range(b0, b1):
            near[m], mid_x[m], mid_y[m], back[m] = b, halves[0, b], halves[1, b], ahead[b]
            m += ahead[b] - foremost <= touching
        a = a0
        while a < a1:
            n_near = np.int64(0)  # for a literal 0, numba would compile `keep_near` again
            while a < a1 and n_near < BATCH:
                line = ahead[a] + touching
                if hindmost <= line:
                    x, y = halves[0, a], halves[1, a]
                    for k in range(m):
                        dx, dy = mid_x[k] - x, mid_y[k] - y
                        marks[k] = (dx * dx + dy * dy <= near2) & (back[k] <= line)
                    # without a branch: the next pair overwrites a pair that is not marked
                    for k in range(m):
                        firsts[n_near], seconds[n_near] = a, near[k]
                        n_near += marks[k]
                a += 1
            for k in range(keep_near(halves, n_near, touching**2, firsts, seconds)):
                c, d = firsts[k], seconds[k]
                d2 = pair_squared(segments, c, d)
                first[n], second[n], borderline[n] = c, d, d2 >= limit - band
                n += outlined | (d2 < limit + band)
    return n, p


@kernel
def keep_outlined(n, owner, segments, limits, first, second, borderline):
    """Test the first n candidate pairs, and keep those whose outlines collide, in place; return their number."""
    m = 0
    limit, band = squared_limit(limits), limits.band
    for k in range(n):
        a, b = first[k], second[k]
        d2 = outlined_squared(segments, a, b, limits, owner[a], owner[b])
        first[m], second[m], borderline[m] = a, b, d2 >= limit - band
        m += d2 < limit + band
    return m


@kernel
def adjacency(first, second, indptr, excluded):
    """Write each pair (a, b) to compressed rows twice: b to the row of a, and a to the row of b."""
    indptr[:] = 0
    for k in range(first.size):
        indptr[first[k] + 1] += 1
        indptr[second[k] + 1] += 1
    for a in range(indptr.size - 1):
        indptr[a + 1] += indptr[a]
    fill = indptr[:-1].copy()
    for k in range(first.size):
        a, b = first[k], second[k]
        excluded[fill[a]] = b
        fill[a] += 1
        excluded[fill[b]] = a
        fill[b] += 1


@kernel
def grow_cliques(owner, indptr, excluded, first, covered, row_start, out, most_work):
    """Cover conflicts of candidates with maximal cliques, beginning with the conflicts of candidate ``first``.

    The row of candidate a in ``indptr`` and ``excluded`` lists the candidates of other positioners that a excludes. A
    clique is made from a conflict that no earlier clique contains. The candidate with the most conflicts with members
    of the clique that no clique contains is added, until no candidate excludes all members. ``covered`` marks the
    conflicts that a clique contains. The function ends when ``row_start`` or ``out`` is full or after about
    ``most_work`` steps. Returns the first candidate whose conflicts are not yet covered, and the number of cliques.
    """
    n = owner.size
    # an element of ``stamp`` that equals ``serial`` is marked; a new serial number removes all marks
    pool, gain, stamp = np.empty(n, np.int64), np.zeros(n, np.int64), np.zeros(n, np.int64)
    rows = work = serial = 0
    for a in range(first, n):
        for k in range(indptr[a], indptr[a + 1]):
            if covered[k]:
                continue
            lo = row_start[rows]
            if rows == row_start.size - 1 or lo + n > out.size or work > most_work:
                return a, rows
            serial += 1
            m = 0
            for c in (a, excluded[k]):
                for q in range(indptr[c], indptr[c + 1]):
                    d = excluded[q]
                    if stamp[d] != serial and d != a and d != excluded[k]:
                        pool[m], stamp[d], gain[d] = d, serial, 0
                        m += 1
            c, hi = a, lo
            while c >= 0:
                out[hi] = c
                hi += 1
                serial += 1
                for q in range(indptr[c], indptr[c + 1]):
                    stamp[excluded[q]] = serial
                    gain[excluded[q]] += not covered[q]
                work += indptr[c + 1] - indptr[c] + m
                kept, best, most = 0, -1, 0
                for p in range(m):
                    d = pool[p]
                    # candidates of one positioner exclude each other as well
                    if d != c and (stamp[d] == serial or owner[d] == owner[c]):
                        pool[kept] = d
                        kept += 1
                        n_d = indptr[d + 1] - indptr[d]
                        if best < 0 or gain[d] > gain[best] or (gain[d] == gain[best] and n_d > most):
                            best, most = d, n_d
                m = kept
                c = excluded[k] if hi == lo + 1 else best
            serial += 1
            for p in range(lo, hi):
                stamp[out[p]] = serial
            for p in range(lo, hi):
                for q in range(indptr[out[p]], indptr[out[p] + 1]):
                    covered[q] |= stamp[excluded[q]] == serial
            out[lo:hi].sort()
            rows += 1
            row_start[rows] = hi
    return n, rows


@kernel
def dominates(a, b, i, alive, options, mark):
    """Return whether candidate b excludes all candidates that candidate a of the same positioner i excludes.

    ``mark[c]`` must equal b for each candidate c that collides with b. Candidates that are not ``alive`` are ignored.
    """
    owner, target, t_indptr, t_candidate = options.owner, options.target, options.t_indptr, options.t_candidate
    indptr, excluded = options.indptr, options.excluded
    for k in range(indptr[a], indptr[a + 1]):
        if alive[excluded[k]] and mark[excluded[k]] != b:
            return False
    if target[a] >= 0 and target[a] != target[b]:
        for k in range(t_indptr[target[a]], t_indptr[target[a] + 1]):
            c = t_candidate[k]
            if alive[c] and owner[c] != i and mark[c] != b:
                return False
    return True


@kernel
def enqueue(i, waiting, queue, tail):
    """Append a positioner to the queue unless the queue already contains it, and return the end of the queue."""
    if not waiting[i]:
        waiting[i] = True
        queue[tail % queue.size] = i
        tail += 1
    return tail


@kernel
def reduce_some(options, alive, queue, waiting, ends, mark, removed, most_work):
    """Set ``alive`` to False for the candidates that an optimal plan does not need.

    A candidate b is not needed if another candidate a of its positioner is at least as good, and if b excludes all
    candidates that a excludes. If only one candidate of a positioner remains, this candidate is in use, and all
    candidates that it excludes are removed.

    ``queue`` is a ring buffer of the positioners for which ``waiting`` is true; ``ends`` contains its beginning and
    end. ``mark`` and ``removed`` are work arrays; on input, all elements of ``mark`` must be -1. The function ends
    after about ``most_work`` comparisons; the next call continues the reduction. ``alive`` is valid after each call.
    """
    start, owner, target, rank, cost = options.start, options.owner, options.target, options.rank, options.cost
    key, as_good, t_indptr, t_candidate = options.key, options.as_good, options.t_indptr, options.t_candidate
    indptr, excluded = options.indptr, options.excluded
    n = start.size - 1
    head, tail = ends[0], ends[1]
    work = 0
    while head < tail and work < most_work:
        i = queue[head % n]
        head += 1
        waiting[i] = False
        n_removed = left = 0
        last = -1
        for b in range(start[i], start[i + 1]):
            if not alive[b]:
                continue
            work += indptr[b + 1] - indptr[b]
            for k in range(indptr[b], indptr[b + 1]):
                mark[excluded[k]] = b
            for a in range(start[i], start[i + 1]):
                if a == b or not alive[a] or rank[a] > rank[b] or not as_good[key[a], key[b]]:
                    continue
                if rank[a] == rank[b] and cost[a] > cost[b]:
                    continue
                work += 4 + (indptr[a + 1] - indptr[a]) // 4
                if dominates(a, b, i, alive, options, mark):
                    alive[b] = False
                    removed[n_removed] = b
                    n_removed += 1
                    break
            if alive[b]:
                left += 1
                last = b
        if left == 1:
            for k in range(indptr[last], indptr[last + 1]):
                if alive[excluded[k]]:
                    alive[excluded[k]] = False
                    removed[n_removed] = excluded[k]
                    n_removed += 1
            if target[last] >= 0:
                for k in range(t_indptr[target[last]], t_indptr[target[last] + 1]):
                    c = t_candidate[k]
                    if alive[c] and owner[c] != i:
                        alive[c] = False
                        removed[n_removed] = c
                        n_removed += 1
        # Repeat the test for each positioner with a candidate that was removed or that a removed candidate excluded.
        for m in range(n_removed):
            c = removed[m]
            tail = enqueue(owner[c], waiting, queue, tail)
            for k in range(indptr[c], indptr[c + 1]):
                tail = enqueue(owner[excluded[k]], waiting, queue, tail)
            if target[c] >= 0:
                for k in range(t_indptr[target[c]], t_indptr[target[c] + 1]):
                    tail = enqueue(owner[t_candidate[k]], waiting, queue, tail)
    ends[0], ends[1] = head, tail
