"""The status of a survey: visits of each class of targets, states of tiles, and progress by date."""

import json

import numpy as np
from astropy.table import QTable

from rfpsurvey._common.descriptions import Column, Fact, describe, facts_of, table_of
from rfpsurvey._field.verdicts import OUTCOMES, Outcome
from rfpsurvey._sky.catalog import Catalog
from rfpsurvey._survey.bookkeeping import classes_by_column, rows_by_class
from rfpsurvey._survey.columns import PAST
from rfpsurvey._survey.folder import read_request
from rfpsurvey._survey.history.events import WORDS, TileState, grouped, places_of
from rfpsurvey._survey.history.replay import visits_of
from rfpsurvey._survey.history.state import SurveyState
from rfpsurvey._survey.source import columns_of, is_science
from rfpsurvey._survey.survey import Survey
from rfpsurvey.errors import InputError, refusal

STATUS = table_of(
    Column("priority", "priority of the targets, or all"),
    Column("category", "category of the targets, or all"),
    Column("n_targets", "number of targets with requested visits"),
    Column("n_complete", "number of these targets with all requested visits"),
    Column("n_requested", "number of requested visits"),
    Column("n_observed", "number of successful visits"),
    Column("n_failed", "number of failed visits"),
    Column("n_left", "number of remaining visits, which are divided into those of the next columns"),
    Column("n_planned", "remaining visits of tiles that will be observed"),
    Column("n_not_assigned", "remaining visits without a fiber, of targets that a tile reaches"),
    Column("n_lost", "remaining visits of targets that were lost to a collision"),
    Column("n_impossible", "remaining visits of targets that no tile can observe"),
    Column("n_expired", "visits that are no longer requested, because no tile that remains may make them"),
)
LOST = Outcome.LOST_TO_A_COLLISION
IMPOSSIBLE = (Outcome.OUT_OF_REACH, Outcome.IN_NO_FIELD, Outcome.EXCLUDED_BY_A_CONSTRAINT)
"""Outcomes of targets that no tile can observe."""
SIZES, MOST_AREAS = (60, 30, 15, 10, 5, 2, 1, 0.5), 20
"""Sizes of areas on the sky in degrees, and their largest number."""
STATUS_FACTS = (
    Fact("tiles", "tiles", zero=True),
    Fact("observed", "finished", "tiles", zero=True),
    Fact("partly observed", "partly observed", "tiles", zero=True),
    Fact("bad", "observed without success", "tiles", zero=True),
    Fact("dropped", "dropped", "tiles", zero=True),
    Fact(PAST, "not observed in time", "tiles"),
    Fact("planned", "not yet observed", "tiles", zero=True),
    Fact("dates", "first and last date"),
    Fact("generation", "generation of the plan"),
    Fact("n_targets", "targets with requested visits", zero=True),
    Fact("n_complete", "complete", "n_targets", zero=True),
    Fact("n_requested", "visits requested", zero=True),
    Fact("n_observed", "observed", "n_requested", zero=True),
    Fact("n_left", "remaining", "n_requested", zero=True),
    Fact("n_planned", "planned", "n_left", zero=True),
    Fact("n_not_assigned", "in reach, not assigned", "n_left", zero=True),
    Fact("n_lost", "lost to a collision", "n_left", zero=True),
    Fact("n_impossible", "out of reach or excluded", "n_left", zero=True),
    Fact("n_failed", "failed visits", zero=True),
    Fact("n_expired", "expired visits"),
)
"""The numbers of the status of a survey that are shown; those of tiles are sums over the passes."""


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
        ``n_lost`` (to a collision), ``n_impossible`` (no tile can observe the target). If targets are wanted on a
        single tile or until a date, ``n_expired`` is the number of visits that are no longer requested, because no tile
        that remains may make them; they are not part of ``n_requested``. The ``meta`` contains ``tiles`` (numbers of
        tiles by state, for each pass), ``areas`` (numbers of visits in 4 to 20 rectangles of right ascension and
        declination, for catalogs in memory), ``progress`` (numbers of observed tiles and visits up to each date;
        ``n_counted`` contains, for each row of the table, the visits that its ``n_observed`` counts), ``failures``
        (positioners whose visits failed in several tiles), ``reasons`` (numbers of targets and visits that are lost,
        impossible or expired, by reason), and ``is_planned``, which states whether the last plan takes all events into
        account.

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
    record = json.loads(json.dumps(state.record))  # a survey without events lacks the record of its state
    is_planned = record == survey.provenance.get("events", None if state.events.files else record)
    left = wanted - observed
    planned = np.minimum(count_planned(survey, state, is_planned=is_planned), left)
    not_planned, n_added = left - planned, len(state) - len(survey.outcomes)
    # targets that were added after the last plan are not assigned
    code = np.pad(survey.outcomes["outcome"], (0, n_added), constant_values=Outcome.IN_REACH_NOT_ASSIGNED)
    by_reason = {OUTCOMES[outcome]: not_planned * (code == outcome) for outcome in (LOST, *IMPOSSIBLE)}
    impossible, lost = np.isin(code, IMPOSSIBLE), code == LOST
    values = {
        "n_targets": wanted > 0,
        "n_complete": (wanted > 0) & (left == 0),
        "n_requested": wanted,
        "n_observed": observed,
        "n_failed": state.failed,
        "n_left": left,
        "n_planned": planned,
        "n_not_assigned": not_planned * ~(lost | impossible),
        "n_lost": not_planned * lost,
        "n_impossible": not_planned * impossible,
    }
    expired = np.zeros_like(wanted)
    if state.limits is not None:
        expired[state.limits.row] = state.limits.expired
        values["n_expired"] = by_reason["expired"] = expired
    classes, counts = classes_by_column(columns["priority"], columns["category"], wanted + expired), {}
    for column, (class_of, names) in classes.items():
        numbers = [np.bincount(class_of, weights=counted, minlength=len(names)) for counted in values.values()]
        counts[column] = names, np.column_stack(numbers).astype(np.int64)
    table = QTable(rows=rows_by_class(counts), names=(*classes, *values))
    table.meta = {
        "made_by": "survey_status",
        "instrument": survey.provenance["instrument"]["name"],
        "layout": survey.provenance["instrument"].get("layout", "not recorded"),
        "tiles": _tiles(survey, state),
        "areas": _areas(state.catalog, values),
        "progress": _progress(state, classes, observed),
        "failures": _failures(state),
        "reasons": [
            {"reason": reason, "n_targets": int((visits > 0).sum()), "n_visits": int(visits.sum())}
            for reason, visits in by_reason.items()
        ],
        "generation": read_request(state.folder).get("generation", 1),
        "is_planned": bool(is_planned),
        "events": state.record,
    }
    return describe(table, STATUS)


