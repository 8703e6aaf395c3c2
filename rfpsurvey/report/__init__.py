"""Reports: self-contained HTML pages that describe results."""

from typing import TYPE_CHECKING

from rfpsurvey._lazy import importer
from rfpsurvey.report._blocks import Facts, Page, Picture, Rows, Section, Text, View
from rfpsurvey.report._facts import (
    estimate_facts,
    rules_of_tile,
    selection_facts,
    status_facts,
    survey_facts,
    tile_facts,
    tile_objectives,
    tile_problems,
    tiling_facts,
)

if TYPE_CHECKING:
    from rfpsurvey.report._notebook import NotebookView, notebook_view
    from rfpsurvey.report._write import MADE_BY, PAGES, check_report, write_report

__all__ = [
    "MADE_BY",
    "PAGES",
    "Facts",
    "NotebookView",
    "Page",
    "Picture",
    "Rows",
    "Section",
    "Text",
    "View",
    "check_report",
    "estimate_facts",
    "notebook_view",
    "rules_of_tile",
    "selection_facts",
    "status_facts",
    "survey_facts",
    "tile_facts",
    "tile_objectives",
    "tile_problems",
    "tiling_facts",
    "write_report",
]

_IMPORTED_ON_USE = {
    "_notebook": ("NotebookView", "notebook_view"),
    "_write": ("MADE_BY", "PAGES", "check_report", "write_report"),
}
__getattr__ = importer(__name__, _IMPORTED_ON_USE)
