"""Stored results of surveys: the files of tiles, and finished surveys, which are checked before they are used."""

from functools import partial
from pathlib import Path

import numpy as np

from rfpsurvey import _io
from rfpsurvey._folder import check_file, read_index, read_verified
from rfpsurvey._roles import has_role
from rfpsurvey.errors import InputError
from rfpsurvey.survey._columns import ALSO_SCIENCE, LOST_TO_RULES, N_LOST
from rfpsurvey.survey._folder import JOINT, TABLES, part_name
from rfpsurvey.survey._request import Request
from rfpsurvey.survey._survey import Survey
from rfpsurvey.survey._unmet import CountOfRule, counts_in, is_unknown
from rfpsurvey.survey._work import Done, cards_of, flags_of, reach_of


def read_part(folder, tile, job) -> Done | None:
    """Return the result that the file of a tile contains, or None if the tile must be planned again."""
    part = folder.file(part_name(tile), partial(folder.distrust, tile))
    if part is None:
        return None
    try:
        done = done_of(*_io.read_fits_bytes(part, f"the stored result of tile {job.tile}"), job)
        if done.counts["n_in_field"] != len(job.field.row):
            raise InputError("its stored result was planned for a different set of targets with remaining visits")
    except InputError as error:  # the checksum is correct; therefore, the index was also changed
        folder.distrust(tile, str(error))
        return None
    return done


def done_of(visits: np.ndarray, cards: dict, job, *, is_kept: bool = False) -> Done:
    """Return the result that the file of a tile states, or raise an error if it is not possible.

    The file of a tile that keeps its plan can lack the numbers of constraints, which are then not checkable.
    """
    lacking = [name for name in ("target_row", "in_collision", "observed") if name not in visits.dtype.names]
    counted = every = cards_of(job.model.options)
    if is_kept:
        counted = {card: one for card, one in counted.items() if card in cards or not isinstance(one[0], CountOfRule)}
    # files of earlier versions do not state whether constraints are checkable, and the numbers of lost targets
    optional = {N_LOST, LOST_TO_RULES.card, ALSO_SCIENCE.card}
    optional |= {card for card, one in counted.items() if is_unknown(one[0])}
    counted = {card: one for card, one in counted.items() if card in cards or card not in optional}
    lacking += [card for card in counted if not isinstance(cards.get(card), int)]
    if lacking:
        raise InputError(f"its file lacks {', '.join(lacking)}")
    _check_part(visits, {card: cards[card] for card in counted})
    cards.setdefault(N_LOST, int(visits["in_collision"].sum()))
    given = visits["target_row"] >= 0
    rows = np.append(job.field.row, -1)
    target = np.where(given, np.searchsorted(job.field.row, visits["target_row"]), -1)
    if not np.array_equal(rows[target], visits["target_row"]):
        raise InputError("its stored result was planned for a different set of targets with remaining visits")
    reach = reach_of(job)
    flags = flags_of(reach.pairs.covered, reach.applied.excluded)
    return Done(None, None, target, visits["observed"].astype(bool), flags, counts_in(cards, every))


def _check_part(visits: np.ndarray, cards: dict) -> None:
    """Raise an error if the stored visits of a tile, or their numbers, have other types or are impossible."""
    for name, kind in (("target_row", "i"), ("in_collision", "b"), ("observed", "b")):
        words = {"i": "integers", "b": "booleans"}[kind]
        if visits.dtype[name].kind != kind:
            raise InputError(f"its column {name} must contain {words}, got the type {visits.dtype[name]}")
    wrong = [card for card, number in cards.items() if not 0 <= number < 2**53]
    if wrong:
        raise InputError(f"its header card {wrong[0]} must be a number of at least 0, got {cards[wrong[0]]}")


def read_finished(folder: Path, request: Request) -> Survey | None:
    """Return the survey in a folder; None if it is not finished, or if its files do not agree with each other.

    All files must match their checksums, and the visits of all tiles must give the numbers of observations in the table
    of outcomes or, if there are cadences, whose incomplete epochs do not count, at least these numbers.
    """
    known, tables, state = read_index(folder), [*TABLES, *([] if request.joint is None else [JOINT])], request.state
    closed = {} if state is None else state.closed
    parts = [part_name(tile) for tile in range(len(request.tiling)) if closed.get(tile, tile) is not None]
    # the index of a finished survey is sorted; later runs that plan a tile again add lines at the end
    if not {*tables, *parts} <= {*known} or list(known) != sorted(known) or any(len(one) > 1 for one in known.values()):
        return None
    try:
        for name in {*known} - {*parts}:
            check_file(folder, name, known)
        rows = {name: _observed(folder, name, known) for name in parts}
        survey = Survey.read(folder)
    except InputError:
        return None
    outcomes = survey.outcomes
    planned = np.concatenate([[], *(rows[name] for name in parts if name not in {part_name(tile) for tile in closed})])
    if max((one.max(initial=0) for one in rows.values()), default=0) >= len(outcomes):
        return None
    times = np.bincount(planned.astype(np.int64), minlength=len(outcomes))
    if state is not None:
        times = np.maximum(np.minimum(times + state.observed, state.requested), state.observed)
    is_requested = np.asarray(outcomes["requested"]) > 0  # standards and sky positions have no requested visits
    observed = np.asarray(outcomes["observed"])
    if (times != observed if request.cadences is None else times < observed)[is_requested].any():
        return None
    if survey.joint is not None:
        survey.joint["seconds"] = np.nan
    return survey


def _observed(folder: Path, name: str, known: dict) -> np.ndarray:
    """Return the rows of the science targets that a tile observed; raise an error if its file is damaged."""
    visits = _io.read_fits_bytes(read_verified(folder, name, known), name)[0]
    if not {"target_row", "observed"} <= set(visits.dtype.names):
        raise InputError(f"{name} must have the columns of a survey")
    counts = visits["observed"].astype(bool) & (visits["target_row"] >= 0)
    counts &= has_role(visits["kind"], "science") if "kind" in visits.dtype.names else True
    return visits["target_row"][counts]
