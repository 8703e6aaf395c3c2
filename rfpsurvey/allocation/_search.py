"""Plans that are proven: what no best plan needs is given up, the rest falls apart, and each part is solved alone."""

from time import perf_counter

import numpy as np
from scipy.sparse import coo_array

from rfpsurvey._kernels import allocation as rules
from rfpsurvey._kernels import reduce
from rfpsurvey._kernels import repair as moves
from rfpsurvey.allocation._candidates import Candidates, find_candidates
from rfpsurvey.allocation._problem import Choice, Level, Problem
from rfpsurvey.allocation._program import Program

__all__ = ["decide", "match", "mend", "pick"]

# Parts are solved together until they have so many positioners: a call of the solver has its price.
SMALLEST = 200
ROUNDS = 10


def decide(problem: Problem, *, collide: bool, integral: bool = True, squared_cost: bool = False) -> Choice:
    """Return the best plan with its proof; ``collide``: arms must not."""
    deadline = perf_counter() + problem.time_limit
    everything = find_candidates(problem, collide=collide, squared_cost=squared_cost)
    alive = np.ones(len(everything), dtype=bool)
    reduce.reduce_candidates(everything.options, alive)
    candidates = everything.where(alive)
    options = candidates.options
    n_left = np.diff(options.start)
    blind = pick(candidates, match(candidates))
    start = mend(candidates, blind)[0] if collide else blind
    chosen = np.where(n_left == 1, options.start[:-1], -1)
    known = chosen[chosen >= 0]
    levels = problem.values(np.where(n_left == 1, options.target[chosen], -1))
    values = bounds = np.array(list(levels.values()))
    n_parts = n_programs = 0
    integers = False
    for rows, edges in _parts(candidates, np.flatnonzero((n_left > 1)[options.own])):
        program = Program(problem, candidates, rows, known, edges)
        mine = np.unique(options.own[rows])
        limit = None if problem.groups else program.value_of(program.picked(blind[mine]))
        part = program.solve(start[mine], deadline, limit, integral=integral, squared_cost=squared_cost)
        # a part that knows of requirements counts what is known already
        adds = [name != "requirements" for name in levels]
        bounds = np.where(adds, bounds, 0.0) + part.bounds
        if part.chosen is None:  # requirements, and no time at all: there is one part only
            return _by_moves(everything, match(candidates), levels, bounds)
        values = np.where(adds, values, 0.0) + part.values
        chosen[options.own[part.chosen]] = part.chosen
        n_parts, n_programs = n_parts + 1, n_programs + part.n_programs
        integers |= part.integral and part.n_programs > 0
    found = [Level(n, float(v), float(b)) for n, v, b in zip(levels, values, bounds, strict=True)]
    meta = {
        "model": "integer program" if integers else "linear program" if n_programs else "no search needed",
        "n_candidates": len(everything), "n_conflicts": everything.pairs.shape[1],
        "n_open": int((n_left > 1).sum()), "n_parts": n_parts, "n_programs": n_programs,
    }  # fmt: skip
    return Choice(options.target[chosen], candidates.side[chosen], None, found, meta)


def _by_moves(candidates, target_of, names, bounds) -> Choice:
    """Return a plan that exceeds no maximum, where there was no time for a better one."""
    problem, options = candidates.problem, candidates.options
    for group in problem.groups:
        most = group.requirement.maximum
        own = np.flatnonzero(target_of >= 0)
        own = own[group.holds(target_of[own], problem.spectrograph_of(own, target_of[own]))]
        own = own[np.argsort(problem.rank_of(target_of[own]), kind="stable")]
        target_of[own[len(own) if most is None else most :]] = -1
    chosen = mend(candidates, pick(candidates, target_of))[0]
    target_of = options.target[chosen]
    values = problem.values(target_of).values()
    levels = [Level(n, v, max(v, float(b))) for n, v, b in zip(names, values, bounds, strict=True)]
    return Choice(target_of, candidates.side[chosen], None, levels, {"model": "out of time"})


