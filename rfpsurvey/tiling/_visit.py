"""Observe the tiles of a list, in the order of the list or in the order of their numbers of remaining targets."""

import heapq

import numpy as np

from rfpsurvey.tiling._problem import TilingProblem, TilingState


def visit_all(state: TilingState, centers: np.ndarray, number: int | None, *, every: bool = False) -> int:
    """Observe the tiles of one pass until no more tiles are needed; return the number of placed tiles.

    By default, a tile is omitted if none of its targets still requires a visit. If ``every`` is true, a tile is omitted
    only if no visits to its targets were requested. The tile with the most targets that still require a visit is
    observed next. Because this number can only decrease, these targets are counted again only for the tile with the
    largest earlier count. If this count has not changed, no other tile has more of these targets.
    """
    index, radius = state.problem.index, state.problem.radius
    state.chances = np.zeros(len(index))
    for center in centers:
        state.chances[index.near(center, radius)] += 1
    counts = index.sum_near(centers, radius, (state.left > 0).astype(np.float64))
    wanted = index.sum_near(centers, radius, (state.problem.wanted > 0).astype(np.float64))
    use = wanted if every else counts
    heap = [(-count, k) for k, count in enumerate(counts.tolist()) if use[k] > 0]
    heapq.heapify(heap)
    before = len(state.rows)
    while heap and (every or not state.done):
        old, k = heapq.heappop(heap)
        count = len(index.near(centers[k], radius, state.left))
        if count < -old and (count > 0 or every):
            heapq.heappush(heap, (-count, k))
            continue
        state.chances[index.near(centers[k], radius)] -= 1
        if count or every:
            state.observe(centers[k], number, every=every)
    state.chances = None
    return len(state.rows) - before


def visit_given(problem: TilingProblem) -> TilingState:
    """Observe the tiles in ``centers`` in their order until the goal is reached; without a goal, observe all tiles."""
    state = TilingState(problem)
    for center, number in zip(problem.where.tiling.vectors, problem.where.tiling.table["pass"].tolist(), strict=True):
        if state.done and not problem.open_ended:
            break
        state.observe(center, number, every=True)
    return state
