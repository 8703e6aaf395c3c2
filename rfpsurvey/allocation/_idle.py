"""Minimize the collisions between idle arms without changing the numbers of assigned targets."""

import numpy as np
from scipy.sparse import csr_array, hstack, vstack

from rfpsurvey._kernels import repair as moves
from rfpsurvey.allocation._candidates import Candidates
from rfpsurvey.allocation._clock import OutOfTimeError, left, share
from rfpsurvey.allocation._clusters import program_of
from rfpsurvey.allocation._local_search import stand
from rfpsurvey.allocation._objectives import DIGITS
from rfpsurvey.allocation._solver import maximize

# Positioners that are changed at the same time have at most this many candidates in total.
SIZE = 2000
# Fraction of the remaining time that one integer program may take.
FOR_ONE = 0.25


def separate_idle_arms(candidates: Candidates, chosen: np.ndarray, deadline: float, *, keep_cost: bool) -> np.ndarray:
    """Return a plan with the same values of all objectives and as few collisions between idle arms as possible.

    The number of these collisions is minimal if there are at most ``SIZE`` candidates. Otherwise, the
    number may not be minimal, because the positioners around each collision are optimized separately. Positioners
    change only if the number decreases. If the targets have subpriorities, the sum of subpriorities of the changed
    positioners is then the largest sum with this number of collisions; with ``keep_cost``, it does not decrease.

    Parameters
    ----------
    candidates : Candidates
        All candidates; the last candidate of each positioner is its idle arm.
    chosen : ndarray of int, shape (n_positioners,)
        Candidate of each positioner.
    deadline : float
        Value of `now` at which the search ends.
    keep_cost : bool
        Whether the cost, which stands for the sum of the subpriorities, takes precedence over these collisions.

    Returns
    -------
    ndarray of int, shape (n_positioners,)
        Candidate of each positioner.
    """
    pairs, idle = candidates.idle_pairs, candidates.options.start[1:] - 1
    state = stand(candidates, chosen)
    if (state[1][state[0]] > 0).any():
        return chosen
    xy, load = candidates.problem.focal_plane.arrays.xy, np.diff(candidates.options.start)
    tried = np.zeros(pairs.shape[1], dtype=bool)
    while left(deadline) > 0:
        now = state[0]
        bad = np.flatnonzero((now[pairs] == idle[pairs]).all(axis=0) & ~tried)
        if len(bad) == 0:
            break
        center = xy[pairs[:, bad[0]]].mean(axis=0)
        order = np.argsort(((xy - center) ** 2).sum(axis=1), kind="stable")
        members = np.sort(order[np.cumsum(load[order]) <= max(SIZE, load[order[:2]].sum())])
        tried[bad[0]] = True
        if len(members) == len(xy):
            tried[:] = True
        try:
            _separate(candidates, members, state, share(deadline, FOR_ONE), keep_cost)
        except OutOfTimeError:
            break
    return state[0]


def _separate(candidates, members, state, deadline, keep_cost):
    """Minimize the collisions between the idle arms of some positioners in place, while all other arms are fixed."""
    options, now = candidates.options, state[0]
    before, idle = now[members].copy(), options.start[1:] - 1
    after = before
    try:
        program = program_of(candidates, members, *state, deadline)
        x = _fewest(program, candidates.idle_pairs, idle, now, program.variables(before), deadline, keep_cost)
        if x is not None and len(program.chosen(x)) == len(members):
            after = program.chosen(x)
    finally:
        for c in after:
            moves.put(options.owner[c], c, options, *state)


def _fewest(program, pairs, idle, now, x, deadline, keep_cost):
    """Return the variables of the plan with the fewest collisions of idle arms, among plans as good as plan ``x``.

    None is returned if no plan has fewer of these collisions than plan ``x``.
    """
    place = program.index[idle[pairs]]  # -1 for positioners that are not members
    cost = np.zeros(program.n)
    both = place[:, (place >= 0).all(axis=0)]
    for k in (0, 1):
        alone = (place[k] >= 0) & (now[pairs[1 - k]] == idle[pairs[1 - k]])
        np.add.at(cost, place[k][alone], 1.0)
    m = both.shape[1]
    matrix, low, high = program.rows
    kept = vstack([program.matrix, csr_array(-np.round(program.costs, DIGITS)[None])], format="csr")
    kept = kept if keep_cost else program.matrix
    matrix = vstack([matrix, kept], format="csr")
    low = np.concatenate([low, kept @ x, np.full(m, -np.inf)])
    high = np.concatenate([high, np.full(kept.shape[0], np.inf), np.ones(m)])
    ones = np.ones(m)
    link = csr_array((np.tile(ones, 2), (np.tile(np.arange(m), 2), both.ravel())), shape=(m, program.n))
    slack = csr_array((-ones, (np.arange(m), np.arange(m))), shape=(m, m))
    wide = hstack([matrix, csr_array((matrix.shape[0], m))], format="csr")
    matrix = vstack([wide, hstack([link, slack], format="csr")], format="csr")
    goal, most = np.append(-cost, -ones), np.append(program.most, ones)
    settings = {"integral": True, "gap": 0.0, "presolve": True}
    found, _ = maximize((matrix, low, high), goal, most, deadline, **settings)
    before = cost @ x + (x[both[0]] * x[both[1]]).sum()
    if found is None or -goal @ found > before - 0.5:
        return None
    if program.problem.subpriority is not None:
        matrix = vstack([matrix, csr_array(goal[None])], format="csr")
        low, high = np.append(low, goal @ found), np.append(high, np.inf)
        worth = np.append(-program.costs, np.zeros(m))
        best, _ = maximize((matrix, low, high), worth, most, deadline, **settings)
        found = found if best is None else best
    return found[: program.n]
