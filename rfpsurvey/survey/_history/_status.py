"""The status of a survey: visits of each class of targets, states of tiles, and progress by date."""

import json

import numpy as np
from astropy.table import QTable

from rfpsurvey._readers import read_fits_bytes
from rfpsurvey.catalog import Catalog
from rfpsurvey.errors import InputError, refusal
from rfpsurvey.pipeline import Outcome, category_classes, priority_classes
from rfpsurvey.survey._history._catalogs import columns_of, is_science
from rfpsurvey.survey._history._events import BAD, DONE, PARTLY
from rfpsurvey.survey._history._replay import visits_of
from rfpsurvey.survey._history._state import SurveyState
from rfpsurvey.survey._survey import Survey
from rfpsurvey.tile import describe

STATUS = {
    "priority": "priority of the targets, or all",
    "category": "category of the targets, or all",
    "n_targets": "number of targets with requested visits",
    "n_complete": "number of these targets with all requested visits",
    "n_requested": "number of requested visits",
    "n_observed": "number of successful visits",
    "n_failed": "number of failed visits",
    "n_left": "number of remaining visits, which are divided into those of the next columns",
    "n_planned": "remaining visits of tiles that will be observed",
    "n_not_assigned": "remaining visits without a fiber, of targets that a tile reaches",
    "n_lost": "remaining visits of targets that were lost to a collision",
    "n_impossible": "remaining visits of targets that no tile can observe",
}
SIZES, MOST_AREAS = (60, 30, 15, 10, 5, 2, 1, 0.5), 20
"""Sizes of areas on the sky in degrees, and their largest number."""
COUNTS = tuple(name for name in STATUS if name.startswith("n_"))


def survey_status(survey: Survey, state: SurveyState) -> QTable:
    """Return the numbers of observed, planned and other visits for each class of targets.

    Parameters
    ----------
    survey : Survey
        The survey, as it was planned last.
    state : SurveyState
        The state of the survey, which can contain further events.

    Returns
    -------
    QTable
        Table with a row for all science targets and, if there are several, a row for each priority and each category.
        Columns: ``priority``, ``category`` if there are several, ``n_targets`` (with requested visits), ``n_complete``
        (targets with all requested visits), ``n_requested``, ``n_observed``, ``n_failed``, ``n_left`` (remaining
        visits), and the numbers into which ``n_left`` is divided: ``n_planned``, ``n_not_assigned`` (no fiber),
        ``n_lost`` (to a collision), ``n_impossible`` (no tile can observe the target). The ``meta`` contains ``tiles``
        (numbers of tiles by state, for each pass), ``areas`` (numbers of visits in 4 to 20 rectangles of right
        ascension and declination, for catalogs in memory), ``progress`` (numbers of observed tiles and visits up to
        each date), and ``is_planned``, which states whether the last plan takes all events into account.

    Raises
    ------
    InputError
        If the state is that of another survey, or if a plan with which a tile was observed is missing.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astropy.coordinates import SkyCoord
    >>> from tempfile import TemporaryDirectory
    >>> import rfpsurvey as rs
    >>> sky = rs.synthetic_catalog("uniform", SkyCoord("6h20m +23d"), 0.3 * u.deg, n_targets=4000, rng=1)
    >>> with TemporaryDirectory() as folder:
    ...     survey = rs.plan_survey(sky, "desi", SkyCoord(["6h20m"], ["+23d"]), folder=f"{folder}/survey")
    ...     status = rs.survey.survey_status(survey, survey.state(sky))
    >>> bool(status["n_planned"][0] == survey.summary["n_visits_observed"])
    True
    """
    if not isinstance(survey, Survey):
        raise refusal("survey must be a Survey", survey)
    if not isinstance(state, SurveyState):
        raise refusal("state must be a SurveyState", state)
    if survey.folder is None or survey.folder.resolve() != state.folder.resolve() or len(survey.outcomes) > len(state):
        raise InputError(f"state must be the state of the survey, got that of the survey in {state.folder}")
    columns = columns_of(state.catalog, None)
    wanted = state.requested * is_science(state.catalog).astype(np.int64)
    observed = np.minimum(state.observed, wanted)
    is_planned = json.loads(json.dumps(state.record)) == survey.provenance.get("events", _none(state))
    left = wanted - observed
    planned = np.minimum(_planned(survey, state, is_planned=is_planned), left)
    rest, code = left - planned, _codes(survey, len(state))
    impossible = np.isin(code, (Outcome.IN_NO_FIELD, Outcome.OUT_OF_REACH, Outcome.EXCLUDED_BY_A_CONSTRAINT))
    lost = code == Outcome.LOST_TO_A_COLLISION
    values = {
        "n_targets": wanted > 0,
        "n_complete": (wanted > 0) & (left == 0),
        "n_requested": wanted,
        "n_observed": observed,
        "n_failed": state.failed,
        "n_left": left,
        "n_planned": planned,
        "n_not_assigned": rest * ~(lost | impossible),
        "n_lost": rest * lost,
        "n_impossible": rest * impossible,
    }
    classes = {"priority": priority_classes(columns["priority"], wanted)}
    categories = category_classes(columns["category"], wanted)
    if len(categories[1]) > 1:
        classes["category"] = categories
    table = _table(classes, values)
    progress = _progress(state, *classes["priority"])
    table.meta = {
        "made_by": "survey_status",
        "instrument": survey.provenance["instrument"]["name"],
        "tiles": _tiles(survey, state),
        "areas": _areas(state.catalog, values),
        "progress": progress,
        "is_planned": bool(is_planned),
        "events": state.record,
    }
    return describe(table, STATUS)


