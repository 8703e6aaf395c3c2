"""Plan one tile for all realizations of a block, and the remaining visits of all targets in these realizations.

The remaining visits are one byte per target and realization.
"""

from collections.abc import Iterable
from typing import NamedTuple

import astropy.units as u
import numpy as np

from rfpsurvey._assignment.rules import RuleProblem, id_numbers, subpriorities_of
from rfpsurvey._field.plan import FieldReach
from rfpsurvey._field.targets import FieldBuilder
from rfpsurvey._instruments.count_collisions import count_poses, make_setup
from rfpsurvey._instruments.find_collisions import find_collisions
from rfpsurvey._instruments.focal_plane import FocalPlane
from rfpsurvey._instruments.reach import Reach, elbow_names
from rfpsurvey._kernels import batch as kernels
from rfpsurvey._kernels.batch import BORDERLINE
from rfpsurvey._sky.arrays import has_role
from rfpsurvey._survey.bookkeeping import Remaining, job_without
from rfpsurvey._survey.cadences import Windows
from rfpsurvey._survey.request import Request
from rfpsurvey._survey.work import Job, reach_of, work


class Failures(NamedTuple):
    """The failures of positioners when a tile was observed."""

    key: tuple[int, int]
    """Row of the tile, and number of the generation with whose plan it was observed."""
    rates: dict[tuple[str, ...], np.ndarray]
    """For the names of the positioners that failed, as known at different times, the probability that each positioner
    fails."""

    def draw(self, seeds: tuple[int, ...]) -> np.ndarray:
        """Return which positioners fail for each element of ``rates``, each seed of a realization, and each positioner.

        All elements of ``rates`` are compared with the same random numbers.
        """
        rates = np.array([*self.rates.values()])
        random = [np.random.default_rng([seed, *self.key]).random(rates.shape[1]) for seed in seeds]
        return np.array(random) < rates[:, None]


class BlockJob(NamedTuple):
    """The input of `plan_together` and `plan_alone`: one tile, and the realizations for which it is planned."""

    job: Job
    """The tile and its field, which contains the targets with remaining visits in at least one realization."""
    left: np.ndarray
    """Remaining visits of each target of the field, shape (n, n_realizations)."""
    seeds: tuple[int, ...]
    failed: Failures | None = None
    """The failures of positioners when the tile was observed; None if it was not observed."""

    def draw(self) -> np.ndarray | tuple:
        """Return the result of `Failures.draw`; an empty tuple if the tile was not observed."""
        return () if self.failed is None else self.failed.draw(self.seeds)


class BlockDone(NamedTuple):
    """The result of `plan_together` and `plan_alone`: the visits of a tile in each realization."""

    mask: np.ndarray
    """For each target of the field, a mask whose bit r is 1 if realization r visits the target."""
    counts: np.ndarray
    """For each realization, the number of positioners with a target, and the number of targets lost to a collision."""
    good: list[np.ndarray]
    """Masks as ``mask``, without the visits of the positioners that fail, for each element of `Failures.rates`."""


def plan_together(given: BlockJob) -> BlockDone:
    """Plan a tile for all realizations of a block; the pairs in reach and the poses of arms are computed once."""
    job, n = given.job, len(given.seeds)
    reach = reach_of(job)
    plane = reach.applied.instrument.focal_plane
    mask, counts = np.zeros(len(given.left), dtype=np.uint32), np.zeros((n, 2), dtype=np.int64)
    pairs, chosen = choose_pairs(reach, given)
    if len(pairs.owner) == 0:
        return BlockDone(mask, counts, [mask] * len(given.draw()))
    lost = np.zeros(chosen.shape, dtype=bool)
    if job.model.lost_in_collision:
        lost = find_lost(plane, reach, pairs, chosen, parked_obstacles=job.model.options.parked_obstacles)
    kernels.mark_visits(chosen, lost, pairs.target, mask, counts)
    good = []
    for fails in given.draw():
        good.append(np.zeros_like(mask))
        kernels.mark_visits(chosen, lost | fails, pairs.target, good[-1], np.empty_like(counts))
    return BlockDone(mask, counts, good)


