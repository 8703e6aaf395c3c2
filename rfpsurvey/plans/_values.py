"""Parts of plan files: columns of narrower types, and keywords that describe the projection."""

import numpy as np

from rfpsurvey._readers import is_number
from rfpsurvey.errors import InputError

PREFIX = "rfpsurvey."
ENTRIES = ("north_of", "projection", "conditions")
"""Entries of the ``meta`` of a plan that describe how its sky positions were projected."""


def to_type(values: np.ndarray, dtype: str, what: str) -> np.ndarray:
    """Return values as integers or floats of a NumPy type; raise an error if this type cannot represent a value."""
    values, dtype = np.asarray(values), np.dtype(dtype)
    if values.dtype == dtype:
        return values
    if dtype.kind == "f":
        limit, numbers = np.finfo(dtype).max, values.astype(float)
        wrong = np.isfinite(numbers) & (np.abs(numbers) > limit)
        range_of = f"numbers from {-limit:g} to {limit:g}"
    else:
        low, high = np.iinfo(dtype).min, np.iinfo(dtype).max
        range_of = f"whole numbers from {low} to {high}"
        # integers and text are converted by Python, whose integers have no limits
        numbers = np.array([_whole(value) for value in values.ravel().tolist()], dtype=object).reshape(values.shape)
        wrong = np.array([not (n is not None and low <= n <= high) for n in numbers.flat]).reshape(values.shape)
    if wrong.any():
        raise InputError(f"{what} must be {range_of}, got {values[wrong].flat[0]}")
    return numbers.astype(dtype)


def _whole(value: object) -> int | None:
    """Return a number or text as an integer; None if it is not a whole number."""
    try:
        return int(value) if int(value) == (int(value) if isinstance(value, str) else value) else None
    except (ValueError, OverflowError, TypeError):
        return None


def to_keywords(meta: dict) -> dict:
    """Return keywords of a file that contain the description of the projection in the ``meta`` of a plan."""
    found = {}

    def add(name, value):
        if isinstance(value, dict):
            for key, one in value.items():
                add(f"{name}.{key}", one)
        elif value is not None:
            found[name] = value

    for name in ENTRIES:
        add(PREFIX + name, meta.get(name))
    return found


def from_keywords(header: dict) -> dict:
    """Return the entries of the ``meta`` of a plan that `to_keywords` wrote to a file."""
    found: dict = {}
    for name, value in header.items():
        if not name.lower().startswith(PREFIX):
            continue
        *groups, last = name[len(PREFIX) :].split(".")
        entry = found
        for group in groups:
            entry = entry.setdefault(group, {}) if isinstance(entry, dict) else {}
        if isinstance(entry, dict):
            entry[last] = float(value) if groups and isinstance(value, str) and is_number(value) else value
    return {name: found[name] for name in ENTRIES if name in found}


def without_keywords(header: dict) -> dict:
    """Return the keywords of a file without those that `to_keywords` wrote."""
    return {name: value for name, value in header.items() if not name.lower().startswith(PREFIX)}
