"""The state of a survey: the visits of all targets that were made and remain, and the states of all tiles."""

import os
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from astropy.table import QTable

from rfpsurvey import _io
from rfpsurvey._units import to_visits
from rfpsurvey.catalog import Catalog, PartitionedCatalog, as_catalog
from rfpsurvey.errors import InputError, number_of, refusal
from rfpsurvey.pipeline import PLANNED_COLUMNS
from rfpsurvey.survey._history._events import DONE, DROPPED, PARTLY, Events, TileEvent, read_events, to_date
from rfpsurvey.survey._history._replay import Replay, TileStates, replay
from rfpsurvey.survey._history._rule import LAST, VisitRule
from rfpsurvey.survey._history._targets import apply_changes
from rfpsurvey.survey._history._tiles import add_tiles
from rfpsurvey.tile import describe
from rfpsurvey.tiling import Tiling

STATE = {
    "target_id": "identifier of the target",
    "requested": "number of requested visits",
    "observed": "number of successful visits",
    "failed": "number of failed visits",
    "left": "number of remaining visits",
    "priority": "priority that the rule determines",
    "last": "result of the last visit",
    "last_tile": "tile of the last visit",
    "last_date": "date of the last visit",
}


@dataclass(frozen=True, eq=False)
class SurveyState:
    """The state of a survey that follows from its plans and from the events that were recorded.

    `Survey.state` makes this object. As the parameter ``visits`` of `plan_survey`, it determines which tiles are
    planned, and how many visits of each target remain.

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

    Examples
    --------
    >>> import astropy.units as u
    >>> from astropy.coordinates import SkyCoord
    >>> from tempfile import TemporaryDirectory
    >>> import rfpsurvey as rs
    >>> sky = rs.synthetic_catalog("uniform", SkyCoord("6h20m +23d"), 0.3 * u.deg, n_targets=4000, rng=1)
    >>> with TemporaryDirectory() as folder:
    ...     survey = rs.plan_survey(sky, "desi", SkyCoord(["6h20m"], ["+23d"]), folder=f"{folder}/survey")
    ...     said = survey.record([{"tile": 0, "date": "2026-01-03", "state": "done"}])
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
    first: Catalog | PartitionedCatalog = field(repr=False, default=None)

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
        """Return the state of the survey in a folder; see `Survey.state`.

        Parameters
        ----------
        folder : str or path-like
            The folder of the survey, which can be unfinished.
        catalog : Catalog, PartitionedCatalog, SkyCoord, Table or DataFrame
            The targets of the first plan.
        rule, visits, until : optional
            As in `Survey.state`.

        Returns
        -------
        SurveyState
            The state.

        Raises
        ------
        InputError
            As in `Survey.state`.
        """
        if folder is None:
            raise InputError("a state needs a survey in a folder, got a survey that was planned without a folder")
        rule = VisitRule() if rule is None else rule
        if not isinstance(rule, VisitRule):
            raise refusal("rule must be a VisitRule", rule)
        events = read_events(_io.to_path(folder))
        until = None if until is None else to_date(until)
        states = TileStates(events.of_tiles(until))
        catalog = catalog if isinstance(catalog, PartitionedCatalog) else as_catalog(catalog)
        first, dropped = catalog, np.zeros(len(catalog), dtype=bool)
        if events.target_tables:
            if visits is not None:  # recorded numbers of visits replace these numbers
                catalog = replace(_in_memory(catalog, "events of targets"), visits=to_visits(visits, len(catalog)))
                visits = None
            catalog, dropped = apply_changes(_in_memory(catalog, "events of targets"), events.target_tables)
        columns = _columns_of(catalog, visits)
        replayed = replay(events, states, columns["id"])
        made = replayed.made if columns["kind"] is None else replayed.made * (columns["kind"] == "science")
        wanted, priority = rule.apply(
            {**columns, "observed": made, "failed": replayed.failed, "last": _last_of(replayed)}
        )
        left = np.where(dropped | (wanted < made), made, wanted) - made
        if priority is not columns["priority"]:
            catalog = replace(_in_memory(catalog, "rules that change priorities"), priority=priority)
        own = made + left, made, replayed.failed, left
        return cls(catalog, *own, events, rule, until, replayed, states, dropped, first)

    @property
    def folder(self) -> Path:
        """The folder of the survey."""
        return self.events.folder

    @cached_property
    def closed(self) -> dict[int, TileEvent | None]:
        """Rows of the tiles that are not planned, with the observation of each observed tile, and None if dropped."""
        found = {row: self.states.state_of(row) for row in self.states.rows()}
        done = {row: one for row, one in found.items() if isinstance(one, TileEvent) and one.state == DONE}
        return done | {row: None for row, one in found.items() if one == DROPPED}

    @cached_property
    def begun(self) -> dict[int, TileEvent]:
        """Rows of the tiles that were partly observed, and keep their plans, with the observation of each tile."""
        found = {row: self.states.state_of(row) for row in self.states.rows()}
        return {row: one for row, one in found.items() if isinstance(one, TileEvent) and one.state == PARTLY}

    @property
    def kept(self) -> dict[int, TileEvent]:
        """Rows of the observed and partly observed tiles, whose plans do not change, with their observations."""
        return {row: event for row, event in (self.closed | self.begun).items() if event is not None}

    @property
    def attempts(self) -> list[TileEvent]:
        """All observations."""
        return self.states.attempts

    def check_current(self) -> None:
        """Raise an error if events were recorded in the folder after this state was read."""
        if read_events(self.folder).digest != self.events.digest:
            raise InputError(
                f"visits must be the state after all events in {self.folder}, got a state that was read before the "
                "last event was recorded; call Survey.state again"
            )

    def check_catalog(self, catalog: object) -> None:
        """Raise an error if a catalog is neither that of the first plan nor that of the state."""
        given = catalog if isinstance(catalog, PartitionedCatalog) else as_catalog(catalog)
        if not any(_is_same(given, own) for own in (self.first, self.catalog)):
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
        observed = sum(one is not None for one in self.closed.values())
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

        Columns: ``target_id``, ``requested``, ``observed``, ``failed``, ``left``, ``priority`` if the catalog has
        priorities, ``last`` (``good``, ``bad`` or ``none``), ``last_tile`` and ``last_date``.
        """
        own, n = self.replayed, len(self.observed)
        catalog = self.catalog if isinstance(self.catalog, Catalog) else None
        ids = self.catalog.parts.column("id") if catalog is None else catalog.id
        table = QTable({"target_id": ids}, copy=False)
        for name in ("requested", "observed", "failed", "left"):
            table[name] = getattr(self, name)
        if catalog is not None and catalog.priority is not None:
            table["priority"] = catalog.priority
        table["last"] = np.array(LAST)[_last_of(own)]
        for name, values in (
            ("last_tile", [one.tile for one in own.attempts]),
            ("last_date", [one.date for one in own.attempts]),
        ):
            table[name] = np.array([*values, ""])[own.last] if n else np.array([], dtype=str)
        table.meta["events"] = self.record
        return describe(table, STATE)

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
        first = self.events.files[0].n_tiles if self.events.files else len(tiling)
        if len(tiling) != first:
            raise InputError(
                f"tiles must be the {number_of(first, 'tile')} of the first plan, got {number_of(len(tiling), 'tile')}"
            )
        tiling = add_tiles(tiling, self.states.added) if self.states.added else tiling
        names = np.asarray(tiling.table["tile"]).astype(str).tolist()
        for event in self.events.of_tiles():
            if names[event.row] != event.tile:
                raise InputError(
                    f"tiles must be those of the first plan, got the tile {names[event.row]} in row {event.row} "
                    f"instead of {event.tile}"
                )
        return tiling

    def __len__(self):
        return len(self.observed)

    def __repr__(self):
        s = self.summary
        return (
            f"<SurveyState of {number_of(len(self), 'target')}: {number_of(s['n_tiles_observed'], 'tile')} observed, "
            f"{number_of(s['n_visits_made'], 'visit')} made, {int(self.left.sum())} left>"
        )


