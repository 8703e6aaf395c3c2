"""Observe a list of tiles in a good order: always the one with the most targets left."""

import heapq

import numpy as np

from rfpsurvey.tiling._problem import Ledger

__all__ = ["visit_all"]


def visit_all(ledger: Ledger, centers: np.ndarray, number: int | None) -> int:
    """Observe the tiles of one pass until the ledger is done; returns how many of them served somebody.

    Numbers of targets left only fall, so that the tile whose number was last known as the largest is the next one as
    soon as its number is still that.
    """
    index, radius = ledger.problem.index, ledger.problem.radius
    ledger.chances = np.zeros(len(index))
    for center in centers:
        ledger.chances[index.near(center, radius)] += 1
    counts = index.sum_near(centers, radius, (ledger.left > 0).astype(np.float64))
    heap = [(-count, k) for k, count in enumerate(counts.tolist()) if count > 0]
    heapq.heapify(heap)
    n = 0
    while heap and not ledger.done:
        old, k = heapq.heappop(heap)
        count = len(index.near(centers[k], radius, ledger.left))
        if count < -old and count > 0:
            heapq.heappush(heap, (-count, k))
            continue
        ledger.chances[index.near(centers[k], radius)] -= 1
        n += bool(count) and len(ledger.observe(centers[k], number)) > 0
    ledger.chances = None
    return n
