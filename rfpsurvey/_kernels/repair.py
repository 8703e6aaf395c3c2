"""Local moves that remove collisions: change the target or elbow side, move one blocking arm, or remove the target.

A candidate is an assignment that a plan may use: a positioner with a target and an elbow, or with its idle arm.
"""

import numpy as np

from rfpsurvey._kernels.jit import kernel

# If arguments were literal integers, numba would compile `put` and `displace` a second time.
NONE, NO, YES = np.int64(-1), np.int64(0), np.int64(1)


@kernel
def put(i, c, options, chosen, blocked, holder):
    """Assign candidate c to positioner i (no candidate if c = -1), and update ``chosen``, ``blocked`` and ``holder``.

    ``blocked`` is the number of candidates in use that collide with each candidate, and ``holder`` is the positioner of
    each target.
    """
    indptr, excluded, target = options.indptr, options.excluded, options.target
    old = chosen[i]
    if old >= 0:
        for k in range(indptr[old], indptr[old + 1]):
            blocked[excluded[k]] -= 1
        if target[old] >= 0 and holder[target[old]] == i:
            holder[target[old]] = -1
    chosen[i] = c
    if c >= 0:
        for k in range(indptr[c], indptr[c + 1]):
            blocked[excluded[k]] += 1
        if target[c] >= 0:
            holder[target[c]] = i


@kernel
def put_all(plan, options, n_targets):
    """Return the state of a plan: its copy, ``blocked`` and ``holder``."""
    # a call of `put` for each positioner would take longer, because all arrays of ``options`` are passed to it
    indptr, excluded, target = options.indptr, options.excluded, options.target
    blocked, holder = np.zeros(target.size, np.int64), np.full(n_targets, -1)
    for i in range(plan.size):
        c = plan[i]
        if c >= 0:
            for k in range(indptr[c], indptr[c + 1]):
                blocked[excluded[k]] += 1
            if target[c] >= 0:
                holder[target[c]] = i
    return plan.copy(), blocked, holder


@kernel
def best_free(i, least, options, chosen, blocked, holder):
    """Return the best unblocked candidate of positioner i, or -1 if there is none.

    Only candidates that are at least as good as the candidate ``least`` are considered.
    """
    target, rank, cost, key, as_good = options.target, options.rank, options.cost, options.key, options.as_good
    best = -1
    for c in range(options.start[i], options.start[i + 1]):
        if blocked[c] > 0 or (target[c] >= 0 and holder[target[c]] >= 0 and holder[target[c]] != i):
            continue
        if rank[c] > rank[least] or not as_good[key[c], key[least]]:
            continue
        if best < 0 or rank[c] < rank[best] or (rank[c] == rank[best] and cost[c] < cost[best]):
            best = c
    return best


@kernel
def sole_blocker(c, i, options, chosen, holder):
    """Return the only positioner that blocks candidate c of positioner i; -1 if there is none, -2 if several do."""
    blocker = -1
    if options.target[c] >= 0 and holder[options.target[c]] >= 0 and holder[options.target[c]] != i:
        blocker = holder[options.target[c]]
    for k in range(options.indptr[c], options.indptr[c + 1]):
        d = options.excluded[k]
        j = options.owner[d]
        if chosen[j] == d and j != blocker:
            if blocker >= 0:
                return -2
            blocker = j
    return blocker


@kernel
def displace(i, floor, better, options, chosen, blocked, holder):
    """Give positioner i a candidate that exactly one other positioner blocks, and move the blocking positioner.

    The new candidate of i must be at least as good as the candidate ``floor``; with ``better=1``, it must also be of a
    more important class. The blocking positioner receives a candidate that is at least as good as its present
    candidate. Returns whether the positioners were moved.
    """
    rank, key, as_good = options.rank, options.key, options.as_good
    mine = chosen[i]
    for c in range(options.start[i], options.start[i + 1]):
        if c == mine or options.target[c] < 0:
            continue
        if rank[c] > rank[floor] - better or not as_good[key[c], key[floor]]:
            continue
        j = sole_blocker(c, i, options, chosen, holder)
        if j < 0:
            continue
        theirs = chosen[j]
        put(j, NONE, options, chosen, blocked, holder)
        put(i, c, options, chosen, blocked, holder)
        d = best_free(j, theirs, options, chosen, blocked, holder)
        if d >= 0 and blocked[c] == 0:
            put(j, d, options, chosen, blocked, holder)
            return True
        put(i, mine, options, chosen, blocked, holder)
        put(j, theirs, options, chosen, blocked, holder)
    return False


