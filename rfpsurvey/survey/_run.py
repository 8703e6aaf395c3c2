"""The loop over the tiles of a survey."""

from collections.abc import Callable
from concurrent.futures import Executor
from contextlib import nullcontext
from functools import partial
from pathlib import Path

import numpy as np

from rfpsurvey import _io
from rfpsurvey._executors import is_local
from rfpsurvey._folder import check_file, read_index, read_verified
from rfpsurvey._progress import Progress
from rfpsurvey._roles import has_role
from rfpsurvey.errors import InputError, warn
from rfpsurvey.pipeline import OUTCOMES
from rfpsurvey.survey._columns import ALSO_SCIENCE, LOST_TO_RULES, N_LOST
from rfpsurvey.survey._folder import JOINT, TABLES, Folder, part_name
from rfpsurvey.survey._history._events import TileState
from rfpsurvey.survey._joint._plan import plan_together
from rfpsurvey.survey._request import Request
from rfpsurvey.survey._result import completeness_table, outcome_table, tile_table
from rfpsurvey.survey._rounds import run_rounds
from rfpsurvey.survey._survey import Survey
from rfpsurvey.survey._unmet import CountOfRule, counts_in, is_unknown
from rfpsurvey.survey._work import DONE, Done, Job, cards_of, early_sentences, flags_of, reach_of, work


def run(
    request: Request, path, executor: Executor | None, progress, *, resume: bool, record: Callable[[Path], None]
) -> Survey:
    """Plan the tiles of a survey, and write them to the folder ``path`` unless ``path`` is None.

    The function ``record`` writes the plan file of the survey to the folder, when the folder is locked.
    """
    joint = None
    where = nullcontext()
    if path is not None:
        request.check_text()
        where = Folder(path, request, resume=resume)
    with where as folder:
        if folder is not None:
            record(folder.path)
        n = len(request.tiling)
        found = None if folder is None else read_finished(folder.path, request)
        if found is not None:
            with Progress(progress, n, "tiles") as tell:
                tell(n, new=False)
            return found
        for text in early_sentences(request):
            warn(text)
        state = request.open_state()
        counts = {name: np.zeros(n, dtype=np.int64) for name, _ in cards_of(request.options).values()}
        counts["n_observed"], parts = state.n_observed, [None] * n
        known = _enter_observed(request, folder, state, counts, parts)
        if request.joint is not None:
            request, joint, progress = plan_together(request, folder, executor, progress)
        with Progress(progress, n, "tiles") as tell:
            tell(len(known), new=False)
            open_job, argument = partial(state.open_job, request), partial(_argument, folder, is_local(executor))
            given = {"argument": argument, "known": known}
            results = run_rounds(request.rounds, executor, work, open_job, state.enter, **given)
            for finished, (tile, _, done, is_new) in enumerate(results, len(known) + 1):
                if is_new and folder is not None:
                    folder.put_part(tile, done.part)
                parts[tile] = done.visits
                for name, value in done.counts.items():
                    counts[name][tile] = value
                tell(finished, new=is_new)
        if state.windows is not None:
            state.windows.close()
        outcomes = outcome_table(request, state)
        tables = tile_table(request, state, counts, outcomes), completeness_table(request, state), outcomes
        if joint is not None:
            tables[0].meta["summary"]["joint"] = joint.meta["summary"]
        if folder is None:
            return Survey(*tables, parts=tuple(parts), joint=joint)
        codes = {f"OUTCOME{k}": (name, f"outcome {k}") for k, name in enumerate(OUTCOMES)}
        for name, table in zip(TABLES, tables, strict=True):
            title, cards = name.split(".")[0].upper(), codes if name == "outcomes.fits" else None
            folder.put_table(name, table, cards, title)
        if joint is not None:
            stored = joint.copy()
            del stored["seconds"]  # the files of equal surveys are equal
            folder.put_table(JOINT, stored, None, "JOINT")
        folder.finish()
    return Survey(*tables, folder.path, joint=joint)


