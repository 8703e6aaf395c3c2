"""Conversion of the columns of a table to text."""

import numpy as np
from astropy.units import Quantity

from rfpsurvey.report._numbers import column_texts

MISSING = "\N{EN DASH}"
SKY = {"ra": 6, "dec": 6}  # numbers of decimals, for columns in degrees


def cells_of(column, name: str) -> tuple[str, bool, list[tuple[str, str | None]]]:
    """Return the unit of a column, whether the column contains numbers, and the text and sorting key of each cell.

    The sorting key is the full value if the text may have fewer digits than the value. The key is "" for a missing
    value, and None if the cell is sorted by its text.
    """
    unit = str(getattr(column, "unit", None) or "")
    values = column.value if isinstance(column, Quantity) else column
    mask = getattr(values, "mask", None)
    plain = np.asarray(getattr(values, "unmasked", values)) if hasattr(values, "dtype") else None
    if plain is None or plain.ndim != 1 or plain.dtype.kind not in "biufSU":
        return unit, False, [_cell("" if value is None else str(value)) for value in column]
    missing = np.zeros(len(plain), bool) if mask is None or mask is np.ma.nomask else np.broadcast_to(mask, len(plain))
    if plain.dtype.kind == "f":
        missing = missing | np.isnan(plain)
        decimals = SKY.get(name) if unit == "deg" else None
        texts = column_texts(np.where(missing, 0, plain), decimals)
        keys = [_key(value) for value in plain.tolist()]
    else:
        texts = [v.decode(errors="replace") if isinstance(v, bytes) else v for v in plain.tolist()]
        texts = column_texts(plain) if plain.dtype.kind in "biu" else texts
        keys = [None] * len(texts)
    cells = zip(texts, keys, missing.tolist(), strict=True)
    return unit, plain.dtype.kind in "iuf", [_cell("" if is_missing else text, key) for text, key, is_missing in cells]


def _cell(text: str, key: str | None = None) -> tuple[str, str | None]:
    """Return the text and the sorting key of a cell; a cell without text is a missing value."""
    return (text, key) if text.strip() else (MISSING, "")


def _key(value: float) -> str:
    """Return a number as text that both Python and a browser can read."""
    return repr(value) if np.isfinite(value) else "Infinity" if value > 0 else "-Infinity"
