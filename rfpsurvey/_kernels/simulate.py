"""Realizations of the sky: fresh targets, their queues, and the collisions of what is drawn from them."""

import math
from typing import NamedTuple

import numpy as np

from rfpsurvey._jit import kernel
from rfpsurvey._kernels.allocation import balanced, draw_configuration, fill_queues
from rfpsurvey._kernels.arms import Geometry, fill_idle, place, shape
from rfpsurvey._kernels.batch import count
from rfpsurvey._kernels.queues import expect, line_up, place_queues
from rfpsurvey._kernels.reach import cell_of, reachable_pairs


class Sky(NamedTuple):
    """Targets fall uniformly into a circle, none nearer to another than the separation."""

    x: float
    y: float
    radius: float
    separation: float


class Array(NamedTuple):
    """What reach and poses depend on: columns, elbows, the grid of the reach, idle arms as they can collide."""

    geometry: Geometry
    side: np.ndarray
    inner: np.ndarray
    outer: np.ndarray
    offers: np.ndarray
    grid: tuple
    idle: np.ndarray


class Room(NamedTuple):
    """Scratch of one thread: targets, who reaches them, queues."""

    x: np.ndarray
    y: np.ndarray
    accepts: np.ndarray
    indptr: np.ndarray
    owner: np.ndarray
    r2: np.ndarray
    code: np.ndarray
    owner_of: np.ndarray
    length: np.ndarray
    queues: np.ndarray
    queue: np.ndarray
    uniform: np.ndarray
    target_of: np.ndarray
    tips: np.ndarray
    cells: np.ndarray
    """Scratch of `scatter_apart`, (2, n)."""


@kernel
def scatter(rng, sky, x, y):
    """Independent points."""
    for t in range(x.size):
        a = b = 1.0
        while a * a + b * b > 1.0:
            a, b = 2.0 * rng.random() - 1.0, 2.0 * rng.random() - 1.0
        x[t], y[t] = sky.x + sky.radius * a, sky.y + sky.radius * b


@kernel
def scatter_apart(rng, sky, cells, x, y):
    """Points no nearer than the separation, by random sequential addition; returns how many found room.

    Points beyond the circle take part up to twice the separation, since without neighbors there its edge would be
    crowded. ``cells`` has the point of each cell of a grid so fine that there is one at most; NaN for none. Gives up
    after 10,000 misses in a row.
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
                near |= (cells[0, k] - a) ** 2 + (cells[1, k] - b) ** 2 < limit  # not for NaN
        misses = misses + 1 if near else 0
        if not near:
            cells[0, row * n + column], cells[1, row * n + column] = a, b
            if r2 <= sky.radius * sky.radius:
                x[t], y[t] = sky.x + a, sky.y + b
                t += 1
    return t


@kernel
def realize(rng, number, sky, array, room):
    """Let targets fall and queue up as `balanced` has it."""
    x, y, g = room.x[:number], room.y[:number], array.geometry
    if sky.separation > 0.0:
        found = scatter_apart(rng, sky, room.cells, x, y)
        x[found:], y[found:] = np.nan, np.nan
    else:
        scatter(rng, sky, x, y)
    x0, y0, size, nx, ny, start, order = array.grid
    indptr = room.indptr[: number + 1]
    reachable_pairs(
        x,
        y,
        room.accepts,
        g.cx,
        g.cy,
        array.inner,
        array.outer,
        array.offers,
        x0,
        y0,
        size,
        nx,
        ny,
        start,
        order,
        indptr,
        room.owner,
        room.r2,
        room.code,
    )
    balanced(indptr, room.owner, room.r2, room.length, room.owner_of[:number])
    fill_queues(room.owner_of[:number], room.length, room.queues, room.queue)


@kernel
def thin(rng, most, indptr, queue):
    """Keep at most so many entries of each queue, drawn without preference; in place."""
    n = begin = 0
    for i in range(indptr.size - 1):
        stop = indptr[i + 1]
        size = stop - begin
        for k in range(min(size, most)):
            pick = begin + k
            if size > most:  # else all stay, in their order
                pick += min(int(rng.random() * (size - k)), size - k - 1)
            queue[pick], queue[n] = queue[begin + k], queue[pick]
            n += 1
        begin = stop
        indptr[i + 1] = n


@kernel
def draw_and_count(rng, numbers, sky, array, room, stage, desk, counts, times, counted):
    """Count the collisions of one configuration of each realization; ``counted`` gains one for each that counts."""
    n = array.side.size
    for c in range(numbers.size):
        realize(rng, numbers[c], sky, array, room)
        for i in range(n):
            room.uniform[i] = rng.random()
        draw_configuration(room.queues, room.queue, room.uniform, room.target_of)
        for i in range(n):
            t = room.target_of[i]
            desk.assigned[i] = t >= 0
            room.tips[i, 0], room.tips[i, 1] = (room.x[t], room.y[t]) if t >= 0 else (np.nan, np.nan)
            counted[i] += desk.assigned[i] | stage.parked[i]
        place(room.tips, array.geometry, array.side, desk.segments)
        shape(desk.segments, stage.model, stage.length, stage.cosine, stage.sine)
        fill_idle(desk.assigned, array.idle, desk.segments)
        count(stage, desk, counts[c], times)


@kernel
def sum_up(indptr, pairs, geometry, stage, hall, risk, chance_of, sums, times, counted):
    """Sum up one realization: expected collisions of all and of assigned positioners, pairs; and who counts how often.

    ``sums`` has the columns expected colliding, counted, expected colliding assigned, assigned, pairs.
    """
    expect(pairs, geometry, stage.limits, stage.obstacle_pairs, stage.obstacles, stage.clearance, hall, risk, chance_of)
    for k in range(5):
        sums[k] = 0.0
    for p in range(pairs.shape[0]):
        sums[4] += chance_of[p]
    for i in range(risk.size):
        assigned = indptr[i + 1] > indptr[i]
        counts_too = assigned | stage.parked[i]
        own = risk[i] if counts_too else 0.0
        sums[0] += own
        sums[1] += counts_too
        sums[2] += own if assigned else 0.0
        sums[3] += assigned
        times[i] += own
        counted[i] += counts_too


@kernel
def queue_and_expect(rng, numbers, most, sky, array, room, pairs, stage, hall, risk, chance_of, sums, times, counted):
    """Take expectations over all entries of the queues, or so many at most, of each realization."""
    for c in range(numbers.size):
        realize(rng, numbers[c], sky, array, room)
        thin(rng, most, room.queues, room.queue)
        place_queues(
            room.x,
            room.y,
            room.queues,
            room.queue,
            array.geometry,
            array.side,
            stage.model,
            stage.length,
            stage.cosine,
            stage.sine,
            hall.segments,
        )
        line_up(room.queues, array.idle, hall)
        sum_up(room.queues, pairs, array.geometry, stage, hall, risk, chance_of, sums[c], times, counted)


@kernel
def expect_given(indptr, pairs, array, stage, hall, risk, chance_of, sums, times, counted):
    """Take expectations over all entries of given queues, which are in the hall."""
    line_up(indptr, array.idle, hall)
    sum_up(indptr, pairs, array.geometry, stage, hall, risk, chance_of, sums, times, counted)
