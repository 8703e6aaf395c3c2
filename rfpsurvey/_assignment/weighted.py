"""Functions for planning tiles together: candidates, rules, integer programs, and bounds."""

from dataclasses import replace
from time import time
from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_array, hstack

from rfpsurvey._assignment.answer import AllocationAnswer
from rfpsurvey._assignment.candidates import Candidates, find_candidates
from rfpsurvey._assignment.clock import now
from rfpsurvey._assignment.clusters import ROUNDING, Prices
from rfpsurvey._assignment.distribution import pairs_within
from rfpsurvey._assignment.problem import AllocationProblem
from rfpsurvey._assignment.solver import choose_one_each
from rfpsurvey._instruments.reach import elbow_names
from rfpsurvey._kernels.paths import TOLERANCE
from rfpsurvey._sky.arrays import without_science
from rfpsurvey.errors import InputError


class TileRules(NamedTuple):
    """Linear constraints on the plan of a tile: the sum over the candidates in use of each row is at most a number."""

    matrix: csr_array  # matrix with a row for each constraint and a column for each candidate
    most: np.ndarray  # largest sum of each row; minima have the opposite sign
    is_count: np.ndarray  # whether each row counts candidates, so that all its elements are 1 or -1
    usable: np.ndarray  # whether each candidate may be used; neighbors that rules count in the given plan are kept


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
        requirement = group.requirement
        for sign, limit in ((-1.0, requirement.minimum or None), (1.0, requirement.maximum)):
            if limit is not None:
                rows.append(sign * held)
                most.append(sign * limit)
    if problem.any_required:
        required = np.append(problem.is_required & ~problem.science, False)
        if required.any():
            rows.append(-1.0 * required[options.target])
            most.append(-1.0 * required[planned].sum())
    n_counts, usable = len(rows), np.ones(len(candidates), dtype=bool)
    for rule, science, near in candidates.spreads:
        kept = near & (options.target == planned[options.owner])
        is_kept = np.zeros(len(planned), dtype=bool)
        is_kept[options.owner[kept]] = True
        usable &= ~is_kept[options.owner] | kept
        first = pairs_within(problem.xy, problem.xy[np.unique(options.target[kept])], rule.distance_mm)[0]
        served = np.bincount(first, minlength=len(problem.xy)) >= rule.k
        # the sum is at most 0 if at least this percentage of the science fibers in use is served
        rows.append(np.where(science, rule.percent / 100 - np.append(served, False)[options.target], 0.0))
        most.append(0.0)
    if not rows:
        return no_rules(len(candidates))
    matrix = csr_array(np.array(rows, dtype=float))
    return TileRules(matrix, np.array(most), np.arange(len(rows)) < n_counts, usable)


# Largest distance (mm) between two positions of the same blank sky, which differ by rounding errors.
SAME_MM = 1e-3


class TileCandidates(NamedTuple):
    """The candidates of the positioners of one tile; the last candidate of each positioner is its idle arm."""

    start: np.ndarray  # index of the first candidate of each positioner, followed by the total number of candidates
    target: np.ndarray  # row of the target of each candidate; -1 for idle arms
    side: np.ndarray  # elbow of each candidate: +1 is right, -1 is left
    indptr: np.ndarray
    column: np.ndarray  # cliques as compressed rows (``indptr``, ``column``): a plan uses at most one of each
    shortened: np.ndarray  # whether some candidates of each positioner were omitted
    pairs: tuple[np.ndarray, np.ndarray]  # positioner and target of each reachable pair
    rules: TileRules  # requirements, required standards and sky positions, and rules on the distribution of fibers


class ListCandidates:
    """An allocator that assigns no target, and returns all candidates in the ``meta`` of its answer.

    Parameters
    ----------
    keep_target : ndarray of int, shape (n_positioners,)
        For each positioner, the target that is never omitted, or -1 if there is no such target.
    reuse : bool, optional
        Whether to add the candidates of `with_reused`.
    """

    counts = distribution = "exactly"

    def __init__(self, keep_target: np.ndarray, *, reuse: bool = False):
        self.keep_target, self.reuse = keep_target, reuse

    def __call__(self, problem: AllocationProblem) -> AllocationAnswer:
        """Return an answer that assigns no target and contains all candidates in ``meta``."""
        candidates = find_candidates(problem, keep_target=self.keep_target)
        cliques = Prices(candidates, np.inf)
        options, reach = candidates.options, problem.pairs
        poses = options.start, options.target.astype(np.int32), candidates.side.astype(np.int8)
        pairs, shortened = (reach.owner, reach.target), candidates.preselection.shortened.any(axis=1)
        given = shortened, tuple(rows.astype(np.int32) for rows in pairs), rules_of(candidates, self.keep_target)
        listed = TileCandidates(*poses, cliques.indptr, cliques.column.astype(np.int32), *given)
        if self.reuse:
            listed = with_reused(listed, candidates, self.keep_target)
        return AllocationAnswer(np.full(len(problem.focal_plane), -1), meta={"candidates": listed})