def choose_pairs(reach: FieldReach, given: BlockJob) -> tuple[Reach, np.ndarray]:
    """Return the pairs that may be assigned, and the index of the pair of each positioner in each realization, or -1.

    A realization uses the same subpriorities and random numbers as the survey with the seed of the realization.
    """
    targets, n_sharing = given.job.field.targets, reach.applied.instrument.focal_plane.arrays.n_sharing
    columns, method, n = targets.columns, given.job.model.options.method, len(targets.id)
    rank, is_required, science = np.zeros(n, dtype=np.int64), None, np.ones(n, dtype=bool)
    if columns.kind is not None:
        science = has_role(columns.kind, "science")
    if method.uses_priorities:
        is_required = columns.is_required
        if columns.priority is not None:
            rank = np.unique(-columns.priority, return_inverse=True)[1].reshape(-1).astype(np.int64)
    problem = RuleProblem.of(reach.allowed, rank, science, is_required, id_numbers(targets.id), n_sharing)
    pairs, chosen = problem.pairs, np.empty((len(given.seeds), problem.pairs.n_positioners), dtype=np.int64)
    is_open, rng = np.ascontiguousarray(given.left.T) > 0, None
    for r, seed in enumerate(given.seeds if len(pairs.owner) else ()):
        if method.uses("rng"):
            rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=given.job.seed.spawn_key))
        answer = method.rule(problem, subpriorities_of(problem.number, seed), is_open[r], rng)
        kernels.find_pairs(pairs.indptr, pairs.owner, answer.target_of_positioner, chosen[r])
    return pairs, chosen


def is_reached(job: Job) -> np.ndarray:
    """Return whether a positioner reaches each target of a field."""
    return reach_of(job).pairs.covered


def plan_alone(given: BlockJob) -> BlockDone:
    """Plan a tile for a single realization, with the function that plans the tiles of surveys."""
    done, ids = work(given.job), given.job.model.instrument.focal_plane.id
    observed = (done.target >= 0) & done.observed

    def mask_of(counted: np.ndarray) -> np.ndarray:
        visited = np.isin(np.arange(len(given.left)), done.target[counted])
        return (visited & (given.left[:, 0] > 0)).astype(np.uint32)  # others are only standards or sky positions

    mask = mask_of(observed)
    good = [mask_of(observed & ~np.isin(done.visits["positioner"], ids[fails])) for (fails,) in given.draw()]
    lost = done.counts["n_colliding_assigned"] if given.job.model.lost_in_collision else 0
    return BlockDone(mask, np.array([[done.counts["n_assigned"], lost]]), good)


def find_lost(
    plane: FocalPlane, reach: FieldReach, pairs: Reach, chosen: np.ndarray, *, parked_obstacles: bool
) -> np.ndarray:
    """Return the positioners that lose their target to a collision, in each realization.

    Parameters
    ----------
    plane : FocalPlane
        The positioners.
    reach : FieldReach
        Positions and required fiber types of the targets.
    pairs : Reach
        The pairs of positioners and targets in reach that may be assigned.
    chosen : ndarray of int, shape (n_realizations, n_positioners)
        Index of the pair of each positioner in each realization, or -1.
    parked_obstacles : bool
        Whether positioners without a target are parked, and are obstacles for other arms. Only positioners with two
        arms of equal length can be parked.

    Returns
    -------
    ndarray of bool, shape (n_realizations, n_positioners)
        Whether each positioner has a target and collides.
    """
    columns, times = plane.arrays, np.zeros(chosen.shape, dtype=np.int64)
    if len(columns.runs) + len(columns.obstacle_pairs) == 0:
        return times > 0
    owner, points = pairs.owner, reach.xy[pairs.target]
    fiber = columns.first_index[owner]
    if reach.fiber_type is not None:
        fiber = columns.index_of(reach.fiber_type[pairs.target], owner)
    side = columns.sides(points, owner, fiber)
    poses = chosen, columns.segments_of(owner, fiber, points, side), columns.idle_segments(parked_obstacles)
    counts = count_poses(plane, make_setup(columns, parked_obstacles), *poses, times, columns.obstacle_slack)
    lost = (times > 0) & (chosen >= 0)
    for r in np.flatnonzero(counts[:, BORDERLINE]):  # exact arithmetic, because rounding could change the result
        used = np.flatnonzero(chosen[r] >= 0)
        pair, tips, hands = chosen[r, used], np.full((len(plane), 2), np.nan), np.ones(len(plane))
        tips[used], hands[used] = points[pair], side[pair]
        types = columns.first_type.astype(object)
        types[used] = np.array(plane.fiber_types, dtype=object)[fiber[pair]]
        given = {"handedness": elbow_names(hands), "fiber_type": types.astype(str)}
        report = find_collisions(plane, tips << u.mm, parked_obstacles=parked_obstacles, **given)
        lost[r] = report.in_collision & (chosen[r] >= 0)
    return lost


