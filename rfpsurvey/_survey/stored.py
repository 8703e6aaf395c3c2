"""Stored results of surveys: the files of tiles and finished surveys, and the verification of all files of a survey."""

import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
from astropy.table import QTable

from rfpsurvey._assignment.constraints.text import with_present_texts
from rfpsurvey._common import io as _io
from rfpsurvey._common.descriptions import Column, describe, table_of
from rfpsurvey._common.folder import INDEX, LOCK, check_file, read_index, read_lines
from rfpsurvey._common.io import TEMPORARY_PREFIX
from rfpsurvey._common.read_documents import content_of, is_present, sentence
from rfpsurvey._sky.arrays import has_role
from rfpsurvey._sky.catalog import Catalog
from rfpsurvey._sky.partitions import PartitionedCatalog, as_catalog
from rfpsurvey._survey import columns as _columns
from rfpsurvey._survey import folder as _folder
from rfpsurvey._survey.generations import EVENTS, GENERATIONS, NEXT, PLANS, read_generations, read_plans
from rfpsurvey._survey.history.event_files import COPY, read_events
from rfpsurvey._survey.history.events import Events, TileState
from rfpsurvey._survey.history.replay import CHECKPOINT, TileStates, checkpoint_of, replay_of_plan
from rfpsurvey._survey.history.rule import VisitRule
from rfpsurvey._survey.key_objects import INPUTS, RECORD
from rfpsurvey._survey.plan_file import check_inputs
from rfpsurvey._survey.request import Request
from rfpsurvey._survey.source import check_first_catalog
from rfpsurvey._survey.survey import Survey
from rfpsurvey._survey.work import Done, cards_of, flags_of, reach_of
from rfpsurvey.errors import InputError, warn

DAMAGES = table_of(
    Column("file", "path of the file relative to the folder"),
    Column("problem", "why the file cannot be used"),
    Column("remedy", "what replaces the file"),
)
MADE, RESTORED = "it is made again when the survey is planned again", "restore it from a backup"
CANCELED = f"{RESTORED}, or record the state planned for its tile, which cancels the observations"
REQUEST = _folder.Folder.request_name
GIVEN = f"{RESTORED}, or give the catalog, the tiles and the instrument of the first plan"


def read_part(folder, tile, job) -> Done | None:
    """Return the result that the file of a tile contains, or None if the tile must be planned again."""
    if _folder.part_name(tile) not in folder._known:
        return None
    try:
        done = done_of(*_folder.read_visits(folder.path, tile, folder._known, job.tile), job)
        if done.counts["n_in_field"] != len(job.field.row):
            raise InputError("its stored result was planned for a different set of targets with remaining visits")
    except InputError as error:
        warn(f"the tile in row {tile} of the tiling is planned again: {error}")
        return None
    return done


def done_of(visits: np.ndarray, cards: dict, job, *, is_kept: bool = False) -> Done:
    """Return the result that the file of a tile states, or raise an error if it is not possible.

    The file of a tile that keeps its plan can lack the numbers of constraints, which are then not checkable.
    """
    every = cards_of(job.model.options)
    # files of earlier versions do not state whether constraints are checkable, and the numbers of lost targets
    optional = {_columns.N_LOST, _columns.LOST_TO_RULES.card, _columns.ALSO_SCIENCE.card}
    for card, (count, *_) in every.items():
        if _columns.is_unknown(count) or (is_kept and isinstance(count, _columns.CountOfRule)):
            optional.add(card)
    counted = [card for card in every if card in cards or card not in optional]
    if lacking := [card for card in counted if not isinstance(cards.get(card), int)]:
        raise InputError(f"its file lacks {', '.join(lacking)}")
    if wrong := [card for card in counted if not 0 <= cards[card] < 2**53]:
        raise InputError(f"its header card {wrong[0]} must be a number of at least 0, got {cards[wrong[0]]}")
    cards.setdefault(_columns.N_LOST, int(visits["in_collision"].sum()))
    given = visits["target_row"] >= 0
    rows = np.append(job.field.row, -1)
    target = np.where(given, np.searchsorted(job.field.row, visits["target_row"]), -1)
    if not np.array_equal(rows[target], visits["target_row"]):
        raise InputError("its stored result was planned for a different set of targets with remaining visits")
    reach = reach_of(job)
    flags = flags_of(reach.pairs.covered, reach.applied.excluded)
    return Done(None, None, target, visits["observed"].astype(bool), flags, _columns.counts_in(cards, every))


def read_finished(folder: Path, request: Request) -> Survey | None:
    """Return the survey in a folder; None if it is not finished, or if a file is missing or damaged."""
    known, state, tables = read_index(folder), request.state, [*_folder.TABLES, *[_folder.JOINT] * bool(request.joint)]
    # the index of a finished survey is sorted; later runs that plan a tile again add lines at the end
    if list(known) != sorted(known) or any(len(entries) > 1 for entries in known.values()) or not {*tables} <= {*known}:
        return None
    if _damaged(folder, None if state is None else state.events)[0]:
        return None
    survey = Survey.read(folder)
    if survey.joint is not None:
        survey.joint["seconds"] = np.nan
    return survey


