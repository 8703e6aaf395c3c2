"""Plan all tiles of a survey together, and make a request that contains the plan of each tile."""

import io
import logging
from dataclasses import dataclass, field, fields
from functools import partial

import numpy as np
from astropy.table import QTable

from rfpsurvey._progress import Progress
from rfpsurvey.errors import warn
from rfpsurvey.survey._joint._fixed import TilePlan, fixed_tiles
from rfpsurvey.survey._joint._search import Search, levels_of
from rfpsurvey.survey._joint._start import classes_of, first_plans, given_plan, goals_of, list_all, place, plans_of
from rfpsurvey.survey._joint._windows import WindowSearch
from rfpsurvey.survey._request import Request

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
        return given_plan(self, super().job(tile, left), self.plans[tile])


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
    names, has_cadences = classes_of(request)[1], request.cadences is not None
    folder = None if has_cadences else folder
    stored = None if folder is None else read_state(folder, n, n_positioners, len(levels_of(len(names))))
    fixed = fixed_tiles(request)
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
        network, directions, subpriority = list_all(request, plans, fixed, executor)
        goals = [] if has_cadences else goals_of(request, network, subpriority)
        chosen = place(network, plans)
        if has_cadences:
            search = WindowSearch(network, chosen, request)
        else:
            search = Search(network, chosen, directions, request.joint, request.seed, stored, len(goals))
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


def table_of(search: Search, names: list[str]) -> QTable:
    """Return a table with a row for each iteration and priority; its meta contains the values of the last iteration."""
    rows = []
    for step in search.steps:
        for k, level in enumerate(search.levels.tolist()):
            visits, bound = int(step.visits[k]), max(float(step.bound[k]), float(step.visits[k]))
            gap = 1.0 - visits / bound if bound else 0.0
            row = step.iteration, names[level], visits, int(bound), gap, round(step.seconds, 2)
            if step.complete is not None:
                row += int(step.complete[k]), int(max(step.complete[k], step.bound_complete[k]))
            rows.append(row)
    columns = ("iteration", "priority", "n_visits", "bound", "gap", "seconds", "n_complete", "bound_complete")
    table, levels, n = QTable(rows=rows, names=columns[: len(rows[0])]), [], len(search.levels)
    for k, (before, row) in enumerate(zip(rows[:n], rows[-n:], strict=True)):
        level = {"priority": row[1], "n_visits_before": before[2], "n_visits": row[2], "bound": row[3], "gap": row[4]}
        level |= dict(zip(columns[6:], row[6:], strict=False))
        if len(search.limits):
            level["bound_without_requirements"] = int(max(search.bounds_of_all[k], search.visits[k]))
        levels.append(level)
    gap = max(level["gap"] for level in levels)
    table.meta["summary"] = {"n_iterations": search.iteration, "levels": levels, "gap": gap}
    return table