def with_reused(listed: TileCandidates, candidates: Candidates, planned: np.ndarray) -> TileCandidates:
    """Return candidates with copies, without the role science, of those of science targets that also have other roles.

    The target of a copy is -2 - t, where t is the row of the target. A copy is in the same cliques as the original,
    because the poses of the arms are equal; therefore, a plan of the tile observes each target at most once.

    Parameters
    ----------
    listed : TileCandidates
        The candidates.
    candidates : Candidates
        The same candidates, with their problem.
    planned : ndarray of int, shape (n_positioners,)
        The target of each positioner in the given plan (see `rules_of`).

    Returns
    -------
    TileCandidates
        The candidates, in which the copies follow the originals of each positioner.
    """
    problem, owner, n = candidates.problem, candidates.options.owner, len(candidates)
    several = problem.science & (problem.kind != "science")
    rows = np.flatnonzero(np.append(several, False)[listed.target])
    if len(rows) == 0:
        return listed
    kind, required = np.where(several, without_science(problem.kind), problem.kind), problem.is_required & ~several
    copies = candidates.for_problem(replace(problem, kind=kind, is_required=required))
    rules, of_copies, is_idle = listed.rules, rules_of(copies, planned), np.zeros(n + len(rows), dtype=bool)
    is_idle[listed.start[1:] - 1] = True
    copied = np.concatenate([np.arange(n), rows])
    order = np.lexsort((is_idle, owner[copied]))  # the idle arm remains the last candidate of its positioner
    copied, is_copy = copied[order], order >= n
    shape = len(listed.indptr) - 1, n
    cliques = csr_array((np.ones(len(listed.column)), listed.column, listed.indptr), shape=shape)[:, copied]
    cliques.sort_indices()
    matrix = csr_array(hstack([rules.matrix, of_copies.matrix[:, rows]]).tocsc()[:, order])
    rules = rules._replace(matrix=matrix, usable=np.append(rules.usable, of_copies.usable[rows])[order])
    start = listed.start + np.searchsorted(np.sort(owner[rows]), np.arange(len(listed.start)))
    target = np.where(is_copy, -2 - listed.target[copied], listed.target[copied])
    columns = {"indptr": cliques.indptr, "column": cliques.indices, "rules": rules}
    return listed._replace(start=start, target=target, side=listed.side[copied], **columns)


class GivenPlan:
    """An allocator that returns a given plan.

    Parameters
    ----------
    target_of : ndarray of int, shape (n_positioners,)
        Target of each positioner, or -1 for no target.
    side : ndarray of int, shape (n_positioners,)
        Elbow of each positioner: +1 is right, -1 is left.
    blank_mm : ndarray of float, shape (n_positioners, 2), optional
        Position of the blank sky that each positioner observes, in mm; NaN for positioners that observe none. The
        position must be one of the added sky positions.
    avoids_collisions : bool, optional
        Whether the plan may change where arms have no path, if a constraint requires paths.

    Raises
    ------
    InputError
        If the position is not one of the added sky positions.
    """

    counts = distribution = "exactly"
    keeps_targets = True  # other targets belong to other tiles

    def __init__(
        self,
        target_of: np.ndarray,
        side: np.ndarray,
        blank_mm: np.ndarray | None = None,
        *,
        avoids_collisions: bool = False,
    ):
        self.target_of, self.side, self.blank_mm = target_of, side, blank_mm
        self.avoids_collisions = avoids_collisions

    def __call__(self, problem: AllocationProblem) -> AllocationAnswer:
        """Return the given plan as the answer of an allocator."""
        target_of, reach = self.target_of.copy(), problem.pairs
        for i in [] if self.blank_mm is None else np.flatnonzero(np.isfinite(self.blank_mm[:, 0])).tolist():
            mine = reach.target[reach.owner == i]
            if problem.watched is not None and problem.watched[i] >= 0:
                mine = problem.watched[[i]]
            apart = np.linalg.norm(problem.xy[mine] - self.blank_mm[i], axis=1)
            if apart.min(initial=np.inf) > SAME_MM:
                raise InputError(
                    f"the sky position of positioner {problem.focal_plane.id[i]} in a fixed tile is not among the "
                    "added sky positions; use the targets, requirements and sky_separation of the fixed survey"
                )
            target_of[i] = mine[np.argmin(apart)]
        return AllocationAnswer(target_of, elbow_names(self.side.astype(float)))


