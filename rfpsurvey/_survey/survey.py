"""The class `Survey`, which contains the result of planning a survey."""

import os
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from astropy.table import QTable, Table, vstack

from rfpsurvey._common import io as _io
from rfpsurvey._common.descriptions import describe, plot, show, to_html, with_unit
from rfpsurvey._common.folder import read_index
from rfpsurvey._common.small_figures import figure_of_tiles
from rfpsurvey._field.verdicts import OUTCOMES
from rfpsurvey._survey.columns import NOT_PLANNED, OUTCOME, TILES
from rfpsurvey._survey.folder import JOINT, TABLES, read_request, read_stored_table, read_visits
from rfpsurvey._survey.generations import EVENTS
from rfpsurvey._survey.living import Living
from rfpsurvey._survey.work import VISITS_UNITS
from rfpsurvey.errors import InputError, number_of


@dataclass(frozen=True, eq=False)
class Survey(Living):
    """The result of planning a survey: tiles, completeness, the outcome of each target, and all visits.

    Parameters
    ----------
    tiles : QTable
        Table with a row for each tile, in the order of the tiling: ``tile``, ``ra``, ``dec``, ``position_angle``,
        ``pass``, ``round`` (tiles of a round do not share targets), ``n_in_field`` (targets in the field that still
        require a visit), ``n_reachable`` (these targets in reach of a positioner), ``n_assigned`` (usable positioners
        with a target), ``n_science``, ``n_standard``, ``n_sky`` (positioners with a target of this kind),
        ``n_colliding`` (positioners in collision), ``n_colliding_assigned`` (usable ones of them with a target),
        ``n_counted`` (positioners that have a target or are parked), ``n_colliding_pairs`` (pairs of arms in
        collision), ``n_obstacle_collisions`` (collisions with obstacles), ``n_unfolding_pairs``,
        ``n_unfolding_obstacle_collisions`` and ``n_needs_planner`` (if a constraint refers to the motion of the arms,
        see `~rfpsurvey.constraints.Motion`: pairs of arms and obstacles that collide while arms unfold, and positioners
        that need a path planner) or ``n_without_path`` (positioners without a planned path), ``n_lost_to_rules``
        (science targets that rules on the distribution of fibers cost, not for joint plans), ``n_also_science``
        (science targets that also meet requirements on standard stars or sky positions, if there are any), ``n_unmet``
        (requirements that are not met; all required targets of a tile count as one, and so do all keep-out circles),
        ``unmet`` (if there are requirements or required targets: the requirements that are not met, with the numbers of
        missing targets), ``not_checkable`` (if there are rules: those for which this tile lacks data), ``n_observed``
        (successful visits to science targets), ``collision_rate`` (``n_colliding`` divided by ``n_counted``),
        ``fiber_use`` (``n_assigned`` divided by the number of usable positioners), ``completeness`` (visits that all
        tiles together made to the targets of this field, divided by the requested visits of these targets; NaN if no
        visits were requested). Its ``meta`` has ``summary`` and ``provenance``.
    completeness : QTable
        Table that describes the state after each pass. Each pass has one row for all targets and, if there are several
        priorities or categories, one row for each priority and for each category. Columns: ``pass``, ``n_tiles``
        (number of tiles up to the end of this pass), ``priority`` and, if there are several categories, ``category``
        (``all`` stands for all values of a column), ``n_targets`` (targets with at least one requested visit),
        ``n_requested`` (requested visits), ``n_observed`` (successful visits), ``n_complete`` (targets that received
        all requested visits), ``completeness`` (``n_observed`` divided by ``n_requested``).
    outcomes : QTable
        Table with a row for each target: ``target_id``, ``requested`` (number of requested visits), ``observed``
        (number of successful visits), ``outcome`` (an index of ``Survey.OUTCOMES``; see `outcome_names`). With cadences
        also ``n_epochs`` and ``released`` (see `~rfpsurvey.survey.Cadences`).
    folder : Path, optional
        Folder that contains the visits.
    parts : tuple of ndarray, optional
        One array for each tile, with the visits of this tile; None if the visits are in the folder.
    joint : QTable, optional
        If all tiles were planned together (`JointOptions`), a table with a row for each iteration and each priority:
        ``iteration``, ``priority``, ``n_visits`` (visits to targets with at least this priority), ``bound`` (upper
        bound of ``n_visits`` in any plan without collisions), ``gap`` (1 - ``n_visits`` / ``bound``), ``seconds``
        (computing time until the end of the iteration, NaN for iterations of an earlier run; files do not contain this
        column). If there are more than eight priorities, the table contains only eight, from the highest to the lowest
        priority. The entry ``joint`` of the summary contains the values after the last iteration. With the constraint
        ``motion paths``, these are the visits before arms without a path lose their targets.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astropy.coordinates import SkyCoord
    >>> import rfpsurvey as rs
    >>> sky = rs.synthetic_catalog("uniform", SkyCoord("6h20m +23d"), 1 * u.deg, n_targets=500, rng=1)
    >>> survey = rs.plan_survey(sky, "moons", SkyCoord([94.9, 95.1] * u.deg, [23, 23] * u.deg))
    >>> survey
    <Survey of 2 tiles: 33 of 500 visits, completeness 0.0660>
    """

    tiles: QTable
    completeness: QTable
    outcomes: QTable
    folder: Path | None = None
    parts: tuple | None = None
    joint: QTable | None = None

    OUTCOMES = OUTCOMES
    """Names of the possible outcomes of a target, in the order of their codes."""

    @property
    def summary(self) -> dict:
        """Numbers of tiles, targets, visits, fibers, collisions and outcomes, and a description of the model.

        ``model`` is a text that states how collisions and positions were computed. ``n_required`` is the number of
        required targets, and ``n_required_observed`` is the number of required targets that were observed at least
        once. ``unmet`` is a list of sentences: one for each requirement that tiles do not meet, with the number of
        missing targets and the first of these tiles, and one for each outcome of required targets that were never
        observed.
        """
        return self.tiles.meta["summary"]

    @property
    def rules(self) -> Table | None:
        """Table of the constraints: the numbers of tiles with each verdict, and the first tiles that fail.

        The columns are ``rule``, ``pass``, ``fail``, ``not checkable`` and ``tiles``. None if there are no constraints.
        The columns ``unmet`` and ``not_checkable`` of ``tiles`` name the constraints of each tile.
        """
        records = self.summary.get("rules")
        return Table(records) if records else None

    @property
    def provenance(self) -> dict:
        """Software versions, instrument, catalog, tiling and parameters of the survey."""
        return self.tiles.meta["provenance"]

    @property
    def outcome_names(self) -> np.ndarray:
        """Outcome of each target as text, as in the outcomes of a tile; ``outcomes`` contains codes of one byte each.

        For example, ``survey.outcomes["name"] = survey.outcome_names`` adds the names to the table.
        """
        return np.array(OUTCOMES)[np.asarray(self.outcomes["outcome"])]

    @property
    def targets(self) -> QTable:
        """Table with a row for each visit of the survey; for large surveys, use `tile`, which reads a single tile.

        Columns: ``tile``, ``target_id``, ``target_row`` (row in the catalog, -1 for blank sky), ``positioner`` (the
        identifier of the positioner, which is the column ``id`` of ``Tile.table``), ``ra``, ``dec``, ``in_collision``,
        ``observed`` (whether the visit counts as an observation), ``fiber_type`` if the fibers of the instrument have
        types, ``kind`` if the catalog has kinds or if blank sky positions were added, and ``priority``, ``category``
        and the further columns (``extra``) of the catalog, if the catalog has these columns. In the columns from the
        catalog, blank sky has the value NaN, empty text, False or -1, depending on the type of the column.
        """
        return vstack(list(self), metadata_conflicts="silent") if len(self.tiles) else QTable()

    def tile(self, tile: int | str) -> QTable:
        """Return the visits of one tile.

        Parameters
        ----------
        tile : int or str
            Identifier of the tile.

        Returns
        -------
        QTable
            The visits, with the columns of `targets`.

        Raises
        ------
        InputError
            If the survey has no tile with this identifier, or if the file of the tile is missing or damaged.
        """
        rows = np.flatnonzero(np.asarray(self.tiles["tile"]).astype(str) == str(tile))
        if len(rows) == 0:
            raise InputError(f"the survey has no tile {tile}; its tiles have names such as {self.tiles['tile'][0]}")
        return self._visits(int(rows[0]))

    def export(
        self,
        tiles: int | str | list | None = None,
        *,
        format: str = "table",  # noqa: A002
        output: str | os.PathLike = ".",
        instrument: object = None,
        overwrite: bool = False,
        alternates: int | None = None,
        times: object = None,
        progress: object = False,
    ) -> QTable:
        """Write tiles to files of plans, one file for each tile, which `~rfpsurvey.plans.read_plan` reads.

        Each file contains the field center, the position angle and the observing conditions of the tile, and the
        generation of its plan. The poses and collisions of each tile are computed again from its visits, and compared
        with those of the survey. If the instrument is not a preset, it is also written to the folder ``output``, and
        `~rfpsurvey.score_tile` uses it for the plans in this folder.

        Parameters
        ----------
        tiles : int, str or list, optional
            Identifiers of tiles, or text such as ``"12-20,31"``, in which a range contains all tiles with numbers
            between its ends. By default, all tiles that have a plan.
        format : str, optional
            Name of the format, as in `~rfpsurvey.plans.write_plan`, or ``table`` for files that `Tile.read
            <rfpsurvey.Tile>` reads.
        output : str or path-like, optional
            Folder of the files, which is made if it does not exist.
        instrument : Instrument or str, optional
            The instrument of the survey, if its plan file does not determine it.
        overwrite : bool, optional
            Whether to replace existing files.
        alternates : int, optional
            Largest number of alternates of each fiber, which are written to a table ``alternates-TILE.ecsv`` beside
            each file: `Tile.alternates <rfpsurvey.Tile>` with the columns ``tile``, ``n_left`` (visits of the target
            that remain if all tiles are observed as planned; 1 for standards and sky positions) and ``n_elsewhere``
            (number of other tiles that observe the target). Targets with remaining visits are first.
        times : Time, optional
            Midpoint of the exposure of each of the ``tiles``, shape (n_tiles,), for a survey with observing conditions.
            The positions are those at these times instead of the planned ones. Fibers that cannot observe their targets
            then receive other targets, or none; a table ``changes.ecsv``, which `record` reads, lists them.
        progress : bool or callable, optional
            Whether to show the progress, as in `plan_survey`.

        Returns
        -------
        QTable
            Table with a row for each file: ``tile``, ``file``, ``n_positioners``, ``n_assigned``, ``n_colliding``,
            ``unmet``, with ``times`` also ``n_changed`` (positioners that do not observe their planned targets) and, if
            requested, ``alternates`` (name of the file). ``meta["left_out"]`` contains the tiles that were left out,
            with the reasons.

        Raises
        ------
        InputError
            If the survey has no folder, if a tile is unknown, or if a file exists and ``overwrite`` is False. If
            ``tiles`` are given, also if a tile has no plan, or if its collisions are not those of the survey, because
            it was planned with another state of the instrument. No file of a tile is written then.
        """
        from rfpsurvey._survey.export import export  # the module imports this one

        options = {"instrument": instrument, "overwrite": overwrite, "alternates": alternates, "times": times}
        return export(self, tiles, format=format, folder=output, **options, progress=progress)

    def __iter__(self) -> Iterator[QTable]:
        return (self._visits(k) for k in range(len(self.tiles)))

    def __len__(self):
        return len(self.tiles)

    def _visits(self, k: int) -> QTable:
        if self._states[k] in NOT_PLANNED:
            planned_rows = [row for row, state in enumerate(self._states) if state not in NOT_PLANNED]
            return self._visits(planned_rows[0])[:0] if planned_rows else QTable()
        tile = self.tiles["tile"][k]
        rows = read_visits(self.folder, k, self._known, tile)[0] if self.parts is None else self.parts[k]
        table = QTable({"tile": np.full(len(rows), tile)})
        units = VISITS_UNITS | self.provenance.get("units", {})
        for name in rows.dtype.names:
            table[name] = with_unit(rows[name], units.get(name))
        return table

    def plot(self, **options: object) -> object:
        """Plot the tiles on the sky, as `rfpsurvey.plot.plot_tiling` does.

        Parameters
        ----------
        **options
            Parameters of `rfpsurvey.plot.plot_tiling`, such as ``ax`` and ``color``.

        Returns
        -------
        matplotlib.axes.Axes
            The axes.
        """
        return plot("plot_tiling", self, **options)

    def show(self, *, height: int = 1000) -> object:
        """Return an interactive map of the tiles for display in a notebook; reports contain the same map.

        The map is in a frame that can run the script of the map, but has no access to the notebook or the network.

        Parameters
        ----------
        height : int, optional
            Height of the frame in pixels.

        Returns
        -------
        NotebookView
            Object that a notebook displays as the map.

        Raises
        ------
        InputError
            If the height is not a positive integer.
        """
        return show(self, height=height)

    def _repr_html_(self) -> str:
        return to_html(self, self.summary, self.tiles, figure_of_tiles(self.tiles))

    def __repr__(self):
        s = self.summary
        return (
            f"<Survey of {number_of(s['n_tiles'], 'tile')}: {s['n_visits_observed']} of "
            f"{number_of(s['n_visits_requested'], 'visit')}, completeness {s['completeness']:.4f}>"
        )

    @classmethod
    def read(cls, folder: str | os.PathLike) -> "Survey":
        """Read a survey from a folder that `plan_survey` wrote.

        Parameters
        ----------
        folder : str or path-like
            Path of the folder.

        Returns
        -------
        Survey
            The survey; visits are read from disk when they are accessed.

        Raises
        ------
        InputError
            If the folder does not contain a survey, or if the survey is unfinished or damaged.
        """
        folder = _io.to_path(folder)
        request, known = read_request(folder), read_index(folder)
        if not request:
            raise InputError(f"{folder} does not hold a survey: there is no survey.json")
        if not all((folder / name).is_file() and (name in known or not known) for name in TABLES):
            n = sum(name.startswith("tiles/") for name in known)
            remedy = "resume=True (--resume)"
            if (folder / EVENTS).is_dir():
                remedy = "rs.survey.continue_survey(FOLDER), or with rfpsurvey survey FOLDER --replan,"
            raise InputError(
                f"{folder} holds a survey that is not finished ({number_of(n, 'tile')} planned so far); continue the "
                f"survey with {remedy} before you read it"
            )
        tables = [read_stored_table(folder, name, known) for name in TABLES]
        joint = read_stored_table(folder, JOINT, known) if JOINT in known else None
        if request.get("events") != tables[0].meta["provenance"].get("events"):
            raise InputError(
                f"{folder / 'survey.json'} must name the events with which {folder / TABLES[0]} was planned, got "
                "other events; restore it"
            )
        for table, about in ((tables[0], TILES), (tables[2], OUTCOME)):  # FITS files are read without descriptions
            describe(table, about)
        return cls(*tables, folder, joint=joint)

    @cached_property
    def _states(self) -> list[str]:
        """The state of each tile."""
        return self.tiles["state"].tolist() if "state" in self.tiles.colnames else ["planned"] * len(self)

    @cached_property
    def _known(self) -> dict:
        """Sizes and checksums of the files of the survey."""
        return read_index(self.folder)
