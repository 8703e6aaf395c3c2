"""Observe a list of tiles in a good order: always the one with the most targets left."""

import heapq

import numpy as np

from rfpsurvey.tiling._problem import Ledger

__all__ = ["visit_all"]


def visit_all(ledger: Ledger, centers: np.ndarray, number: int | None, *, every: bool = False) -> int:
    """Observe the tiles of one pass until the ledger is done; returns how many were placed.

    Tiles that serve nobody are left out; with ``every``, only those on which nobody ever wanted a visit.

    Numbers of targets left only fall, so that the tile whose number was last known as the largest is the next one as
    soon as its number is still that.
    """
    index, radius = ledger.problem.index, ledger.problem.radius
    ledger.chances = np.zeros(len(index))
    for center in centers:
        ledger.chances[index.near(center, radius)] += 1
    counts = index.sum_near(centers, radius, (ledger.left > 0).astype(np.float64))
    wanted = index.sum_near(centers, radius, (ledger.problem.wanted > 0).astype(np.float64))
    use = wanted if every else counts
    heap = [(-count, k) for k, count in enumerate(counts.tolist()) if use[k] > 0]
    heapq.heapify(heap)
    before = len(ledger.rows)
    while heap and (every or not ledger.done):
        old, k = heapq.heappop(heap)
        count = len(index.near(centers[k], radius, ledger.left))
        if count < -old and (count > 0 or every):
            heapq.heappush(heap, (-count, k))
            continue
        ledger.chances[index.near(centers[k], radius)] -= 1
        if count or every:
            ledger.observe(centers[k], number, every=every)
    ledger.chances = None
    return len(ledger.rows) - before
