"""Pieces of time in which tiles can be observed: intersections, unions, and parts in which a condition is true."""

from collections.abc import Callable, Iterable
from typing import NamedTuple

import numpy as np

from rfpsurvey._survey.night.sky import RATE, TURN, NightSky

# Time to which the ends of pieces are refined, and gap between two parts of one piece, which rounding can cause (days).
FINE, TOUCH = 1e-8, 1e-9


class Pieces(NamedTuple):
    """Times in which tiles can be observed: row of the tile, and start and end in days since noon."""

    tile: np.ndarray
    start: np.ndarray
    end: np.ndarray

    def of(self, keep: np.ndarray) -> "Pieces":
        """Return some of the times."""
        return Pieces(*(values[keep] for values in self))

    def between(self, low: np.ndarray, high: np.ndarray) -> "Pieces":
        """Return the parts that lie between times, one pair for each piece."""
        start, end = np.maximum(self.start, low), np.minimum(self.end, high)
        return Pieces(self.tile, start, end).of(end >= start)

    def inside(self, intervals: "Pieces") -> "Pieces":
        """Return the parts that lie in one of some intervals, which are the same for all tiles."""
        return joined([self.between(low, high) for low, high in zip(intervals.start, intervals.end, strict=True)])


NEVER = Pieces(np.empty(0, dtype=np.int64), np.empty(0), np.empty(0))
ALWAYS = Pieces(np.zeros(1, dtype=np.int64), np.zeros(1), np.ones(1))


def joined(parts: Iterable[Pieces]) -> Pieces:
    """Return pieces in the order of tiles and times; those that touch become one."""
    pieces = Pieces(*(np.concatenate(values) for values in zip(NEVER, *parts, strict=True)))
    pieces = pieces.of(np.lexsort((pieces.start, pieces.tile)))
    apart = (pieces.tile[1:] != pieces.tile[:-1]) | (pieces.start[1:] > pieces.end[:-1] + TOUCH)
    first = np.flatnonzero(np.append(np.ones(min(1, len(pieces.tile)), dtype=bool), apart))
    end = np.maximum.reduceat(pieces.end, first) if len(first) else pieces.end
    return Pieces(pieces.tile[first], pieces.start[first], end)


def cut(pieces: Pieces, allowed: Callable, step: float) -> Pieces:
    """Return the parts of pieces in which ``allowed(tile, time)`` is true; their ends are refined between steps."""
    if not len(pieces.tile):
        return pieces
    n = np.ceil((pieces.end - pieces.start) / step).astype(np.int64) + 1
    of, last = np.repeat(np.arange(len(n)), n), np.cumsum(n) - 1
    first = last - n + 1
    time = (
        pieces.start[of] + (np.arange(len(of)) - first[of]) / np.maximum(n - 1, 1)[of] * (pieces.end - pieces.start)[of]
    )
    ok = allowed(pieces.tile[of], time)
    before = np.flatnonzero((ok[1:] != ok[:-1]) & (of[1:] == of[:-1]))
    low, high, begins, tile = time[before], time[before + 1], ok[before + 1], pieces.tile[of[before]]
    while np.max(high - low, initial=0.0) > FINE:
        middle = (low + high) / 2
        is_late = allowed(tile, middle) == begins
        low, high = np.where(is_late, low, middle), np.where(is_late, middle, high)
    edge = np.where(begins, high, low)  # an end that is allowed
    starts = np.append(edge[begins], pieces.start[ok[first]]), np.append(of[before][begins], np.flatnonzero(ok[first]))
    ends = np.append(edge[~begins], pieces.end[ok[last]]), np.append(of[before][~begins], np.flatnonzero(ok[last]))
    order, start = np.lexsort(starts), starts[0]
    return Pieces(pieces.tile[starts[1][order]], start[order], ends[0][np.lexsort(ends)])


def in_hour_angles(sky: NightSky, pieces: Pieces, low: np.ndarray | float, high: np.ndarray | float) -> Pieces:
    """Return the parts of pieces in which the absolute hour angle of the tile lies between two limits, one per tile."""
    n = len(sky.ra_dec[0])
    low, high = (np.broadcast_to(limit, n)[pieces.tile] for limit in (low, high))
    rest = (low > 0) | (high < np.pi)
    kept, pieces, low, high = pieces.of(~rest), pieces.of(rest), low[rest], np.minimum(high[rest], np.pi)
    begin = sky.hour_angle(pieces.tile, pieces.start)
    parts = [kept]
    for turn in (0, TURN, 2 * TURN):  # from -pi to more than 3 pi
        for least, most in ((turn - high, turn - low), (turn + low, turn + high)):
            some = (least <= most) & (most >= begin)
            limits = ((angle - begin)[some] / RATE + pieces.start[some] for angle in (least, most))
            parts.append(pieces.of(some).between(*limits))
    return joined(parts)


def crossing(sky: NightSky, altitude: float) -> np.ndarray:
    """Return the absolute hour angle at which tiles are at an altitude; -inf if they are lower, inf if higher."""
    dec = sky.ra_dec[1]
    with np.errstate(divide="ignore", invalid="ignore"):
        cosine = (np.sin(altitude) - np.sin(sky.lat) * np.sin(dec)) / (np.cos(sky.lat) * np.cos(dec))
    return np.where(cosine > 1, -np.inf, np.where(cosine < -1, np.inf, np.arccos(np.clip(cosine, -1, 1))))
