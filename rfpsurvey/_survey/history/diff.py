"""The differences of two surveys: tiles and fibers that changed, and the reason of each change."""

import os
from functools import cached_property
from pathlib import Path

import numpy as np
from astropy.table import QTable

from rfpsurvey._common.descriptions import Column, describe, table_of
from rfpsurvey._common.folder import check_file
from rfpsurvey._survey.columns import NOT_PLANNED, PAST
from rfpsurvey._survey.folder import kept_name, parse_visits, part_name, read_request, verified
from rfpsurvey._survey.generations import generations_of, read_plans
from rfpsurvey._survey.history.event_files import read_events
from rfpsurvey._survey.history.events import WORDS, Events, TileState, places_of
from rfpsurvey._survey.history.replay import Replay, replay_of_plan
from rfpsurvey._survey.history.state import SurveyState
from rfpsurvey._survey.history.targets import DROPPED, ROW
from rfpsurvey._survey.survey import Survey
from rfpsurvey.errors import InputError, refusal

DIFF = table_of(
    Column("tile", "identifier of the tile"),
    Column("positioner", "identifier of the positioner; empty for a change of the whole tile"),
    Column("before", "target of the positioner in the first survey; empty if there is none"),
    Column("after", "target of the positioner in the second survey; empty if there is none"),
    Column("reason", "reason of the change"),
)
STATES = WORDS | {TileState.PLANNED: "planned again", PAST: PAST}
REASONS = (
    "other catalog",
    "target dropped",
    "target complete",
    "target added",
    "failed visit",
    "priority changed",
    "visits changed",
)
"""Reasons of changes of fibers; the first one that applies is given, and "other plan" if none applies."""
OTHER = "other plan"
NO_TARGET = -2
"""Row of the target of a positioner without a target; the row of blank sky is -1."""


def diff_surveys(first: Survey | str | os.PathLike, second: Survey | str | os.PathLike) -> QTable:
    """Return the tiles and fibers that differ between two plans of a survey, with the reason of each difference.

    Parameters
    ----------
    first, second : Survey or path-like
        Two surveys, or their folders, such as a copy of a survey, and the survey that was planned again.

    Returns
    -------
    QTable
        Table with a row for each tile whose state or position differs, and for each positioner of a tile that has
        another target. Columns: ``tile``, ``positioner`` (empty for a change of the whole tile), ``before`` and
        ``after`` (identifiers of the targets as text; empty if there is none), and ``reason``. Reasons for tiles:
        ``observed``, ``partly observed``, ``dropped``, ``planned again``, ``added``, ``removed``, ``moved``. Reasons
        for fibers, of which the first one that applies is given: ``other catalog``, ``target dropped``, ``target
        complete`` (the previous target needs no visit any more), ``target added`` (the new target is new),
        ``failed visit`` (of the new target), ``priority changed``, ``visits changed`` (the number of requested visits),
        and ``other plan``. If the plans are equal, the table has no rows. ``meta["n_later_files"]`` contains, for each
        survey, the number of files of events after its plan, which are not compared.

    Raises
    ------
    InputError
        If a folder does not contain a finished survey, or if a file is damaged.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astropy.coordinates import SkyCoord
    >>> import rfpsurvey as rs
    >>> sky = rs.synthetic_catalog("uniform", SkyCoord("6h20m +23d"), 0.3 * u.deg, n_targets=4000, rng=1)
    >>> survey = rs.plan_survey(sky, "moons", SkyCoord(["6h20m"], ["+23d"]))
    >>> len(rs.survey.diff_surveys(survey, survey))
    0
    """
    earlier, later = _Side(first, "first"), _Side(second, "second")
    changes, compared = {name: [] for name in (*earlier.row_of, *later.row_of)}, []
    for name, parts in changes.items():
        if not (name in earlier.row_of and name in later.row_of):
            parts.append(_changes(name, ["added" if name in later.row_of else "removed"]))
            continue
        rows = earlier.row_of[name], later.row_of[name]
        states = earlier.survey._states[rows[0]], later.survey._states[rows[1]]
        reasons = [] if states[0] == states[1] else [STATES[states[1]]]
        reasons += [] if earlier.places[rows[0]] == later.places[rows[1]] else ["moved"]
        parts.append(_changes(name, reasons))
        if {*NOT_PLANNED} & {*states}:
            continue
        digests = earlier.digest(rows[0]), later.digest(rows[1])
        if digests[0] is None or digests[0] != digests[1]:
            compared.append((name, rows))
    for _, rows in compared:  # the priorities in all plans that differ are known before fibers are compared
        earlier.see(rows[0]), later.see(rows[1])
    for name, rows in compared:
        changes[name].append(_fibers(name, earlier, rows[0], later, rows[1]))
    table = _table([part for parts in changes.values() for part in parts], earlier, later)
    table.meta = {
        "made_by": "diff_surveys",
        "n_tiles": [len(earlier.row_of), len(later.row_of)],
        "n_later_files": [earlier.n_later_files, later.n_later_files],
    }
    return table


