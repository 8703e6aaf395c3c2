"""The state of a survey: the visits of all targets that were made and remain, and the states of all tiles."""

import os
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from astropy.table import QTable

from rfpsurvey._common import io as _io
from rfpsurvey._common.units import to_visits
from rfpsurvey._sky.arrays import has_role
from rfpsurvey._sky.catalog import Catalog
from rfpsurvey._sky.partitions import PartitionedCatalog, as_catalog
from rfpsurvey._survey.folder import read_request
from rfpsurvey._survey.history.event_files import read_events
from rfpsurvey._survey.history.events import Events, TileEvent, TileState, add_tiles, to_date
from rfpsurvey._survey.history.replay import Replay, TileStates, last_results, replay, state_table
from rfpsurvey._survey.history.rule import VisitRule
from rfpsurvey._survey.history.targets import apply_changes
from rfpsurvey._survey.source import check_first_catalog, columns_of, digest_of, in_memory, is_same, is_science
from rfpsurvey._survey.tiling.tiling import Tiling
from rfpsurvey.errors import InputError, number_of, refusal, warn


@dataclass(frozen=True, eq=False)
class SurveyState:
    """The state of a survey that follows from its plans and from the events that were recorded.

    `rfpsurvey.Survey.state` makes this object. As the parameter ``visits`` of `rfpsurvey.plan_survey`, it determines
    which tiles are planned, and how many visits of each target remain.

    Parameters
    ----------
    catalog : Catalog or PartitionedCatalog
        The targets, including those that were added, with the priorities that follow from the rule.
    requested, observed, failed, left : ndarray of uint8, shape (n_targets,)
        Numbers of visits of each target: requested, successful, failed, and remaining.
    events : Events
        The recorded events.
    rule : VisitRule
        The rule.
    until : str or None
        Date of the last events that are taken into account; None if all events are.
    replayed : Replay
        The visits of all targets that follow from the observations.
    states : TileStates
        The states of all tiles.
    dropped : ndarray of bool, shape (n_targets,)
        Whether each target was dropped.
    given : tuple
        The catalog of the first plan, the requested visits that were given with it, and the required targets.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astropy.coordinates import SkyCoord
    >>> from tempfile import TemporaryDirectory
    >>> import rfpsurvey as rs
    >>> sky = rs.synthetic_catalog("uniform", SkyCoord("6h20m +23d"), 0.3 * u.deg, n_targets=4000, rng=1)
    >>> with TemporaryDirectory() as folder:
    ...     survey = rs.plan_survey(sky, "desi", SkyCoord(["6h20m"], ["+23d"]), folder=f"{folder}/survey")
    ...     said = survey.record([{"tile": 0, "date": "2026-01-03"}])
    ...     state = survey.state(sky)
    >>> bool(state.observed.sum() == survey.summary["n_visits_observed"])
    True
    """

    catalog: Catalog | PartitionedCatalog
    requested: np.ndarray
    observed: np.ndarray
    failed: np.ndarray
    left: np.ndarray
    events: Events
    rule: VisitRule
    until: str | None = None
    replayed: Replay = field(repr=False, default=None)
    states: TileStates = field(repr=False, default=None)
    dropped: np.ndarray = field(repr=False, default=None)
    given: tuple = field(repr=False, default=())

    @classmethod
    def read(
        cls,
        folder: str | os.PathLike,
        catalog: Catalog | PartitionedCatalog,
        *,
        rule: VisitRule | None = None,
        visits: int | np.ndarray | None = None,
        until: str | None = None,
    ) -> "SurveyState":
        """Return the state of the survey in a folder; see `rfpsurvey.Survey.state`.

        Parameters
        ----------
        folder : str or path-like
            The folder of the survey, which can be unfinished.
        catalog : Catalog, PartitionedCatalog, SkyCoord, Table or DataFrame
            The targets of the first plan.
        rule, visits, until : optional
            As in `rfpsurvey.Survey.state`.

        Returns
        -------
        SurveyState
            The state.

        Raises
        ------
        InputError
            As in `rfpsurvey.Survey.state`.
        """
        if folder is None:
            raise InputError("a state needs a survey in a folder, got a survey that was planned without a folder")
        rule = VisitRule() if rule is None else rule
        if not isinstance(rule, VisitRule):
            raise refusal("rule must be a VisitRule", rule)
        catalog = catalog if isinstance(catalog, PartitionedCatalog) else as_catalog(catalog)
        request = read_request(_io.to_path(folder))
        if "cadences" in request:
            raise InputError(f"{folder} holds a survey with cadences, which cannot be continued from what was observed")
        if visits is None and not rule.record:
            _check_visits(request, catalog)
        check_first_catalog(request, catalog, visits, rule)
        until = None if until is None else to_date(until)
        return cls._of(read_events(_io.to_path(folder)), (catalog, visits, request.get("required_ids")), rule, until)

    @classmethod
    def _of(cls, events: Events, given: tuple, rule: VisitRule, until: str | None, *, visited: bool = True):
        """Return the state after events; without ``visited``, as if no visit had been made or had failed."""
        states, (catalog, visits, required) = TileStates(events.of_tiles(until)), given
        dropped = np.zeros(len(catalog), dtype=bool)
        if events.target_tables:
            usual = 1 if visits is None or np.ndim(visits) else int(visits)
            catalog = in_memory(catalog, "events of targets")
            if visits is not None:  # recorded numbers of visits replace these numbers
                catalog, visits = replace(catalog, visits=to_visits(visits, len(catalog))), None
            catalog, dropped = apply_changes(catalog, events.target_tables, until, usual)
        columns = columns_of(catalog, visits)
        replayed = replay(events, states, columns["id"]) if visited else Replay(len(catalog))
        made = replayed.made if columns["kind"] is None else replayed.made * has_role(columns["kind"], "science")
        wanted, priority = rule.apply(
            {**columns, "observed": made, "failed": replayed.failed, "last": last_results(replayed)}
        )
        if required is not None:  # at least one visit of each required target is requested
            is_required = np.isin(np.asarray(columns["id"]).astype(str), required)
            wanted = np.where(is_required & (wanted == 0) & ~dropped, np.uint8(1), wanted)
        wanted = np.where(dropped, np.minimum(wanted, made), wanted)
        left = np.where(wanted < made, np.uint8(0), wanted - made)
        if priority is not columns["priority"]:
            catalog = replace(in_memory(catalog, "rules that change priorities"), priority=priority)
        return cls(catalog, wanted, made, replayed.failed, left, events, rule, until, replayed, states, dropped, given)

    def before(self, n: int) -> "SurveyState":
        """Return the state after the first files of events, as if no visit had been made.

        Parameters
        ----------
        n : int
            Number of files.

        Returns
        -------
        SurveyState
            The state.
        """
        return self._of(self.events.first(n), self.given, self.rule, self.until, visited=False)

    @property
    def folder(self) -> Path:
        """The folder of the survey."""
        return self.events.folder

    @cached_property
    def closed(self) -> dict[int, TileEvent | None]:
        """Rows of the tiles that are not planned, with the observation of each observed tile, and None if dropped."""
        states, done = (TileState.DONE, TileState.DROPPED), TileState.DONE
        events = [event for event in map(self.states.state_of, self.states.rows()) if event.state in states]
        return {event.row: event if event.state == done else None for event in events}

    @cached_property
    def begun(self) -> dict[int, TileEvent]:
        """Rows of the tiles that were partly observed, and keep their plans, with the observation of each tile."""
        events = map(self.states.state_of, self.states.rows())
        return {event.row: event for event in events if event.state == TileState.PARTLY}

    @property
    def kept(self) -> dict[int, TileEvent]:
        """Rows of the observed and partly observed tiles, whose plans do not change, with their observations."""
        return {row: event for row, event in (self.closed | self.begun).items() if event is not None}

    def generations(self) -> dict[int, int]:
        """Return, for each tile in `kept`, the number of files of events with which its plan was made.

        Returns
        -------
        dict
            Dict from the row of each tile to the number of files.
        """
        made: dict[tuple, int] = {}
        for number, event in self.events.numbered():
            n_files = self.events.files[number - 1].n_applied if event.made_with < 0 else event.made_with
            made.setdefault(event.observation, n_files)
        generations = {}
        for row, event in self.kept.items():  # a tile keeps the plan with which its observation began
            parts = [part for part in self.states.of(row) if (part.state, part.plan) == (TileState.PARTLY, event.plan)]
            generations[row] = min(made[part.observation] for part in (event, *parts))
        return generations

    @property
    def attempts(self) -> list[TileEvent]:
        """All observations."""
        return self.states.attempts

    @property
    def first(self) -> Catalog | PartitionedCatalog:
        """The catalog of the first plan."""
        return self.given[0]

    @cached_property
    def digest(self) -> str:
        """A digest of the catalog of the first plan, which is computed without an index on the sky."""
        return digest_of(self.first)

    def present_events(self) -> Events:
        """Return all events in the folder, which can contain more than those of this state.

        Returns
        -------
        Events
            The events.

        Raises
        ------
        InputError
            If a file of events is missing or damaged.
        """
        return read_events(self.folder, self.events)

    def check_current(self) -> None:
        """Raise an error if events were recorded in the folder after this state was read.

        Raises
        ------
        InputError
            If there are later events.
        """
        if self.present_events().digest != self.events.digest:
            raise InputError(
                f"visits must be the state after all events in {self.folder}, got a state that was read before the "
                "last event was recorded; call Survey.state again"
            )

    def check_catalog(self, catalog: object) -> None:
        """Raise an error if a catalog is neither that of the first plan nor that of the state.

        Parameters
        ----------
        catalog : Catalog or PartitionedCatalog
            The catalog.

        Raises
        ------
        InputError
            If the catalog is another catalog.
        """
        given = catalog if isinstance(catalog, PartitionedCatalog) else as_catalog(catalog)
        if not any(is_same(given, planned) for planned in (self.first, self.catalog)):
            raise InputError(
                f"the catalog must be that of the state, with {number_of(len(self), 'target')}, got another catalog "
                f"with {number_of(len(given), 'target')}"
            )

    @property
    def record(self) -> dict:
        """The state as text and numbers, as it is written to files."""
        return {
            "n_files": len(self.events.files),
            "digest": self.events.digest,
            **({} if self.until is None else {"until": self.until}),
            **({"rule": self.rule.record} if self.rule.record else {}),
        }

    @property
    def summary(self) -> dict:
        """Numbers of observed, partly observed and dropped tiles, and of successful and failed visits."""
        observed = sum(event is not None for event in self.closed.values())
        return {
            "n_tiles_observed": observed,
            "n_tiles_partly_observed": len(self.begun),
            "n_tiles_dropped": len(self.closed) - observed,
            "n_visits_made": int(self.observed.sum()),
            "n_visits_failed": int(self.failed.sum()),
        }

    @property
    def table(self) -> QTable:
        """Table with a row for each target, in the order of the catalog.

        Columns: ``target_id``, ``requested``, ``observed``, ``failed``, ``left``, ``kind`` and ``priority`` if the
        catalog has them, ``last`` (``good``, ``bad`` or ``none``), ``last_tile`` and ``last_date``. No visits of
        standards and sky positions are requested.
        """
        return state_table(self)

    def write(self, path: str | os.PathLike, *, overwrite: bool = False) -> None:
        """Write the table of all targets as FITS or ECSV; TOPCAT reads both formats.

        Parameters
        ----------
        path : str or path-like
            Path that ends in ``.fits`` or ``.ecsv``.
        overwrite : bool, optional
            Whether to replace an existing file.

        Raises
        ------
        InputError
            If the folder does not exist, or if the file exists and ``overwrite`` is False.
        """
        _io.write_table(self.table, path, overwrite=overwrite)

    def tiling(self, tiling: Tiling) -> Tiling:
        """Return the tiling of the first plan with the tiles that were added or moved.

        Parameters
        ----------
        tiling : Tiling
            The tiling of the first plan.

        Returns
        -------
        Tiling
            The present tiling; added tiles are at the end.

        Raises
        ------
        InputError
            If the tiles are not those of the first plan.
        """
        files = self.events.files
        added = [event.row for file in files for event in file.tiles if event.place and event.row >= file.n_tiles]
        first = min(added, default=files[-1].n_tiles if files else 0)
        if len(tiling) < first or (added and len(tiling) > first):
            remedy = "; record further tiles with the state added" if len(tiling) > first else ""
            raise InputError(
                f"tiles must be the {number_of(first, 'tile')} of the first plan, got {number_of(len(tiling), 'tile')}"
                f"{remedy}"
            )
        if self.states.added:
            tiling = add_tiles(tiling, self.states.added, TileStates(self.events.of_tiles()).dropped)
        names = dict(enumerate(np.asarray(tiling.table["tile"]).astype(str).tolist()))
        for event in self.events.of_tiles():
            if names.get(event.row) != event.tile:
                raise InputError(
                    f"tiles must be those of the first plan, got the tile {names.get(event.row)} in row {event.row} "
                    f"instead of {event.tile}"
                )
        return tiling

    def __len__(self):
        return len(self.observed)

    def __repr__(self):
        s = self.summary
        return (
            f"<SurveyState of {number_of(len(self), 'target')}: {number_of(s['n_tiles_observed'], 'tile')} observed, "
            f"{number_of(s['n_visits_made'], 'visit')} made, {int(self.left[is_science(self.catalog)].sum())} left>"
        )


def _check_visits(request: dict, catalog: Catalog | PartitionedCatalog) -> None:
    """Issue a warning if the first plan requested another number of visits than the catalog."""
    first = request.get("first", request)
    targets, said = (str(first.get(name, "")).partition(",")[0] for name in ("catalog", "visits"))
    now = number_of(int(columns_of(catalog, None)["requested"].sum(dtype=np.int64)), "visit")
    is_same = targets == number_of(len(catalog), "target")  # another catalog is an error when the survey is planned
    if is_same and said not in ("", now) and not request.get("required"):
        warn(
            f"the first plan requested {said}, but the catalog requests {now}; give the visits= and rule= of the first "
            "plan, unless they have changed"
        )