class WeightedProblem(NamedTuple):
    """The problem of choosing one candidate for each positioner such that the sum of the weights is largest.

    In addition, a plan may use at most a given number of the candidates of each set.
    """

    start: np.ndarray  # index of the first candidate of each positioner, followed by the total number of candidates
    weight: np.ndarray
    sets: csr_array  # matrix with a row for each set, usually of ones, and a column for each candidate
    most: np.ndarray  # largest sum of the elements of each row over the candidates that a plan uses
    first: np.ndarray | None  # candidate of each positioner in the plan from which the search starts, if any
    nodes: int  # largest number of nodes of the search tree
    gap: float  # allowed relative error of the largest sum of the weights
    deadline: float  # value of `time.time` at which the search ends; all processes share this clock


def solve_weighted(problem: WeightedProblem) -> tuple[np.ndarray | None, float]:
    """Return the candidate of each positioner (None if no plan is found), and an upper bound of the sum of the weights.

    Parameters
    ----------
    problem : WeightedProblem
        The candidates with their weights, the sets, and the limits of the search.

    Returns
    -------
    chosen : ndarray of int, shape (n_positioners,), or None
        Candidate of each positioner in the best plan that was found.
    bound : float
        Upper bound of the sum of the weights, including an allowance for the rounding errors of HiGHS.
    """
    n, sets, first = len(problem.weight), problem.sets, None
    if problem.first is not None:
        first = np.zeros(n)
        first[problem.first] = 1.0
    limits = {"gap": problem.gap, "first": first, "nodes": problem.nodes}
    deadline = now() + problem.deadline - time()  # on the clock of this process
    x, bound = choose_one_each(problem.start, problem.weight, sets, problem.most, deadline, **limits)
    if x is None:
        return None, bound
    chosen = np.flatnonzero(x > 0.5)
    owner = np.searchsorted(problem.start, chosen, side="right") - 1
    if not np.array_equal(owner, np.arange(len(problem.start) - 1)) or (sets @ x > problem.most + TOLERANCE).any():
        return None, bound
    return chosen, bound


class RowPrices(Prices):
    """Prices (Lagrange multipliers) of sets of candidates.

    A plan may use at most a given number of the candidates of each set.

    Parameters
    ----------
    start : ndarray of int, shape (n_positioners + 1,)
        Index of the first candidate of each positioner, followed by the total number of candidates.
    matrix : csr_array
        Matrix with a row for each set and a column for each candidate; the column indices of each row are sorted.
    most : ndarray of float
        Largest number of candidates of each set that a plan may use.
    free : ndarray of bool, shape (n_positioners,)
        Whether some candidates of each positioner were omitted. A positioner with omitted candidates contributes at
        least 1 to the upper bound.
    n_least : int, optional
        Number of sets, the last ones, of which a plan must use at least the number in ``most``. The prices of these
        sets are at most 0.
    """

    def __init__(self, start: np.ndarray, matrix: csr_array, most: np.ndarray, free: np.ndarray, n_least: int = 0):
        self.start, self.matrix, self.most, self.free = start, matrix, most, free
        self.owner = np.repeat(np.arange(len(start) - 1), np.diff(start))
        self.indptr, self.column = matrix.indptr.astype(np.int64), matrix.indices.astype(np.int64)
        self.price = np.zeros(len(most))
        is_least = np.arange(len(most)) >= len(most) - n_least
        self.lowest, self.highest = np.where(is_least, -np.inf, 0.0), np.where(is_least, 0.0, np.inf)

    def bound(self, weights: np.ndarray) -> float:
        """Return an upper bound of the total weight of any plan.

        Parameters
        ----------
        weights : ndarray of float, shape (n_candidates,)
            Weight of each candidate, 0 to 1.

        Returns
        -------
        float
            Upper bound of the total weight of any plan.
        """
        # for any prices, no plan exceeds the cost of all limits plus the best priced candidate of each positioner
        total = float(self.price @ self.most)
        best = np.maximum.reduceat(self.values(weights), self.start[:-1])
        # an omitted candidate may belong to all sets of which a plan must use a number of candidates
        best = np.where(self.free, np.maximum(best, 1.0 - np.minimum(self.price, 0.0).sum()), best)
        terms = float(np.abs(self.price) @ np.abs(self.most)) + float(np.abs(best).sum())
        return total + float(best.sum()) + ROUNDING * (len(self.start) + terms)

    def improve(self, weights: np.ndarray, sweeps: tuple, is_over) -> float:
        """Adjust the prices to reduce the upper bound of the total weight of any plan, and return this bound.

        Parameters
        ----------
        weights : ndarray of float, shape (n_candidates,)
            Weight of each candidate, 0 to 1.
        sweeps : tuple of (float, int)
            For each stage of the adjustment, the width of the smooth maximum that replaces the largest value among the
            candidates of a positioner, and the number of sweeps. A sweep adjusts all prices once.
        is_over : callable
            Function that returns whether the time limit has passed.

        Returns
        -------
        float
            Upper bound of the total weight of any plan.
        """
        return self.adjust(weights, sweeps, is_over, slow=1e-5, n_least=1)
