"""The state of all targets in a block of realizations: one byte per target and realization."""

import numpy as np

from rfpsurvey._kernels import realizations as kernels

__all__ = ["State"]


class State:
    """The remaining visits of each target in each realization of a block.

    Parameters
    ----------
    wanted : ndarray of uint8, shape (n_targets,)
        Requested number of visits, by slot.
    available : ndarray of uint8, shape (n_targets,)
        Remaining visits before the first tile. It is 1 for standards and sky positions in use.
    spends : ndarray of bool, shape (n_targets,), or None
        Whether visits to each target count; None if the visits to all targets count.
    n_realizations : int
        Number of realizations.
    """

    def __init__(self, wanted, available, spends, n_realizations: int):
        self.wanted = wanted
        self.spends = np.broadcast_to(np.True_, len(wanted)) if spends is None else spends
        self.left = np.repeat(available[:, None], n_realizations, axis=1)
        self.is_open = (available > 0).astype(np.uint8)
        self.n_rounds = 0
        """Number of rounds that are finished."""
        self.counts = np.zeros((n_realizations, 3), dtype=np.int64)
        """Numbers per realization: positioners with a target, targets lost to a collision, and visits that count."""

    def take(self, slot: np.ndarray) -> np.ndarray:
        """Return the remaining visits of some targets, shape (k, n_realizations)."""
        out = np.empty((len(slot), self.left.shape[1]), dtype=np.uint8)
        kernels.take_left(self.left, slot, out)
        return out

    def enter(self, slot: np.ndarray, mask: np.ndarray, counts: np.ndarray) -> None:
        """Record a tile: the mask of the realizations that visit each target of its field, and the counts."""
        self.counts[:, :2] += counts
        observed = np.zeros(len(self.counts), dtype=np.int64)
        kernels.record_visits(mask, slot, self.spends, self.left, self.is_open, observed)
        self.counts[:, 2] += observed

    def masks(self) -> np.ndarray:
        """Return the mask of the realizations that observe each target, shape (n_targets,)."""
        mask = np.empty(len(self.wanted), dtype=np.uint32)
        kernels.to_masks(self.left, self.wanted, self.spends, mask)
        return mask

    def restore(self, left: np.ndarray, counts: np.ndarray, n_rounds: int) -> None:
        """Continue from an earlier state."""
        self.left, self.counts, self.n_rounds = left, counts, n_rounds
        self.is_open = (left > 0).any(axis=1).astype(np.uint8)
