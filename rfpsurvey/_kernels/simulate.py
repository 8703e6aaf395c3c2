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
    """Targets fall uniformly into a circle about the origin, none nearer to another than the separation."""

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
    """Target in each cell of the sky's grid, -1 for none; empty without a separation."""


@kernel
def scatter(rng, radius, x, y):
    """Independent points."""
    for t in range(x.size):
        a = b = 1.0
        while a * a + b * b > 1.0:
            a, b = 2.0 * rng.random() - 1.0, 2.0 * rng.random() - 1.0
        x[t], y[t] = radius * a, radius * b


@kernel
def scatter_apart(rng, radius, separation, cells, x, y):
    """Points no nearer than the separation, by random sequential addition; returns how many found room.

    A cell of the grid is so small that it holds one of them; give up after 10,000 misses in a row.
    """
    n = int(math.sqrt(cells.size))
    size = 2.0 * radius / n
    wide = math.ceil(separation / size)
    cells[:] = -1
    t = misses = 0
    while t < x.size and misses < 10_000:
        a, b = radius * (2.0 * rng.random() - 1.0), radius * (2.0 * rng.random() - 1.0)
        row, column = cell_of(b, -radius, size, n), cell_of(a, -radius, size, n)
        if a * a + b * b > radius * radius:
            continue
        fits = cells[row * n + column] < 0
        for r in range(max(row - wide, 0), min(row + wide + 1, n)):
            if not fits:
                break
            for c in range(max(column - wide, 0), min(column + wide + 1, n)):
                k = cells[r * n + c]
                if k >= 0 and (x[k] - a) ** 2 + (y[k] - b) ** 2 < separation * separation:
                    fits = False
                    break
        if fits:
            x[t], y[t] = a, b
            cells[row * n + column] = t
            t += 1
            misses = 0
        else:
            misses += 1
    return t


@kernel
def realize(rng, number, sky, array, room):
    """Let targets fall and queue up as `balanced` has it."""
    x, y, g = room.x[:number], room.y[:number], array.geometry
    if sky.separation > 0.0:
        found = scatter_apart(rng, sky.radius, sky.separation, room.cells, x, y)
        x[found:], y[found:] = np.nan, np.nan
    else:
        scatter(rng, sky.radius, x, y)
    x0, y0, size, nx, ny, start, order = array.grid
    indptr = room.indptr[: number + 1]
    reachable_pairs(
        x, y, room.accepts, g.cx, g.cy, array.inner, array.outer, array.offers, x0, y0, size, nx, ny, start, order,
        indptr, room.owner, room.r2, room.code,
    )  # fmt: skip
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
def sum_up(indptr, pairs, geometry, stage, hall, risk, sums, times, counted):
    """Sum up one realization: expected collisions of all and of assigned positioners, pairs; and who counts how often.

    ``sums`` has the columns expected colliding, counted, expected colliding assigned, assigned, pairs.
    """
    sums[4] = expect(pairs, geometry, stage.limits, stage.obstacle_pairs, stage.obstacles, stage.clearance, hall, risk)
    for k in range(4):
        sums[k] = 0.0
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
def queue_and_expect(rng, numbers, most, sky, array, room, pairs, stage, hall, risk, sums, times, counted):
    """Take expectations over all entries of the queues, or so many at most, of each realization."""
    for c in range(numbers.size):
        realize(rng, numbers[c], sky, array, room)
        thin(rng, most, room.queues, room.queue)
        place_queues(
            room.x, room.y, room.queues, room.queue, array.geometry, array.side, stage.model, stage.length,
            stage.cosine, stage.sine, hall.segments,
        )  # fmt: skip
        line_up(room.queues, array.idle, hall)
        sum_up(room.queues, pairs, array.geometry, stage, hall, risk, sums[c], times, counted)


@kernel
def expect_given(indptr, pairs, array, stage, hall, risk, sums, times, counted):
    """Take expectations over all entries of given queues, which are in the hall."""
    line_up(indptr, array.idle, hall)
    sum_up(indptr, pairs, array.geometry, stage, hall, risk, sums, times, counted)
