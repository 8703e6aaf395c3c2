"""Conversion of single numbers (four significant digits) and of columns (the same number of decimals) to text."""

import math

import numpy as np

DIGITS = 4
SMALL, LARGE = 1e-4, 1e7  # numbers outside of this range are written with an exponent
WIDE = 100  # if the numbers of a column differ by this factor or more, each number has its own number of decimals


def number_text(value: object) -> str:
    """Return a number as text; booleans become "yes" or "no"."""
    if isinstance(value, bool | np.bool_):
        return "yes" if value else "no"
    if not isinstance(value, float | np.floating) or not math.isfinite(value):
        return str(value)
    if value == 0 or SMALL <= abs(value) < LARGE:
        return f"{value:.{_decimals(abs(value))}f}" if abs(value) >= 10 ** (DIGITS - 1) else f"{value:.{DIGITS}g}"
    return f"{value:.{DIGITS - 1}e}"


def column_texts(values: np.ndarray, decimals: int | None = None) -> list[str]:
    """Return the numbers of a column as text, if possible with the same number of decimals.

    Each number has its own number of decimals if the largest number is at least ``WIDE`` times the smallest, or if a
    number is below ``SMALL`` or at least ``LARGE``.
    """
    values = np.asarray(values)
    if values.dtype.kind != "f":
        return [number_text(v) for v in values.tolist()]
    sizes = np.abs(values[np.isfinite(values) & (values != 0)])
    low, high = (sizes.min(), sizes.max()) if len(sizes) else (0, 0)
    if decimals is None and low >= SMALL and high < LARGE and high < WIDE * low:
        decimals = _decimals(low)
        exact = [k for k in range(decimals) if (np.round(sizes, k) == sizes).all()]
        decimals = exact[0] if exact else decimals
    if decimals is None:
        return [number_text(v) for v in values.tolist()]
    return [f"{v:.{decimals}f}" if math.isfinite(v) else str(v) for v in values.tolist()]


def _decimals(size: float) -> int:
    """Return the number of decimals with which a number of this size has four significant digits."""
    return 0 if size == 0 else max(DIGITS - 1 - math.floor(math.log10(size)), 0)