def diff_generations(survey: Survey, state: SurveyState) -> QTable:
    """Return the fibers that differ between the plan of a survey and the last plan before it that was kept.

    The columns are those of `diff_surveys`. The last generation determines which tiles are compared: those whose plans
    it introduced. ``meta["generation"]`` is its number, and ``meta["unknown"]`` contains the tiles of which no earlier
    plan was kept.
    """
    folder, later = survey.folder, _Side(survey, "second")
    generations, plans = generations_of(folder, read_request(folder)), read_plans(folder)
    number, unknown, replaced, names, former = generations[-1].number, [], {}, [*later.row_of], later
    for name, row in later.row_of.items() if len(generations) > 1 else ():
        *earlier, last = plans.get(part_name(row)) or [None]
        if later.survey._states[row] in NOT_PLANNED or last != (later.digest(row), number):
            continue
        content = verified(folder / kept_name(earlier[-1][0]), earlier[-1][0]) if earlier else None
        if content is None:
            unknown.append(name)
        else:
            replaced[row] = QTable(parse_visits(content, f"the former plan of tile {name}", name)[0])
    if replaced:
        events = later.events, later.events.first(generations[-2].n_files)
        present, before = (SurveyState._of(known, state.given, state.rule, None) for known in events)
        later.requested, former = present.requested, _Former(later, before, replaced)
    for row in replaced:
        former.see(row), later.see(row)
    parts = [_fibers(names[row], former, row, later, row) for row in replaced]
    table = _table([_changes("", []), *parts], former, later)
    table.meta = {"made_by": "diff_generations", "generation": number, "unknown": unknown}
    return table


def _table(parts: list[list[np.ndarray]], earlier: "_Side", later: "_Side") -> QTable:
    """Return the table of parts (see `_changes` and `_fibers`), with the reasons of all changes of fibers."""
    *columns, reasons, before, after = map(np.concatenate, zip(*parts, strict=True))
    if (fiber := columns[1] != "").any():
        of_fibers = _reasons(earlier, later, before[fiber], after[fiber])
        reasons = reasons.astype(np.promote_types(reasons.dtype, of_fibers.dtype))
        reasons[fiber] = of_fibers
    return describe(QTable(dict(zip(DIFF, [*columns, reasons], strict=True))), DIFF)


class _Side:
    """One of the two surveys, and the events with which it was planned."""

    def __init__(self, survey: object, name: str):
        if isinstance(survey, str | os.PathLike):
            survey = Survey.read(survey)
        if not isinstance(survey, Survey):
            raise refusal(f"the {name} survey must be a Survey or the folder of a survey", survey)
        self.survey, tiles = survey, survey.tiles
        events = Events(Path()) if survey.folder is None else read_events(survey.folder)
        self.events = events.of_plan(survey.provenance)
        """The events with which the survey was planned; none if it is not in a folder."""
        self.n_later_files = len(events.files) - len(self.events.files)
        """Number of files of events after the plan, which are not compared."""
        self.row_of = {str(tile): row for row, tile in enumerate(np.asarray(tiles["tile"]).tolist())}
        self.ids, self.requested = np.asarray(survey.outcomes["target_id"]), np.asarray(survey.outcomes["requested"])
        self.priority = np.full(len(self.ids), np.nan)
        self.places = places_of(tiles).tolist()

    def digest(self, row: int) -> str | None:
        """Return the checksum of the plan of a tile, after its file was tested; None if the survey is in memory."""
        if self.survey.folder is None:
            return None
        check_file(self.survey.folder, part_name(row), self.survey._known)
        return self.survey._known[part_name(row)][-1][1]

    def visits(self, row: int) -> QTable:
        """Return the visits of a tile."""
        return self.survey._visits(row)

    def see(self, row: int) -> None:
        """Keep the priorities of the targets of a tile."""
        visits = self.visits(row)
        if "priority" in visits.colnames:
            target = np.asarray(visits["target_row"])
            self.priority[target[target >= 0]] = np.asarray(visits["priority"], dtype=float)[target >= 0]

    @cached_property
    def replayed(self) -> Replay:
        """The visits that were made and failed before the survey was planned."""
        return replay_of_plan(self.survey, self.events)

    @cached_property
    def dropped(self) -> np.ndarray:
        """Whether each target was dropped."""
        dropped = np.zeros(len(self.ids), dtype=bool)
        for _, table in self.events.target_tables:
            state = np.asarray(table[DROPPED])
            dropped[np.asarray(table[ROW])[state >= 0]] = state[state >= 0] == 1
        return dropped