def verify_survey(folder: str | os.PathLike, catalog: object = None) -> QTable:
    """Check all files in the folder of a survey, and return a table of the files that are missing or damaged.

    The checksums of all files in the index are compared, and the request, the chain of events, the tables of targets,
    the plans with which tiles were observed, and the checkpoint are checked. The visits of all tiles must agree with
    the table of outcomes. Nothing is written.

    Parameters
    ----------
    folder : str or path-like
        The folder of the survey, which can be unfinished.
    catalog : Catalog, PartitionedCatalog, SkyCoord, Table or DataFrame, optional
        The targets of the first plan, whose digest is compared with that in the request.

    Returns
    -------
    QTable
        Table with a row for each file that is missing or damaged, with the columns ``file`` (path relative to the
        folder), ``problem`` and ``remedy``. ``meta["others"]`` lists files that do not belong to the survey.

    Raises
    ------
    InputError
        If the folder does not contain a survey.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astropy.coordinates import SkyCoord
    >>> from tempfile import TemporaryDirectory
    >>> import rfpsurvey as rs
    >>> sky = rs.synthetic_catalog("uniform", SkyCoord("6h20m +23d"), 0.3 * u.deg, n_targets=4000, rng=1)
    >>> with TemporaryDirectory() as folder:
    ...     survey = rs.plan_survey(sky, "moons", SkyCoord(["6h20m"], ["+23d"]), folder=f"{folder}/survey")
    ...     (survey.folder / "outcomes.fits").unlink()
    ...     damaged = rs.survey.verify_survey(survey.folder)
    >>> damaged["file"].tolist()
    ['outcomes.fits']
    """
    folder = _io.to_path(folder).absolute()
    if not is_present(folder / REQUEST):
        Survey.read(folder)  # raises an error
    if not (catalog is None or isinstance(catalog, PartitionedCatalog)):
        catalog = as_catalog(catalog)
    damaged, others = _damaged(folder, catalog=catalog)
    columns = np.array([(name, *damaged[name]) for name in sorted(damaged)], dtype=str).reshape(-1, 3).T
    table = QTable(dict(zip(DAMAGES, columns, strict=True)))
    table.meta = {"made_by": "verify_survey", "others": others}
    return describe(table, DAMAGES)


