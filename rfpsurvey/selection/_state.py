"""The realizations of a survey, and the remaining visits of all targets in a block of realizations.

The remaining visits are one byte per target and realization.
"""

from dataclasses import replace

import numpy as np

from rfpsurvey._kernels import realizations as kernels
from rfpsurvey.pipeline import FieldBuilder
from rfpsurvey.survey import Request


def seeds_of(seed: int, n: int) -> list[int]:
    """Return the seeds of n realizations; if n is increased, the first seeds remain the same."""
    return [int(word) >> 1 for word in np.random.SeedSequence(seed).generate_state(n, np.uint64)]


def request_of(request: Request, seed: int) -> Request:
    """Return the request of the survey of one realization."""
    return replace(request, options=replace(request.options, subpriority=seed), seed=seed)


def in_batch(request: Request) -> bool:
    """Return whether all realizations of a block can be planned together."""
    options = request.options
    # the rules do not meet requirements, which some of the allocators with a rule ignore as well
    simple = options.sky_separation is None and not (options.counts and options.method.uses("requirements"))
    return options.method.rule is not None and simple


class State:
    """The remaining visits of each target in each realization of a block.

    A block is a group of realizations that are planned together.

    Parameters
    ----------
    builder : FieldBuilder
        The targets, with their requested numbers of visits. The *slot* of a target is its index in the arrays of the
        builder.
    n_realizations : int
        Number of realizations.
    """

    def __init__(self, builder: FieldBuilder, n_realizations: int):
        self.wanted = builder.wanted
        self.spends = np.broadcast_to(np.True_, len(self.wanted)) if builder.spends is None else builder.spends
        self.left = np.repeat(builder.left[:, None], n_realizations, axis=1)
        self.is_open = (builder.left > 0).astype(np.uint8)
        self.n_rounds = 0
        """Number of finished rounds; a round is a group of tiles that share no targets."""
        self.counts = np.zeros((n_realizations, 3), dtype=np.int64)
        """For each realization: numbers of assigned positioners, of lost targets, and of visits to science targets."""

    def enter(self, slot: np.ndarray, mask: np.ndarray, counts: np.ndarray) -> None:
        """Record the visits of a tile.

        For each target in ``slot``, bit r of ``mask`` is 1 if realization r visits the target. For each realization,
        ``counts`` contains the number of positioners with a target and the number of targets lost to a collision.
        """
        self.counts[:, :2] += counts
        observed = np.zeros(len(self.counts), dtype=np.int64)
        kernels.record_visits(mask, slot, self.spends, self.left, self.is_open, observed)
        self.counts[:, 2] += observed

    def masks(self, before: np.ndarray | None = None, made: np.ndarray | None = None) -> np.ndarray:
        """Return a mask for each target, whose bit r is 1 if realization r observes the target, shape (n_targets,).

        ``before`` contains the remaining visits before the first tile, by default the requested visits. ``made``
        contains the numbers of further visits. Both have the shape (n_targets, n_realizations).
        """
        mask = np.zeros(len(self.wanted), dtype=np.uint32)
        for r in range(self.left.shape[1]):
            observed = self.left[:, r] < (self.wanted if before is None else before[:, r])
            observed |= False if made is None else made[:, r] > 0
            mask |= (observed & self.spends).astype(np.uint32) << np.uint32(r)
        return mask

    def restore(self, left: np.ndarray, counts: np.ndarray, n_rounds: int) -> None:
        """Replace this state by a stored state."""
        self.left, self.counts, self.n_rounds = left, counts, n_rounds
        self.is_open = (left > 0).any(axis=1).astype(np.uint8)