def _enter_observed(request, folder, state, counts, parts) -> list[int]:
    """Record the tiles that are not planned, because they were observed, begun or dropped, and return their rows."""
    if request.state is None:
        return []
    history = request.state
    _mark_reached(request, state)
    is_same = folder is not None and folder.path.resolve() == history.folder.resolve()
    if is_same and history.until is None and history.events.files:
        history.replayed.write(folder.path)
    cards = cards_of(request.options)
    for tile, event in history.kept.items():
        if folder is None:
            parts[tile] = history.events.visits(event)[0]
        elif not folder.has_part(tile, event.plan):
            folder.put_part(tile, history.events.plan(tile, event.plan))
        if tile in history.closed:
            own = history.replayed.counts[tile]
            found = counts_in(own, cards) | {"n_observed": own["n_good"]}
        else:
            job, (visits, cards_of_plan) = request.job(tile, np.ones_like(state.left)), history.events.visits(event)
            done = _done_of(visits, cards_of_plan, job, is_kept=True)
            if request.builder.lasting is not None:  # standards that are also science targets may spend no visit
                others = visits["target_row"][~has_role(visits["kind"], "science")]
                field = request.builder.in_other_roles(job.field, np.isin(job.field.row, others))
                job = job._replace(field=field)
            slot = np.append(job.field.slot, -1)[done.target]
            open_ = (slot < 0) | (state.left[slot] > 0)
            found = done.counts
            state.enter(tile, job, done._replace(observed=done.observed & open_))
        for name, value in found.items():
            counts.setdefault(name, np.zeros(len(request.tiling), dtype=np.int64))[tile] = value
    return [*history.closed, *history.begun]


def _mark_reached(request, state) -> None:
    """Mark the targets in the fields and in reach of the observed tiles.

    The marks of a tile are stored with the state of the survey, so that they are computed only once. Targets with
    successful visits are omitted, because their outcome does not depend on the marks.
    """
    own, to_slots = request.state.replayed, request.source.to_slots
    own.mark_for([request.instrument.provenance["digest"], request.parameters])
    unseen = (own.made == 0).astype(np.uint8)
    added = unseen.copy()
    added[: own.n_searched] = 0
    for attempts, searched in ((own.attempts[: own.n_flagged], added), (own.attempts[own.n_flagged :], unseen)):
        left = to_slots(searched)
        for event in attempts if searched.any() else ():
            if event.state == TileState.DONE:
                job = request.job(event.row, left)
                reach = reach_of(job)
                own.flags[job.field.row] |= flags_of(reach.pairs.covered, reach.applied.excluded)
    own.n_flagged, own.n_searched = len(own.attempts), len(unseen)
    state.flags |= to_slots(own.flags)
    state.flags[to_slots(own.made) > 0] |= DONE


def _argument(folder, writes: bool, tile: int, job: Job) -> tuple[Job, Done | None]:
    """Return the job that a worker receives, and the stored result of the tile, if any.

    If ``writes`` is true, workers write the file of the tile, unless they would replace another file.
    """
    if folder is None:
        return job.bare(), None
    known = _read(folder, tile, job)
    return job._replace(as_file=True, path=folder.new_path(tile) if writes else None).bare(), known


def _read(folder, tile, job) -> Done | None:
    """Return the result that the file of a tile contains, or None if the tile must be planned again."""
    part = folder.file(part_name(tile), partial(folder.distrust, tile))
    if part is None:
        return None
    try:
        done = _done_of(*_io.read_fits_bytes(part, f"the stored result of tile {job.tile}"), job)
        if done.counts["n_in_field"] != len(job.field.row):
            raise InputError("its stored result was planned for a different set of targets with remaining visits")
    except InputError as error:  # the checksum is correct; therefore, the index was also changed
        folder.distrust(tile, str(error))
        return None
    return done


def _done_of(visits: np.ndarray, cards: dict, job, *, is_kept: bool = False) -> Done:
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
