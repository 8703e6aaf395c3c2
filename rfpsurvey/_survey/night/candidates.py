"""The tiles of which a night is made: those of a survey that remain, with their merits, and those of a table."""

import json
from typing import NamedTuple

import astropy.units as u
import numpy as np
from astropy.table import QTable

from rfpsurvey._common.units import to_numbers
from rfpsurvey._instruments.instrument import Instrument
from rfpsurvey._sky.arrays import has_role
from rfpsurvey._survey.columns import NOT_PLANNED
from rfpsurvey._survey.night.merits import merit_of
from rfpsurvey._survey.survey import Survey
from rfpsurvey._survey.tiling.centers import neighbors_within
from rfpsurvey._survey.tiling.tiling import Tiling, as_tiling
from rfpsurvey.errors import InputError

WAITS, LATER, NOTHING = "waits for an earlier pass", "planned for another date", "merit 0"
"""Reasons why a tile of a survey is no candidate; other tiles have their state as the reason."""


DONE = {"done": "observed"} | {word: word for word in NOT_PLANNED}
"""States of tiles that are not observed any more, and the reasons."""


class Candidates(NamedTuple):
    """Tiles of which a night is made, their merits, and the reasons of other tiles by name."""

    tiling: Tiling
    merit: np.ndarray
    excluded: dict[str, str]


def candidates_of(
    tiles: object, merit: object, in_passes: bool, noon: float, instrument: Instrument | None
) -> Candidates:
    """Return the tiles that can be observed in a night, according to the state of the survey and its rules.

    Parameters
    ----------
    tiles : Survey, Tiling, SkyCoord or QTable
        The survey or the tiles.
    merit : str, callable or None
        As in `rfpsurvey.night.plan_night`.
    in_passes : bool
        Whether a tile waits for tiles of earlier passes with which it overlaps.
    noon : float
        Modified Julian date at which the night begins, which takes 24 hours.
    instrument : Instrument or None
        Instrument, whose field radius determines which tiles overlap.

    Returns
    -------
    Candidates
        The tiles.
    """
    if isinstance(tiles, Survey):
        table, reason = _of_survey(tiles, noon)
        tiling, done = Tiling(table), np.isin(reason.astype(str), [*DONE.values()])
    else:
        tiling = as_tiling(tiles)
        table, reason, done = tiling.table, np.full(len(tiling), "", dtype=object), np.zeros(len(tiling), dtype=bool)
        if merit is not None and not callable(merit):
            raise InputError(f"merit must be a column or a function for tiles without a survey, got {merit!r}")
    if in_passes:
        reason[(reason == "") & _waiting(tiling, done, instrument)] = WAITS
    rows = np.flatnonzero(reason == "")
    if isinstance(tiles, Survey):
        values = merit_of("visits" if merit is None else merit, _with_visits(tiles, table, rows))
    elif merit is not None:
        values = merit_of(merit, QTable(table[rows]))
    else:
        given = (
            to_numbers(table["merit"], "merit", unitless=True) if "merit" in table.colnames else np.ones(len(tiling))
        )
        if given.ndim > 1 or not (np.isfinite(given) & (given >= 0)).all():
            raise InputError("merit must be one finite number of at least 0 for every tile")
        values = given[rows]
    reason[rows[values == 0]] = NOTHING
    rows, values = rows[values > 0], values[values > 0]
    names = tiling.table["tile"]
    excluded = {str(names[row]): str(reason[row]) for row in np.flatnonzero(reason != "")}
    return Candidates(Tiling(tiling.table[rows]), values, excluded)


def _of_survey(survey: Survey, noon: float) -> tuple[QTable, np.ndarray]:
    """Return the table of tiles of a survey, and the reason why each tile is no candidate."""
    if survey.folder is None:
        raise InputError("tiles must be a survey in a folder, or a table of tiles, got a survey that has no folder")
    state = survey.state()
    if json.loads(json.dumps(state.record)) != survey.provenance.get(
        "events", state.record if not state.events.files else None
    ):
        raise InputError(
            f"{survey.folder} must be planned with all events that were recorded; plan the rest with Survey.replan, "
            "rfpsurvey survey FOLDER --replan, or rfpsurvey night FOLDER --update"
        )
    reason = np.array([DONE.get(word, "") for word in survey._states], dtype=object)
    if state.cadences is not None:
        times = state.given[3].times
        due = (times.utc.mjd >= noon) & (times.utc.mjd < noon + 1)
        reason[: len(due)][(reason[: len(due)] == "") & ~due] = LATER
    return survey.tiles, reason


def _with_visits(survey: Survey, table: QTable, rows: np.ndarray) -> QTable:
    """Return tiles with the numbers of visits that are planned, in total and for each priority, highest first."""
    plans = [survey._visits(int(row)) for row in rows]
    of = np.repeat(np.arange(len(rows)), [len(plan) for plan in plans])
    counted = np.concatenate([np.zeros(0, dtype=bool), *map(_of_science, plans)])
    has_classes = all("priority" in plan.colnames for plan in plans)
    priority = np.concatenate([np.zeros(0), *(np.asarray(plan["priority"]) for plan in plans if has_classes)])
    priority = priority if has_classes else np.zeros(len(of))
    values, which = np.unique(-priority[counted], return_inverse=True)
    numbers = np.zeros((len(rows), max(1, len(values))), dtype=np.int64)
    np.add.at(numbers, (of[counted], which), 1)
    chosen = QTable(table[rows])
    chosen["n_visits"], chosen["n_by_class"] = numbers.sum(axis=1), numbers
    return chosen


def _of_science(visits: QTable) -> np.ndarray:
    """Return which visits of a tile are made to science targets."""
    counted = np.asarray(visits["observed"]).astype(bool) & (np.asarray(visits["target_row"]) >= 0)
    return counted & has_role(np.asarray(visits["kind"]), "science") if "kind" in visits.colnames else counted


def _waiting(tiling: Tiling, done: np.ndarray, instrument: Instrument | None) -> np.ndarray:
    """Return which tiles overlap with a tile of an earlier pass that is not finished."""
    if instrument is None:
        raise InputError(
            "instrument must be given for tiles in passes, because its field determines which tiles overlap"
        )
    vectors, number = tiling.coord.cartesian.xyz.value.T, np.asarray(tiling.table["pass"])
    indptr, near = neighbors_within(vectors, 2 * instrument.field_radius.to_value(u.rad))
    row = np.repeat(np.arange(len(tiling)), np.diff(indptr))
    waiting = np.zeros(len(tiling), dtype=bool)
    waiting[row[(number[near] < number[row]) & ~done[near]]] = True
    return waiting
