"""The realizations of a survey, and the remaining visits of all targets in a block of realizations.

The remaining visits are one byte per target and realization.
"""

from collections.abc import Iterable

import numpy as np

from rfpsurvey._kernels import realizations as kernels
from rfpsurvey.pipeline import FieldBuilder
from rfpsurvey.selection._work import BlockDone
from rfpsurvey.survey import Job, Request


def seeds_of(seed: int, n: int) -> list[int]:
    """Return the seeds of n realizations; if n is increased, the first seeds remain the same."""
    return [int(word) >> 1 for word in np.random.SeedSequence(seed).generate_state(n, np.uint64)]


def in_batch(request: Request) -> bool:
    """Return whether all realizations of a block can be planned together."""
    options = request.options
    # the rules do not meet requirements, which some of the allocators with a rule ignore as well
    simple = options.sky_separation is None and not (options.counts and options.method.uses("requirements"))
    return options.method.rule is not None and simple


class State:
    """The remaining visits of each target in each realization of a block.

    A block is a group of realizations that are planned together. The *slot* of a target is its index in the arrays of
    the builder.
    """

    def __init__(self, builder: FieldBuilder, n_realizations: int):
        self.builder = builder
        """The targets of the last realization."""
        self.spends = np.broadcast_to(np.True_, len(builder.left)) if builder.spends is None else builder.spends
        self.first = np.broadcast_to(builder.left[:, None], (len(builder.left), n_realizations))
        """Number of remaining visits of each target in each realization before the first tile."""
        self.restore(self.first.copy(), np.zeros((n_realizations, 3), dtype=np.int64))

    def enter(self, _, job: Job, done: BlockDone) -> None:
        """Record the visits of a tile."""
        self.record(job.field.slot, done.mask, done.counts)

    def record(self, slot: np.ndarray, mask: np.ndarray, counts: np.ndarray) -> None:
        """Record the visits of a tile to the targets in ``slot``; the other parameters are those of `BlockDone`."""
        self.counts[:, :2] += counts
        observed = np.zeros(len(self.counts), dtype=np.int64)
        kernels.record_visits(mask, slot, self.spends, self.left, self.is_open, observed)
        self.counts[:, 2] += observed

    def masks(self) -> np.ndarray:
        """Return a mask for each target, whose bit r is 1 if realization r observes the target, shape (n_targets,)."""
        return to_mask((now < before) & self.spends for now, before in zip(self.left.T, self.first.T, strict=True))

    def restore(self, left: np.ndarray, counts: np.ndarray, n_rounds: int = 0) -> None:
        """Replace this state by another state.

        For each target and realization, ``left`` is the number of remaining visits. For each realization, ``counts``
        contains the numbers of assigned positioners, of lost targets, and of visits to science targets. ``n_rounds`` is
        the number of finished rounds, which are groups of tiles that share no targets.
        """
        self.left, self.counts, self.n_rounds = left, counts, n_rounds
        self.is_open = (left > 0).any(axis=1).astype(np.uint8)


def to_mask(columns: Iterable[np.ndarray]) -> np.ndarray:
    """Return a mask for each target, whose bit r is its value in column r."""
    return sum(column.astype(np.uint32) << np.uint32(r) for r, column in enumerate(columns))


def to_bits(mask: np.ndarray, n: int) -> np.ndarray:
    """Return the first n bits of each mask as booleans, shape (n_targets, n)."""
    return (mask[:, None] >> np.arange(n, dtype=np.uint32)) & np.uint32(1) > 0
