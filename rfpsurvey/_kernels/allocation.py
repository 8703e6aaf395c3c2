"""Allocators whose input is a list of pairs of a positioner and a target in its reach, as compressed rows (CSR).

If the pairs are sorted by target, the positioners that reach target t are ``owner[indptr[t]:indptr[t + 1]]``. If the
pairs are sorted by positioner, the targets in reach of positioner i are ``target[indptr[i]:indptr[i + 1]]``. ``r2``
contains the squared distance of the target from the center of the positioner, for each pair.
"""

import numpy as np

from rfpsurvey._kernels.jit import inlined_kernel, kernel

# A number that is larger than the rank of any priority class.
MOST = 2**62


@kernel
def balanced(indptr, owner, r2, targets, count, positioner_of_target):
    """Add each of the given targets, in this order, to the shortest queue among the positioners that reach it.

    The queue of a positioner is a list of targets, from which one target is drawn later. If several queues are equally
    short, the target is added to the queue of the nearest of these positioners or, in a tie, of the positioner with the
    lowest index.
    """
    count[:] = 0
    for t in targets:
        best = -1
        best_r2 = 0.0
        for k in range(indptr[t], indptr[t + 1]):
            i = owner[k]
            if (
                best < 0
                or count[i] < count[best]
                or (count[i] == count[best] and (r2[k] < best_r2 or (r2[k] == best_r2 and i < best)))
            ):
                best = i
                best_r2 = r2[k]
        positioner_of_target[t] = best
        if best >= 0:
            count[best] += 1


@kernel
def fill_queues(positioner_of_target, targets, count, indptr, queue):
    """List the targets of all queues, one positioner after the other, in the given order within each queue."""
    indptr[0] = 0
    for i in range(count.size):
        indptr[i + 1] = indptr[i] + count[i]
    fill = indptr[:-1].copy()
    for t in targets:
        i = positioner_of_target[t]
        if i >= 0:
            queue[fill[i]] = t
            fill[i] += 1


@kernel
def draw_places(indptr, uniform, place):
    """Draw a place in each queue: an index from ``indptr[i]`` to ``indptr[i + 1] - 1``, or -1 if the queue is empty.

    ``uniform`` contains a random number for each configuration and positioner.
    """
    for c in range(uniform.shape[0]):
        for i in range(uniform.shape[1]):
            n = indptr[i + 1] - indptr[i]
            place[c, i] = indptr[i] + min(int(uniform[c, i] * n), n - 1) if n > 0 else -1


@inlined_kernel
def precedes(rank, order, number, by_distance, s, s_r2, t, t_r2):
    """Return whether target s precedes target t in the order in which targets are assigned.

    The order is by class; then, if ``by_distance`` is true, by the squared distance from the positioner; then by
    subpriority, then by the integer that represents the identifier, then by row.
    """
    if rank[s] != rank[t]:
        return rank[s] < rank[t]
    if by_distance and s_r2 != t_r2:
        return s_r2 < t_r2
    if order[s] != order[t]:
        return order[s] > order[t]
    return number[s] < number[t] or (number[s] == number[t] and s < t)


@kernel
def list_best(indptr, owner, r2, rank, order, number, by_distance, is_open, start):
    """List the first targets of each positioner, sorted in the order of `precedes`.

    The input lists the positioners that reach each target. Only targets marked in ``is_open`` are listed. At most
    ``start[i + 1] - start[i]`` targets of positioner i are stored, beginning at the index ``start[i]``. Return the
    number of stored targets of each positioner, the targets, their squared distances, and the number of open targets in
    reach of each positioner.
    """
    n = start.size - 1
    count, in_reach = np.zeros(n, np.int64), np.zeros(n, np.int64)
    target, out_r2 = np.empty(start[n], np.int64), np.empty(start[n])
    for t in range(indptr.size - 1):
        if not is_open[t]:
            continue
        for k in range(indptr[t], indptr[t + 1]):
            i, d = owner[k], r2[k]
            in_reach[i] += 1
            first = start[i]
            m = first + count[i]
            if m == start[i + 1]:
                m -= 1
                if m < first or precedes(rank, order, number, by_distance, target[m], out_r2[m], t, d):
                    continue
            else:
                count[i] += 1
            while m > first and precedes(rank, order, number, by_distance, t, d, target[m - 1], out_r2[m - 1]):
                target[m], out_r2[m] = target[m - 1], out_r2[m - 1]
                m -= 1
            target[m], out_r2[m] = t, d
    return count, target, out_r2, in_reach


