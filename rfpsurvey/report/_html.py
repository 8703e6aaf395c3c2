"""Conversion of a page to HTML: a single file that loads no other files."""

import base64
import hashlib
import re
from collections.abc import Callable
from functools import cache, partial
from importlib.resources import files
from itertools import count, groupby
from typing import TYPE_CHECKING

import numpy as np

from rfpsurvey.report._blocks import Facts, Page, Rows, View
from rfpsurvey.report._svg import dark_grays, svg_of
from rfpsurvey.report._text import MISSING, cells_of, json_of, number_text, text_of
from rfpsurvey.tile import versions

if TYPE_CHECKING:
    from jinja2 import Template

BREAK = re.compile(r"(?<=\w[._])(?=\w)")  # places where a name may be broken into two lines
MOST_ITEMS = 30  # largest number of values that the page shows of a list in the provenance
NEEDS = {
    "focal_plane": ["long_table", "focal_plane_drawing"],
    "sky_map": ["sky_map_drawing"],
}  # further scripts that a view requires
PAPER = (510, 690)  # widths (pt) of the text on upright and on wide paper, both A4 and US letter
LETTER, GAP = 0.68, 2  # width of a letter divided by the size of the text, and number of letters between columns
LARGE_PRINT, SMALL_PRINT, LEAST_PRINT = 7.5, 6.5, 4.0  # sizes of text (pt); below the second, the paper is wide
MOST_LETTERS = 30  # longer cells are broken into several lines
MAX_ROWS = 1000  # largest number of rows that the page shows of a table, by default


def html_of(page: Page, max_rows: int | None, *, framed: bool = False) -> str:
    """Return a page as HTML; tables show at most ``max_rows`` rows, or ``MAX_ROWS`` rows if ``max_rows`` is None.

    A ``framed`` page contains only an interactive view, which fills the frame of a notebook.
    """
    kinds = sorted({block.kind for section in page.sections for block in section.blocks if isinstance(block, View)})
    script = _script(tuple(kinds))
    return _template().render(
        page=page,
        framed=framed,
        digest=base64.b64encode(hashlib.sha256(script.encode()).digest()).decode(),
        script=script,
        max_rows=max_rows,
        provenance=[Facts(name or "general", group) for name, group in _groups(page.provenance, "").items() if group],
        version=versions()["rfpsurvey"],
        number=partial(next, count(1)),
    )


@cache
def _template() -> "Template":
    """Return the template of all pages, which applies `text_of` to every text and escapes the result."""
    from jinja2 import Environment, FunctionLoader, StrictUndefined

    environment = Environment(
        loader=FunctionLoader(_asset),
        autoescape=True,
        undefined=StrictUndefined,
        finalize=lambda value: value if hasattr(value, "__html__") else text_of(value),
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.filters |= {
        "class_name": lambda block: type(block).__name__,
        "columns": _columns,
        "dark_grays": dark_grays,
        "json": json_of,
        "parts": BREAK.split,
        "plain": _plain,
        "print_size": _print_size,
        "sorting_key": _sorting_key,
        "svg": svg_of,
    }
    return environment.get_template(
        "page.html.jinja",
        globals={
            "LEAST_PRINT": LEAST_PRINT,
            "groupby": groupby,
            "style": _asset("page.css"),
            "view_style": _asset("scripts/view.css"),
            "type": type,
            "zip": zip,
        },
    )


@cache
def _script(kinds: tuple[str, ...]) -> str:
    """Return the script of a page with the given kinds of views; without views, the script only controls tables."""
    parts = [part for kind in kinds for part in (*NEEDS.get(kind, ()), kind)]
    names = ["page.js", *(f"scripts/{part}.js" for part in (["shared", *parts] if kinds else []))]
    return "\n" + "\n".join(_asset(name) for name in names)


def _asset(name: str) -> str:
    return (files("rfpsurvey.report") / name).read_text(encoding="utf-8")


def _columns(block: Rows, max_rows: int | None) -> tuple[int, list[dict]]:
    """Return the number of rows of a table that the page shows, and the columns of the table."""
    table = block.table[: MAX_ROWS if max_rows is None else max_rows]
    columns = []
    for name in table.colnames:
        unit, numbers, cells = cells_of(table[name], name)
        columns.append({"name": name, "unit": unit, "numbers": numbers, "cells": cells})
    return len(table), columns


def _print_size(columns: list[dict]) -> tuple[float, bool]:
    """Return the size of the text (pt) at which all columns of a table fit on paper, and whether the paper is wide."""
    letters = 0
    for column in columns:
        head = max(map(len, column["name"].replace("_", " ").split()), default=0)
        cells = max((len(text) for text, _ in column["cells"]), default=0)
        letters += GAP + max(head, len(column["unit"]) + 2, min(cells, MOST_LETTERS))
    sizes = [width / max(letters * LETTER, 1) for width in PAPER]
    wide = sizes[0] < SMALL_PRINT
    return round(max(min(sizes[wide], LARGE_PRINT), LEAST_PRINT), 2), wide


def _sorting_key(value: object) -> str:
    """Return a number as text with all its digits; return empty text for any other value."""
    number = isinstance(value, int | float | np.number) and not isinstance(value, bool) and not np.isnan(value)
    return repr(float(value)) if number else ""


def _plain(value: object, number: Callable = number_text) -> str:
    """Return a value of a summary or of the provenance as text; ``number`` converts numbers."""
    if isinstance(value, np.ndarray | np.generic) and not hasattr(value, "unit"):
        value = value.tolist()
    if value is None or (isinstance(value, str) and not value) or (isinstance(value, float) and np.isnan(value)):
        return MISSING
    if isinstance(value, dict):
        return ", ".join(f"{k} {_plain(v, number)}" for k, v in value.items()) or "none"
    if isinstance(value, list | tuple):
        more = f", and {len(value) - MOST_ITEMS} more" if len(value) > MOST_ITEMS else ""
        return (", ".join(_plain(v, number) for v in value[:MOST_ITEMS]) or "none") + more
    return number(value)


def _groups(values: dict, name: str) -> dict[str, dict]:
    """Return a dict of groups by title; each group contains the values of one nested dict, as text with all digits."""
    groups = {name: {str(k): _plain(v, _exactly) for k, v in values.items() if not (isinstance(v, dict) and v)}}
    for key, value in values.items():
        if isinstance(value, dict):
            for title, group in _groups(value, f"{name} {key}".strip().replace("_", " ")).items():
                while title in groups and groups[title] and group:  # another dict has the same title
                    title += "'"
                groups[title] = groups.get(title, {}) | group
    return groups


def _exactly(value: object) -> str:
    return f"{value:.15g}" if isinstance(value, float) else number_text(value)
