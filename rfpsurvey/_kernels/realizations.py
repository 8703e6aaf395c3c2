"""Assignments, lost targets and visits in many realizations of a tile, which differ only in the order of targets.

All realizations share the reachable pairs of targets and positioners, and the segment of the arm of each pair. A
realization is a row of ``chosen``, which contains the index of the pair that each positioner uses, or -1. Bit r of a
mask stands for realization r of at most 32 realizations.
"""

import numpy as np

from rfpsurvey._jit import kernel
from rfpsurvey._kernels import allocation
from rfpsurvey._kernels.allocation import nominate, precedes
from rfpsurvey._kernels.batch import mark_colliding
from rfpsurvey._kernels.hashing import mix

# Largest number of realizations in one call.
MOST = 32


@kernel
def find_lost(chosen, segments, idle, setup, obstacle_slack, workspace, lost, uncertain):
    """Mark the positioners that have a target and collide, in each realization.

    ``segments`` contains, for each pair, the segment of the arm that can collide; ``idle`` contains the segments of
    the idle arms. ``uncertain`` marks realizations in which rounding could change the result.
    """
    lost[:] = False
    n = chosen.shape[1]
    for r in range(chosen.shape[0]):
        uncertain[r] = False
        assigned = False
        for i in range(n):
            k = chosen[r, i]
            assigned |= k >= 0
            for row in range(4):
                workspace.segments[row, i] = segments[row, k] if k >= 0 else idle[row, i]
        if not assigned:
            continue
        uncertain[r] = mark_colliding(setup, workspace, obstacle_slack)[2] > 0
        for i in range(n):
            lost[r, i] = workspace.colliding[i] and chosen[r, i] >= 0


@kernel
def mark_visits(chosen, lost, target, mask, counts):
    """Set bit r of ``mask`` for each target that is visited in realization r, and count assigned and lost targets.

    ``target`` contains the target of each pair. The columns of ``counts`` are the number of positioners with a target,
    and the number of targets lost to collisions.
    """
    mask[:] = 0
    counts[:] = 0
    for r in range(chosen.shape[0]):
        bit = np.uint32(1) << np.uint32(r)
        for i in range(chosen.shape[1]):
            k = chosen[r, i]
            if k >= 0:
                counts[r, 0] += 1
                if lost[r, i]:
                    counts[r, 1] += 1
                else:
                    mask[target[k]] |= bit


@kernel
def take_left(left, slot, out):
    """Copy the numbers of remaining visits of the targets of a field, for all realizations.

    Row ``slot[f]`` of ``left`` belongs to target f of the field.
    """
    for f in range(slot.size):
        for r in range(left.shape[1]):
            out[f, r] = left[slot[f], r]


@kernel
def record_visits(mask, slot, spends, left, is_open, observed):
    """Subtract the visits of a tile from the remaining visits, and count the visits of each realization.

    ``mask`` contains the visits of the tile; row ``slot[f]`` of ``left`` belongs to target f of the tile. ``spends``
    states whether a visit to a target reduces its remaining visits; visits to all other targets are ignored.
    ``is_open`` marks targets with remaining visits in at least one realization.
    """
    n = left.shape[1]
    for f in range(slot.size):
        s = slot[f]
        if mask[f] != 0 and spends[s]:
            rest = False
            for r in range(n):
                done = (mask[f] >> np.uint32(r)) & np.uint32(1)
                left[s, r] -= np.uint8(done)
                observed[r] += np.int64(done)
                rest |= left[s, r] > 0
            is_open[s] = rest


@kernel
def to_masks(left, wanted, spends, mask):
    """Set bit r of the mask of each target that has received at least one visit in realization r.

    ``wanted`` and ``left`` are the numbers of requested and of remaining visits of each target. ``spends`` states
    whether visits reduce the remaining visits of a target; otherwise, the mask of the target is 0.
    """
    for s in range(left.shape[0]):
        found = np.uint32(0)
        if spends[s]:
            for r in range(left.shape[1]):
                found |= np.uint32(left[s, r] < wanted[s]) << np.uint32(r)
        mask[s] = found


@kernel
def set_order(number, seed, order):
    """Compute the subpriorities of all targets for one seed, as 53-bit integers; larger values have precedence."""
    mixed = mix(seed)
    for t in range(number.size):
        order[t] = mix(number[t] ^ mixed) >> np.uint64(11)


@kernel
def nearest(indptr, owner, r2, closest, rank, number, seeds, left, chosen):
    """Assign targets by class, then by subpriority; each target is assigned to its closest free positioner.

    ``closest`` contains the pairs of each target, sorted by `sort_by_distance`.
    """
    n = indptr.size - 1
    order, cursor = np.empty(n, np.uint64), np.empty(n, np.int64)
    target_of = np.empty(chosen.shape[1], np.int64)
    for r in range(chosen.shape[0]):
        set_order(number, seeds[r], order)
        for t in range(n):
            cursor[t] = indptr[t] if left[t, r] > 0 else indptr[t + 1]
        allocation.nearest(indptr, owner, r2, closest, rank, order, number, False, cursor, target_of, chosen[r])


