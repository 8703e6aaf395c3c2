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
    now, blocked, _ = state = stand(candidates, chosen)
    if (blocked[now] > 0).any():
        return chosen
    xy, load = candidates.problem.focal_plane.arrays.xy, np.diff(candidates.options.start)
    tried = np.zeros(pairs.shape[1], dtype=bool)
    while left(deadline) > 0:
        bad = np.flatnonzero((now[pairs] == idle[pairs]).all(axis=0) & ~tried)
        if len(bad) == 0:
            break
        center = xy[pairs[:, bad[0]]].mean(axis=0)
        order = np.argsort(((xy - center) ** 2).sum(axis=1), kind="stable")
        # the two positioners of the collision are always members
        members = np.sort(order[np.cumsum(load[order]) <= max(SIZE, load[order[:2]].sum())])
        tried[bad[0]] = True
        tried |= len(members) == len(xy)
        try:
            _separate(candidates, members, state, share(deadline, FOR_ONE), keep_cost)
        except OutOfTimeError:
            break
    return now


def _separate(candidates, members, state, deadline, keep_cost):
    """Minimize the collisions between the idle arms of some positioners in place, while all other arms are fixed."""
    options, idle = candidates.options, candidates.options.start[1:] - 1
    before = after = state[0][members].copy()
    try:
        program = program_of(candidates, members, *state, deadline)
        x = _fewest(program, candidates.idle_pairs, idle, state[0], program.variables(before), deadline, keep_cost)
        if x is not None and len(program.chosen(x)) == len(members):
            after = program.chosen(x)
    finally:  # `program_of` takes the candidates from the members before it can run out of time
        for c in after:
            moves.put(options.owner[c], c, options, *state)


def _fewest(program, pairs, idle, now, x, deadline, keep_cost):
    """Return the variables of the plan with the fewest collisions of idle arms, among plans as good as plan ``x``.

    None is returned if no plan has fewer of these collisions than plan ``x``.
    """
    variable = program.index[idle[pairs]]  # of each idle arm; -1 for positioners that are not members
    linked = variable[:, (variable >= 0).all(axis=0)]
    cost, unit = np.zeros(program.n), np.ones(linked.shape[1])
    for member, fixed in ((0, 1), (1, 0)):
        alone = (variable[member] >= 0) & (now[pairs[fixed]] == idle[pairs[fixed]])
        np.add.at(cost, variable[member][alone], 1.0)
    costs = [csr_array(-np.round(program.costs, DIGITS)[None])] if keep_cost else []
    kept = vstack([program.matrix, *costs], format="csr")
    rows = _with_pairs(_with_least(program.rows, kept, kept @ x), linked)
    goal, most = np.append(-cost, -unit), np.append(program.most, unit)
    settings = {"integral": True, "gap": 0.0, "presolve": True}
    fewest, _ = maximize(rows, goal, most, deadline, **settings)
    # the numbers of collisions are whole numbers
    if fewest is None or -goal @ fewest > cost @ x + (x[linked[0]] * x[linked[1]]).sum() - 0.5:
        return None
    if program.problem.subpriority is not None:
        rows = _with_least(rows, csr_array(goal[None]), goal @ fewest)
        best, _ = maximize(rows, np.append(-program.costs, 0.0 * unit), most, deadline, **settings)
        fewest = fewest if best is None else best
    return fewest[: program.n]


def _with_least(rows, matrix, least):
    """Return constraints with additional constraints: ``matrix`` times the variables is at least ``least``."""
    present, low, high = rows
    high = np.append(high, np.full(matrix.shape[0], np.inf))
    return vstack([present, matrix], format="csr"), np.append(low, least), high


def _with_pairs(rows, linked):
    """Return constraints with a variable for each pair of variables, which is 1 if both variables of the pair are 1."""
    matrix, low, high = rows
    n = linked.shape[1]
    unit, row = np.ones(n), np.arange(n)
    # the sum of the pair minus the new variable is at most 1; the new variable is 0 otherwise, because it has a cost
    link = csr_array((np.tile(unit, 2), (np.tile(row, 2), linked.ravel())), shape=(n, matrix.shape[1]))
    link = hstack([link, csr_array((-unit, (row, row)), shape=(n, n))], format="csr")
    wide = hstack([matrix, csr_array((matrix.shape[0], n))], format="csr")
    return vstack([wide, link], format="csr"), np.append(low, np.full(n, -np.inf)), np.append(high, unit)
