"""Find proven plans: remove unnecessary candidates, split the rest into independent parts, and solve each part."""

from functools import partial
from time import perf_counter
from typing import NamedTuple

import numpy as np
from scipy.sparse import coo_array

from rfpsurvey._kernels import reduce
from rfpsurvey.allocation._candidates import Candidates, find_candidates
from rfpsurvey.allocation._lexicographic import pursue
from rfpsurvey.allocation._local_search import improve, match, pick, repair_collisions, trim
from rfpsurvey.allocation._milp import Program
from rfpsurvey.allocation._problem import AllocationAnswer, AllocationProblem, Level
from rfpsurvey.focal_plane import elbow_names

__all__ = ["decide"]

# Small parts are combined up to about this number of positioners, because each call of the solver takes time.
SMALLEST = 200
# Fraction of the time that is reserved for the bound on plans with omitted candidates.
FOR_BOUND = 0.3


def decide(
    problem: AllocationProblem, *, collide: bool, integral: bool = True, squared_cost: bool = False
) -> AllocationAnswer:
    """Return the best plan with proven bounds; if ``collide`` is true, arms must not collide."""
    deadline = perf_counter() + problem.time_limit
    everything = find_candidates(problem, collide=collide, squared_cost=squared_cost)
    options = {"integral": integral, "squared_cost": squared_cost}
    n_left_out = everything.preselection.n_left_out
    # Some time is reserved for the bound on plans with omitted candidates.
    halt = deadline - FOR_BOUND * (deadline - perf_counter()) if collide and n_left_out else deadline
    used, found = _search(everything, halt, collide=collide, **options)
    target_of = used.options.target[found.chosen]
    reached = problem.values(target_of)
    names, values, bounds = list(reached), np.array(list(reached.values())), found.bounds
    meta = {"n_candidates": len(everything), "n_conflicts": everything.pairs.shape[1], **found.meta}
    if collide and n_left_out:
        meta["n_left_out"] = n_left_out
        relaxed = _search(everything.relaxed(), deadline, collide=True, **options)[1]
        bounds = np.maximum(relaxed.bounds, values)
    if (values < bounds).any():
        bounds = _bounds(problem, everything, names, values, bounds)
    levels = [Level(n, float(v), float(b)) for n, v, b in zip(names, values, bounds, strict=True)]
    return AllocationAnswer(target_of, elbow_names(used.side[found.chosen]), None, levels, meta)


def _search(everything: Candidates, deadline: float, *, collide: bool, integral: bool, squared_cost: bool):
    """Return the candidates that the search used, and the best plan that it found."""
    problem = everything.problem
    alive = np.ones(len(everything), dtype=bool)
    reduce.reduce_candidates(everything.options, alive)
    used = everything.where(alive)
    blind = pick(used, match(used))
    # If the idle arm of a positioner is not among the candidates, this is not always a valid plan.
    start = _plan(used, blind, collide)
    found = _solve(used, blind, start, deadline, integral=integral, squared_cost=squared_cost)
    if not found.complete:
        used = everything
        return used, found._replace(chosen=_plan(used, pick(used, trim(problem, match(used))), collide))
    if (found.values < found.bounds).any() and collide:
        return used, found._replace(chosen=improve(used, found.chosen))
    return used, found


def _plan(candidates, chosen, collide):
    """Return an initial plan, which has no collisions if ``collide`` is true; positioners without a target are idle."""
    if collide:
        return repair_collisions(candidates, chosen)[0]
    return np.where(chosen < 0, candidates.options.start[1:] - 1, chosen)


class _Found(NamedTuple):
    chosen: np.ndarray
    """Candidate that each positioner uses; -1 if no candidate was found within the time limit."""
    values: np.ndarray
    bounds: np.ndarray
    complete: bool
    meta: dict


