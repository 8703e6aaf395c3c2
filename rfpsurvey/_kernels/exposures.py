"""Plans of several exposures of the same fields: visits of each fiber to each target, and the exposures of the visits.

A *pair* is a fiber of a field and a target in its reach; its *uses* are the exposures in which the fiber observes the
target. Uses change along augmenting paths. If no fiber and no target has more uses than there are exposures, all uses
can be scheduled, as in the edge coloring of a bipartite graph, except those of arms that collide in the same exposure.
"""

from typing import NamedTuple

import numpy as np

from rfpsurvey._kernels.jit import kernel

# Values in a schedule: the fiber is free, or is not available in this exposure.
FREE, CLOSED = -1, -2
# Largest number of fibers of which an exchange of two exposures changes the targets.
MOST_CHANGED = 400
# Exchanges of targets between lists: number of fibers that are considered, largest number of targets that are removed,
# and number of targets that are tried.
NEAR, MOST_REMOVED, MOST_TRIES = 30, 8, 300


class Pairs(NamedTuple):
    """Pairs of a fiber and a target."""

    t_indptr: np.ndarray
    fiber: np.ndarray  # fiber of each pair; pairs are sorted by targets
    target: np.ndarray
    f_indptr: np.ndarray
    pair: np.ndarray  # pairs of each fiber, as compressed rows
    most: np.ndarray  # largest number of uses of each pair


class Poses(NamedTuple):
    """Candidates of the fibers of one exposure, and their cliques; at most one candidate of each clique is used."""

    fiber: np.ndarray
    target: np.ndarray
    indptr: np.ndarray
    clique: np.ndarray  # cliques of each candidate, as compressed rows


@kernel
def add_use(t, pairs, uses, room, seen, stamp, taken, given, queue, journal):
    """Add a visit to target t along a shortest path, on which other targets move to other fibers.

    Return whether there is a path, and the number of fibers in ``queue``. The journal receives the changes: p for an
    added use of pair p, and -1 - p for a removed one.
    """
    first, last = 0, 0
    for p in range(pairs.t_indptr[t], pairs.t_indptr[t + 1]):
        f = pairs.fiber[p]
        if uses[p] < pairs.most[p] and seen[f] != stamp:
            seen[f], taken[f], given[f], queue[last] = stamp, p, -1, f
            last += 1
    while first < last:
        f = queue[first]
        first += 1
        if room[f] > 0:
            room[f] -= 1
            while True:
                uses[taken[f]] += 1
                journal.append(taken[f])
                p = given[f]
                if p < 0:
                    return True, last
                uses[p] -= 1
                journal.append(-1 - p)
                f = pairs.fiber[p]
        for k in range(pairs.f_indptr[f], pairs.f_indptr[f + 1]):
            p = pairs.pair[k]
            if uses[p] == 0 or pairs.target[p] == t:
                continue
            for q in range(pairs.t_indptr[pairs.target[p]], pairs.t_indptr[pairs.target[p] + 1]):
                g = pairs.fiber[q]
                if seen[g] != stamp and uses[q] < pairs.most[q]:
                    seen[g], taken[g], given[g], queue[last] = stamp, q, p, g
                    last += 1
    return False, last


@kernel
def undo(journal, pairs, uses, room):
    """Undo the changes in a journal."""
    for change in journal:
        p = max(change, -1 - change)
        step = 1 if change < 0 else -1
        uses[p] += step
        room[pairs.fiber[p]] -= step


@kernel
def smallest(done, scale, is_open):
    """Return the list with the smallest value of done / scale, or -1 if no list is open."""
    best = -1
    for k in range(scale.size):
        if is_open[k] and (best < 0 or done[k] * scale[best] < done[best] * scale[k]):
            best = k
    return best


@kernel
def finish_targets(lists, l_indptr, scale, done, needed, pairs, uses, room, finished):
    """Finish targets in the order of the lists, next always one of the list with the smallest value of done / scale.

    ``needed`` is the number of visits that finish each target. ``done`` (number of finished targets of each list),
    ``uses``, ``room`` (number of further uses of each fiber) and ``finished`` change.
    """
    seen, stamp, place = np.zeros(room.size, np.int64), 0, l_indptr[:-1].copy()
    taken, given, queue = np.empty_like(seen), np.empty_like(seen), np.empty_like(seen)
    able = np.full(room.size, 1 << 30)  # estimate of the largest number of visits that paths from each fiber can add
    while True:
        best = smallest(done, scale, place < l_indptr[1:])
        if best < 0:
            return
        t = lists[place[best]]
        place[best] += 1
        total = 0
        for p in range(pairs.t_indptr[t], pairs.t_indptr[t + 1]):
            total += able[pairs.fiber[p]]
        if finished[t] or total < needed[t]:
            continue
        journal, made = [np.int64(0) for _ in range(0)], 0
        while made < needed[t]:
            stamp += 1
            is_added, last = add_use(t, pairs, uses, room, seen, stamp, taken, given, queue, journal)
            if not is_added:
                able[queue[:last]] = made
                break
            made += 1
        if made == needed[t]:
            finished[t] = True
            done[best] += 1
        else:
            undo(journal, pairs, uses, room)


