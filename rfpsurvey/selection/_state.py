"""The remaining visits of all targets in a block of realizations: one byte per target and realization."""

import numpy as np

from rfpsurvey._kernels import realizations as kernels
from rfpsurvey.pipeline import FieldBuilder


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

    def take(self, slot: np.ndarray) -> np.ndarray:
        """Return the remaining visits of the targets with the given slots, shape (k, n_realizations)."""
        out = np.empty((len(slot), self.left.shape[1]), dtype=np.uint8)
        kernels.take_left(self.left, slot, out)
        return out

    def enter(self, slot: np.ndarray, mask: np.ndarray, counts: np.ndarray) -> None:
        """Record the visits of a tile.

        For each target in ``slot``, bit r of ``mask`` is 1 if realization r visits the target. For each realization,
        ``counts`` contains the number of positioners with a target and the number of targets lost to a collision.
        """
        self.counts[:, :2] += counts
        observed = np.zeros(len(self.counts), dtype=np.int64)
        kernels.record_visits(mask, slot, self.spends, self.left, self.is_open, observed)
        self.counts[:, 2] += observed

    def masks(self) -> np.ndarray:
        """Return a mask for each target, whose bit r is 1 if realization r observes the target, shape (n_targets,)."""
        mask = np.empty(len(self.wanted), dtype=np.uint32)
        kernels.to_masks(self.left, self.wanted, self.spends, mask)
        return mask

    def restore(self, left: np.ndarray, counts: np.ndarray, n_rounds: int) -> None:
        """Replace this state by a stored state."""
        self.left, self.counts, self.n_rounds = left, counts, n_rounds
        self.is_open = (left > 0).any(axis=1).astype(np.uint8)
