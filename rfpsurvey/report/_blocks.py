"""The components of a report page, values as text, and facts; a label with two leading spaces gives a detail."""

import json
import math
import unicodedata
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from astropy.table import Table
from astropy.units import Quantity

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from rfpsurvey._field.tile import Tile
    from rfpsurvey._studies.question import Estimate
    from rfpsurvey._survey.tiling.tiling import Tiling


@dataclass(frozen=True)
class Text:
    """A paragraph, or a list of sentences."""

    words: str | list[str]


@dataclass(frozen=True)
class Facts:
    """A list of labels and values; an indented label gives a detail of the label above it."""

    caption: str
    values: dict


@dataclass(frozen=True)
class Rows:
    """A table that can be sorted.

    ``where`` names the file or attribute that contains all rows; the page states this name if some rows are not shown.
    ``left_out`` is the number of rows that ``table`` omits. ``marks`` maps the text of cells to a style: good, bad or
    open.
    """

    caption: str
    table: Table
    where: str = ""
    left_out: int = 0
    marks: dict = field(default_factory=dict)


@dataclass(frozen=True)
class Picture:
    """A matplotlib figure with its caption, and a description of what the figure shows."""

    caption: str
    figure: "Figure | Axes"
    words: str = ""


@dataclass(frozen=True)
class View:
    """An interactive view.

    The script ``scripts/KIND.js``, where KIND is the value of ``kind``, draws the ``data``, which must be valid JSON.
    The blocks in ``still`` replace the view on paper, and in browsers that run no scripts.
    """

    kind: str
    caption: str
    data: dict
    still: list


@dataclass(frozen=True)
class Section:
    """A heading, and the blocks below it."""

    title: str
    blocks: list


@dataclass(frozen=True)
class Page:
    """A page: the kind of the result, a title, an introductory sentence, the most important values, and sections.

    The end of the page shows ``provenance``, in which each nested dict becomes a group of values.
    """

    kind: str
    title: str
    lead: str
    highlights: dict
    sections: list[Section]
    provenance: dict


BAD = ("Cc", "Cn", "Co", "Cs")
"""Unicode categories of characters that are not text: control, unassigned, private-use and surrogate characters."""
TURNS = "\u202a\u202b\u202c\u202d\u202e\u2066\u2067\u2068\u2069"
"""Characters that change the direction of the text that follows."""


def text_of(value: object) -> str:
    """Return a value as text for a page; characters that are invalid or change the direction of text are replaced."""
    text = str(value).replace("\r\n", "\n")
    if text.isascii() and text.isprintable():
        return text
    return "".join(c if _is_text(c) else "\N{REPLACEMENT CHARACTER}" for c in text)


def _is_text(character: str) -> bool:
    return character in "\n\t" or (unicodedata.category(character) not in BAD and character not in TURNS)


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


TILING = {
    "n_tiles": "tiles",
    "radius_deg": "radius of a field in degrees",
    "area_deg2": "area of the region in square degrees",
    "covering_fraction": "fraction of the region that fields cover",
    "fraction_in_reach": "  in reach of a positioner",
    "fraction_beyond_declination": "  outside the limits of declination",
    "mean_depth": "mean number of fields that cover a position",
    "n_samples": "positions at which the coverage is measured",
    "fibers": "fibers per tile",
    "n_targets": "targets with requested visits",
    "n_beyond_declination": "  outside the limits of declination",
    "n_on_tiles": "  on at least one tile",
    "n_requested": "visits requested",
    "n_observed": "  observed",
    "completeness": "completeness",
    "completeness_means": "definition of the completeness",
    "fiber_use": "fraction of the fibers used",
    "n_isolated": "targets with no other target too close",
    "completeness_isolated": "  completeness of these targets",
}


def tiling_facts(tiling: "Tiling") -> dict:
    """Return the values in the summary of a tiling; a value without a label is labeled by its key."""
    return {TILING.get(key, key.replace("_", " ")): value for key, value in tiling.summary.items() if value != ""}


def model_facts(tile: "Tile") -> dict:
    """Return what a tile states about its model, about poses of arms without a target, and about its projection."""
    texts = {"model": tile.summary.get("model"), "poses": tile.summary.get("poses_without_target")}
    projection = tile.summary.get("projection", {})
    if "sentence" in projection:
        texts["projection"] = f"{projection['model']}; {projection['sentence']}"
    return {label: text for label, text in texts.items() if text}


def estimate_facts(estimate: "Estimate") -> dict:
    """Return the values of an estimate as text, with as many digits as its error allows."""
    formula, error = np.isnan(estimate.low), estimate.standard_error
    digits = 5 if formula or not 0 < error < 1e-5 else 1 - int(np.floor(np.log10(error)))
    digits = max(digits, 1 - int(np.floor(np.log10(estimate.value)))) if 0 < estimate.value < 1e-4 else digits
    unknown = f"none: {estimate.meta['no_interval']}" if "no_interval" in estimate.meta else "no error is known"
    interval = unknown if formula else f"{estimate.low:.{digits}f} to {estimate.high:.{digits}f}"
    lines = {
        "collision probability": f"{estimate.value:.{digits}f}",
        f"  {100 * estimate.meta['confidence']:g} % interval": interval,
        "  standard error": "" if formula else f"{estimate.standard_error:.2g}",
        "  of assigned positioners only": f"{estimate.value_assigned:.{digits}f}",
        "colliding pairs per positioner": "" if formula else f"{estimate.pairs_per_positioner:.5f}",
        "iterations": estimate.n or "",
        "effective number of trials": "" if formula else f"{estimate.n_effective:.0f}",
        "seconds": f"{estimate.seconds:.3f}",
    }
    return {label: value for label, value in lines.items() if value not in ("", "nan")}