def _none(state: SurveyState) -> dict | None:
    """Return the record of a state without events, which a survey without events lacks."""
    return None if state.events.files else json.loads(json.dumps(state.record))


def _codes(survey: Survey, n: int) -> np.ndarray:
    """Return the outcome of each target; targets that were added after the last plan are not assigned."""
    code = np.asarray(survey.outcomes["outcome"])
    return np.concatenate([code, np.full(n - len(code), Outcome.IN_REACH_NOT_ASSIGNED, dtype=code.dtype)])


def _planned(survey: Survey, state: SurveyState, *, is_planned: bool) -> np.ndarray:
    """Return the number of visits of each target in the tiles that will be observed."""
    planned = np.zeros(len(state), dtype=np.int64)
    if is_planned:
        own = np.asarray(survey.outcomes["observed"]).astype(np.int64)
        planned[: len(own)] = np.maximum(own - state.observed[: len(own)], 0)
        return planned
    for row in range(len(survey)):
        if row not in state.closed and not _is_moved(survey, state, row):
            visits = survey._visits(row)
            target = np.asarray(visits["target_row"])[np.asarray(visits["observed"])]
            planned += np.bincount(target[target >= 0], minlength=len(state))
    return planned


def _is_moved(survey: Survey, state: SurveyState, row: int) -> bool:
    """Return whether a tile has no plan for its present position."""
    if row not in state.states.added:
        return False
    one = survey.tiles[row]
    place = [getattr(one[name], "value", one[name]) for name in ("ra", "dec", "position_angle", "pass")]
    return not np.array_equal(place, state.states.added[row].place)


def _table(classes: dict, values: dict) -> QTable:
    """Return the table with a row for all targets, and a row for each class."""
    rows = [(*["all"] * len(classes), *(int(one.sum()) for one in values.values()))]
    for column, (class_of, names) in classes.items():
        if len(names) < 2:
            continue
        counts = [np.bincount(class_of, weights=one, minlength=len(names)).astype(np.int64) for one in values.values()]
        for k, name in enumerate(names):
            rows.append((*(name if column == other else "all" for other in classes), *(int(one[k]) for one in counts)))
    return QTable(rows=rows, names=(*classes, *values))


def _areas(catalog, values: dict) -> list[dict]:
    """Return the numbers of visits in rectangles on the sky, which are as large as possible; none for small fields."""
    if not isinstance(catalog, Catalog):
        return []
    icrs = catalog.coord.icrs
    for size in SIZES:
        cell = np.column_stack([icrs.ra.deg // size, (icrs.dec.deg + 90) // size]).astype(np.int64)
        cells, place = np.unique(cell[values["n_requested"] > 0], axis=0, return_inverse=True)
        if 4 <= len(cells) <= MOST_AREAS:
            break
    else:
        return []
    found = [
        {"ra": f"{a * size:g} to {(a + 1) * size:g}", "dec": f"{b * size - 90:g} to {(b + 1) * size - 90:g}"}
        for a, b in cells
    ]
    for name, one in values.items():
        counts = np.bincount(place.reshape(-1), weights=one[values["n_requested"] > 0], minlength=len(cells))
        for area, count in zip(found, counts.astype(np.int64).tolist(), strict=True):
            area[name] = count
    return found


def _tiles(survey: Survey, state: SurveyState) -> list[dict]:
    """Return the numbers of tiles by state, for each pass; ``bad`` are tiles whose last observation failed."""
    number = {row: int(one) for row, one in enumerate(survey.tiles["pass"])}
    number |= {row: event.place[3] for row, event in state.states.added.items()}
    found: dict[int, dict] = {}
    for row, one in number.items():
        words = found.setdefault(one, {"pass": one, **dict.fromkeys((*_WORDS.values(), "dropped", "planned"), 0)})
        kept = state.closed.get(row, state.begun.get(row))
        attempts = state.states.of(row) if kept is None else [kept]
        if row in state.closed and kept is None:
            words["dropped"] += 1
        else:
            words[_WORDS[attempts[-1].state] if attempts else "planned"] += 1
    return [found[one] for one in sorted(found)]


_WORDS = {DONE: "observed", PARTLY: "partly observed", BAD: "bad"}


def _progress(state: SurveyState, class_of: np.ndarray, names: list[str]) -> dict:
    """Return the numbers of observed tiles, and of visits by priority, up to each date."""
    done = sorted((event for event in state.attempts if event.state == DONE), key=lambda event: event.date)
    dates = list(dict.fromkeys(event.date for event in done))
    tiles, visits = np.zeros(len(dates), dtype=np.int64), np.zeros((len(dates), len(names)), dtype=np.int64)
    for event in done:
        content, _ = read_fits_bytes(state.events.plan(event.row, event.plan), f"the plan of tile {event.tile}")
        target, good, _ = visits_of(event, content)
        tiles[dates.index(event.date)] += 1
        visits[dates.index(event.date)] += np.bincount(class_of[target[good]], minlength=len(names))
    visits = visits.cumsum(axis=0)
    by_class = dict(zip(names, visits.T.tolist(), strict=True)) if len(names) > 1 else {}
    return {
        "date": dates,
        "n_tiles": tiles.cumsum().tolist(),
        "n_observed": {"all": visits.sum(axis=1).tolist(), **by_class},
    }
