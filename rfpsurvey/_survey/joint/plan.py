"""Plan all tiles of a survey together, and make a request that contains the plan of each tile.

In the first plan, the tiles are planned one after the other.
"""

import io
import logging
from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import dataclass, field, fields, replace
from functools import partial

import numpy as np
from astropy.table import QTable

from rfpsurvey._assignment.clock import now
from rfpsurvey._assignment.rules import FEWEST_FIRST, to_subpriorities
from rfpsurvey._assignment.weighted import GivenPlan, ListCandidates, TileCandidates
from rfpsurvey._common.executors import Progress, map_in_order
from rfpsurvey._common.units import exact_text
from rfpsurvey._field.targets import FieldBuilder
from rfpsurvey._survey.bookkeeping import Bookkeeping
from rfpsurvey._survey.joint.exposures import Exposures
from rfpsurvey._survey.joint.finished import FinishedSearch
from rfpsurvey._survey.joint.fixed import TilePlan, candidates_of, fixed_tiles, with_roles
from rfpsurvey._survey.joint.network import Network, make_network
from rfpsurvey._survey.joint.search import FOR_PRICES, Search, levels_of, table_of
from rfpsurvey._survey.joint.values import Shares, class_weights, worth_of
from rfpsurvey._survey.joint.windows import WindowSearch
from rfpsurvey._survey.request import Request
from rfpsurvey._survey.work import Done, Job, plan_of, projection_of, run_rounds
from rfpsurvey.errors import warn


def _plan(job: Job):
    """Plan a tile; return the target and handedness of each positioner.

    The target is an index among the targets of the field, which are followed by all blank sky positions that were
    found.
    """
    allocation = plan_of(job).allocation
    side = np.where(allocation.handedness == "left", -1, 1).astype(np.int8)
    rows = np.concatenate([np.arange(allocation.n_given), allocation.n_given + allocation.added, [-1]])
    return rows[allocation.target_of_positioner], side


def _list(job: Job) -> tuple[TileCandidates, np.ndarray]:
    """Return the candidates of a tile, and the unit vectors of the centers of its positioners."""
    plane = job.model.instrument.focal_plane
    vectors = projection_of(job).unproject(plane.arrays.xy, np.full(len(plane), plane.fiber_types[0]))
    return plan_of(job).allocation.meta["candidates"], vectors


def first_plans(request, fixed: dict, executor: Executor | None, tell: Callable) -> list[TilePlan]:
    """Plan the tiles one after the other, and return their plans; ``fixed`` contains plans of observed tiles."""
    state, plans = _state_after(request, fixed), [None] * len(request.tiling)
    for tile, observed in fixed.items():
        plans[tile] = TilePlan(np.where(observed.counted, observed.slot, -1), observed.side)

    def enter(tile: int, job: Job, answer: tuple) -> None:
        (target, side), n = answer, len(job.field.slot)
        inside = np.where(target < n, target, -1)
        slots = with_roles(request.builder, job.field.slot, job.field.targets)
        slot = np.where(target >= n, n - 2 - target, np.append(slots, -1)[inside])
        state.enter(tile, job, Done(None, None, inside, np.ones(len(slot), dtype=bool), np.uint8(0), {}))
        plans[tile] = TilePlan(slot, side)

    results = run_rounds(request.rounds, executor, _plan, partial(state.open_job, request), enter, known=fixed)
    for done, _ in enumerate(results, len(fixed) + 1):
        tell(done)
    return plans


def _state_after(request, fixed: dict) -> Bookkeeping:
    """Return the state after the visits of fixed tiles."""
    state = request.open_state()
    for tile, observed in fixed.items():
        state.spend(observed.spent(request.builder), tile)
    return state