STATUS_RESULT = ("tiles", "observed", "partly observed", "planned", "n_targets", "n_complete", "n_requested")
STATUS_RESULT += ("n_observed", "n_left", "n_planned", "n_failed", "n_expired")
"""The numbers of the shortest status of a survey."""


def status_facts(status: QTable, *, is_short: bool = False) -> dict:
    """Return the labels and values of the status of a survey."""
    values = {name: int(status[name][0]) for name in status.colnames if name.startswith("n_")}
    tiles = {name: sum(row.get(name, 0) for row in status.meta["tiles"]) for name in (*WORDS.values(), PAST)}
    dates = [date for date in status.meta["progress"]["date"] if date]
    first_and_last = f"{dates[0]} {dates[-1]}" if dates else None
    values |= {"generation": status.meta["generation"], "dates": first_and_last}
    values |= {**tiles, "tiles": sum(tiles.values())}
    return facts_of(STATUS_FACTS, values, STATUS_RESULT if is_short else None)


def _failures(state: SurveyState) -> list[dict]:
    """Return the positioners whose visits failed in several observed tiles, most failures first."""
    done = [event for event in state.attempts if event.state == TileState.DONE]
    failed = grouped(failure for event in done for failure in event.failed.items())
    repeated = sorted((-len(reasons), name) for name, reasons in failed.items() if len(reasons) > 1)
    return [
        {"positioner": name, "n_failed": -n, "reasons": ", ".join(sorted({*failed[name]} - {""}))}
        for n, name in repeated
    ]