def seeds_of(seed: int, n: int) -> list[int]:
    """Return the seeds of n realizations; if n is increased, the first seeds remain the same."""
    return [int(word) >> 1 for word in np.random.SeedSequence(seed).generate_state(n, np.uint64)]


def in_batch(request: Request) -> bool:
    """Return whether all realizations of a block can be planned together."""
    options = request.options
    # the rules do not meet requirements, which some of the allocators with a rule ignore as well
    simple = options.sky_separation is None and not (options.counts and options.method.uses("requirements"))
    return options.method.rule is not None and simple


class State(Remaining):
    """The remaining visits of each target in each realization of a block.

    A block is a group of realizations that are planned together. The *slot* of a target is its index in the arrays of
    the builder. The windows of cadences have an element for each slot and realization.
    """

    def __init__(self, builder: FieldBuilder, n_realizations: int, windows: Windows | None = None):
        self.builder = builder
        """The targets of the last realization."""
        self.windows = windows
        self.spends = np.broadcast_to(np.True_, len(builder.left)) if builder.spends is None else builder.spends
        self.first = np.broadcast_to(builder.left[:, None], (len(builder.left), n_realizations))
        """Number of remaining visits of each target in each realization before the first tile."""
        self.restore(self.first.copy(), np.zeros((n_realizations, 3), dtype=np.int64))

    def open_job(self, request: Request, tile: int) -> Job:
        """Return the job of a tile with the targets that at least one realization may observe."""
        job = request.job(tile, self.is_open)
        if self.windows is None:
            return job
        slot = job.field.slot
        return job_without(request, tile, self.is_open, slot[~self.open_left(slot, tile).any(axis=1)])

    def open_left(self, slot: np.ndarray, tile: int) -> np.ndarray:
        """Return the remaining visits of targets, shape (n, n_realizations); 0 if the window is closed at a tile."""
        left = self.left.take(slot, axis=0)
        if self.windows is not None:
            left[~self.allows(self.index_of(slot), tile) & self.spends[slot][:, None]] = 0
        return left

    def index_of(self, slot: np.ndarray) -> np.ndarray:
        """Return the index of the element of each target and realization, shape (n, n_realizations)."""
        return slot[:, None] * len(self.counts) + np.arange(len(self.counts))

    def enter(self, tile: int, job: Job, done: BlockDone) -> None:
        """Record the visits of a tile."""
        self.record(tile, job.field.slot, done.mask, done.counts)

    def record(self, tile: int, slot: np.ndarray, mask: np.ndarray, counts: np.ndarray) -> None:
        """Record the visits of a tile to the targets in ``slot``; the other parameters are those of `BlockDone`."""
        self.counts[:, :2] += counts
        n = len(self.counts)
        if self.windows is None:
            observed = np.zeros(n, dtype=np.int64)
            kernels.record_visits(mask, slot, self.spends, self.left, self.is_open, observed)
        else:
            counted = self.spend(self.index_of(slot)[to_bits(mask, n) & self.spends[slot][:, None]], tile)
            observed = np.bincount(counted % n, minlength=n)
            self.is_open[slot] = self.left[slot].any(axis=1)
        self.counts[:, 2] += observed

    def made(self) -> np.ndarray:
        """Return the number of visits that count of each target in each realization, except those before the first."""
        return (self.first - self.left) * self.spends[:, None]

    def masks(self) -> np.ndarray:
        """Return a mask for each target, whose bit r is 1 if realization r observes the target, shape (n_targets,)."""
        return to_mask((now < before) & self.spends for now, before in zip(self.left.T, self.first.T, strict=True))

    def restore(self, left: np.ndarray, counts: np.ndarray, n_rounds: int = 0) -> None:
        """Replace this state by another state.

        For each target and realization, ``left`` is the number of remaining visits. For each realization, ``counts``
        contains the numbers of assigned positioners, of lost targets, and of visits to science targets. ``n_rounds`` is
        the number of finished rounds, which are groups of tiles that share no targets.
        """
        self.left, self.counts, self.n_rounds = left, counts, n_rounds
        self.is_open = (left > 0).any(axis=1).astype(np.uint8)


def to_mask(columns: Iterable[np.ndarray]) -> np.ndarray:
    """Return a mask for each target, whose bit r is its value in column r."""
    return sum(column.astype(np.uint32) << np.uint32(r) for r, column in enumerate(columns))


def to_bits(mask: np.ndarray, n: int) -> np.ndarray:
    """Return the first n bits of each mask as booleans, shape (n_targets, n)."""
    return (mask[:, None] >> np.arange(n, dtype=np.uint32)) & np.uint32(1) > 0
