"""Reports: self-contained HTML pages that describe results."""

from typing import TYPE_CHECKING

from rfpsurvey._common.lazy import importer
from rfpsurvey.report._blocks import estimate_facts, model_facts, tiling_facts

if TYPE_CHECKING:
    from rfpsurvey.report._aladin import write_aladin
    from rfpsurvey.report._views import NotebookView, notebook_view
    from rfpsurvey.report._write import check_report, write_report

__all__ = [
    "NotebookView",
    "check_report",
    "estimate_facts",
    "model_facts",
    "notebook_view",
    "tiling_facts",
    "write_aladin",
    "write_report",
]

_IMPORTED_ON_USE = {
    "_aladin": ("write_aladin",),
    "_views": ("NotebookView", "notebook_view"),
    "_write": ("check_report", "write_report"),
}
__getattr__ = importer(__name__, _IMPORTED_ON_USE)
