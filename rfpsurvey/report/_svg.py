"""Conversion of figures to SVG with unique ids, without style sheets, and with gray levels that the page defines."""

import base64
import io
import re
from collections.abc import Iterator
from contextlib import contextmanager
from xml.etree import ElementTree

import numpy as np

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
