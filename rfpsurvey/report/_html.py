"""Conversion of a page, with its figures as SVG, to HTML: a single file that loads no other files."""

import base64
import hashlib
import io
import re
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache, partial
from importlib.resources import files
from itertools import count, groupby
from typing import TYPE_CHECKING
from xml.etree import ElementTree

import numpy as np

from rfpsurvey._field.facts import versions
from rfpsurvey.report._blocks import MISSING, Facts, Page, Rows, View, cells_of, json_of, number_text, text_of

if TYPE_CHECKING:
    from jinja2 import Template

# In figures with more than MOST_POINTS points, artists with more than MANY_POINTS points become images inside the SVG,
# because the arms of 4000 positioners, for example, would take megabytes as paths.
MOST_POINTS = 60_000
MANY_POINTS = 2000
DPI = 200
WIDE = 9  # width in inches; the caption of a wider figure is below the figure
STYLE = {"svg.fonttype": "none", "svg.hashsalt": "rfpsurvey", "svg.image_inline": True}
ILLEGAL = re.compile(rb"[\x00-\x08\x0b\x0c\x0e-\x1f]")  # bytes that XML does not allow
IMAGE = "data:image/png;base64,"
SAFE = "#", IMAGE, "https://", "http://"
"""Beginnings of links that a page keeps; others, such as ``javascript:``, could run code of the author of a figure."""
LONG = re.compile(r"(-?\d+\.\d\d)\d+")
REFERENCE = re.compile(r"url\(#([^)]*)\)")
GRAY = re.compile(r"#([0-9a-f]{2})\1\1\b")
USED_GRAY = re.compile(r"var\(--g([0-9a-f]{2}),")
# colors that replace black and white on a dark screen; only grays change, because other colors can represent values
DARK_INK, DARK_PAPER = np.array([226, 229, 233]), np.array([22, 25, 29])


def svg_of(figure, name: str) -> dict:
    """Return the content, box and width of the SVG of a figure, and whether the figure is wide.

    All ids in the SVG begin with ``name``.
    """
    from matplotlib import rc_context

    figure = getattr(figure, "figure", figure)
    file = io.BytesIO()
    with rc_context(STYLE), _heavy_as_images(figure):
        figure.savefig(file, format="svg", dpi=DPI, transparent=True, metadata={"Date": None})
    root = ElementTree.fromstring(ILLEGAL.sub(b"?", file.getvalue()))
    _remove(root, {"metadata", "style"})
    names = _new_names(root, f"{name}-")
    for element in root.iter():
        element.tag = _local(element.tag)
        element.attrib = {_local(k): v for k, v in element.attrib.items()}
        _rename(element.attrib, names)
    return {
        "box": root.attrib["viewBox"],
        "width": root.attrib["width"],
        "wide": figure.get_figwidth() > WIDE,
        "content": "".join(ElementTree.tostring(child, encoding="unicode") for child in root),
    }


def dark_grays(page: str) -> str:
    """Return the style sheet that changes the grays of the figures of a page on a dark screen."""
    lines = []
    for gray in sorted(set(USED_GRAY.findall(page))):
        light = int(gray, 16) / 255
        red, green, blue = np.rint(light * DARK_PAPER + (1 - light) * DARK_INK).astype(int)
        lines.append(f"--g{gray}:#{red:02x}{green:02x}{blue:02x}")
    return f"@media screen and (prefers-color-scheme: dark) {{ :root {{ {'; '.join(lines)} }} }}" if lines else ""


@contextmanager
def _heavy_as_images(figure) -> Iterator[None]:
    """Draw artists with many points as images within this context, if the figure has too many points."""
    points = {artist: _points(artist) for artist in figure.findobj(lambda a: not a.get_rasterized())}
    crowded = sum(points.values()) > MOST_POINTS
    heavy = [artist for artist, number in points.items() if crowded and number > MANY_POINTS]
    for artist in heavy:
        artist.set_rasterized(True)
    try:
        yield
    finally:
        for artist in heavy:
            artist.set_rasterized(False)


