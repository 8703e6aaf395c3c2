"""Conversion of columns to compact JSON, which the scripts of a page unpack."""

import json

import numpy as np

from rfpsurvey.report._text import text_of

FEW = 64  # a text column with at most this many different values is stored as names and the index of each name


def pack(values: object, decimals: int | None = None) -> dict:
    """Return a column of numbers or text as a dict.

    The key ``v`` contains the values or, if there is a key ``d``, integers to be divided by 10 to the power ``d``; NaN
    becomes None. The key ``c`` contains the only value of a constant column. A text column with few distinct values has
    the keys ``names`` and ``v``, where ``v`` contains indices into ``names``.
    """
    mask = np.ma.getmaskarray(values) if np.ma.isMaskedArray(values) else None
    plain = np.asarray(np.ma.getdata(values) if mask is not None else getattr(values, "value", values))
    if plain.dtype.kind == "f":
        return _pack_numbers(plain, decimals)
    if plain.dtype.kind == "b":
        plain = plain.astype(int)
    if plain.dtype.kind in "iu":
        numbers = plain.tolist()
        if mask is not None and mask.any():
            numbers = [None if gone else value for value, gone in zip(numbers, mask.tolist(), strict=True)]
        return _values(numbers)
    texts = ["" if value is None else text_of(value) for value in np.ma.filled(values, "").tolist()]
    return pack_texts(texts)


def pack_texts(texts: list[str]) -> dict:
    """Return a column of texts as a dict (see `pack`)."""
    names = list(dict.fromkeys(texts))
    if len(names) == 1 or len(names) > FEW:
        return _values(texts)
    codes = {name: k for k, name in enumerate(names)}
    return {"names": names, "v": [codes[text] for text in texts]}


def _pack_numbers(values, decimals):
    good = np.isfinite(values)
    if decimals is None:
        numbers = [float(f"{v:.6g}") if ok else None for v, ok in zip(values.tolist(), good.tolist(), strict=True)]
        return _values(numbers)
    whole = np.rint(np.where(good, values, 0) * 10**decimals).astype(np.int64).tolist()
    numbers = [v if ok else None for v, ok in zip(whole, good.tolist(), strict=True)]
    return {"d": decimals, **_values(numbers)}


def _values(values):
    """Return a list of values as a dict; if all values are equal, the dict contains only one of them."""
    return {"c": values[0]} if values and all(value == values[0] for value in values) else {"v": values}


def json_of(data: object) -> str:
    """Return data as JSON for a script element, in ASCII and without the characters that can end the element."""
    text = json.dumps(data, ensure_ascii=True, allow_nan=False, separators=(",", ":"))
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")
