"""Realizations of the sky: random targets, queues of positioners, and collisions of random configurations."""

import math
from typing import NamedTuple

import numpy as np

from rfpsurvey._kernels.allocation import balanced, draw_places, fill_queues
from rfpsurvey._kernels.arms import Geometry, cell_of, reachable_pairs
from rfpsurvey._kernels.jit import kernel
from rfpsurvey._kernels.queues import expect, place_queues, prepare_entries


class TargetCircle(NamedTuple):
    """A circle with uniformly distributed targets, and the minimum separation of the targets."""

    x: float
    y: float
    radius: float
    separation: float


class Positioners(NamedTuple):
    """Data of all positioners that determine which targets are in reach and which poses arms have."""

    geometry: Geometry
    side: np.ndarray
    annuli: np.ndarray
    offers: np.ndarray
    grid: tuple
    idle: np.ndarray


class Realization(NamedTuple):
    """Arrays in which one thread stores targets, the positioners that reach each target, and queues."""

    x: np.ndarray
    y: np.ndarray
    accepts: np.ndarray
    targets: np.ndarray  # row of each target: 0, 1, 2, and so on
    indptr: np.ndarray
    owner: np.ndarray
    r2: np.ndarray
    code: np.ndarray
    owner_of: np.ndarray
    length: np.ndarray
    queues: np.ndarray
    queue: np.ndarray
    cells: np.ndarray  # grid that `scatter_apart` uses, shape (2, n)


@kernel
def scatter(rng, sky, x, y):
    """Draw independent points with a uniform distribution in the circle of ``sky``."""
    for t in range(x.size):
        a = b = 1.0
        while a * a + b * b > 1.0:
            a, b = 2.0 * rng.random() - 1.0, 2.0 * rng.random() - 1.0
        x[t], y[t] = sky.x + sky.radius * a, sky.y + sky.radius * b


@kernel
def scatter_apart(rng, sky, cells, x, y):
    """Draw points with at least the minimum separation, by random sequential addition, and return their number.

    Points are also drawn outside the circle, up to twice the separation from its edge; otherwise the density would be
    too large at the edge. ``cells`` is a grid so fine that each cell contains at most one point; empty cells are NaN.
    The function ends early if 10,000 points in a row are too close to other points.
    """
    n = int(math.sqrt(cells.shape[1]))
    wide = sky.radius + 2.0 * sky.separation
    size, limit = 2.0 * wide / n, sky.separation * sky.separation
    steps = math.ceil(sky.separation / size)
    cells[:] = np.nan
    t = misses = 0
    while t < x.size and misses < 10_000:
        a, b = wide * (2.0 * rng.random() - 1.0), wide * (2.0 * rng.random() - 1.0)
        r2 = a * a + b * b
        if r2 > wide * wide:
            continue
        row, column = cell_of(b, -wide, size, n), cell_of(a, -wide, size, n)
        near = False
        for r in range(max(row - steps, 0), min(row + steps + 1, n)):
            for k in range(r * n + max(column - steps, 0), r * n + min(column + steps + 1, n)):
                near |= (cells[0, k] - a) ** 2 + (cells[1, k] - b) ** 2 < limit  # false for NaN
        misses = misses + 1 if near else 0
        if not near:
            cells[0, row * n + column], cells[1, row * n + column] = a, b
            if r2 <= sky.radius * sky.radius:
                x[t], y[t] = sky.x + a, sky.y + b
                t += 1
    return t


@kernel
def realize(rng, number, sky, positioners, realization):
    """Draw random targets, and add each target to the queue of a positioner with `balanced`."""
    x, y = realization.x[:number], realization.y[:number]
    if sky.separation > 0.0:
        n_placed = scatter_apart(rng, sky, realization.cells, x, y)
        x[n_placed:], y[n_placed:] = np.nan, np.nan
    else:
        scatter(rng, sky, x, y)
    indptr, owner, r2 = realization.indptr[: number + 1], realization.owner, realization.r2
    types = realization.accepts, positioners.annuli, positioners.offers
    reachable_pairs(x, y, *types, *positioners.grid, indptr, owner, r2, realization.code)
    targets, owner_of = realization.targets[:number], realization.owner_of[:number]
    balanced(indptr, owner, r2, targets, realization.length, owner_of)
    fill_queues(owner_of, targets, realization.length, realization.queues, realization.queue)


@kernel
def thin(rng, most, indptr, queue):
    """Reduce each queue in place to at most ``most`` entries, which are selected at random."""
    n = begin = 0
    for i in range(indptr.size - 1):
        stop = indptr[i + 1]
        size = stop - begin
        for k in range(min(size, most)):  # the first steps of a Fisher-Yates shuffle
            pick = begin + k
            if size > most:  # a shorter queue keeps all entries in their order
                pick += min(int(rng.random() * (size - k)), size - k - 1)
            queue[pick], queue[n] = queue[begin + k], queue[pick]
            n += 1
        begin = stop
        indptr[i + 1] = n


@kernel
def draw_tips(rng, numbers, sky, positioners, realization, tips):
    """Draw one random configuration per realization; the tips of positioners without a target are NaN."""
    n = positioners.side.size
    uniform, place = np.empty((1, n)), np.empty((1, n), np.int64)
    for c in range(numbers.size):
        realize(rng, numbers[c], sky, positioners, realization)
        for i in range(n):
            uniform[0, i] = rng.random()
        draw_places(realization.queues, uniform, place)
        for i in range(n):
            t = realization.queue[place[0, i]] if place[0, i] >= 0 else -1
            tips[c, i, 0], tips[c, i, 1] = (realization.x[t], realization.y[t]) if t >= 0 else (np.nan, np.nan)


@kernel
def sum_realization(indptr, pairs, geometry, setup, entries, expected, sums):
    """Write the expected numbers of collisions of a realization to ``sums``.

    The elements of ``sums`` are the expected number of colliding positioners, the number of counted positioners, the
    expected number of colliding assigned positioners, the number of assigned positioners, and the expected number of
    colliding pairs. A positioner is counted if it is assigned or parked. For each counted positioner, its collision
    probability is added to ``expected.times``, and 1 is added to ``expected.counted``.
    """
    expect(pairs, geometry, setup, entries, expected)
    probability, pair_probability = expected.probability, expected.pair_probability
    for k in range(5):
        sums[k] = 0.0
    for p in range(pairs.shape[0]):
        sums[4] += pair_probability[p]
    for i in range(probability.size):
        assigned = indptr[i + 1] > indptr[i]
        counts_too = assigned | setup.parked[i]
        p_collision = probability[i] if counts_too else 0.0
        sums[0] += p_collision
        sums[1] += counts_too
        sums[2] += p_collision if assigned else 0.0
        sums[3] += assigned
        expected.times[i] += p_collision
        expected.counted[i] += counts_too


@kernel
def queue_and_expect(rng, numbers, most, sky, positioners, realization, pairs, setup, entries, expected, sums):
    """Compute the expected collisions of each realization from at most ``most`` entries of each queue."""
    for c in range(numbers.size):
        realize(rng, numbers[c], sky, positioners, realization)
        thin(rng, most, realization.queues, realization.queue)
        place_queues(realization, positioners, setup, entries.segments)
        expect_given(realization.queues, pairs, positioners, setup, entries, expected, sums[c])


@kernel
def expect_given(indptr, pairs, positioners, setup, entries, expected, sums):
    """Compute the expected collisions from all targets of the queues; ``entries`` contains the segments of the arms."""
    prepare_entries(indptr, positioners.idle, entries)
    sum_realization(indptr, pairs, positioners.geometry, setup, entries, expected, sums)
