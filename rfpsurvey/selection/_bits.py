"""Packed bits: one bit for each target and realization, in 64-bit integers."""

import numpy as np

PER_WORD = 64
"""Number of realizations whose bits one integer contains."""


def n_words(n_realizations: int) -> int:
    """Return the number of 64-bit integers that contain the bits of one target."""
    return -(-n_realizations // PER_WORD)


def pack_bits(observed: np.ndarray) -> np.ndarray:
    """Return the packed bits of a boolean array.

    Realization r is bit ``r % 64`` of the integer ``r // 64``, where bit 0 is the least significant bit. The unused
    bits of the last integer are 0.

    Parameters
    ----------
    observed : ndarray of bool, shape (n_targets, n_realizations)
        Whether each realization observes each target.

    Returns
    -------
    ndarray of uint64, shape (n_targets, n_words)
        The packed bits.
    """
    n, m = observed.shape
    padded = np.zeros((n, n_words(m) * PER_WORD), dtype=bool)
    padded[:, :m] = observed
    octets = np.packbits(padded, axis=1, bitorder="little")
    return octets.view("<u8").astype(np.uint64)


def unpack_bits(bits: np.ndarray, n_realizations: int) -> np.ndarray:
    """Return the boolean array, shape (n_targets, n_realizations), that `pack_bits` packed."""
    octets = np.ascontiguousarray(bits, dtype="<u8").view(np.uint8)
    return np.unpackbits(octets, axis=1, count=n_realizations, bitorder="little").astype(bool)


def count_bits(bits: np.ndarray) -> np.ndarray:
    """Return, for each target, the number of bits that are 1, shape (n_targets,)."""
    return np.bitwise_count(bits).sum(axis=1, dtype=np.int64)