@kernel
def select_pairs(indptr, owner, r2, rank, code, n_codes, start, n_spread, wanted, keep, shortened):
    """Mark the pairs to keep: the best targets of each positioner and code, and a sample of the other targets.

    Targets that count toward the same requirements have the same code. The input lists the positioners that reach each
    target. Each combination of a positioner i and a code is a cell with the index ``cell = i * n_codes + code``. The
    targets of a cell are sorted by rank, then distance, then catalog order, and the first
    ``start[cell + 1] - start[cell]`` targets are kept. Of the remaining targets that have the same rank as the last
    kept target, ``n_spread`` targets at regular intervals in catalog order are also kept. The target ``wanted[i]`` of
    positioner i is always kept. ``shortened`` marks the cells from which some targets were omitted. Returns the number
    of pairs that are kept.
    """
    n_cells = start.size - 1
    best, place = np.empty(start[n_cells], np.int64), np.empty(start[n_cells], np.int64)
    end = start[:-1].copy()
    # For each full cell (with the largest allowed number of targets), the rank and the distance of its last target.
    cut, far = np.full(n_cells, MOST, np.int64), np.full(n_cells, np.inf)
    for t in range(indptr.size - 1):
        c = rank[t]
        for k in range(indptr[t], indptr[t + 1]):
            cell = owner[k] * n_codes + code[t]
            keep[k] = False
            if cut[cell] < c or (cut[cell] == c and far[cell] <= r2[k]):
                continue
            first, m = start[cell], end[cell]
            if m == start[cell + 1]:
                m -= 1
                keep[best[m]] = False
            else:
                end[cell] += 1
            while m > first and (rank[place[m - 1]] > c or (rank[place[m - 1]] == c and r2[best[m - 1]] > r2[k])):
                best[m], place[m] = best[m - 1], place[m - 1]
                m -= 1
            best[m], place[m] = k, t
            keep[k] = True
            if end[cell] == start[cell + 1]:
                cut[cell], far[cell] = rank[place[end[cell] - 1]], r2[best[end[cell] - 1]]
    left, seen = np.zeros(n_cells, np.int64), np.zeros(n_cells, np.int64)
    if n_spread > 0:
        for t in range(indptr.size - 1):
            for k in range(indptr[t], indptr[t + 1]):
                cell = owner[k] * n_codes + code[t]
                left[cell] += (not keep[k]) & (rank[t] == cut[cell])
    due, taken = np.zeros(n_cells, np.int64), np.zeros(n_cells, np.int64)
    n_kept = 0
    shortened[:] = False
    for t in range(indptr.size - 1):
        for k in range(indptr[t], indptr[t + 1]):
            if not keep[k]:
                cell = owner[k] * n_codes + code[t]
                keep[k] = wanted[owner[k]] == t
                if left[cell] > 0 and rank[t] == cut[cell]:
                    if seen[cell] == due[cell]:
                        keep[k] = True
                        taken[cell] += 1
                        due[cell] = max(taken[cell] * left[cell] // n_spread, seen[cell] + 1)
                    seen[cell] += 1
                shortened[cell] |= not keep[k]
            n_kept += keep[k]
    return n_kept


@kernel
def nominate(start, count, target, r2, rank, indptr, owner, free_reach):
    """Assign the targets of one priority class after the other, in rounds of nominations (the method of LAMOST).

    Every free positioner nominates its nearest unassigned target of the class. If several positioners nominate a
    target, it is assigned to the positioner with the fewest unassigned targets in reach; ties are decided by the
    distance, then by the index of the positioner. ``free_reach`` must be the number of targets in reach of each
    positioner, even if the list of candidates does not contain all of these targets. The candidates of positioner i
    have the indices from ``start[i]`` up to, but not including, ``start[i] + count[i]``. Return the target of each
    positioner.
    """
    n, cursor = count.size, start[:-1].copy()
    target_of_positioner, positioner_of_target = np.full(n, -1), np.full(rank.size, -1)
    nominee_of, nominee_r2 = np.full(rank.size, -1), np.empty(rank.size)
    c = 0
    while c < MOST:
        upcoming = MOST
        nominated = True
        while nominated:
            nominated = False
            upcoming = MOST
            for i in range(n):
                if target_of_positioner[i] >= 0:
                    continue
                k, stop = cursor[i], start[i] + count[i]
                while k < stop and (
                    rank[target[k]] < c or (rank[target[k]] == c and positioner_of_target[target[k]] >= 0)
                ):
                    k += 1
                cursor[i] = k
                if k == stop:
                    continue
                if rank[target[k]] != c:
                    upcoming = min(upcoming, rank[target[k]])
                    continue
                nominated = True
                t = target[k]
                rival = nominee_of[t]
                # In a tie, the positioner with the lowest index is kept, because a later one must be strictly better.
                if (
                    rival < 0
                    or free_reach[i] < free_reach[rival]
                    or (free_reach[i] == free_reach[rival] and r2[k] < nominee_r2[t])
                ):
                    nominee_of[t] = i
                    nominee_r2[t] = r2[k]
            for i in range(n):
                k = cursor[i]
                if target_of_positioner[i] >= 0 or k == start[i] + count[i] or nominee_of[target[k]] != i:
                    continue
                t = target[k]
                if rank[t] != c or positioner_of_target[t] >= 0:
                    continue
                target_of_positioner[i] = t
                positioner_of_target[t] = i
                for m in range(indptr[t], indptr[t + 1]):
                    free_reach[owner[m]] -= 1
        c = upcoming  # the next class with a candidate of a free positioner
    return target_of_positioner


@kernel
def sort_by_distance(indptr, r2):
    """Return the pairs of each target by distance, then by the index of the positioner, with an insertion sort."""
    closest = np.empty(r2.size, np.int64)
    for t in range(indptr.size - 1):
        for k in range(indptr[t], indptr[t + 1]):
            m = k
            while m > indptr[t] and r2[closest[m - 1]] > r2[k]:
                closest[m] = closest[m - 1]
                m -= 1
            closest[m] = k
    return closest


@kernel
def nearest(n, indptr, owner, r2, closest, rank, order, number, by_distance, is_open):
    """Assign each target, in the order of `precedes`, to its closest free one of n positioners; return their targets.

    If ``by_distance`` is true, this means that the closest pair of the first class is assigned first, then the closest
    remaining pair of this class, and so on. ``closest`` contains the pairs of each target, sorted by
    `sort_by_distance`. Only targets marked in ``is_open`` are assigned.

    The method is deferred acceptance. Each target proposes to its positioners in the order of ``closest``, and a
    positioner keeps the best target among the targets that have proposed to it. The result is the same as if the
    targets were assigned one after the other, but they need not be sorted.
    """
    target_of_positioner, pair = np.full(n, -1), np.full(n, -1)
    # the next pair of each target that it may use, as index in ``closest``
    cursor = np.empty(indptr.size - 1, np.int64)
    for t in range(indptr.size - 1):
        cursor[t] = indptr[t] if is_open[t] else indptr[t + 1]
    for first in range(indptr.size - 1):
        t = first
        while t >= 0 and cursor[t] < indptr[t + 1]:
            k = closest[cursor[t]]
            cursor[t] += 1
            i = owner[k]
            s = target_of_positioner[i]
            if s >= 0 and precedes(rank, order, number, by_distance, s, r2[pair[i]], t, r2[k]):
                continue
            target_of_positioner[i], pair[i] = t, k
            t = s
    return target_of_positioner


@kernel
def fill_quota(order, need, indptr, target, r2, wanted, locked, target_of_positioner, positioner_of_target):
    """Assign up to ``need`` of the targets that are marked in ``wanted``.

    Each positioner, in the given order, is assigned to the nearest marked target that is not yet assigned. The previous
    target of the positioner is then no longer assigned. The positioners that were changed are marked in ``locked``.
    """
    for i in order:
        if need <= 0:
            break
        best = -1
        for k in range(indptr[i], indptr[i + 1]):
            t = target[k]
            if wanted[t] and positioner_of_target[t] < 0 and (best < 0 or r2[k] < r2[best]):
                best = k
        if best < 0:
            continue
        if target_of_positioner[i] >= 0:
            positioner_of_target[target_of_positioner[i]] = -1
        target_of_positioner[i] = target[best]
        positioner_of_target[target[best]] = i
        locked[i] = True
        need -= 1


@kernel
def match(order, t_indptr, t_owner, n):
    """Match targets to n positioners in the given order, and return the target of each positioner, or -1.

    A target without an augmenting path is not matched. A matched target may change its positioner, but it remains
    matched. The result is therefore the best matching if matchings are compared lexicographically in the given order
    of the targets.
    """
    target_of_positioner, positioner_of_target = np.full(n, -1), np.full(t_indptr.size - 1, -1)
    # Positioners that a failed search has reached are skipped, because no later augmenting path contains them.
    closed, seen, came_from = np.zeros(n, np.bool_), np.full(n, -1), np.empty(n, np.int64)
    queue = np.empty(n + 1, np.int64)
    for t in order:
        head, tail = 0, 1
        queue[0] = t
        free = -1
        while head < tail and free < 0:
            s = queue[head]
            head += 1
            for k in range(t_indptr[s], t_indptr[s + 1]):
                i = t_owner[k]
                if seen[i] == t or closed[i]:
                    continue
                seen[i] = t
                came_from[i] = s
                if target_of_positioner[i] < 0:
                    free = i
                    break
                queue[tail] = target_of_positioner[i]
                tail += 1
        if free < 0:
            for m in range(1, tail):
                closed[positioner_of_target[queue[m]]] = True
        while free >= 0:
            s = came_from[free]
            before = positioner_of_target[s]
            target_of_positioner[free] = s
            positioner_of_target[s] = free
            free = before if s != t else -1
    return target_of_positioner
