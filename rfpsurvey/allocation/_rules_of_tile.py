"""The requirements and rules of one tile as linear constraints on its candidates, for plans of several tiles."""

from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_array

from rfpsurvey.allocation._candidates import Candidates
from rfpsurvey.allocation._distribution import pairs_within


class TileRules(NamedTuple):
    """Linear constraints on the plan of a tile: the sum over the candidates in use of each row is at most a number."""

    matrix: csr_array
    """Matrix with a row for each constraint and a column for each candidate."""
    most: np.ndarray
    """Largest sum of each row; minima have the opposite sign."""
    is_count: np.ndarray
    """Whether each row counts candidates, so that all its elements are 1 or -1."""
    usable: np.ndarray
    """Whether each candidate may be used. Neighbors that rules on the distribution count in the given plan are kept."""


def no_rules(n: int) -> TileRules:
    """Return no constraints on ``n`` candidates."""
    return TileRules(csr_array((0, n)), np.empty(0), np.empty(0, dtype=bool), np.ones(n, dtype=bool))


def rules_of(candidates: Candidates, planned: np.ndarray) -> TileRules:
    """Return the constraints that requirements, required targets and rules impose on plans.

    Required science targets impose no constraint. ``planned`` is the target of each positioner in the given plan, or
    -1: plans observe at least as many required standards and sky positions as the given plan. A rule on the
    distribution of fibers becomes linear, because all neighbors of the given plan are kept. Stuck fibers that observe
    sky count, because the targets of their candidates are these sky positions.
    """
    problem, options, rows, most = candidates.problem, candidates.options, [], []
    for group, held in zip(problem.groups, candidates.held, strict=True):
        one = group.requirement
        for sign, limit in ((-1.0, one.minimum or None), (1.0, one.maximum)):
            if limit is not None:
                rows.append(sign * held)
                most.append(sign * limit)
    if problem.any_required:
        others = np.append(problem.is_required & ~problem.science, False)
        if others.any():
            rows.append(-1.0 * others[options.target])
            most.append(-1.0 * others[planned].sum())
    n_counts, usable = len(rows), np.ones(len(candidates), dtype=bool)
    for rule, science, near in candidates.spreads:
        kept = near & (options.target == planned[options.own])
        is_kept = np.zeros(len(planned), dtype=bool)
        is_kept[options.own[kept]] = True
        usable &= ~is_kept[options.own] | kept
        first = pairs_within(problem.xy, problem.xy[np.unique(options.target[kept])], rule.distance_mm)[0]
        served = np.bincount(first, minlength=len(problem.xy)) >= rule.k
        rows.append(np.where(science, rule.percent / 100 - np.append(served, False)[options.target], 0.0))
        most.append(0.0)
    if not rows:
        return no_rules(len(candidates))
    matrix = csr_array(np.array(rows, dtype=float))
    return TileRules(matrix, np.array(most), np.arange(len(rows)) < n_counts, usable)
