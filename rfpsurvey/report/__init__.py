"""Reports: self-contained HTML pages on results."""

from rfpsurvey.report._blocks import Facts, Page, Picture, Rows, Section, Text
from rfpsurvey.report._facts import estimate_facts, survey_facts, tile_facts, tile_objectives, tiling_facts
from rfpsurvey.report._write import MADE_BY, PAGES, check_report, write_report

__all__ = [
    "MADE_BY",
    "PAGES",
    "Facts",
    "Page",
    "Picture",
    "Rows",
    "Section",
    "Text",
    "check_report",
    "estimate_facts",
    "survey_facts",
    "tile_facts",
    "tile_objectives",
    "tiling_facts",
    "write_report",
]