@kernel
def balance(lists, l_indptr, scale, done, group, needed, pairs, uses, room, finished):
    """Finish targets of the list with the smallest value of done / scale in place of targets of other lists.

    The smallest value never decreases. ``group`` is the list of each target, or -1; see `finish_targets`.
    """
    seen, stamp, is_open = np.zeros(room.size, np.int64), 0, np.full(scale.size, True)
    taken, given, queue = np.empty_like(seen), np.empty_like(seen), np.empty_like(seen)
    removed = np.empty(MOST_REMOVED, np.int64)
    while True:
        k = smallest(done, scale, is_open)
        if k < 0:
            return
        is_open[k], tries = False, 0
        for t in lists[l_indptr[k] : l_indptr[k + 1]]:
            if finished[t]:
                continue
            tries += 1
            if tries > MOST_TRIES:
                break
            journal, made, n = [np.int64(0) for _ in range(0)], 0, 0
            while made < needed[t]:
                stamp += 1
                is_added, last = add_use(t, pairs, uses, room, seen, stamp, taken, given, queue, journal)
                if is_added:
                    made += 1
                    continue
                r = (
                    spare_target(k, queue[: min(last, NEAR)], done, scale, group, pairs, uses)
                    if n < MOST_REMOVED
                    else -1
                )
                if r < 0:
                    break
                for p in range(pairs.t_indptr[r], pairs.t_indptr[r + 1]):
                    while uses[p] > 0:
                        uses[p] -= 1
                        room[pairs.fiber[p]] += 1
                        journal.append(-1 - p)
                removed[n], finished[r] = r, False
                done[group[r]] -= 1
                n += 1
            if made == needed[t]:
                finished[t], is_open[k] = True, True
                done[k] += 1
                break
            undo(journal, pairs, uses, room)
            for r in removed[:n]:
                finished[r] = True
                done[group[r]] += 1


@kernel
def spare_target(k, fibers, done, scale, group, pairs, uses):
    """Return a target of the fibers whose list has the largest value of done / scale without it, or -1.

    This value must be larger than that of list k.
    """
    best, most = -1, done[k] / scale[k]
    for f in fibers:
        for i in range(pairs.f_indptr[f], pairs.f_indptr[f + 1]):
            g = group[pairs.target[pairs.pair[i]]]
            if uses[pairs.pair[i]] > 0 and g >= 0 and g != k and (done[g] - 1) / scale[g] > most:
                best, most = pairs.target[pairs.pair[i]], (done[g] - 1) / scale[g]
    return best


@kernel
def conflicts_with(c, e, poses, load):
    """Return the number of candidates in use in exposure e that exclude candidate c, counted in each clique."""
    total = 0
    for k in range(poses.indptr[c], poses.indptr[c + 1]):
        total += load[e, poses.clique[k]]
    return total


@kernel
def put(c, e, step, poses, load):
    """Add ``step`` to the number of used candidates of each clique of candidate c in exposure e."""
    if c >= 0:
        for k in range(poses.indptr[c], poses.indptr[c + 1]):
            load[e, poses.clique[k]] += step


@kernel
def exchange(a, b, f, poses, plan, at, load, members):
    """Exchange the exposures a and b for fiber f, and for all fibers that are linked with it by their targets.

    Return the change of the number of conflicts, or 1 << 30 if the exchange is not possible.
    """
    n, members[0] = 1, f
    for here in range(2):
        out, back = (a, b) if here == 0 else (b, a)
        g = f
        while True:
            c = plan[out, g]
            if c == CLOSED:
                return 1 << 30
            if c == FREE:
                break
            g = at[back, poses.target[c]]
            if g < 0 or g == f:
                break
            if n == members.size:
                return 1 << 30
            members[n] = g
            n += 1
        if g == f and here == 0:
            break  # a closed path contains both directions
    for k in range(n):
        if plan[a, members[k]] == CLOSED or plan[b, members[k]] == CLOSED:
            return 1 << 30
    change = 0
    for k in range(n):
        for e in (a, b):
            c = plan[e, members[k]]
            if c >= 0:
                put(c, e, -1, poses, load)
                change -= conflicts_with(c, e, poses, load)
                at[e, poses.target[c]] = -1
    for k in range(n):
        g = members[k]
        plan[a, g], plan[b, g] = plan[b, g], plan[a, g]
        for e in (a, b):
            c = plan[e, g]
            if c >= 0:
                change += conflicts_with(c, e, poses, load)
                put(c, e, 1, poses, load)
                at[e, poses.target[c]] = g
    return change