@kernel
def give_up_target(i, options, chosen, blocked, holder, fixed):
    """Assign the best unblocked candidate to positioner i; if there is none, assign its idle arm and set ``fixed``."""
    idle = options.start[i + 1] - 1
    c = best_free(i, idle, options, chosen, blocked, holder)
    if c < 0:
        c = idle
        fixed[i] = True
    put(i, c, options, chosen, blocked, holder)


@kernel
def fill_group(order, need, group, held, count, most, options, chosen, blocked, holder):
    """Assign candidates of one group to positioners in the given order, until ``need`` candidates are assigned.

    A group consists of the candidates that count toward one requirement. ``held[g, c]`` is True if candidate c belongs
    to group g. ``count[g]`` is the number of candidates of group g in use, and ``most[g]`` is the largest allowed
    number of such candidates.
    """
    for i in order:
        if need <= 0:
            break
        now = chosen[i]
        for c in range(options.start[i], options.start[i + 1]):
            t = options.target[c]
            if not held[group, c] or blocked[c] > 0 or (t >= 0 and holder[t] >= 0):
                continue
            full = False
            for g in range(count.size):
                full |= held[g, c] and not held[g, now] and count[g] >= most[g]
            if full:
                continue
            for g in range(count.size):
                count[g] += int(held[g, c]) - int(held[g, now])
            put(i, c, options, chosen, blocked, holder)
            need -= 1
            break


@kernel
def settle(options, order, fixed, chosen, blocked, holder):
    """Move colliding positioners to collision-free candidates that are at least as good.

    ``order`` lists the positioners in the order in which they move, except those marked in ``fixed``.
    """
    for i in order:
        if fixed[i] or blocked[chosen[i]] == 0:
            continue
        c = best_free(i, chosen[i], options, chosen, blocked, holder)
        if c >= 0:
            put(i, c, options, chosen, blocked, holder)
        else:
            displace(i, chosen[i], NO, options, chosen, blocked, holder)


@kernel
def drop(options, order, fixed, chosen, blocked, holder):
    """Remove targets from positioners, in place, until no arms collide.

    The positioner that collides with the most arms loses its target first. In a tie, the positioner that is earlier in
    ``order`` loses its target first.
    """
    while True:
        most = 0
        for i in order:
            if not fixed[i]:
                most = max(most, blocked[chosen[i]])
        if most == 0:
            return
        for i in order:
            if fixed[i] or blocked[chosen[i]] != most:
                continue
            give_up_target(i, options, chosen, blocked, holder, fixed)
            if fixed[i]:  # the idle arm of this positioner collides, so that other positioners collide with more arms
                break


@kernel
def gain(options, order, chosen, blocked, holder):
    """Replace targets by more important targets, for the positioners in ``order``; return whether the plan changed."""
    start, rank = options.start, options.rank
    changed = False
    for i in order:
        better = False
        for c in range(start[i], start[i + 1]):
            better |= rank[c] < rank[chosen[i]]
        if not better or blocked[chosen[i]] > 0:
            continue
        c = best_free(i, chosen[i], options, chosen, blocked, holder)
        if c >= 0 and rank[c] < rank[chosen[i]]:
            put(i, c, options, chosen, blocked, holder)
            changed = True
        elif displace(i, chosen[i], YES, options, chosen, blocked, holder):
            changed = True
    return changed