def list_all(
    request, plans: list, fixed: dict, executor: Executor | None, chosen: np.ndarray | None = None
) -> tuple[Network, np.ndarray, np.ndarray | None]:
    """Return the candidates of all tiles as a `Network`, and the unit vectors of the centers of all positioners.

    Also return the subpriority of each target in the order of slots; None if there are no subpriorities. ``chosen`` is
    whether to list each target, by default all targets.
    """
    builder, left, given = request.builder, request.builder.left, request.options.subpriority
    available = left if chosen is None else np.where(chosen, left, 0).astype(left.dtype)
    jobs, slots, n, subpriority, reuse = [], [], len(request.tiling), None, builder.lasting is not None
    for tile in range(n):
        job = request.job(tile, available)
        slots.append(with_roles(builder, job.field.slot, job.field.targets))
        values = job.field.targets.columns.subpriority
        if given not in (None, FEWEST_FIRST):
            values = to_subpriorities(given, job.field.targets.id, job.field.targets.extra)
        if values is not None:
            subpriority = np.zeros(len(left)) if subpriority is None else subpriority
            subpriority[job.field.slot] = values
        if tile in fixed:
            # a reused target has a slot of its own, in addition to that of the science target
            slots[-1] = np.append(slots[-1], np.setdiff1d(fixed[tile].slot[fixed[tile].slot >= len(left)], slots[-1]))
            continue
        keep = _rows(job.field.slot, without_roles(builder, plans[tile].slot)[0])
        jobs.append(_with_allocator(request, job.bare(), ListCandidates(keep, reuse=reuse)))
    lists = map_in_order(executor, _list, jobs)
    nowhere = np.zeros((len(request.instrument.focal_plane), 3))  # positioners of fixed tiles are in no patch
    parts = [(candidates_of(fixed[k], slots[k]), nowhere) if k in fixed else next(lists) for k in range(n)]
    tiles, vectors = zip(*parts, strict=True)
    class_of, names = classes_of(request)
    if reuse:
        with_copies = [_with_slots(tile, slot, len(left)) for tile, slot in zip(tiles, slots, strict=True)]
        tiles, slots = zip(*with_copies, strict=True)
        left, class_of = np.tile(left, 2), np.append(class_of, np.full(len(left), len(names)))
    network = make_network(list(tiles), list(slots), left, class_of, len(names))
    if chosen is not None:
        network = replace(network, free=np.ones(len(network.free), dtype=bool))
    return network, np.concatenate(vectors), subpriority


def _finish_exposures(request, plans: list, fixed: dict) -> tuple:
    """Return the `Exposures`, the shares of the categories, plans that finish targets, and which targets to list.

    The first and the last value are None if all targets are listed.
    """
    class_of, names = classes_of(request)
    if request.joint.objective != "finished":
        return None, None, [], None

    def list_tile(job: Job) -> TileCandidates:
        nothing = np.full(len(request.instrument.focal_plane), -1)
        return _list(_with_allocator(request, job.bare(), ListCandidates(nothing)))[0]

    exposures = Exposures(request, fixed, class_of, len(names), list_tile)
    shares, share, builder = None, request.joint.share, request.builder
    if share:
        counted = exposures.in_field & (class_of < len(names)), (builder.wanted > 0) & (builder.left == 0)
        shares = Shares.of(share, request.source.by_slot("category"), *counted)
    end = now() + FOR_PRICES * min(request.joint.seconds, 1e9)
    finishing, listed = exposures.finish(plans, shares, request.seed, end)
    starts, n = [finishing], len(names)
    weights = class_weights(n)[np.minimum(class_of[exposures.slots], n - 1)]
    first = exposures.relax(weights, end, shares)[1]
    if (first < 2).any():
        finishing, further = exposures.finish(plans, shares, request.seed, end, first)
        starts.append(finishing)
        listed |= further
    if not exposures.is_large:
        return None, shares, starts, None
    for plan in fixed.values():
        listed[without_roles(request.builder, plan.slot[plan.slot >= 0])[0]] = True
    return exposures, shares, starts, listed


