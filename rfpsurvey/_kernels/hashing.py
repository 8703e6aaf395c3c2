"""Reproducible random numbers, computed from a seed and the identifiers of targets."""

import numpy as np

from rfpsurvey._jit import kernel

# Offset and prime of the hash FNV-1a with 64 bits.
FNV_OFFSET, FNV_PRIME = np.uint64(0xCBF29CE484222325), np.uint64(0x100000001B3)
# Increment and factors of the random number generator SplitMix64 (Steele, Lea & Flood 2014).
GOLDEN, FIRST, SECOND = np.uint64(0x9E3779B97F4A7C15), np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB)
# Code point of the digit 0, and the numbers 9 and 10. An unsigned integer of 64 bits is at most 10 * LARGEST + LAST;
# a signed integer is at least -MOST_NEGATIVE.
ZERO, NINE, TEN = np.uint64(48), np.uint64(9), np.uint64(10)
LARGEST, LAST, MOST_NEGATIVE = np.uint64((2**64 - 1) // 10), np.uint64((2**64 - 1) % 10), np.uint64(2**63)
# Scale that converts 53 bits to a number in [0, 1).
UNIT = 2.0**-53


def split_mix(number):
    """Return the output of SplitMix64 for a number or for an array; each bit depends on all bits of the number."""
    z = number + GOLDEN
    z = (z ^ (z >> np.uint64(30))) * FIRST
    z = (z ^ (z >> np.uint64(27))) * SECOND
    return z ^ (z >> np.uint64(31))


mix = kernel(split_mix)


@kernel
def uniform(number, seed):
    """Return a random value in [0, 1) for the integer that represents a target; ``seed`` is the output of `mix`."""
    return (mix(number ^ seed) >> np.uint64(11)) * UNIT


@kernel
def uniforms(numbers, seed, out):
    """Compute a random value in [0, 1) for each target, from one seed and the integers that represent the targets."""
    mixed = mix(seed)
    for t in range(numbers.size):
        out[t] = uniform(numbers[t], mixed)


@kernel
def numbers_of_texts(codes, out):
    """Compute one 64-bit integer for each text.

    Each row of ``codes`` contains the Unicode code points of one text, followed by zeros. A text that is an integer of
    at most 64 bits in decimal form is converted to this integer. For any other text, the result is the hash FNV-1a,
    computed from code points in place of bytes.
    """
    for t in range(codes.shape[0]):
        n = 0
        while n < codes.shape[1] and codes[t, n] != 0:
            n += 1
        begin = 1 if n > 1 and codes[t, 0] == 45 else 0
        # Integers have no leading zeros, and there is no negative zero.
        is_integer = begin < n <= begin + 20 and (codes[t, begin] != 48 or n == 1)
        value = np.uint64(0)
        total = FNV_OFFSET
        for k in range(n):
            code = np.uint64(codes[t, k])
            total = (total ^ code) * FNV_PRIME
            if k >= begin and is_integer:
                digit = code - ZERO
                is_integer = digit <= NINE and (value < LARGEST or (value == LARGEST and digit <= LAST))
                value = value * TEN + digit
        is_integer = is_integer and (begin == 0 or value <= MOST_NEGATIVE)
        out[t] = (np.uint64(0) - value if begin else value) if is_integer else total
