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
from rfpsurvey._survey import source as _source
from rfpsurvey._survey.cadences import Cadences, Windows
from rfpsurvey._survey.folder import read_request
from rfpsurvey._survey.history.dated import check_dates, replay_windows, times_of
from rfpsurvey._survey.history.event_files import read_events
from rfpsurvey._survey.history.events import Events, TileEvent, TileState, to_date
from rfpsurvey._survey.history.limits import Limits, limits_of
from rfpsurvey._survey.history.replay import Replay, TileStates, last_results, replay, state_table, tiling_after
from rfpsurvey._survey.history.rule import VisitRule
from rfpsurvey._survey.history.targets import apply_changes
from rfpsurvey._survey.tiling.tiling import Tiling
from rfpsurvey.errors import InputError, number_of, refusal


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
        The catalog of the first plan, the requested visits that were given with it, the required targets, and, with
        cadences, the tiles.
    windows : Windows or None
        The epochs that the targets have completed, if the targets have cadences.
    limits : Limits or None
        The tiles that may observe targets of opportunity, if there are any.

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
    windows: Windows | None = field(repr=False, default=None)
    limits: Limits | None = field(repr=False, default=None)

    @classmethod
    def read(
        cls,
        folder: str | os.PathLike,
        catalog: Catalog | PartitionedCatalog,
        *,
        rule: VisitRule | None = None,
        visits: int | np.ndarray | Cadences | None = None,
        until: str | None = None,
        tiles: Tiling | None = None,
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
        tiles : Tiling, optional
            The planned tiles, which are required if the targets have cadences, or are wanted until a date.

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
        check_dates(folder, request, visits, tiles, rule.record)
        if visits is None and not rule.record:
            _source.check_number_of_visits(request, catalog)
        _source.check_first_catalog(request, catalog, None if isinstance(visits, Cadences) else visits, rule)
        until = None if until is None else to_date(until)
        given = catalog, visits, request.get("required_ids"), tiles
        return cls._of(read_events(_io.to_path(folder)), given, rule, until)

    @classmethod
    def _of(cls, events: Events, given: tuple, rule: VisitRule, until: str | None, *, visited: bool = True):
        """Return the state after events; without ``visited``, as if no visit had been made or had failed."""
        states, (catalog, visits, required, tiles) = TileStates(events.of_tiles(until)), given
        dropped = np.zeros(len(catalog), dtype=bool)
        cadences, visits = (visits, None) if isinstance(visits, Cadences) else (None, visits)
        if events.target_tables:
            usual = 1 if visits is None or np.ndim(visits) else int(visits)
            catalog = _source.in_memory(catalog, "events of targets")
            if visits is not None:  # recorded numbers of visits replace these numbers
                catalog, visits = replace(catalog, visits=to_visits(visits, len(catalog))), None
            catalog, dropped = apply_changes(catalog, events.target_tables, until, usual)
        is_required = _source.required_in(catalog, required)
        visits = visits if cadences is None else cadences.visits(_source.in_memory(catalog, "cadences"), is_required)
        columns = _source.columns_of(catalog, visits)
        replayed = replay(events, states, columns["id"]) if visited else Replay(len(catalog))
        windows = None
        if cadences is not None:
            windows = replay_windows(events, states if visited else TileStates(()), cadences, catalog, tiles)
        made = replayed.made if windows is None else windows.counts()[:, 1].astype(np.uint8)
        made = made if columns["kind"] is None else made * has_role(columns["kind"], "science")
        wanted, priority = rule.apply(
            {**columns, "observed": made, "failed": replayed.failed, "last": last_results(replayed)}
        )
        if required is not None:  # at least one visit of each required target is requested
            wanted = np.where(is_required & (wanted == 0) & ~dropped, np.uint8(1), wanted)
        wanted = np.where(dropped, np.minimum(wanted, made), wanted)
        limits = limits_of((table for _, table in events.target_tables), states, until, tiles)
        if limits is not None:
            wanted, limits = limits.apply(wanted, made)
        left = np.where(wanted < made, np.uint8(0), wanted - made)
        if priority is not columns["priority"]:
            catalog = replace(_source.in_memory(catalog, "rules that change priorities"), priority=priority)
        about = events, rule, until, replayed, states, dropped, given, windows, limits
        return cls(catalog, wanted, made, replayed.failed, left, *about)

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
        """Rows of the tiles that are not planned, with the observation of each observed tile, and None for others."""
        states, done = (TileState.DONE, TileState.DROPPED), TileState.DONE
        events = [event for event in map(self.states.state_of, self.states.rows()) if event.state in states]
        return {event.row: event if event.state == done else None for event in events} | dict.fromkeys(self.past)

    @property
    def cadences(self) -> Cadences | None:
        """The cadences of the targets; None if there are none."""
        return self.given[1] if isinstance(self.given[1], Cadences) else None

    @cached_property
    def past(self) -> list[int]:
        """Rows of the tiles that lie in the past without having been observed, if the targets have cadences."""
        return [] if self.cadences is None else times_of(self.given[3], self.states)[1]

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
        return _source.digest_of(self.first)

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
        if not any(_source.is_same(given, planned) for planned in (self.first, self.catalog)):
            raise InputError(
                f"the catalog must be that of the state, with {number_of(len(self), 'target')}, got another catalog "
                f"with {number_of(len(given), 'target')}"
            )

    @property
    def record(self) -> dict:
        """The state as text and numbers, as it is written to files."""
        days = None if self.limits is None else self.limits.days
        return {
            "n_files": len(self.events.files),
            "digest": self.events.digest,
            **({} if self.until is None else {"until": self.until}),
            **({"rule": self.rule.record} if self.rule.record else {}),
            **({} if days is None else {"days": _source.digest(days)}),
        }

    @property
    def summary(self) -> dict:
        """Numbers of observed, partly observed and dropped tiles, and of successful and failed visits."""
        observed, cadences = sum(event is not None for event in self.closed.values()), {}
        if self.cadences is not None:
            n_made = int((self.replayed.made * _source.is_science(self.catalog)).sum())
            cadences = {"n_tiles_past": len(self.past), "n_visits_not_counted": n_made - int(self.observed.sum())}
        return {
            "n_tiles_observed": observed,
            "n_tiles_partly_observed": len(self.begun),
            "n_tiles_dropped": len(self.closed) - observed - len(self.past),
            "n_visits_made": int(self.observed.sum()),
            "n_visits_failed": int(self.failed.sum()),
            **cadences,
            **({} if self.limits is None else {"n_visits_expired": int(self.limits.expired.sum())}),
        }

    @property
    def table(self) -> QTable:
        """Table with a row for each target, in the order of the catalog.

        Columns: ``target_id``, ``requested``, ``observed``, ``failed``, ``left``, ``kind`` and ``priority`` if the
        catalog has them, ``last`` (``good``, ``bad`` or ``none``), ``last_tile`` and ``last_date``. No visits of
        standards and sky positions are requested. If targets are wanted on a single tile or until a date, the columns
        ``only_tile`` and ``until``, and ``expired``, the number of visits that are no longer requested, follow.
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
        return tiling_after(self.events, self.states, tiling)

    def __len__(self):
        return len(self.observed)

    def __repr__(self):
        s = self.summary
        n_left, of = int(self.left[_source.is_science(self.catalog)].sum()), number_of(len(self), "target")
        made = f"{number_of(s['n_visits_made'], 'visit')} made, {n_left} left"
        return f"<SurveyState of {of}: {number_of(s['n_tiles_observed'], 'tile')} observed, {made}>"
