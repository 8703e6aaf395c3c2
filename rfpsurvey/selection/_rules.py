"""Rules by which three allocators assign the targets of a tile, each for all realizations of a block.

A rule is a function of a `BlockProblem` and of an array ``chosen``. For each realization and positioner, it writes to
``chosen`` the index of the pair that assigns a target to the positioner, or -1 if the positioner has no target.
"""

from typing import NamedTuple

import numpy as np

from rfpsurvey._kernels import realizations as kernels
from rfpsurvey._kernels.allocation import sort_by_distance
from rfpsurvey._roles import has_role
from rfpsurvey.allocation import id_numbers
from rfpsurvey.focal_plane import Reach
from rfpsurvey.pipeline import FieldReach


class BlockProblem(NamedTuple):
    """The targets of a field, and the pairs of a target and a positioner that may be assigned."""

    pairs: Reach
    rank: np.ndarray
    """Priority class of each target; class 0 is assigned first."""
    n_ranks: int
    number: np.ndarray
    """Integer that represents the identifier of each target, and from which its subpriority is computed."""
    left: np.ndarray
    """Remaining visits of each target in each realization, shape (n_targets, n_realizations)."""
    seeds: np.ndarray
    tile: int

    n_sharing: np.ndarray
    """For each positioner, an upper limit of the number of other positioners that can reach any of its targets."""

    @classmethod
    def of(cls, reach: FieldReach, given) -> "BlockProblem":
        """Return the problem of the tile whose `BlockJob` is ``given``."""
        targets, pairs = given.job.field.targets, reach.allowed
        columns, n, n_sharing = targets.columns, len(targets.id), reach.instrument.focal_plane.arrays.n_sharing
        allowed = np.ones(n, dtype=bool) if columns.kind is None else has_role(columns.kind, "science")
        rank = np.zeros(n, dtype=np.int64)
        if given.job.model.options.method.uses_priorities:
            if columns.priority is not None:
                rank = np.unique(-columns.priority, return_inverse=True)[1].reshape(-1).astype(np.int64)
            if columns.is_required is not None:
                rank = np.where(columns.is_required, 0, rank + 1)
                allowed = allowed | columns.is_required
        if not allowed.all():
            pairs = pairs.where(allowed[pairs.target])
        seeds = np.array(given.seeds, dtype=np.uint64)
        n_ranks = int(rank.max(initial=0)) + 1
        return cls(pairs, rank, n_ranks, id_numbers(targets.id), given.left, seeds, given.tile, n_sharing)


def balanced(problem: BlockProblem, chosen: np.ndarray) -> None:
    """Add each target, in order of subpriority, to the shortest queue in reach; then draw one target of each queue."""
    # a realization uses the same random numbers as the survey with the seed of the realization
    streams = [np.random.SeedSequence(int(seed), spawn_key=(problem.tile,)) for seed in problem.seeds]
    uniform = np.array([np.random.default_rng(stream).random(chosen.shape[1]) for stream in streams])
    pairs = problem.pairs
    kernels.balanced(pairs.indptr, pairs.owner, pairs.r2, problem.number, problem.seeds, problem.left, uniform, chosen)


def lamost_rule(problem: BlockProblem, chosen: np.ndarray) -> None:
    """Assign the targets, class by class, by nominations.

    Each free positioner nominates its target with the largest subpriority. If several positioners nominate a target,
    the target is assigned to the positioner with the fewest targets in reach.
    """
    pairs = problem.pairs
    in_reach = np.bincount(pairs.owner, minlength=pairs.n_positioners)
    # If k other positioners reach targets of a positioner, at least one of its first k + 1 targets is always free.
    start = np.concatenate([[0], np.cumsum(np.minimum(in_reach, problem.n_sharing + 1))])
    kernels.lamost_rule(
        pairs.indptr,
        pairs.owner,
        pairs.r2,
        problem.rank,
        problem.n_ranks,
        problem.number,
        problem.seeds,
        problem.left,
        start,
        chosen,
    )


def nearest(problem: BlockProblem, chosen: np.ndarray) -> None:
    """Assign each target, sorted by class, then by subpriority, to its closest free positioner."""
    pairs = problem.pairs
    closest = np.arange(len(pairs.owner))
    sort_by_distance(pairs.indptr, pairs.r2, closest)
    of_targets = problem.rank, problem.number, problem.seeds, problem.left
    kernels.nearest(pairs.indptr, pairs.owner, pairs.r2, closest, *of_targets, chosen)


RULES = {"balanced": balanced, "lamost_rule": lamost_rule, "nearest": nearest}
"""The rule of each allocator, by the name of the allocator."""
