"""The components of a report page."""

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from astropy.table import Table

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


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
