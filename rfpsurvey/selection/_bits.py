"""Packed bits: one bit for each target and realization, in 64-bit integers."""

import numpy as np

PER_WORD = 64
"""Number of realizations whose bits one integer contains."""


def n_words(n_realizations: int) -> int:
    """Return the number of 64-bit integers that contain the bits of one target."""
    return -(-n_realizations // PER_WORD)


def count_bits(bits: np.ndarray) -> np.ndarray:
    """Return, for each target, the number of bits that are 1, shape (n_targets,)."""
    return np.bitwise_count(bits).sum(axis=1, dtype=np.int64)
