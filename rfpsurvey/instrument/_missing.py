"""Values of calibration files that stand for missing numbers."""

import numpy as np

CODES = np.array([99, 999, 9999, 99999, 999999], dtype=float)
"""Numbers that observatories write instead of missing values, with either sign."""


def is_missing(values: np.ndarray, low: float, high: float, *, codes: bool = True) -> np.ndarray:
    """Return whether values are NaN, are outside physical limits, or are codes for missing values.

    If ``codes`` is False, codes between the limits are valid values.
    """
    wrong = ~((values >= low) & (values <= high))
    return wrong | np.isin(np.abs(values), CODES) if codes else wrong
