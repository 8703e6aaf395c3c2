"""A page as HTML: one file that fetches nothing."""

import base64
import hashlib
import re
from collections.abc import Callable
from importlib.resources import files
from itertools import groupby

import numpy as np

from rfpsurvey.report._blocks import Facts, Page, Picture, Rows, Text
from rfpsurvey.report._columns import MISSING, cells_of, rounded_cells_of
from rfpsurvey.report._numbers import number_text
from rfpsurvey.report._svg import dark_grays, svg_of
from rfpsurvey.report._text import text_of
from rfpsurvey.tile import versions

__all__ = ["html_of"]

BREAK = re.compile(r"(\w[._])(?=\w)")  # where a name may go on in the next line
WIDE = 9  # inches: a wider figure has its caption below
LONG, LONG_NAME = 30, 12  # characters: a longer text may take several lines
MOST_ITEMS = 30  # of a list in the provenance
MAX_ROWS = 1000  # of a table, by default
FOLDED = 100  # rows of a complete table that are not shown until it is opened


def html_of(page: Page, max_rows: int | None) -> str:
    """Return a page as text, with tables of at most that many rows; None is the default of each table."""
    counter = iter(range(1, 1_000_000))
    sections = "\n".join(_section(section, counter, max_rows) for section in page.sections)
    by = f"Written by rfpsurvey {versions()['rfpsurvey']}. This page is complete in itself: it fetches nothing."
    groups = f'<div class="groups">\n{_provenance(page.provenance)}\n</div>'
    foot = f"<footer>\n<h2>Provenance</h2>\n{groups}\n<p>{text_of(by)}</p>\n</footer>"
    body = f"{_header(page)}\n<main>\n{sections}\n</main>\n{foot}"
    style = f"{_asset('page.css')}\n{dark_grays(body)}".strip()
    script = f"\n{_asset('page.js')}"
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    # the browser itself holds the page to its word: nothing is fetched, and no other script runs
    policy = f"default-src 'none'; style-src 'unsafe-inline'; img-src data:; script-src 'sha256-{digest}'"
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        f'<meta http-equiv="Content-Security-Policy" content="{policy}">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        '<meta name="color-scheme" content="light dark">\n<meta name="generator" content="rfpsurvey">\n'
        f'<title>{text_of(page.title)}</title>\n<link rel="icon" href="data:,">\n<style>\n{style}\n</style>\n</head>\n'
        f"<body>\n{body}\n<script>{script}</script>\n</body>\n</html>\n"
    )


def _asset(name: str) -> str:
    return (files("rfpsurvey.report") / name).read_text(encoding="utf-8")


def _header(page: Page) -> str:
    lines = [f'<p class="kind">rfpsurvey · {text_of(page.kind)}</p>', f"<h1>{text_of(page.title)}</h1>"]
    if page.lead:
        lines.append(f'<p class="lead">{text_of(page.lead)}</p>')
    if page.highlights:
        figures = [f"<div><dt>{text_of(k)}</dt><dd>{text_of(_plain(v))}</dd></div>" for k, v in page.highlights.items()]
        lines += ['<dl class="highlights">', *figures, "</dl>"]
    return "<header>\n" + "\n".join(lines) + "\n</header>"


def _section(section, counter, max_rows) -> str:
    parts = []
    for kind, blocks in groupby(section.blocks, type):
        made = "\n".join(BLOCKS[kind](block, counter, max_rows) for block in blocks)
        parts.append(f'<div class="groups">\n{made}\n</div>' if kind is Facts else made)
    return "\n".join(["<section>", f"<h2>{text_of(section.title)}</h2>", *parts, "</section>"])


def _paragraph(block: Text, counter, max_rows) -> str:
    if isinstance(block.words, str):
        return f"<p>{text_of(block.words)}</p>"
    return "<ul>\n" + "\n".join(f"<li>{text_of(words)}</li>" for words in block.words) + "\n</ul>"


def _facts(block: Facts, counter, max_rows) -> str:
    rows = []
    for label, value in block.values.items():
        part = ' class="part"' if label.startswith(" ") else ""
        number = isinstance(value, int | float | np.number) and not isinstance(value, bool) and not np.isnan(value)
        look = f' class="number" data-value="{float(value)!r}"' if number else ""
        name = BREAK.sub(r"\1<wbr>", text_of(label.strip()))
        rows.append(f'<tr{part}><th scope="row">{name}</th><td{look}>{text_of(_plain(value))}</td></tr>')
    caption = f"<caption>{text_of(block.caption)}</caption>\n" if block.caption else ""
    return "\n".join([f'<table class="facts">\n{caption}<tbody>', *rows, "</tbody>\n</table>"])


