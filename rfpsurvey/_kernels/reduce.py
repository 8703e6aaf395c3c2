"""Remove candidates that an optimal plan does not need; if a positioner has one candidate left, use this candidate.

A candidate is a positioner with one target and one elbow position, or a positioner without a target. A candidate
excludes all candidates with which its arm would collide, and all candidates of the same target.
"""

from rfpsurvey._jit import kernel


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
