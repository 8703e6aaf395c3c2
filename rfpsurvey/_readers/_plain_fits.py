"""Read the rows of FITS files with one simple table, such as those of surveys, without astropy, which is slower."""

import re

import numpy as np

BLOCK, CARD = 2880, 80
PRIMARY = b"SIMPLE  =                    T", b"NAXIS   =                    0", b"XTENSION= 'BINTABLE'"
TYPES = {"L": "u1", "B": "u1", "I": ">i2", "J": ">i4", "K": ">i8", "E": ">f4", "D": ">f8"}
# Cards of scaled columns, columns with missing values, multidimensional columns and columns with several values.
OTHERS = re.compile(r"TSCAL\d+|TZERO\d+|TNULL\d+|TDIM\d+|THEAP|CONTINUE|COMMENT|HISTORY")
NAME = re.compile(r"[A-Z0-9_-]+")
NUMBER = re.compile(r"[-+]?\d+")
REAL = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)(E[-+]?\d+)?")


def read_plain(content: bytes) -> tuple[np.ndarray, dict] | None:
    """Return the rows and header cards of a FITS file; None if the file is not simple, or is damaged."""
    begins = 0, 2 * CARD, BLOCK
    if not all(content.startswith(text, at) for text, at in zip(PRIMARY, begins, strict=True)):
        return None
    cards, end = {}, BLOCK
    while (card := content[end : end + CARD]) and card.rstrip() != b"END":
        if not card.isascii():
            return None
        name, value = card[:8].decode().rstrip(), _value(card[8:].decode())
        if value is None or not NAME.fullmatch(name) or OTHERS.fullmatch(name) or name in cards:
            return None
        cards[name], end = value, end + CARD
    begin = end + CARD + (-(end + CARD)) % BLOCK
    try:
        fields = [_field(cards[f"TTYPE{k}"], cards[f"TFORM{k}"]) for k in range(1, cards["TFIELDS"] + 1)]
        dtype, n = np.dtype(fields), cards["NAXIS2"]
        size = n * dtype.itemsize
        layout = cards["NAXIS"], cards["NAXIS1"], cards["PCOUNT"], cards["GCOUNT"]
        if layout != (2, dtype.itemsize, 0, 1) or type(n) is not int or "GROUPS" in cards:
            return None
        if len(content) != begin + size + (-size) % BLOCK:
            return None
        rows = np.frombuffer(content, dtype, n, begin)
        columns = [_native(rows[name], cards[f"TFORM{k}"]) for k, name in enumerate(dtype.names, 1)]
        return np.rec.fromarrays(columns, names=list(dtype.names)), cards
    except (KeyError, TypeError, ValueError):
        return None


def _value(text: str) -> object:
    """Return the value of a card; None if the text has another form than the texts that rfpsurvey writes."""
    if text.startswith("= '"):
        value, quote, rest = text[3:].partition("'")
        return value.rstrip() if quote and re.match(" *(/|$)", rest) else None
    text = text[1:].partition("/")[0].strip() if text.startswith("= ") else ""
    if text in ("T", "F"):
        return text == "T"
    if NUMBER.fullmatch(text):
        return int(text)
    return float(text) if REAL.fullmatch(text) else None


def _field(name: str, form: str) -> tuple[str, str]:
    if form.endswith("A"):
        return name, f"S{int(form[:-1] or 1)}"
    return name, TYPES[form.removeprefix("1")]


def _native(values: np.ndarray, form: str) -> np.ndarray:
    if form.endswith("L"):
        return values == ord("T")
    if form.endswith("A"):
        return values.astype(f"U{values.dtype.itemsize}")
    return values.astype(values.dtype.newbyteorder("="))
