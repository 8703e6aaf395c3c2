"""Designs that no other one beats."""

import numpy as np
from astropy.table import QTable

from rfpsurvey.errors import InputError, check_choice

__all__ = ["OBJECTIVES", "check_objectives", "on_front"]

OBJECTIVES = {"coverage": "max", "loss": "min"}


def check_objectives(objectives: object, columns: tuple[str, ...]) -> dict[str, str]:
    """Return two columns and whether their largest or smallest value is wanted."""
    pairs = list(objectives.items()) if isinstance(objectives, dict) else []
    if len(pairs) != 2:
        raise InputError(f"objectives must be two columns with 'max' or 'min', such as {OBJECTIVES}, got {objectives}")
    for name, aim in pairs:
        check_choice(name, columns, "column for an objective")
        check_choice(aim, ("max", "min"), f"aim for {name}")
    return dict(pairs)


def on_front(table: QTable, objectives: dict[str, str]) -> np.ndarray:
    """Mark rows that no other row beats: at least as good in both columns, and better in one.

    Rows with the same values are on the front together, and rows without a value never.
    """
    signs = {"max": -1.0, "min": 1.0}
    values = [signs[aim] * np.asarray(getattr(table[name], "value", table[name])) for name, aim in objectives.items()]
    first, second = (np.asarray(v, dtype=float) for v in values)
    known = np.flatnonzero(np.isfinite(first) & np.isfinite(second))
    order = known[np.lexsort((second[known], first[known]))]
    a, b = first[order], second[order]
    start = np.searchsorted(a, a, side="left")  # of the rows with the same first value, of which the best come first
    least = np.append(np.inf, np.minimum.accumulate(b))[start]  # second value of all before them
    front = np.zeros(len(table), dtype=bool)
    front[order] = (b == b[start]) & (b < least)
    return front
