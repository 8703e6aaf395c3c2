"""The first plan, in which the tiles are planned one after the other, and the candidates of all tiles."""

from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from rfpsurvey._executors import map_in_order
from rfpsurvey._units import exact_text
from rfpsurvey.allocation import GivenPlan, ListCandidates, TileCandidates
from rfpsurvey.survey._joint._fixed import candidates_of
from rfpsurvey.survey._joint._network import Network, make_network
from rfpsurvey.survey._work import Job, plan_of, projection_of


class TilePlan(NamedTuple):
    """The plan of a tile."""

    slot: np.ndarray
    """Slot of the target of each positioner (see `Bookkeeping`); -1 if the positioner has no target."""
    side: np.ndarray
    """Handedness of each positioner: +1 is right, -1 is left."""


def _plan(job: Job):
    """Plan a tile; return the target (its index among the targets of the field) and handedness of each positioner."""
    allocation = plan_of(job).allocation
    side = np.where(allocation.handedness == "left", -1, 1).astype(np.int8)
    return allocation.target_of_positioner, side


def _list(job: Job) -> tuple[TileCandidates, np.ndarray]:
    """Return the candidates of a tile, and the unit vectors of the centers of its positioners."""
    plane = job.model.instrument.focal_plane
    vectors = projection_of(job).unproject(plane.arrays.xy, np.full(len(plane), plane.fiber_types[0]))
    return plan_of(job).allocation.meta["candidates"], vectors


def first_plans(request, fixed: dict, executor: Executor | None, tell: Callable) -> list[TilePlan]:
    """Plan the tiles one after the other, and return their plans; ``fixed`` contains plans of observed tiles."""
    left, plans = request.builder.left.copy(), [None] * len(request.tiling)
    done = 0
    for tile, observed in fixed.items():
        slot = np.where(observed.counted, observed.slot, -1)
        left[slot[slot >= 0]] -= 1
        plans[tile] = TilePlan(slot, observed.side)
        done += 1
    for round_ in request.rounds:
        tiles = np.array([tile for tile in round_.tolist() if tile not in fixed], dtype=np.int64)
        jobs = [request.job(tile, left, as_file=False) for tile in tiles.tolist()]
        for tile, job, (target, side) in zip(
            tiles.tolist(), jobs, map_in_order(executor, _plan, [job.bare() for job in jobs]), strict=True
        ):
            slot = np.append(job.field.slot, -1)[target]
            left[slot[slot >= 0]] -= 1
            plans[tile] = TilePlan(slot, side)
            done += 1
            tell(done)
    return plans


def list_all(request, plans: list, fixed: dict, executor: Executor | None) -> tuple[Network, np.ndarray]:
    """Return the candidates of all tiles as a `Network`, and the unit vectors of the centers of all positioners."""
    left = request.builder.left
    jobs, slots, n = [], [], len(request.tiling)
    for tile in range(n):
        job = request.job(tile, left, as_file=False)
        slots.append(job.field.slot)
        if tile in fixed:
            continue
        keep = _rows(job.field.slot, plans[tile].slot)
        options = replace(request.options, allocator=ListCandidates(keep))
        jobs.append(job.bare()._replace(model=replace(request.model, options=options)))
    lists = map_in_order(executor, _list, jobs)
    nowhere = np.zeros((len(request.instrument.focal_plane), 3))  # positioners of fixed tiles are in no patch
    parts = [(candidates_of(fixed[k], slots[k]), nowhere) if k in fixed else next(lists) for k in range(n)]
    tiles, vectors = zip(*parts, strict=True)
    return make_network(list(tiles), slots, left, class_of(request, left)), np.concatenate(vectors)


def class_of(request, wanted: np.ndarray) -> np.ndarray:
    """Return the class of each target in the order of slots; the classes are the distinct priorities, largest first."""
    priority = request.source.by_slot("priority")
    if priority is None:
        return np.zeros(len(wanted), dtype=np.int64)
    values = np.unique(priority[wanted > 0])[::-1]
    return np.clip(np.searchsorted(-values, -priority), 0, max(len(values) - 1, 0)).astype(np.int64)


def class_names(request) -> list[str]:
    """Return the names of the classes that `class_of` returns; the name of a class is its priority."""
    priority = request.source.by_slot("priority")
    wanted = request.builder.left
    if priority is None or not (wanted > 0).any():
        return ["all"]
    return [exact_text(value) for value in np.unique(priority[wanted > 0])[::-1]]


def place(network: Network, plans: list[TilePlan]) -> np.ndarray:
    """Return the planned candidate of each positioner, or its idle arm if the planned target is not a candidate."""
    slot, side = (np.concatenate(column) for column in zip(*plans, strict=True))
    place = np.searchsorted(network.slot, slot)
    target = np.where(slot >= 0, place, -2)
    own = network.own
    fits = (network.target == target[own]) & (network.side == side[own]) & (network.target >= 0)
    chosen = network.start[1:] - 1
    rows = np.flatnonzero(fits)
    chosen[own[rows]] = rows
    return chosen


def plans_of(network: Network, chosen: np.ndarray) -> list[TilePlan]:
    """Return the plans of all tiles in which each positioner uses the candidate in ``chosen``."""
    target = network.target[chosen]
    slot = np.append(network.slot, -1)[target]
    side = network.side[chosen]
    return [TilePlan(slot[a:b], side[a:b]) for a, b in zip(network.first[:-1], network.first[1:], strict=True)]


def given_plan(request, job: Job, plan: TilePlan) -> Job:
    """Return a copy of the job whose allocator returns the given plan."""
    allocator = GivenPlan(_rows(job.field.slot, plan.slot), plan.side)
    return job._replace(model=replace(request.model, options=replace(request.options, allocator=allocator)))


def _rows(slots: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """Return the index of each slot of ``wanted`` in the array ``slots``; the index of slot -1 is -1."""
    order = np.argsort(slots, kind="stable")
    index = order[np.minimum(np.searchsorted(slots[order], wanted), max(len(slots) - 1, 0))] if len(slots) else wanted
    return np.where(wanted >= 0, index, -1)
