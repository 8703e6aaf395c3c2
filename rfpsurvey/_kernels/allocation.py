"""Allocation rules on reachable pairs in CSR form."""

from rfpsurvey._jit import kernel


@kernel
def balanced(indptr, owner, r2, count, positioner_of_target):
    """Give each target, in catalog order, to the shortest queue, then the nearest, then the lowest index."""
    count[:] = 0
    for t in range(indptr.size - 1):
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
def fill_queues(positioner_of_target, count, indptr, queue):
    """Lay the queues out one after the other, each in catalog order."""
    indptr[0] = 0
    for i in range(count.size):
        indptr[i + 1] = indptr[i] + count[i]
    fill = indptr[:-1].copy()
    for t in range(positioner_of_target.size):
        i = positioner_of_target[t]
        if i >= 0:
            queue[fill[i]] = t
            fill[i] += 1


@kernel
def draw_configuration(indptr, queue, uniform, target_of_positioner):
    """Take one target from each queue that has any, by one uniform number in [0, 1) a positioner."""
    for i in range(indptr.size - 1):
        n = indptr[i + 1] - indptr[i]
        target_of_positioner[i] = -1
        if n > 0:
            target_of_positioner[i] = queue[indptr[i] + min(int(uniform[i] * n), n - 1)]


@kernel
def sort_candidates(indptr, target, r2, rank):
    """Sort each positioner's candidates by class (rank 0 first), then distance, then catalog order."""
    for i in range(indptr.size - 1):
        for k in range(indptr[i] + 1, indptr[i + 1]):
            t, d = target[k], r2[k]
            m = k
            while m > indptr[i]:
                s = target[m - 1]
                if rank[s] < rank[t] or (rank[s] == rank[t] and (r2[m - 1] < d or (r2[m - 1] == d and s <= t))):
                    break
                target[m], r2[m] = target[m - 1], r2[m - 1]
                m -= 1
            target[m], r2[m] = t, d


@kernel
def nominate(
    indptr,
    target,
    r2,
    rank,
    n_ranks,
    t_indptr,
    t_owner,
    free_reach,
    nominee_of,
    nominee_r2,
    cursor,
    target_of_positioner,
    positioner_of_target,
):
    """LAMOST's rounds of nomination, class after class.

    Every free positioner nominates its nearest unassigned target of the class; a target nominated by several
    goes to the one with the fewest unassigned targets in reach, then the nearest, then the lowest index.
    """
    n = indptr.size - 1
    for i in range(n):
        target_of_positioner[i] = -1
        cursor[i] = indptr[i]
        free_reach[i] = indptr[i + 1] - indptr[i]
    for t in range(positioner_of_target.size):
        positioner_of_target[t] = -1
        nominee_of[t] = -1
    c = 0
    while c < n_ranks:
        upcoming = n_ranks
        nominated = True
        while nominated:
            nominated = False
            upcoming = n_ranks
            for i in range(n):
                if target_of_positioner[i] >= 0:
                    continue
                k = cursor[i]
                while k < indptr[i + 1] and (
                    rank[target[k]] < c or (rank[target[k]] == c and positioner_of_target[target[k]] >= 0)
                ):
                    k += 1
                cursor[i] = k
                if k == indptr[i + 1]:
                    continue
                if rank[target[k]] != c:
                    upcoming = min(upcoming, rank[target[k]])
                    continue
                nominated = True
                t = target[k]
                rival = nominee_of[t]
                # a later positioner wins only if it is strictly better: ties go to the lowest index
                if (
                    rival < 0
                    or free_reach[i] < free_reach[rival]
                    or (free_reach[i] == free_reach[rival] and r2[k] < nominee_r2[t])
                ):
                    nominee_of[t] = i
                    nominee_r2[t] = r2[k]
            for i in range(n):
                k = cursor[i]
                if target_of_positioner[i] >= 0 or k == indptr[i + 1] or nominee_of[target[k]] != i:
                    continue
                t = target[k]
                if rank[t] != c or positioner_of_target[t] >= 0:
                    continue
                target_of_positioner[i] = t
                positioner_of_target[t] = i
                for m in range(t_indptr[t], t_indptr[t + 1]):
                    free_reach[t_owner[m]] -= 1
        c = upcoming  # the next class that any free positioner can see