def _solve(candidates, blind, start, deadline, *, integral, squared_cost) -> _Found:
    """Solve the independent parts of a problem one after the other.

    ``blind`` contains the candidate of each positioner in a matching whose arms may collide, or -1 for no target.
    """
    problem, options = candidates.problem, candidates.options
    n_left = np.diff(options.start)
    chosen = np.where(n_left == 1, options.start[:-1], -1)
    known = chosen[chosen >= 0]
    levels = problem.values(np.where(chosen < 0, -1, options.target[chosen]))
    values = bounds = np.array(list(levels.values()))
    # The requirements of a part also count the targets of the parts that are already solved.
    adds = np.array([name != "requirements" for name in levels])
    n_parts = n_programs = 0
    integers, complete = False, True
    parts = list(_parts(candidates, np.flatnonzero((n_left > 1)[options.own])))
    for rows, edges in parts:
        program = Program(candidates, rows, known, edges)
        mine = np.unique(options.own[rows])
        limit = None if problem.groups else program.reaches(program.variables(blind[mine][blind[mine] >= 0]))
        tell = None if problem.tell is None else partial(_tell, problem.tell, n_parts, len(parts))
        part = pursue(program, start[mine], deadline, limit, integral=integral, squared_cost=squared_cost, tell=tell)
        values, bounds = np.where(adds, values, 0.0) + part.values, np.where(adds, bounds, 0.0) + part.bounds
        if part.chosen is None:
            complete = False
        else:
            chosen[options.own[part.chosen]] = part.chosen
        n_parts, n_programs = n_parts + 1, n_programs + part.n_programs
        integers |= part.integral and part.n_programs > 0
    meta = {
        "model": "integer program" if integers else "linear program" if n_programs else "no search needed",
        "n_open": int((n_left > 1).sum()),
        "n_parts": n_parts,
        "n_programs": n_programs,
    }
    return _Found(chosen, values, bounds, complete, meta)


def _tell(tell, part: int, n_parts: int, level: int, n_levels: int) -> None:
    """Report the current part of a search and the objective that is being solved."""
    of_parts = f"part {part + 1} of {n_parts}, " if n_parts > 1 else ""
    tell((part + level / n_levels) / n_parts, f"{of_parts}class {level + 1} of {n_levels}")


def _bounds(problem, everything, names, values, bounds):
    """Return the upper bounds of the levels; they are proven up to the first level that is below its bound.

    The bounds of the later levels follow from a matching whose arms may collide: no plan has more targets of the first
    classes, or of all classes, than this matching.
    """
    first = int(np.flatnonzero(values < bounds)[0]) if (values < bounds).any() else len(names)
    target_of = match(everything)
    counts = np.bincount(problem.rank[target_of[target_of >= 0]], minlength=len(problem.classes) + 1)
    if problem.any_required:  # the matching did not assign targets by their class alone
        counts = np.bincount(problem.rank[np.diff(problem.pairs.indptr) > 0], minlength=len(counts))
    most, total = np.cumsum(counts), min(int(counts.sum()), len(target_of))
    offset = len(names) - len(problem.classes) - (not problem.science.all())  # position of the first class
    out = bounds.copy()
    for k in range(first + 1, len(names)):
        if k < offset:
            out[k] = 0.0 if names[k] == "requirements" else min(int(most[-2]), len(target_of))
        elif k < offset + len(problem.classes):
            out[k] = min(most[k - offset], len(target_of)) - values[offset:k].sum()
        else:
            out[k] = total
    return np.maximum(out, values)


def _parts(candidates, rows):
    """Split undecided candidates into independent parts, and return the candidates and the collisions of each part."""
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
    same = np.array([real[:-1], real[1:]])
    same = same[:, options.target[same[0]] == options.target[same[1]]]
    first, second = options.own[np.concatenate([edges, same], axis=1)]
    n = len(options.start) - 1
    ends = first.astype(np.int32), second.astype(np.int32)  # older versions of SciPy only accept 32-bit integers
    _, label = connected_components(coo_array((np.ones(len(first)), ends), shape=(n, n)), directed=False)
    # Small parts are combined in the order of their labels.
    members = np.unique(options.own[rows])
    names, size = np.unique(label[members], return_counts=True)
    batch = np.zeros(n, dtype=np.int64)
    batch[names] = np.concatenate([[0], np.cumsum(size)[:-1]]) // SMALLEST
    of_row, of_edge = batch[label[options.own[rows]]], batch[label[options.own[edges[0]]]]
    for b in np.unique(of_row):
        yield rows[of_row == b], edges[:, of_edge == b]
