"""Surveys that are already finished, which are read instead of planned."""

from pathlib import Path

import numpy as np

from rfpsurvey import _io
from rfpsurvey._folder import check_file, read_index, read_verified
from rfpsurvey._roles import has_role
from rfpsurvey.errors import InputError
from rfpsurvey.survey._folder import JOINT, TABLES, part_name
from rfpsurvey.survey._survey import Survey


def read_finished(folder: Path, n_tiles: int, *, joint: bool, cadences: bool, state=None) -> Survey | None:
    """Return the survey in a folder; None if it is not finished, or if its files do not agree with each other.

    All files must match their checksums, and the visits of all tiles must give the numbers of observations in the table
    of outcomes or, if there are cadences, whose incomplete epochs do not count, at least these numbers.
    """
    known, tables = read_index(folder), [*TABLES, *([JOINT] if joint else [])]
    closed = {} if state is None else state.closed
    parts = [part_name(tile) for tile in range(n_tiles) if closed.get(tile, tile) is not None]
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
    if (times < observed if cadences else times != observed)[is_requested].any():
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