def _columns_of(catalog, visits: object) -> dict:
    """Return the columns of a catalog that rules use."""
    names = ("id", "priority", "category", "kind", "visits")
    own = {
        name: getattr(catalog, name) if isinstance(catalog, Catalog) else catalog.parts.column(name) for name in names
    }
    n = len(catalog)
    requested = own.pop("visits") if visits is None else to_visits(visits, n)
    return {**own, "requested": np.ones(n, dtype=np.uint8) if requested is None else requested}


def _is_same(one: Catalog | PartitionedCatalog, other: Catalog | PartitionedCatalog) -> bool:
    """Return whether two catalogs are equal in all columns that a plan uses."""
    if one is other:
        return True
    if isinstance(one, PartitionedCatalog) or isinstance(other, PartitionedCatalog):
        return type(one) is type(other) and one.parts.digest() == other.parts.digest()
    places = [np.column_stack([sky.coord.icrs.ra.deg, sky.coord.icrs.dec.deg]) for sky in (one, other)]
    columns = [[sky.id, sky.visits, *(getattr(sky, name) for name in PLANNED_COLUMNS)] for sky in (one, other)]
    return all(np.array_equal(a, b) for a, b in zip([places[0], *columns[0]], [places[1], *columns[1]], strict=True))


def _last_of(own: Replay) -> np.ndarray:
    """Return the result of the last visit of each target as an index of ``LAST``."""
    return np.where(own.last < 0, 0, np.where(own.is_good, LAST.index("good"), LAST.index("bad")))


def _in_memory(catalog: Catalog | PartitionedCatalog, what: str) -> Catalog:
    if isinstance(catalog, PartitionedCatalog):
        raise InputError(f"{what} must be used with a catalog in memory, got a partitioned catalog")
    return catalog
