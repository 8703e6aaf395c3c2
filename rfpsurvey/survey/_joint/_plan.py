"""Plan all tiles of a survey together, and make a request whose tiles have the plans that were found."""

import logging
from dataclasses import dataclass, field, fields

import numpy as np
from astropy.table import QTable

from rfpsurvey._progress import Progress
from rfpsurvey.survey._joint._search import Search
from rfpsurvey.survey._joint._start import (
    TilePlan,
    class_names,
    first_plans,
    given_plan,
    list_all,
    place,
    plans_of,
)
from rfpsurvey.survey._joint._state import read_state, write_state
from rfpsurvey.survey._request import Request

__all__ = ["Together"]

log = logging.getLogger("rfpsurvey")


@dataclass(frozen=True, eq=False)
class PlannedRequest(Request):
    """The request of a survey whose tiles have given plans."""

    plans: list[TilePlan] = field(default_factory=list)

    def job(self, tile: int, left: np.ndarray, *, as_file: bool):
        """Return the job that makes the tile with its given plan."""
        return given_plan(self, super().job(tile, left, as_file=as_file), self.plans[tile])


class Together:
    """The joint plan of a survey.

    Parameters
    ----------
    executor : Executor or None
        Executor for the programs.
    progress : bool or callable
        As in `plan_survey`.
    begun : callable, optional
        Function that is called with a dict before the first iteration: the visits of the tiles planned one after the
        other, and the bound of a matching without collisions, for each level.
    """

    def __init__(self, executor, progress, begun=None):
        self._executor, self._progress, self._begun = executor, progress, begun

    def __call__(self, request: Request, folder) -> tuple[Request, QTable]:
        """Return a request with the plans of all tiles, and the table of iterations."""
        n, most = len(request.tiling), request.joint.iterations
        stored = None if folder is None else read_state(folder)
        with Progress(self._progress, n + most + 1, "steps") as tell:
            if stored is None:
                plans = first_plans(request, self._executor, lambda done: tell(done, note="tiles one after the other"))
            else:
                plans = [TilePlan(*columns) for columns in stored.plans]
                tell(n, new=False)
            network, directions = list_all(request, plans, self._executor)
            chosen = place(network, plans)
            search = Search(network, chosen, directions, request.joint, request.seed)
            if stored is not None:
                search.restore(stored)
            else:
                search.begin(self._tell_gain)
                _store(folder, network, search)
            while not search.is_over:
                search.iterate(self._executor)
                tell(n + search.iteration, note=f"largest gap {search.gaps.max():.3%}")
                _store(folder, network, search)
            tell(n + most + 1)
        log.info("planned %d tiles together in %d iterations", n, search.iteration)
        columns = {f.name: getattr(request, f.name) for f in fields(request)}
        planned = PlannedRequest(**columns, plans=plans_of(network, search.chosen))
        return planned, table_of(search, class_names(request))

    def _tell_gain(self, search: Search) -> None:
        if self._begun is not None:
            self._begun({"visits": search.visits.tolist(), "bound": search.bounds.tolist()})


def _store(folder, network, search) -> None:
    """Write the state of the search to the folder."""
    if folder is not None:
        write_state(folder, plans_of(network, search.chosen), search)


def table_of(search: Search, names: list[str]) -> QTable:
    """Return the table of iterations, with a row for each iteration and level; the last state is in its meta."""
    rows = []
    for step in search.steps:
        for k, level in enumerate(search.levels.tolist()):
            visits, bound = int(step.visits[k]), max(float(step.bound[k]), float(step.visits[k]))
            gap = 1.0 - visits / bound if bound else 0.0
            rows.append((step.iteration, names[level], visits, int(bound), gap, round(step.seconds, 2)))
    table = QTable(rows=rows, names=("iteration", "priority", "n_visits", "bound", "gap", "seconds"))
    last = rows[-len(search.levels) :]
    first = rows[: len(search.levels)]
    table.meta["summary"] = {
        "n_iterations": search.iteration,
        "levels": [
            {"priority": name, "n_visits_before": before[2], "n_visits": visits, "bound": bound, "gap": gap}
            for before, (_, name, visits, bound, gap, _) in zip(first, last, strict=True)
        ],
        "gap": max((row[4] for row in last), default=0.0),
    }
    return table
