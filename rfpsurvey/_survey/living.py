"""Methods of `Survey` for observations: their records, the state that follows from them, and the rest of the plan."""

import os
from functools import partial

from astropy.table import QTable, Table


class Living:
    """Methods that `Survey` inherits; the modules that they call are imported on first use."""

    def record(
        self,
        table: Table | str | os.PathLike,
        *,
        enough: float = 1.0,
        tile: int | str | None = None,
        columns: dict[str, str] | None = None,
        note: str = "",
        replaces: bool = False,
        swaps: bool = False,
        allow_future: bool = False,
        dry_run: bool = False,
    ) -> dict:
        """Record what was observed, or which tiles or targets changed, in the folder of the survey.

        Each call appends one file to the folder, with the rows of the table, its name, the time and the user. A later
        record of the same tile and date corrects the state of the tile and adds failed visits; records that equal an
        earlier record are not repeated. `undo` undoes a record. If `plan_survey` is called with the new `state`,
        observed tiles keep their plans, and all other tiles are planned again.

        Parameters
        ----------
        table : Table, DataFrame, list of dict, or path-like
            Observations, with the column ``tile`` and optionally ``state`` (``done``, ``partly``, ``bad``, ``dropped``,
            ``added``, or ``planned``, which cancels earlier records of the tile), ``good``, ``date``, ``fraction``,
            ``positioner`` or ``target``, ``spectrograph`` (also ``petal``, ``module`` or ``block``: all visits of this
            group of positioners of the instrument), ``reason``, ``replaces``, and ``generation`` (the number of the
            plan of the survey) or ``plan`` (the digest ``PLANID`` of the plan of the tile). Without a state, a tile is
            bad if ``good`` is false or ``fraction`` is 0, partly observed if ``fraction`` is less than ``enough``, and
            done otherwise. A row with a positioner or a target means that this visit failed, unless ``good`` is true;
            visits without a row were successful, unless they were lost to a collision. Added tiles have the columns
            ``ra``, ``dec``, and optionally ``position_angle`` and ``pass``. A table without the column ``tile`` changes
            targets: it has the column ``target``, and optionally ``priority``, ``visits``, ``state`` (``added``,
            ``dropped`` or ``planned``) and, for added targets, ``ra``, ``dec`` and the columns of the catalog. If the
            state in each row is ``added``, ``tile`` names the only tile that may observe the target, and only tiles
            with times before the end of the date ``until`` may observe it. The usual names of columns in tables of DESI
            are also read (``TILEID``, ``ZDATE``, ``OBSSTATUS``, ``TARGETID``). The path of a confSummaryF file of
            SDSS-V gives the fibers of one tile that were not on target, whose visits failed.
        enough : float, optional
            Fraction of the exposure from which a tile without a state is done; below, it is partly done.
        tile : int or str, optional
            The tile of all rows of a table without the column ``tile``.
        columns : dict of str to str, optional
            Names of columns of the table by their roles, which are the names above, such as ``{"date": "night"}``.
        note : str, optional
            Note that is stored with the record.
        replaces : bool, optional
            Whether the failed visits of the table replace those of earlier records of the same tile and date, instead
            of being added to them. The column ``replaces`` of the table states this for single tiles.
        swaps : bool, optional
            Whether each row with a positioner and a target states that the positioner observed this target in place of
            the planned one, successfully unless ``good`` is false. The planned target then has no visit. The column
            ``swaps`` of the table states this for single rows.
        allow_future : bool, optional
            Whether dates later than tomorrow are accepted.
        dry_run : bool, optional
            Whether to check the table, and to return what would change, without recording anything.

        Returns
        -------
        dict
            Number of new events (``n_events``), of rows that were already recorded (``n_known``), and of rows without
            an observation (``n_ignored``); tiles and targets by the kind of their change (``changes``).

        Raises
        ------
        InputError
            If a tile, positioner or target is unknown, if no tile that remains may observe an added target, if the plan
            with which a tile was observed is not clear, if a value is not valid, or if another run uses the folder.
            Nothing is written then.

        Warns
        -----
        RfpsurveyWarning
            If a tile with a time was observed on another date, and a planned target moved by more than 0.1 arcsec, or
            the state of a positioner changed, between this time and the night of the observation.
        """
        from rfpsurvey._survey.history.record import record

        options = {"note": note, "replaces": replaces, "allow_future": allow_future, "dry_run": dry_run, "swaps": swaps}
        return record(self, table, enough=enough, tile=tile, columns=columns, **options)

    def undo(self, number: int, *, note: str = "", dry_run: bool = False) -> dict:
        """Undo a record, as if its table had not been recorded; tiles and targets that it added are dropped.

        This appends a file to the folder, which can be undone as well. Records on which later records depend cannot be
        undone before these.

        Parameters
        ----------
        number : int
            Number of the record, from 1; `events` lists the records.
        note : str, optional
            Note that is stored with the record.
        dry_run : bool, optional
            Whether to check only whether the record can be undone, and to return what would be undone.

        Returns
        -------
        dict
            The number of the record (``undone``), the number of the record that takes effect again because this one
            had undone it (``restored``, 0 for none), and the ``changes`` of the record as in `record`.

        Raises
        ------
        InputError
            If there is no such record, if it was already undone, or if later records depend on it.
        """
        from rfpsurvey._survey.history.record import undo

        return undo(self, number, note=note, dry_run=dry_run)

    def events(self) -> QTable:
        """Return a table of all records of the survey, and of the plans that were made after them.

        Returns
        -------
        QTable
            Table with a row for each record and each plan of the rest: the ``number`` of the record or the
            ``generation`` of the plan (0 for others), the ``time`` of recording (UTC) or the date of the plan, the
            ``user``, the name of the ``table``, the ``note`` or the changed keys of the plan file, the first and the
            last date of its rows (``dates``), the numbers of tiles (``n_tiles``), of failed visits (``n_failed``) and
            of targets (``n_targets``) that it states, the record that it undoes (``undoes``, 0 for none), the record
            that undid it (``undone_by``), and the names of the files in the folder ``events`` with its rows (``rows``).

        Raises
        ------
        InputError
            If the survey has no folder, or if a file of events is missing or damaged.
        """
        from rfpsurvey._survey.history.record import events_table

        return events_table(self)

    def state(
        self, catalog: object = None, *, rule: object = None, visits: object = None, until: str | None = None
    ) -> object:
        """Return the state of the survey that follows from the recorded events.

        Parameters
        ----------
        catalog : Catalog, PartitionedCatalog, SkyCoord, Table or DataFrame, optional
            The targets of the first plan. By default, the catalog, ``rule`` and ``visits`` are those in the plan file
            of the folder.
        rule : VisitRule, optional
            Rule that determines the requested visits and the priorities. If a catalog is given, the default is that
            each target is observed until the requested visits are successful.
        visits : int, array_like of int or Cadences, optional
            Requested visits as in the first plan. If a catalog is given, the default is the column ``visits`` of the
            catalog, or 1.
        until : str, optional
            Date of the last observations that are taken into account, such as 2026-01-03.

        Returns
        -------
        SurveyState
            The state, which is the parameter ``visits`` of `plan_survey` and `selection_probabilities`.

        Raises
        ------
        InputError
            If the catalog is another one, if a file of events is missing or damaged, or if no catalog is given and the
            folder has no plan file.
        """
        from rfpsurvey._survey import plan_file as _plan_file
        from rfpsurvey._survey.continue_survey import tiling_in

        given = {"rule": rule, "visits": visits, "until": until}
        if catalog is None:
            given = {name: value for name, value in given.items() if value is not None}
            return _plan_file.state_in(self.folder, **given)
        if isinstance(visits, _plan_file.Cadences):
            return _plan_file.state_in(self.folder, catalog=catalog, **given)
        given["tiles"] = partial(tiling_in, self.folder)  # only some states require the tiles
        return _plan_file.SurveyState.read(self.folder, catalog, **given)

    def replan(self, *, executor: object = None, progress: object = False, **changes: object) -> object:
        """Plan the rest of the survey in its folder, as `rfpsurvey.survey.continue_survey` does.

        Parameters
        ----------
        executor, progress : optional
            As in `plan_survey`.
        **changes : object
            Parameters with other values than in the first plan, as in `rfpsurvey.survey.continue_survey`.

        Returns
        -------
        Survey
            The survey.

        Raises
        ------
        InputError
            As `rfpsurvey.survey.continue_survey`.
        """
        from rfpsurvey._survey.continue_survey import continue_survey

        return continue_survey(self.folder, executor=executor, progress=progress, **changes)

    def status(self, until: str | None = None) -> QTable:
        """Return the numbers of observed, planned and other visits, as `rfpsurvey.survey.survey_status` does.

        Parameters
        ----------
        until : str, optional
            Date of the last observations that are taken into account, such as 2026-01-03.

        Returns
        -------
        QTable
            Table with a row for each class of targets.

        Raises
        ------
        InputError
            As `state`.
        """
        from rfpsurvey._survey.history.status import survey_status

        return survey_status(self, self.state(until=until))

    def select(self, n_realizations: int = 128, **options: object) -> object:
        """Return the probability that each target is observed, as `rfpsurvey.selection_probabilities` does.

        Parameters
        ----------
        n_realizations : int, optional
            Number of realizations of the survey, each of which repeats the recorded observations.
        **options : object
            The parameters ``folder``, ``resume``, ``executor``, ``progress`` and ``rng`` of
            `rfpsurvey.selection_probabilities`, and parameters that the plan file cannot contain, such as a function
            as ``allocator``, or cadences in another column than ``cadence`` as ``visits``.

        Returns
        -------
        SelectionProbabilities
            The probabilities.

        Raises
        ------
        InputError
            As `rfpsurvey.selection_probabilities`, and if a parameter that the plan file cannot contain is required.
        """
        from rfpsurvey._survey.selection.select import select_survey

        return select_survey(self, n_realizations, **options)