def _plain(value: object, number: Callable = number_text) -> str:
    """Return a value of a summary or of the provenance as text."""
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


def _rows(block: Rows, counter, max_rows) -> str:
    most = max_rows if max_rows is not None else len(block.table) if block.complete else MAX_ROWS
    table = block.table[:most]
    missing = len(block.table) - len(table) + block.left_out
    caption = f"<strong>{text_of(block.caption)}</strong>"
    if missing:
        where = f"; all are in {block.where}" if block.where else ""
        caption += text_of(f" Shown: {len(table)} of {len(table) + missing} rows{where}.")
    cells = rounded_cells_of if block.complete else cells_of
    columns = [(name, *cells(table[name], name)) for name in table.colnames]
    heads = []
    for name, unit, numbers, _ in columns:
        unit = f' <span class="unit">{text_of(unit)}</span>' if unit else ""
        looks = ["number" if numbers else "", "long" if len(name) > LONG_NAME else ""]
        heads.append(f'<th scope="col"{_class(looks)}>{text_of(name.replace("_", " "))}{unit}</th>')
    made = [_cells(c == 0, numbers, values, block) for c, (_, _, numbers, values) in enumerate(columns)]
    lines = ["<tbody>", *(f"<tr>{''.join(row)}</tr>" for row in zip(*made, strict=True)), "</tbody>"]
    head = f"<caption>{caption}</caption>\n<thead>\n<tr>{''.join(heads)}</tr>\n</thead>"
    looks = "rows rounded" if block.complete else "rows"
    text = "\n".join([_scroll(block.caption), f'<table class="{looks}">', head, *lines, "</table>\n</div>"])
    if block.complete and len(table) > FOLDED:
        text = (
            f"<details>\n<summary>{text_of(block.caption.rstrip('.'))}: {len(table)} rows</summary>\n{text}\n</details>"
        )
    return text


def _cells(first: bool, numbers: bool, values: list, block: Rows) -> list[str]:
    """Return the cells of a column. Numbers are to the right; in a rounded table all cells are, but for text."""
    tag, scope = ("th", ' scope="row"') if first else ("td", "")
    usual = ("" if numbers else "text") if block.complete else ("number" if numbers else "")
    made = []
    for text, key in values:
        looks = [usual, "missing" if key == "" else "", "long" if len(text) > LONG else "", block.marks.get(text, "")]
        data = "" if key is None else f' data-value="{key}"'
        made.append(f"<{tag}{scope}{_class(looks)}{data}>{text_of(text)}</{tag}>")
    return made


def _class(looks: list[str]) -> str:
    return f' class="{" ".join(filter(None, looks))}"' if any(looks) else ""


def _picture(block: Picture, counter, max_rows) -> str:
    svg = svg_of(block.figure, next(counter), block.caption, block.words)
    words = f" {text_of(block.words)}" if block.words else ""
    caption = f"<figcaption><strong>{text_of(block.caption)}</strong>{words}</figcaption>"
    wide = ' class="wide"' if getattr(block.figure, "figure", block.figure).get_figwidth() > WIDE else ""
    return f"<figure{wide}>\n{_scroll(block.caption)}{svg}</div>\n{caption}\n</figure>"


def _scroll(caption: str) -> str:
    """Open a part that is scrolled, with the keyboard too, where it is wider than the screen."""
    return f'<div class="scroll" role="region" aria-label="{text_of(caption)}" tabindex="0">'


BLOCKS: dict[type, Callable] = {Text: _paragraph, Facts: _facts, Rows: _rows, Picture: _picture}


def _provenance(values: dict) -> str:
    """Return a table for what has no group, and one for each group."""
    groups = _groups(values, "")
    return "\n".join(_facts(Facts(name or "general", group), None, 0) for name, group in groups.items() if group)


def _groups(values: dict, name: str) -> dict[str, dict]:
    """Return dicts in dicts beside each other, with a name each; numbers in full."""
    groups = {name: {str(k): _plain(v, _exactly) for k, v in values.items() if not (isinstance(v, dict) and v)}}
    for key, value in values.items():
        if isinstance(value, dict):
            for title, group in _groups(value, f"{name} {key}".strip().replace("_", " ")).items():
                while title in groups and groups[title] and group:  # dicts whose names read alike
                    title += "'"
                groups[title] = groups.get(title, {}) | group
    return groups


def _exactly(value: object) -> str:
    return f"{value:.15g}" if isinstance(value, float) else number_text(value)
