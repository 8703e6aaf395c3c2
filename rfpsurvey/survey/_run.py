"""The loop over the tiles of a survey."""

from collections import deque
from collections.abc import Iterator
from concurrent.futures import BrokenExecutor, Executor
from contextlib import nullcontext

import numpy as np

from rfpsurvey import _io
from rfpsurvey.survey._folder import Folder
from rfpsurvey.survey._progress import Ticker
from rfpsurvey.survey._request import Request
from rfpsurvey.survey._result import completeness_table, outcome_table, tile_table
from rfpsurvey.survey._survey import COMPLETENESS, TARGETS, TILES, Survey
from rfpsurvey.survey._work import COUNTS, Done, in_reach, work

__all__ = ["run"]

# Tiles that are handed out before the first of them is back.
IN_FLIGHT = 256


def run(request: Request, path, executor: Executor | None, progress, *, resume: bool) -> Survey:
    """Plan the tiles, and write them if there is a path."""
    with nullcontext() if path is None else Folder(path, request.identity(), resume=resume) as folder:
        ledger = request.open_ledger()
        n = len(request.tiling)
        round_of, parts = np.empty(n, dtype=np.int64), [None] * n
        counts = {name: np.zeros(n, dtype=np.int64) for name in (*COUNTS.values(), "n_observed")}
        finished = 0
        with Ticker(progress, n) as ticker:
            for k, tiles in enumerate(request.rounds):
                round_of[tiles] = k
                for tile, field, done, fresh in _plan_round(request, tiles, ledger, folder, executor):
                    slot = np.append(field.slot, -1)[done.target]
                    kept = ledger.enter(field, done.in_reach, slot, done.observed, request.number[tile])
                    if fresh and folder is not None:
                        folder.put_part(tile, done.part)
                    parts[tile] = done.visits
                    for name, value in {**done.counts, "n_observed": kept}.items():
                        counts[name][tile] = value
                    finished += 1
                    ticker.step(finished, new=fresh)
        tables = {
            TILES: tile_table(request, ledger, round_of, counts),
            COMPLETENESS: completeness_table(request, ledger),
            TARGETS: outcome_table(request, ledger),
        }
        if folder is None:
            return Survey(*tables.values(), parts=tuple(parts))
        for name, table in tables.items():
            folder.put(name, _io.table_bytes(table, name))
        folder.finish()
    return Survey(*tables.values(), folder.path)


def _plan_round(request, tiles, ledger, folder, executor) -> Iterator:
    """Yield tile, field, what came out, and whether that is new, in the order of ``tiles``."""
    waiting = deque()
    try:
        for tile in tiles.tolist():
            job = request.job(tile, ledger.left, as_file=folder is not None)
            part = None if folder is None else folder.part(tile)
            if part is not None:
                waiting.append((tile, job.field, _read(part, job), False))
            elif executor is None:
                waiting.append((tile, job.field, work(job), True))
            else:
                waiting.append((tile, job.field, executor.submit(work, job), True))
            if executor is None or len(waiting) >= IN_FLIGHT:
                yield _take(waiting)
        while waiting:
            yield _take(waiting)
    finally:
        for *_, done, _ in waiting:
            if not isinstance(done, Done):
                done.cancel()


def _take(waiting: deque):
    """Return the first that waits, finished."""
    tile, field, done, fresh = waiting.popleft()
    if not isinstance(done, Done):
        try:
            done = done.result()
        except BrokenExecutor as error:
            text = "a worker died; tiles that were written stay: continue the survey with resume=True (--resume)"
            raise BrokenExecutor(text) from error
    return tile, field, done, fresh


def _read(part: bytes, job) -> Done:
    """Return what came out when the part was made."""
    visits, cards = _io.read_fits_bytes(part)
    target = np.searchsorted(job.field.row, visits["target_row"])
    counts = {name: cards[card] for card, name in COUNTS.items()}
    target = np.where(visits["target_row"] >= 0, target, -1)
    return Done(None, None, target, visits["observed"].astype(bool), in_reach(job), counts)