def match(candidates: Candidates) -> np.ndarray:
    """Return the target of each positioner in the best plan of arms that may collide, without requirements."""
    options, problem = candidates.options, candidates.problem
    n, m = len(options.start) - 1, len(problem.points)
    classes = problem.rank if problem.required is None else problem.rank - problem.required * (len(problem.classes) + 2)
    target_of, positioner_of = np.empty(n, dtype=np.int64), np.empty(m, dtype=np.int64)
    order = np.argsort(classes, kind="stable")
    rules.match(order, options.t_indptr, options.own[options.t_candidate], target_of, positioner_of)
    return target_of


def pick(candidates: Candidates, target_of: np.ndarray, side: np.ndarray | None = None) -> np.ndarray:
    """Return the candidate of each positioner for given targets and elbows; the last one where there is none."""
    options = candidates.options
    fits = (options.target >= 0) & (options.target == target_of[options.own])
    if side is not None:
        fits &= candidates.side == side[options.own]
    chosen = options.start[1:] - 1
    rows = np.flatnonzero(fits)[::-1]
    chosen[options.own[rows]] = rows
    return chosen


def mend(candidates: Candidates, chosen: np.ndarray) -> tuple[np.ndarray, int, int]:
    """Return a plan without collisions, how many positioners moved without a loss, and how many gave up."""
    options, held = candidates.options, candidates.held
    groups = candidates.problem.groups
    low = [group.requirement.minimum > 0 for group in groups]
    n = len(chosen)
    now = np.full(n, -1)
    blocked, holder = np.zeros(len(candidates), dtype=np.int64), np.full(len(candidates.problem.points), -1)
    for i in range(n):
        moves.put(i, chosen[i], options, now, blocked, holder)

    def order():
        """Return positioners, those that no requirement needs and with the least important targets first."""
        return np.lexsort((-options.rank[now], held[low][:, now].any(axis=0)))

    moved, dropped = moves.repair(options, order(), now, blocked, holder, ROUNDS)
    for counts, group in zip(held, groups, strict=True):
        need = group.requirement.minimum - int(counts[now].sum())
        spare = ~held[low][:, now].any(axis=0)
        first = order()
        moves.claim(first[spare[first]], need, counts, options, now, blocked, holder)
    return now, int(moved), int(dropped)


def _parts(candidates, rows):
    """Split undecided candidates into parts that do not touch each other, with the conflicts in each."""
    from scipy.sparse.csgraph import connected_components

    options, problem = candidates.options, candidates.problem
    if len(rows) == 0:
        return
    undecided = np.zeros(len(candidates), dtype=bool)
    undecided[rows] = True
    edges = candidates.pairs[:, undecided[candidates.pairs].all(axis=0)]
    if problem.groups:
        yield rows, edges
        return
    real = rows[options.target[rows] >= 0]
    real = real[np.argsort(options.target[real], kind="stable")]
    twins = np.array([real[:-1], real[1:]])
    twins = twins[:, options.target[twins[0]] == options.target[twins[1]]]
    first, second = options.own[np.concatenate([edges, twins], axis=1)]
    n = len(options.start) - 1
    _, label = connected_components(coo_array((np.ones(len(first)), (first, second)), shape=(n, n)), directed=False)
    # parts of a few positioners each, put together in the order of their labels
    members = np.unique(options.own[rows])
    names, size = np.unique(label[members], return_counts=True)
    batch = np.zeros(n, dtype=np.int64)
    batch[names] = np.concatenate([[0], np.cumsum(size)[:-1]]) // SMALLEST
    of_row, of_edge = batch[label[options.own[rows]]], batch[label[options.own[edges[0]]]]
    for b in np.unique(of_row):
        yield rows[of_row == b], edges[:, of_edge == b]