def count_planned(survey: Survey, state: SurveyState, *, is_planned: bool) -> np.ndarray:
    """Return the number of visits of each target in the tiles that will be observed."""
    if is_planned:
        observed = np.asarray(survey.outcomes["observed"]).astype(np.int64)
        return np.maximum(np.pad(observed, (0, len(state) - len(observed))) - state.observed, 0)
    planned = np.zeros(len(state), dtype=np.int64)
    places, added = places_of(survey.tiles), state.states.added
    for row in range(len(survey)):
        has_plan = row not in added or np.array_equal(places[row], added[row].place)
        if row not in state.closed and has_plan:  # otherwise, the tile has no plan for its present position
            visits = survey._visits(row)
            target = np.asarray(visits["target_row"])[np.asarray(visits["observed"])]
            planned += np.bincount(target[target >= 0], minlength=len(state))
    return planned


def _areas(catalog, values: dict) -> list[dict]:
    """Return the numbers of visits in rectangles on the sky, which are as large as possible; none for small fields."""
    if not isinstance(catalog, Catalog):
        return []
    icrs, is_requested = catalog.coord.icrs, values["n_requested"] > 0
    for size in SIZES:
        cell = np.column_stack([icrs.ra.deg // size, (icrs.dec.deg + 90) // size]).astype(np.int64)
        cells, place = np.unique(cell[is_requested], axis=0, return_inverse=True)
        if 4 <= len(cells) <= MOST_AREAS:
            break
    else:
        return []
    counts = {
        name: np.bincount(place.reshape(-1), weights=numbers[is_requested], minlength=len(cells)).astype(np.int64)
        for name, numbers in values.items()
    }
    return [
        {"ra": f"{a * size:g} to {(a + 1) * size:g}", "dec": f"{b * size - 90:g} to {(b + 1) * size - 90:g}"}
        | {name: int(numbers[k]) for name, numbers in counts.items()}
        for k, (a, b) in enumerate(cells)
    ]


def _tiles(survey: Survey, state: SurveyState) -> list[dict]:
    """Return the numbers of tiles by state, for each pass; ``bad`` are tiles whose last observation failed."""
    passes = dict(enumerate(map(int, survey.tiles["pass"])))
    passes |= {row: event.place[3] for row, event in state.states.added.items()}
    past = {row for row in state.past if not state.states.of(row)}
    names = dict.fromkeys([*WORDS.values(), *([] if state.cadences is None else [PAST])], 0)
    counts = {number: {"pass": number, **names} for number in sorted({*passes.values()})}
    for row, number in passes.items():
        counts[number][PAST if row in past else state.states.word_of(row)] += 1
    return [*counts.values()]


def _progress(state: SurveyState, classes: dict, observed: np.ndarray) -> dict:
    """Return the numbers of observed tiles, of visits by priority, and of counted visits of each class, by date.

    Of each target, as many visits are counted as its number ``observed``, the first ones.
    """
    done = sorted((event for event in state.attempts if event.state == TileState.DONE), key=lambda event: event.date)
    dates = list(dict.fromkeys(event.date for event in done))
    tiles, made = np.zeros(len(dates), dtype=np.int64), np.zeros(len(observed), dtype=np.int64)
    labels = [*classes.values(), classes["priority"]]
    visits = [np.zeros((len(dates), len(names)), dtype=np.int64) for _, names in labels]
    for event in done:
        target, good, _ = visits_of(event, state.events.observed(event)[0])
        k, target = dates.index(event.date), target[good]
        tiles[k] += 1
        made[target] += 1
        counted = [target[made[target] <= observed[target]]] * len(classes)
        for numbers, rows, (class_of, names) in zip(visits, [*counted, target], labels, strict=True):
            numbers[k] += np.bincount(class_of[rows], minlength=len(names))
    *counted, numbers = visits
    counted = [v.T for v, (_, names) in zip(counted, labels, strict=False) if len(names) > 1]
    by_priority = zip(labels[-1][1], numbers.cumsum(axis=0).T.tolist(), strict=True) if len(numbers.T) > 1 else ()
    return {
        "date": dates,
        "n_tiles": tiles.cumsum().tolist(),
        "n_observed": {"all": numbers.sum(axis=1).cumsum().tolist(), **dict(by_priority)},
        "n_counted": np.vstack([visits[0].sum(axis=1)[None], *counted]).cumsum(axis=1).tolist(),
    }
