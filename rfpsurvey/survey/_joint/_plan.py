"""Plan all tiles of a survey together, and make a request that contains the plan of each tile."""

import logging
from dataclasses import dataclass, field, fields
from functools import partial

import numpy as np
from astropy.table import QTable

from rfpsurvey._progress import Progress
from rfpsurvey.survey._joint._fixed import fixed_tiles
from rfpsurvey.survey._joint._search import Search, levels_of
from rfpsurvey.survey._joint._start import (
    TilePlan,
    classes_of,
    first_plans,
    given_plan,
    goals_of,
    list_all,
    place,
    plans_of,
)
from rfpsurvey.survey._joint._state import read_state, write_state
from rfpsurvey.survey._joint._windows import WindowSearch
from rfpsurvey.survey._request import Request

log = logging.getLogger("rfpsurvey")


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


def plan_together(request: Request, folder, executor, progress) -> tuple[Request, QTable, object]:
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
    if request.cadences is not None:
        return _plan_windows(request, executor, progress)
    n, n_positioners = len(request.tiling), len(request.instrument.focal_plane)
    names = classes_of(request)[1]
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
            plans = [TilePlan(*columns) for columns in stored.plans]
            tell(n, new=False)
        network, directions, subpriority = list_all(request, plans, fixed, executor)
        goals = goals_of(request, network, subpriority)
        given = request.joint, request.seed, stored, len(goals)
        search = Search(network, place(network, plans), directions, *given)
        if stored is None:
            search.begin(partial(_inform, request.joint.inform))
            _store(folder, network, search)
        while not search.is_over:
            search.iterate(executor)
            tell(n + search.iteration, note=f"largest gap {search.gaps.max():.3%}")
            _store(folder, network, search)
        search.finish(executor, goals)
        tell(steps)
    log.info("planned %d tiles together in %d iterations", n, search.iteration)
    return _planned(request, plans_of(network, search.chosen), fixed), table_of(search, names), progress


def _plan_windows(request: Request, executor, progress) -> tuple[Request, QTable, object]:
    """Plan dated tiles with cadences; the parameters and results are those of `plan_together`."""
    n, last = len(request.tiling), request.joint.iterations + 1
    tell = progress
    if callable(progress):
        tell, progress = (partial(_tell, progress, before, 2 * n + last) for before in (0, n + last))
    with Progress(tell, n + last, "steps") as tell:
        plans = first_plans(request, {}, executor, partial(tell, note="planning one tile after the other"))
        network = list_all(request, plans, {}, executor)[0]
        search = WindowSearch(network, place(network, plans), request)
        search.begin()
        _inform(request.joint.inform, search)
        while not search.is_over:
            search.iterate()
            tell(n + search.iteration, note=f"largest gap {search.gaps.max():.3%}")
        tell(n + last)
    planned = _planned(request, plans_of(network, search.chosen), {})
    return planned, table_of(search, classes_of(request)[1]), progress


def _planned(request: Request, plans: list[TilePlan], fixed: dict) -> PlannedRequest:
    """Return the request with the plan of each tile."""
    return PlannedRequest(**{f.name: getattr(request, f.name) for f in fields(request)}, plans=plans, fixed=fixed)


def _tell(progress, before: int, total: int, done: float, _) -> None:
    """Report the progress of a stage of the computation; the stage begins after ``before`` of ``total`` steps."""
    progress(before + done, total)


def _inform(inform, search: Search) -> None:
    """Call the function ``inform`` with the numbers of visits and their upper bounds before the first iteration."""
    if inform is not None:
        before = search.steps[0].visits.tolist()
        inform({"visits_before": before, "visits": search.visits.tolist(), "bound": search.bounds.tolist()})


def _store(folder, network, search) -> None:
    """Write the state of the search to the folder."""
    if folder is not None:
        write_state(folder, plans_of(network, search.chosen), search)


def table_of(search: Search, names: list[str]) -> QTable:
    """Return a table with a row for each iteration and priority; its meta contains the values of the last iteration."""
    rows = []
    for step in search.steps:
        for k, level in enumerate(search.levels.tolist()):
            visits, bound = int(step.visits[k]), max(float(step.bound[k]), float(step.visits[k]))
            gap = 1.0 - visits / bound if bound else 0.0
            rows.append((step.iteration, names[level], visits, int(bound), gap, round(step.seconds, 2)))
    table = QTable(rows=rows, names=("iteration", "priority", "n_visits", "bound", "gap", "seconds"))
    if search.steps[-1].complete is not None:
        of_steps = [(step.complete, np.maximum(step.complete, step.bound_complete)) for step in search.steps]
        columns = (np.concatenate(values) for values in zip(*of_steps, strict=True))
        for name, values in zip(("n_complete", "bound_complete"), columns, strict=True):
            table[name] = values.astype(np.int64)
    n = len(search.levels)
    first, last, others = rows[:n], rows[-n:], {name: table[name][-n:] for name in table.colnames[6:]}
    if len(search.limits):
        others["bound_without_requirements"] = np.maximum(search.bounds_of_all, search.visits)
    more = [{name: int(values[k]) for name, values in others.items()} for k in range(n)]
    table.meta["summary"] = {
        "n_iterations": search.iteration,
        "levels": [
            {"priority": name, "n_visits_before": before[2], "n_visits": visits, "bound": bound, "gap": gap, **other}
            for before, (_, name, visits, bound, gap, _), other in zip(first, last, more, strict=True)
        ],
        "gap": max((row[4] for row in last), default=0.0),
    }
    return table