def without_roles(builder: FieldBuilder, slot: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return slots without the numbers that `with_roles` adds, and whether a number was added."""
    n = len(builder.left)
    return np.where(slot >= n, slot - n, slot), slot >= n


def _with_slots(tile: TileCandidates, slots: np.ndarray, n: int) -> tuple[TileCandidates, np.ndarray]:
    """Return the candidates and slots of a tile with a target for the copies of each target (see `with_reused`)."""
    rows, k = np.unique(-2 - tile.target[tile.target < -1]), len(slots)

    def moved(target):
        shifted = np.where(target < k, target, target + len(rows))  # blank sky positions are the last targets
        return np.where(target < -1, k + np.searchsorted(rows, -2 - target), shifted).astype(np.int32)

    tile = tile._replace(target=moved(tile.target), pairs=(tile.pairs[0], moved(tile.pairs[1])))
    return tile, np.append(slots, slots[rows] + n)


def classes_of(request) -> tuple[np.ndarray, list[str]]:
    """Return the class of each target in the order of slots, and the name of each class, which is its priority.

    The classes are the required targets, if there are any, and the distinct priorities of the other targets with
    requested visits, largest first. The class of standards and sky positions is the number of classes.
    """
    builder = request.builder
    priority, wanted, required = request.source.by_slot("priority"), builder.left > 0, builder.is_required
    wanted = wanted if builder.spends is None else wanted & builder.spends
    first = np.zeros(len(wanted), dtype=bool) if required is None else required & wanted
    not_required = wanted & ~first
    if priority is None or not not_required.any():
        class_of, names = np.zeros(len(wanted), dtype=np.int64), ["all"]
    else:
        values = np.unique(priority[not_required])[::-1]
        class_of, names = np.searchsorted(-values, -priority), [exact_text(value) for value in values]
    if first.any():
        class_of, names = np.where(first, 0, class_of + 1), ["required", *names]
    last = len(names) - 1
    return np.where(builder.spends is None or builder.spends, np.clip(class_of, 0, last), last + 1), names


def place(network: Network, plans: list[TilePlan]) -> np.ndarray:
    """Return the planned candidate of each positioner, or its idle arm if the planned target is not a candidate."""
    slot, side = (np.concatenate([getattr(plan, name) for plan in plans]) for name in ("slot", "side"))
    positioner = network.positioner
    same = np.append(network.slot, -1)[network.target] == slot[positioner]
    fits = same & (network.side == side[positioner]) & (network.target >= 0)
    chosen = network.start[1:] - 1
    rows = np.flatnonzero(fits)
    chosen[positioner[rows]] = rows
    return chosen


def plans_of(network: Network, chosen: np.ndarray) -> list[TilePlan]:
    """Return the plans of all tiles in which each positioner uses the candidate in ``chosen``."""
    target = network.target[chosen]
    slot = np.append(network.slot, -1)[target]
    side = network.side[chosen]
    return [TilePlan(slot[a:b], side[a:b]) for a, b in zip(network.first[:-1], network.first[1:], strict=True)]


def given_plan(request, job: Job, plan: TilePlan, *, is_new: bool = False) -> Job:
    """Return a copy of the job whose allocator returns the given plan; new plans may change where arms have no path."""
    slot, is_other = without_roles(request.builder, plan.slot)
    if is_other.any():
        field = request.builder.in_other_roles(job.field, np.isin(job.field.slot, slot[is_other]))
        job = job._replace(field=field)
    given = GivenPlan(_rows(job.field.slot, slot), plan.side, plan.blank_mm, avoids_collisions=is_new)
    return _with_allocator(request, job, given)


def _with_allocator(request, job: Job, allocator: Callable) -> Job:
    """Return a copy of the job with another allocator, and without subpriorities, which would sort the targets."""
    options = replace(request.options, allocator=allocator, subpriority=None)
    targets = job.field.targets
    targets = targets._replace(columns=targets.columns._replace(subpriority=None))
    return job._replace(model=replace(job.model, options=options), field=job.field._replace(targets=targets))


def _rows(slots: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """Return the index of each slot of ``wanted`` in the array ``slots``; blank sky positions follow, -1 remains -1."""
    order = np.argsort(slots, kind="stable")
    index = order[np.minimum(np.searchsorted(slots[order], wanted), max(len(slots) - 1, 0))] if len(slots) else wanted
    if not np.isin(wanted[wanted >= 0], slots).all():
        raise RuntimeError("a joint plan must contain only targets of the field of each tile")
    return np.where(wanted >= 0, index, np.where(wanted == -1, -1, len(slots) - 2 - wanted))


def goals_of(request, network: Network, subpriority: np.ndarray | None) -> list[np.ndarray]:
    """Return the goals after the visits, with a value from 0 to 1 for each candidate.

    They are the sum of the subpriorities of all visits and, if requested, the number of visits in early passes.
    """
    real, goals = network.rank < network.n_classes, []
    if subpriority is not None:
        slot = np.where(real, np.append(network.slot, -1)[network.target], -1)  # blank sky has no subpriority
        value = np.append(subpriority, 0.0)[slot]
        low, high = value[real].min(initial=np.inf), value[real].max(initial=-np.inf)
        goals.append(np.where(real, (value - low) / max(high - low, 1e-300), 0.0))
    if request.joint.early:
        number = np.repeat(request.number, np.diff(network.first))[network.positioner]
        goals.append(np.where(real, 1.0 - number / max(len(request.passes) - 1, 1), 0.0))
    return goals


log = logging.getLogger("rfpsurvey")
STATE = "joint/state.npz"
"""File of the state of the search in the folder of a survey."""


@dataclass(frozen=True, eq=False)
class PlannedRequest(Request):
    """The request of a survey in which the plan of each tile is already known."""

    plans: list[TilePlan] = field(default_factory=list)
    fixed: dict = field(default_factory=dict)
    is_planned = True

    def job(self, tile: int, left: np.ndarray):
        """Return the job that makes a tile from its known plan."""
        if tile in self.fixed:  # the targets of this tile may have no remaining visits
            job = super().job(tile, self.builder.left)
            return given_plan(self, job, self.fixed[tile])
        return given_plan(self, super().job(tile, left), self.plans[tile], is_new=True)


def plan_jointly(request: Request, folder, executor, progress) -> tuple[Request, QTable, object]:
    """Plan all tiles together; return a request with these plans, and a table of the iterations of the search.

    Parameters
    ----------
    request : Request
        The request of the survey.
    folder : Folder or None
        Folder for the state of the search.
    executor : Executor or None
        Executor that plans tiles and solves integer programs in parallel.
    progress : bool or callable
        Whether and how to show the progress, as in `plan_survey`.

    Returns
    -------
    planned : PlannedRequest
        The request with the plan of each tile.
    table : QTable
        Table with a row for each iteration and priority.
    progress : bool or callable
        The value of ``progress`` for the step after the search, in which the tiles are written.
    """
    n, n_positioners = len(request.tiling), len(request.instrument.focal_plane)
    (class_of, names), has_cadences = classes_of(request), request.cadences is not None
    is_finished = request.joint.objective != "visits" and not has_cadences
    folder = None if has_cadences or is_finished else folder
    stored = None if folder is None else read_state(folder, n, n_positioners, len(levels_of(len(names))))
    fixed = fixed_tiles(request)
    before = _state_after(request, fixed)
    tell, steps = progress, n + request.joint.iterations + 1
    if callable(progress):  # the search and the writing of the tiles report the same total number of steps
        tell, progress = (partial(_tell, progress, before, steps + n) for before in (0, steps))
    with Progress(tell, steps, "steps") as tell:
        if stored is None:
            note = "planning one tile after the other"
            plans = first_plans(request, fixed, executor, partial(tell, note=note))
        else:
            slots, sides = (stored[name].reshape(n, n_positioners) for name in ("slot", "side"))
            plans = list(map(TilePlan, slots, sides))
            tell(n, new=False)
        starts, chosen, exposures, shares = [plans], None, None, None
        if is_finished:
            exposures, shares, others, chosen = _finish_exposures(request, plans, fixed)
            starts += others
        first = starts[0 if chosen is None else -1]
        network, directions, subpriority = list_all(request, first, fixed, executor, chosen)
        goals = [] if has_cadences or is_finished else goals_of(request, network, subpriority)
        chosen, *others = (place(network, plans) for plans in starts)
        if has_cadences:
            search = WindowSearch(network, chosen, request, before)
        elif is_finished:
            search = FinishedSearch(network, (chosen, *others), request, directions, shares, exposures)
        else:
            search = Search(network, chosen, directions, request.joint, request.seed, stored, len(goals))
        is_complete = (request.builder.wanted > 0) & ((request.builder if is_finished else before).left == 0)
        category = request.source.by_slot("category")
        category = category if category is None else category[is_complete]
        worth = worth_of(request.joint.objective, request.builder.wanted[is_complete], category)
        worth = np.bincount(class_of[is_complete], worth, minlength=len(names))
        search.complete_before = np.cumsum(worth)[search.levels]
        if stored is None:
            search.begin()
            if request.joint.inform is not None:
                numbers = {"visits_before": search.steps[0].visits, "visits": search.visits, "bound": search.bounds}
                request.joint.inform({name: values.tolist() for name, values in numbers.items()})
            _store(folder, network, search)
        while not search.is_over:
            search.iterate(executor)
            tell(n + search.iteration, note=f"largest gap {search.gaps.max():.3%}")
            _store(folder, network, search)
        if goals:
            search.finish(executor, goals)
        elif is_finished:
            search.add_visits()
        tell(steps)
    log.info("planned %d tiles together in %d iterations", n, search.iteration)
    known = {f.name: getattr(request, f.name) for f in fields(request)}
    planned = PlannedRequest(**known, plans=plans_of(network, search.chosen), fixed=fixed)
    return planned, table_of(search, names), progress


def _tell(progress, before: int, total: int, done: float, _) -> None:
    """Report the progress of a stage of the computation; the stage begins after ``before`` of ``total`` steps."""
    progress(before + done, total)


def _store(folder, network, search: Search) -> None:
    """Write the state of a search to the folder of a survey, if there is one."""
    if folder is None:
        return
    plans = plans_of(network, search.chosen)
    seconds = search.seconds if np.isfinite(search.options.seconds) else 0.0  # files of equal searches are equal
    columns = {name: np.concatenate([getattr(plan, name) for plan in plans]) for name in ("slot", "side")}
    columns |= {"size": np.diff(network.first), "numbers": np.array([search.size, search.iteration, seconds])}
    columns |= {"bounds": search.bounds, "next_size": search.next_size}
    columns["steps"] = np.array([[step.iteration, *step.visits, *step.bound] for step in search.steps])
    if len(search.limits):
        columns |= {"bounds_of_all": search.bounds_of_all, "limits": search.limits}
    columns |= {f"price{k}": prices.price for k, prices in enumerate(search.prices) if prices is not None}
    content = io.BytesIO()
    np.savez(content, **columns)
    folder.put_file(STATE, content.getvalue())


def read_state(folder, n_tiles: int, n_positioners: int, n_levels: int) -> dict[str, np.ndarray] | None:
    """Return the arrays of the stored state of a search; None if there is no state, or if it is damaged."""
    per_level, per_set, n = ("f8", (n_levels,)), ("f8", (None,)), n_tiles * n_positioners
    expected = {"slot": ("i8", (n,)), "side": ("i1", (n,)), "numbers": ("f8", (3,))}
    expected |= {"bounds": per_level, "next_size": per_level, "steps": ("f8", (None, 1 + 2 * n_levels))}
    expected |= {"bounds_of_all?": per_level, "limits?": per_set, **{f"price{k}?": per_set for k in range(n_levels)}}
    stored = folder.load(STATE.removesuffix(".npz"), **expected)
    if stored is None:
        return None
    if all(np.isfinite(stored[name]).all() for name in ("numbers", "next_size")) and stored["numbers"].min() >= 0:
        return stored
    warn("the search for a joint plan starts again, because its stored state must contain finite numbers, got others")
    return None