def _points(artist) -> int:
    """Return the approximate number of points of an artist in an SVG file."""
    from matplotlib.collections import Collection
    from matplotlib.lines import Line2D

    if isinstance(artist, Line2D):
        return len(artist.get_xdata(orig=False))
    if not isinstance(artist, Collection):
        return 0
    paths = artist.get_paths() or ()
    copies = max(len(artist.get_offsets()) // max(len(paths), 1), 1)  # a path can be drawn at many positions
    return copies * sum(map(len, paths))


def _local(name: str) -> str:
    """Return the name of an XML element or attribute without its namespace, which HTML does not require."""
    return name.rpartition("}")[2]


def _remove(root, names) -> None:
    for parent in list(root.iter()):
        for child in list(parent):
            if _local(child.tag) in names:
                parent.remove(child)


def _new_names(root, prefix: str) -> dict[str, str]:
    """Return a new name for each id to which an element refers, numbered in the order of the document."""
    used = set()
    for element in root.iter():
        for name, value in element.attrib.items():
            used.update([value[1:]] if _local(name) == "href" and value.startswith("#") else REFERENCE.findall(value))
    ids = [e.attrib["id"] for e in root.iter() if e.attrib.get("id") in used]
    return {name: f"{prefix}{k}" for k, name in enumerate(ids)}


def _rename(attributes: dict, names: dict[str, str]) -> None:
    """Give ids and references their new names, remove unused ids, shorten paths, and replace grays by CSS variables."""
    if attributes.get("id") not in names:
        attributes.pop("id", None)
    if not attributes.get("href", "").lower().startswith(SAFE):
        attributes.pop("href", None)
    for key, value in attributes.items():
        if key == "id":
            attributes[key] = names[value]
        elif key == "href" and value.startswith("#"):
            attributes[key] = f"#{names[value[1:]]}"
        elif key == "href" and value.startswith(IMAGE):
            attributes[key] = IMAGE + _with_palette(value[len(IMAGE) :])
        elif key == "d":  # a precision of a hundredth of a point suffices
            attributes[key] = LONG.sub(r"\1", value)
        elif key == "style":
            value = REFERENCE.sub(lambda m: f"url(#{names[m[1]]})", value)
            attributes[key] = GRAY.sub(lambda m: f"var(--g{m[1]},{m[0]})", value)
        elif key == "clip-path":
            attributes[key] = REFERENCE.sub(lambda m: f"url(#{names[m[1]]})", value)


def _with_palette(image: str) -> str:
    """Reduce a PNG image to 256 colors, which suffice for line drawings; this divides the file size by about three."""
    from PIL import Image

    file = io.BytesIO()
    picture = Image.open(io.BytesIO(base64.b64decode(image))).convert("RGBA")
    picture.quantize(256, Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE).save(file, "png", optimize=True)
    return base64.b64encode(file.getvalue()).decode()


BREAK = re.compile(r"(?<=\w[._])(?=\w)")  # places where a name may be broken into two lines
MOST_ITEMS = 30  # largest number of values that the page shows of a list in the provenance
NEEDS = {
    "focal_plane": ["long_table", "focal_plane_drawing"],
    "motion": ["long_table", "focal_plane_drawing", "focal_plane"],
    "sky_map": ["long_table", "sky_map_drawing"],
    "status": ["long_table", "focal_plane_drawing", "sky_map_drawing", "sky_map"],
}  # further scripts that a view requires
PAPER = (510, 690)  # widths (pt) of the text on upright and on wide paper, both A4 and US letter
LETTER, GAP = 0.68, 2  # width of a letter divided by the size of the text, and number of letters between columns
LARGE_PRINT, SMALL_PRINT, LEAST_PRINT = 7.5, 6.5, 4.0  # sizes of text (pt); below the second, the paper is wide
MOST_LETTERS = 30  # longer cells are broken into several lines
MOST_OPEN = 100  # tables with more rows are closed until the summary above them is clicked, except on paper
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
        loader=FunctionLoader(asset),
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
            "MOST_OPEN": MOST_OPEN,
            "groupby": groupby,
            "style": asset("page.css"),
            "view_style": asset("scripts/view.css"),
            "type": type,
            "zip": zip,
        },
    )


@cache
def _script(kinds: tuple[str, ...]) -> str:
    """Return the script of a page with the given kinds of views; without views, the script only controls tables."""
    parts = dict.fromkeys(part for kind in kinds for part in (*NEEDS.get(kind, ()), kind))
    names = ["page.js", *(f"scripts/{part}.js" for part in (["shared", *parts] if kinds else []))]
    return "\n" + "\n".join(asset(name) for name in names)


def asset(name: str) -> str:
    return (files("rfpsurvey.report") / name).read_text(encoding="utf-8")


def deflated(data: dict) -> dict:
    """Return the data of a large view as a dict with compressed JSON, which the script of the page expands."""
    return {"deflated": base64.b64encode(zlib.compress(json_of(data).encode())).decode()}


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
