"""Values of calibration files that stand for missing numbers."""

import numpy as np

from rfpsurvey.errors import number_of

CODES = np.array([99, 999, 9999, 99999, 999999], dtype=float)
"""Numbers that observatories write instead of missing values, with either sign."""


IMPOSSIBLE = "layout.impossible_values"
"""Name of the value of an instrument that counts the positioners with impossible values in the files."""


def impossible_entry(n: int, source: str) -> dict:
    """Return the value of an instrument that counts positioners with impossible values; empty if there are none."""
    return {IMPOSSIBLE: {"value": n, "status": "derived", "source": source}} if n else {}


def impossible_sentence(instrument) -> str:
    """Return text with the number of positioners with impossible values in the files of an instrument."""
    n = instrument.values.get(IMPOSSIBLE, {}).get("value", 0)
    if not n:
        return ""
    n_disabled = np.count_nonzero(instrument.focal_plane.disabled)
    return (
        " The files of the instrument have impossible values, which count as missing, for "
        f"{number_of(n, 'positioner')} (see its notes); {n_disabled} of all positioners are disabled."
    )


def is_missing(values: np.ndarray, low: float, high: float, *, codes: bool = True) -> np.ndarray:
    """Return whether values are NaN, are outside physical limits, or are codes for missing values.

    If ``codes`` is False, codes between the limits are valid values.
    """
    wrong = ~((values >= low) & (values <= high))
    return wrong | np.isin(np.abs(values), CODES) if codes else wrong
