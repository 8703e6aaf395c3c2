"""The Pareto front of designs."""

import numpy as np
from astropy.table import QTable

from rfpsurvey._units import to_plain
from rfpsurvey.errors import check_choice, refusal

OBJECTIVES = {"coverage": "max", "loss": "min"}


def check_objectives(objectives: object, columns: tuple[str, ...]) -> dict[str, str]:
    """Return the two objectives (a dict from column to "max" or "min"), or raise an error."""
    pairs = list(objectives.items()) if isinstance(objectives, dict) else []
    if len(pairs) != 2:
        text = f"objectives must be two columns with 'max' or 'min', such as {OBJECTIVES}"
        raise refusal(text, objectives, dict)
    for name, direction in pairs:
        check_choice(name, columns, "column for an objective")
        check_choice(direction, ("max", "min"), f"direction of {name}")
    return dict(pairs)


def on_front(table: QTable, objectives: dict[str, str]) -> np.ndarray:
    """Return whether each row is on the Pareto front.

    A row is on the front if no other row is at least as good in both columns and better in one. If several rows have
    the same best values, all of them are on the front. Rows without a value are not on the front.
    """
    signs = {"max": -1.0, "min": 1.0}
    first, second = (signs[aim] * to_plain(table[name]) for name, aim in objectives.items())
    known = np.flatnonzero(np.isfinite(first) & np.isfinite(second))
    order = known[np.lexsort((second[known], first[known]))]
    a, b = first[order], second[order]
    start = np.searchsorted(a, a, side="left")  # first row with the same first value; its second value is the best
    least = np.append(np.inf, np.minimum.accumulate(b))[start]  # best second value of all rows before start
    front = np.zeros(len(table), dtype=bool)
    front[order] = (b == b[start]) & (b < least)
    return front