def _damaged(folder: Path, events: Events | None = None, catalog: Catalog | PartitionedCatalog | None = None) -> tuple:
    """Check all files of a survey.

    Parameters
    ----------
    folder : Path
        The folder.
    events : Events, optional
        The events with which the survey was planned; by default, those in the folder, which are checked.
    catalog : Catalog or PartitionedCatalog, optional
        The targets of the first plan.

    Returns
    -------
    damaged : dict
        The problem and the remedy for each file that is missing or damaged.
    others : list of str
        The files that do not belong to the survey.
    """
    damaged: dict[str, tuple[str, str]] = {}
    is_verified = events is None

    def check(name: str, remedy: str, function: Callable, *arguments):
        """Return the result of a function, or None if it raises an error, which is recorded for the file ``name``."""
        try:
            return function(*arguments)
        except Exception as error:  # files that were changed with their checksums can have any content
            text = sentence(error)
            if text.startswith(f"{folder}/"):  # an error of read_events names one of several files
                name, _, text = text.removeprefix(f"{folder}/").partition(" ")
            damaged.setdefault(name.rstrip(":"), (text.partition("; ")[0], remedy))
            return None

    request = check(REQUEST, RESTORED, _folder.read_request, folder) or {}
    if catalog is not None:
        check(REQUEST, RESTORED, check_first_catalog, request, catalog, None, VisitRule())
    known, n_strange = check(INDEX, MADE, read_lines, folder) or ({}, 0)
    if n_strange or not known:
        damaged.setdefault(INDEX, ("must have a line with the checksum of each file, got other lines or none", MADE))
    # a survey that was planned with the events of another folder does not contain them
    has_events = "events" not in request or "planned" in request or is_present(folder / EVENTS)
    chain = events or (check(EVENTS, RESTORED, read_events, folder) if has_events else Events(folder))
    events = chain or Events(folder)
    belonging = {REQUEST, INDEX, LOCK, PLANS, GENERATIONS, CHECKPOINT, COPY, RECORD, *known}
    belonging |= {f"{EVENTS}/{number:06d}.json" for number in range(1, len(events.files) + 1)}
    for name in (name for file in events.files for name in file.others):
        belonging.add(f"{EVENTS}/{name}")
        check(f"{EVENTS}/{name}", RESTORED, events.read_other, name)
    for event in TileStates(events.of_tiles()).attempts:
        check(_folder.part_name(event.row), CANCELED, events.plan, event.row, event.plan)
    plans = check(PLANS, RESTORED, read_plans, folder) or {}
    check(GENERATIONS, RESTORED, read_generations, folder)
    replaced = {checksum for plans_of_tile in plans.values() for checksum, _ in plans_of_tile}
    for name, plan in {(_folder.kept_name(plan), plan) for plan in replaced | {plan for _, plan in events.plans}}:
        if is_present(folder / name):
            belonging.add(name)
            check(name, RESTORED, _folder.read_named, folder / name, plan)
    if is_present(folder / CHECKPOINT):
        check(CHECKPOINT, MADE, checkpoint_of, folder)
    if events.files and request.get("events") and is_present(folder / EVENTS):
        check(PLANS, RESTORED, content_of, folder / PLANS)
    is_begun = any(name in known or is_present(folder / name) for name in _folder.TABLES)
    expected = {*known, *_folder.TABLES} if is_begun else {*known}
    for name in sorted(name for name in expected if not name.startswith("tiles/")):
        check(name, MADE, check_file, folder, name, known)
    is_readable = is_begun and not damaged.keys() & {*_folder.TABLES, _folder.JOINT}
    survey = check(REQUEST, RESTORED, Survey.read, folder) if is_readable else None
    states, planned = {} if survey is None else dict(enumerate(survey._states)), []
    rows = {_folder.part_name(row): row for row, state in states.items() if state not in _columns.NOT_PLANNED}
    for name in sorted(name for name in {*known, *rows} if name.startswith("tiles/")):
        if (row := rows.get(name)) is None:
            check(name, MADE, check_file, folder, name, known)
            continue
        observed_rows = check(name, MADE, _observed, folder, row, known, survey.tiles["tile"][row])
        planned += [observed_rows] if observed_rows is not None and states[row] != TileState.DONE else []
    if survey is not None and not damaged:
        check(_folder.TABLES[2], MADE, _check_outcomes, survey, planned, events)
        check(REQUEST, RESTORED, _check_request, survey, request)
    if is_verified and is_present(folder / RECORD):
        check(RECORD, GIVEN, check_inputs, folder, request)
        belonging |= {str(path.relative_to(folder)) for path in (folder / INPUTS).glob("*")}
    belonging |= {*expected, *rows, *damaged}
    present = {str(path.relative_to(folder)) for path in folder.rglob("*") if not path.is_dir()}
    not_known = tuple(name for name, content in ((EVENTS, chain), ("tiles", survey)) if content is None)
    omitted = (*not_known, f"{NEXT}/")
    others = {name for name in present - belonging if not name.startswith(omitted) and TEMPORARY_PREFIX not in name}
    return damaged, sorted(others)


def _observed(folder: Path, row: int, known: dict, tile: object) -> np.ndarray:
    """Return the rows of the science targets that a tile observes; raise an error if its file is damaged."""
    visits, _ = _folder.read_visits(folder, row, known, tile)
    counts = visits["observed"].astype(bool) & (visits["target_row"] >= 0)
    counts &= has_role(visits["kind"], "science") if "kind" in visits.dtype.names else True
    return visits["target_row"][counts]


def _check_outcomes(survey: Survey, planned: list[np.ndarray], events: Events) -> None:
    """Raise an error if the visits of all tiles do not give the numbers of observations in the table of outcomes.

    If there are cadences, whose incomplete epochs do not count, the visits must give at least these numbers.
    ``planned`` contains the rows of the science targets that each tile observes, except observed tiles.
    """
    requested, observed = (np.asarray(survey.outcomes[name]).astype(np.int64) for name in ("requested", "observed"))
    times = np.bincount(np.concatenate([[], *planned]).astype(np.int64), minlength=len(observed))
    is_wrong, applied = len(times) > len(observed), events.of_plan(survey.provenance)
    if not is_wrong and applied.digest == survey.provenance.get("events", {"digest": ""})["digest"]:
        if applied.files:
            made = replay_of_plan(survey, applied).made
            times = np.maximum(np.minimum(times + made, requested), made)
        differ = times < observed if "cadences" in survey.provenance["parameters"] else times != observed
        is_wrong = differ[requested > 0].any()  # standards and sky positions have no requested visits
    if is_wrong:
        raise InputError(f"{survey.folder / _folder.TABLES[2]} must agree with the visits of all tiles, got others")


def _check_request(survey: Survey, request: dict) -> None:
    """Raise an error if the request differs from the provenance of the survey, which has a checksum."""
    about = survey.provenance
    used = {**about["parameters"], "instrument": "{name}, digest {digest}".format_map(about["instrument"])}
    if wrong := [name for name, value in with_present_texts(used, request).items() if request.get(name) != value]:
        path = survey.folder / REQUEST
        raise InputError(f"{path} must be the request of {_folder.TABLES[0]}, got another {wrong[0]}")