@kernel
def list_first(indptr, owner, r2, rank, order, number, left, realization, start, count, target, out_r2, in_reach):
    """List the first targets of each positioner, sorted by class, then by subpriority (in the order of `precedes`).

    Only targets that require a visit in the realization are listed, and their number is written to ``in_reach``. At
    most ``start[i + 1] - start[i]`` targets of positioner i are stored, beginning at the index ``start[i]``. The number
    of stored targets is written to ``count[i]``.
    """
    count[:] = 0
    in_reach[:] = 0
    for t in range(indptr.size - 1):
        if left[t, realization] == 0:
            continue
        for k in range(indptr[t], indptr[t + 1]):
            i = owner[k]
            in_reach[i] += 1
            first = start[i]
            m = first + count[i]
            if m == start[i + 1]:
                if m == first or precedes(rank, order, number, target[m - 1], t):
                    continue
                m -= 1
            else:
                count[i] += 1
            while m > first and precedes(rank, order, number, t, target[m - 1]):
                target[m], out_r2[m] = target[m - 1], out_r2[m - 1]
                m -= 1
            target[m], out_r2[m] = t, r2[k]


@kernel
def pair_of(indptr, owner, t, i):
    """Return the index of the pair of a target and a positioner."""
    k = indptr[t]
    while owner[k] != i:
        k += 1
    return k


@kernel
def lamost_rule(indptr, owner, r2, rank, n_ranks, number, seeds, left, start, chosen):
    """Assign targets by nominations; each positioner nominates its target with the largest subpriority.

    ``start`` contains the index at which the list of targets of each positioner begins. The list of a positioner may be
    shortened, but it must be long enough that at least one target remains if every other positioner that reaches
    targets of the list takes one of them.
    """
    n, m = indptr.size - 1, chosen.shape[1]
    order, t_indptr, t_owner = np.empty(n, np.uint64), np.empty(n + 1, np.int64), np.empty(owner.size, np.int64)
    target, list_r2 = np.empty(start[m], np.int64), np.empty(start[m])
    count, in_reach = np.empty(m, np.int64), np.empty(m, np.int64)
    c_indptr, c_target, c_r2 = np.empty(m + 1, np.int64), np.empty(start[m], np.int64), np.empty(start[m])
    nominee_of, nominee_r2, cursor = np.empty(n, np.int64), np.empty(n), np.empty(m, np.int64)
    target_of, positioner_of = np.empty(m, np.int64), np.empty(n, np.int64)
    for r in range(chosen.shape[0]):
        set_order(number, seeds[r], order)
        list_first(indptr, owner, r2, rank, order, number, left, r, start, count, target, list_r2, in_reach)
        c_indptr[0] = 0
        for i in range(m):  # the lists follow each other without gaps
            c_indptr[i + 1] = c_indptr[i] + count[i]
            for k in range(count[i]):
                c_target[c_indptr[i] + k], c_r2[c_indptr[i] + k] = target[start[i] + k], list_r2[start[i] + k]
        n_open = 0
        for t in range(n):
            t_indptr[t] = n_open
            if left[t, r] > 0:
                for k in range(indptr[t], indptr[t + 1]):
                    t_owner[n_open] = owner[k]
                    n_open += 1
        t_indptr[n] = n_open
        nominate(
            c_indptr,
            c_target,
            c_r2,
            rank,
            n_ranks,
            t_indptr,
            t_owner,
            in_reach,
            nominee_of,
            nominee_r2,
            cursor,
            target_of,
            positioner_of,
        )
        for i in range(m):
            chosen[r, i] = pair_of(indptr, owner, target_of[i], i) if target_of[i] >= 0 else -1


@kernel
def balanced(indptr, owner, r2, number, seeds, left, uniform, chosen):
    """Add each target, in the order of subpriority, to the shortest queue in reach; then draw one target of each queue.

    ``uniform`` contains a number in [0, 1) for each realization and positioner.
    """
    n, m = indptr.size - 1, chosen.shape[1]
    order, queue_of = np.empty(n, np.uint64), np.empty(n, np.int64)
    count, pick = np.empty(m, np.int64), np.empty(m, np.int64)
    for r in range(chosen.shape[0]):
        set_order(number, seeds[r], order)
        for t in range(n):
            order[t] = ~order[t]  # because argsort sorts in ascending order
        first = np.argsort(order, kind="mergesort")
        for k in range(1, n):  # targets of equal subpriority are sorted by ``number``
            j = k
            while j > 0 and order[first[j - 1]] == order[first[j]] and number[first[j - 1]] > number[first[j]]:
                first[j - 1], first[j] = first[j], first[j - 1]
                j -= 1
        count[:] = 0
        chosen[r, :] = -1
        for t in first:
            best = -1
            if left[t, r] > 0:
                for k in range(indptr[t], indptr[t + 1]):
                    if best < 0 or (
                        count[owner[k]] < count[owner[best]]
                        or (count[owner[k]] == count[owner[best]] and r2[k] < r2[best])
                    ):
                        best = k  # in a tie, the first pair is used, whose positioner has the lowest index
            queue_of[t] = best
            if best >= 0:
                count[owner[best]] += 1
        for i in range(m):
            pick[i] = min(int(uniform[r, i] * count[i]), count[i] - 1)
        count[:] = 0
        for t in first:
            k = queue_of[t]
            if k >= 0:
                if count[owner[k]] == pick[owner[k]]:
                    chosen[r, owner[k]] = k
                count[owner[k]] += 1
