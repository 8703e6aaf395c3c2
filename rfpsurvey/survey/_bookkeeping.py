"""The state of all targets of a survey: visits wanted and left, and outcomes, in a few bytes per target."""

import numpy as np

from rfpsurvey.survey._source import Field

__all__ = ["OUTCOMES", "Bookkeeping"]

OUTCOMES = (
    "not wanted",
    "observed",
    "partly observed",
    "collided out",
    "competed out",
    "reachable by no positioner",
    "on no tile",
)
NOT_WANTED, OBSERVED, PARTLY, COLLIDED, COMPETED, UNREACHABLE, NO_TILE = range(len(OUTCOMES))
SEEN, REACHED, LOST = 1, 2, 4
# Priorities that are counted apart; where there are more, ranges of them.
MOST_CLASSES, N_RANGES = 20, 10


class Bookkeeping:
    """Counts visits by slot; the order in which tiles that share no target are entered does not matter."""

    def __init__(self, visits, priority, kind, *, n_passes: int, use_others: bool, in_turn: bool):
        science = None if kind is None else kind == "science"
        self.wanted = visits if science is None else np.where(science, visits, 0).astype(np.uint8)
        # sky and standards are there for every tile that asks for them
        self.left = self.wanted.copy()
        self._spend = None
        if science is not None and use_others:
            self.left[~science] = 1
            self._spend = science
        self.flags = np.zeros(len(visits), dtype=np.uint8)
        self.class_of, self.classes = _classes(priority, self.wanted)
        self.n_wanted = np.bincount(self.class_of, weights=self.wanted, minlength=len(self.classes)).astype(np.int64)
        self.n_targets = np.bincount(self.class_of[self.wanted > 0], minlength=len(self.classes))
        self.n_observed = np.zeros((n_passes, len(self.classes)), dtype=np.int64)
        self.n_complete = np.zeros_like(self.n_observed)
        # the last pass, by number, with a visit of each target; where passes come in turn, it is that of the last tile
        self._last = None if in_turn else np.zeros(len(visits), dtype=np.min_scalar_type(n_passes))

    def enter(self, field: Field, in_reach: np.ndarray, slot: np.ndarray, observed: np.ndarray, number: int) -> int:
        """Enter a tile of the pass ``number``: its field, and the slots of its visits, -1 for none of the catalog.

        Returns the number of visits that count.
        """
        self.flags[field.slot] |= np.where(in_reach, SEEN | REACHED, SEEN).astype(np.uint8)
        slot, observed = slot[slot >= 0], observed[slot >= 0]
        self.flags[slot[~observed]] |= LOST
        slot = slot[observed]
        if self._spend is not None:
            slot = slot[self._spend[slot]]
        self.left[slot] -= 1
        n = len(self.classes)
        self.n_observed[number] += np.bincount(self.class_of[slot], minlength=n)
        complete = slot[self.left[slot] == 0]
        if self._last is not None:
            self._last[slot] = np.maximum(self._last[slot], number)
            number = self._last[complete]
        np.add.at(self.n_complete, (number, self.class_of[complete]), 1)
        return len(slot)

    def done(self) -> np.ndarray:
        """Return how often each target was observed."""
        done = self.wanted - self.left
        if self._spend is not None:
            done[~self._spend] = 0
        return done

    def outcomes(self) -> np.ndarray:
        """Return what became of each target, an index of `OUTCOMES`."""
        done, flags = self.done(), self.flags
        code = np.full(len(done), NO_TILE, dtype=np.uint8)
        for flag, outcome in ((SEEN, UNREACHABLE), (REACHED, COMPETED), (LOST, COLLIDED)):
            code[(flags & flag) > 0] = outcome
        code[done > 0] = PARTLY
        code[done == self.wanted] = OBSERVED
        code[self.wanted == 0] = NOT_WANTED
        return code


def _classes(priority, wanted):
    """Class of each target, the most important first, and the names of the classes."""
    if priority is None or not wanted.any():
        return np.zeros(len(wanted), dtype=np.uint8), [""]
    values, counts = np.unique(priority[wanted > 0], return_counts=True)
    group = np.arange(len(values))
    if len(values) > MOST_CLASSES:  # ranges with about as many targets each; one value is never split
        before = np.cumsum(counts) - counts
        group = np.unique(before * N_RANGES // counts.sum(), return_inverse=True)[1].reshape(-1)
    low = values[np.searchsorted(group, np.arange(group[-1] + 1))]
    high = values[np.searchsorted(group, np.arange(group[-1] + 1), side="right") - 1]
    names = [f"{a:.15g}" if a == b else f"{a:.15g} to {b:.15g}" for a, b in zip(low, high, strict=True)]
    place = np.clip(np.searchsorted(low, priority, side="right") - 1, 0, len(low) - 1)
    return (len(low) - 1 - place).astype(np.uint8), names[::-1]
