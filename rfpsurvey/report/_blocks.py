"""What a page is made of."""

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from astropy.table import Table

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["Facts", "Page", "Picture", "Rows", "Section", "Text"]


@dataclass(frozen=True)
class Text:
    """A paragraph, or a list of sentences."""

    words: str | list[str]


@dataclass(frozen=True)
class Facts:
    """Labels and values; a label with blanks before it is a part of the one above."""

    caption: str
    values: dict


@dataclass(frozen=True)
class Rows:
    """A table that can be sorted.

    ``where`` says where all rows are, if not all are shown; ``left_out`` counts rows that were left out already.
    ``marks`` gives cells with a certain text a look: good, bad or open. A table that is ``complete`` shows all rows
    unless a limit was asked for; it is folded where it is long, and its cells are rounded, which keeps pages small.
    """

    caption: str
    table: Table
    where: str = ""
    left_out: int = 0
    marks: dict = field(default_factory=dict)
    complete: bool = False


@dataclass(frozen=True)
class Picture:
    """A figure of matplotlib with its caption, and a description of what it shows."""

    caption: str
    figure: "Figure | Axes"
    words: str = ""


@dataclass(frozen=True)
class Section:
    """A heading, and what is below it."""

    title: str
    blocks: list


@dataclass(frozen=True)
class Page:
    """A page: what the result is in a word or two, a sentence on it, a few figures that stand out, and sections.

    ``provenance`` goes to the foot; its dicts become groups.
    """

    kind: str
    title: str
    lead: str
    highlights: dict
    sections: list[Section]
    provenance: dict