class _Former(_Side):
    """Replaced plans of the tiles in some rows, and the state with which they were made."""

    def __init__(self, later: _Side, state: SurveyState, replaced: dict[int, QTable]):
        self.replaced, self.requested, self.dropped = replaced, state.requested, state.dropped
        self.replayed, self.ids = state.replayed, later.ids[: len(state)]
        self.priority = np.full(len(self.ids), np.nan)

    def visits(self, row: int) -> QTable:
        """Return the visits of the replaced plan of a tile."""
        return self.replaced[row]


def _changes(name: str, reasons: list[str]) -> list[np.ndarray]:
    """Return the columns of rows on changes of a whole tile, and rows of targets as for `_fibers`."""
    n = len(reasons)
    nothing, targets = (np.full(n, value) for value in ("", NO_TARGET))
    return [np.full(n, name), nothing, nothing, nothing, np.array(reasons, dtype=str), targets, targets]


def _fibers(name: str, earlier: _Side, row: int, later: _Side, later_row: int) -> list[np.ndarray]:
    """Return the columns of rows on the fibers of a tile that have another target, and the rows of both targets.

    The reasons are empty.
    """
    visits = earlier.visits(row), later.visits(later_row)
    fibers = [np.asarray(part["positioner"]) for part in visits]
    if fibers[0].dtype.kind != fibers[1].dtype.kind:
        raise InputError("the surveys must have the same instrument, got other identifiers of positioners")
    positioners = np.union1d(*fibers)
    targets, ids = [], []
    for part, names in zip(visits, fibers, strict=True):
        place = np.full(len(positioners), len(part))
        place[np.searchsorted(positioners, names)] = np.arange(len(part))
        targets.append(np.append(np.asarray(part["target_row"]), NO_TARGET)[place])
        ids.append(np.append(np.asarray(part["target_id"]).astype(str), "")[place])
    changed = (targets[0] != targets[1]) | (ids[0] != ids[1])
    tile, reasons = (np.full(np.count_nonzero(changed), text) for text in (name, ""))
    return [
        tile,
        positioners[changed].astype(str),
        *(one[changed] for one in ids),
        reasons,
        *(t[changed] for t in targets),
    ]


def _reasons(earlier: _Side, later: _Side, before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """Return the reason why each fiber has another target."""
    n = min(len(earlier.ids), len(later.ids))
    if earlier.ids.dtype.kind != later.ids.dtype.kind or not np.array_equal(earlier.ids[:n], later.ids[:n]):
        return np.full(len(before), REASONS[0])

    def of(target: np.ndarray, values: np.ndarray) -> np.ndarray:
        """Return the values of targets that both surveys have, and zero for others."""
        return np.where((target >= 0) & (target < n), np.append(values[:n], 0)[np.minimum(target, n)], 0)

    def any_of(values: np.ndarray) -> np.ndarray:
        return of(before, values).astype(bool) | of(after, values).astype(bool)

    made, again = earlier.replayed, later.replayed
    complete = (again.made[:n] >= later.requested[:n]) & (again.made[:n] > made.made[:n])
    both_known = np.isfinite(earlier.priority[:n]) & np.isfinite(later.priority[:n])
    conditions = [
        of(before, later.dropped[:n] & ~earlier.dropped[:n]).astype(bool),
        of(before, complete).astype(bool),
        after >= n,
        of(after, again.failed[:n] > made.failed[:n]).astype(bool),
        any_of(both_known & (earlier.priority[:n] != later.priority[:n])),
        any_of(earlier.requested[:n] != later.requested[:n]),
    ]
    return np.select(conditions, REASONS[1:], OTHER)