@kernel
def schedule(order, uses, c_indptr, candidate, poses, rolls, closed, plan, load):
    """Give each use of the pairs in ``order`` an exposure, and then exchange exposures so that fewer arms collide.

    Parameters
    ----------
    order : ndarray of int
        Pairs in the order in which they are scheduled.
    uses : ndarray of int
        Number of uses of each pair.
    c_indptr, candidate : ndarray of int
        Candidates of each pair, as compressed rows.
    poses : Poses
        The candidates.
    rolls : ndarray of int
        A random whole number for each turn of exchanges.
    closed : ndarray of int, shape (n_exposures, n_fibers)
        Candidate of each fiber that is not available, or -1.
    plan : ndarray of int, shape (n_exposures, n_fibers)
        Candidate of each fiber, or `FREE` or `CLOSED`; it changes. Uses without an exposure are omitted.
    load : ndarray of int, shape (n_exposures, n_cliques)
        Number of candidates in use of each clique; it changes.
    """
    n_exposures, n_fibers = plan.shape
    at = np.full((n_exposures, poses.target.max() + 1), -1)
    members = np.empty(MOST_CHANGED, np.int64)
    for e in range(n_exposures):
        for f in range(n_fibers):
            put(closed[e, f], e, 1, poses, load)
    for p in order:
        for _ in range(uses[p]):
            c = candidate[c_indptr[p]]
            f, t = poses.fiber[c], poses.target[c]
            least, where = 1 << 30, -1
            for e in range(n_exposures):
                if plan[e, f] != FREE or at[e, t] >= 0:
                    continue
                for k in range(c_indptr[p], c_indptr[p + 1]):
                    number = conflicts_with(candidate[k], e, poses, load)
                    if number < least:
                        least, where, c = number, e, candidate[k]
            # exchange two exposures of other visits, so that the fiber and the target are free in the same exposure
            for a in range(n_exposures if where < 0 else 0):
                for b in range(n_exposures if plan[a, f] == FREE and at[a, t] >= 0 else 0):
                    if at[b, t] < 0 and exchange(a, b, at[a, t], poses, plan, at, load, members) < 1 << 30:
                        where = a
                        break
                if where >= 0:
                    break
            if where >= 0:
                plan[where, f], at[where, t] = c, f
                put(c, where, 1, poses, load)
    for turn in range(rolls.size):
        is_done = True
        for a in range(n_exposures):
            for f in range(n_fibers):
                if plan[a, f] < 0 or not collides(plan[a, f], a, poses, load):
                    continue
                is_done = False
                for k in range(n_exposures):
                    b = (rolls[turn] + 7 * f + k) % n_exposures
                    change = exchange(a, b, f, poses, plan, at, load, members) if a != b else 1 << 30
                    if change < 0 or (change == 0 and k % 2 == turn % 2):
                        break
                    if change < 1 << 30:
                        exchange(a, b, f, poses, plan, at, load, members)
        if is_done:
            break


@kernel
def collides(c, e, poses, load):
    """Return whether another candidate in use in exposure e excludes candidate c, which is in use."""
    most = 0
    for k in range(poses.indptr[c], poses.indptr[c + 1]):
        most = max(most, load[e, poses.clique[k]])
    return most > 1


@kernel
def drop_collisions(rank, n_ranks, poses, plan, load, dropped):
    """Remove candidates that collide from a schedule, those of targets with a large ``rank`` first.

    ``dropped`` receives, for each candidate, whether it was removed.
    """
    for level in range(n_ranks - 1, -1, -1):
        for e in range(plan.shape[0]):
            for f in range(plan.shape[1]):
                c = plan[e, f]
                if c >= 0 and rank[poses.target[c]] == level and collides(c, e, poses, load):
                    put(c, e, -1, poses, load)
                    plan[e, f], dropped[c] = FREE, True
