"""The function that writes reports."""

import os
from collections.abc import Callable, Mapping
from dataclasses import replace
from itertools import chain
from pathlib import Path

from astropy.table import Table

from rfpsurvey._io import check_output, to_path, writing_to
from rfpsurvey.compare import PARTS
from rfpsurvey.errors import InputError, InputTypeError, check_keywords, check_whole, items_of, refusal
from rfpsurvey.probability import Estimate
from rfpsurvey.report._blocks import Page, Picture, Section
from rfpsurvey.report._html import html_of
from rfpsurvey.report._survey import page_of_selection, page_of_status, page_of_survey, page_of_tiling
from rfpsurvey.report._tables import (
    is_designs,
    page_of_allocators,
    page_of_designs,
    page_of_estimate,
    page_of_instruments,
    page_of_table,
)
from rfpsurvey.report._tile import page_of_tile
from rfpsurvey.report._views import check_plans
from rfpsurvey.selection import SelectionProbabilities
from rfpsurvey.survey import Survey
from rfpsurvey.tile import Tile
from rfpsurvey.tiling import Tiling

PAGES: dict[type, Callable[..., Page]] = {
    Tile: page_of_tile,
    Survey: page_of_survey,
    Tiling: page_of_tiling,
    Estimate: page_of_estimate,
    SelectionProbabilities: page_of_selection,
    Table: page_of_table,
}
"""For each type of result, the function that makes its page.

The arguments of the function are the result, and the name of the file that contains all rows.
"""
MADE_BY: dict[str, tuple[Callable[..., Page], set[str]]] = {
    "compare_allocators": (page_of_allocators, {"allocator", "usable", "science", "missing", "seconds"}),
    "survey_status": (page_of_status, {"priority", "n_requested", "n_observed", "n_planned", "n_lost", "n_impossible"}),
    "compare_instruments": (page_of_instruments, {"instrument", *chain(*PARTS.values())}),
}
"""For each value of ``meta["made_by"]`` of a table, the function that makes its page, and the required columns."""
WITH_PLANS = (page_of_tile, page_of_allocators)
"""Functions that make pages with an interactive focal plane."""
ENDINGS = (".html", ".htm")


def check_report(path: str | os.PathLike, *, overwrite: bool = False) -> Path:
    """Return the path if a report can be written to it, or raise an error."""
    return check_output(path, ENDINGS, overwrite=overwrite)


@check_keywords
def write_report(
    result: "Tile | Survey | Tiling | Estimate | SelectionProbabilities | Table",
    path: str | os.PathLike,
    *,
    overwrite: bool = False,
    title: str | None = None,
    figures: object = (),
    data: str | os.PathLike | None = None,
    max_rows: int | None = None,
    plans: Mapping[str, Tile] | None = None,
) -> None:
    """Write an HTML page on a result, with figures, tables that can be sorted, and the provenance.

    The page is a single file that contains its styles, script and figures (as SVG), and loads nothing from a network.
    If the same result is written twice, the two files have the same bytes.

    Parameters
    ----------
    result : Tile, Survey, Tiling, Estimate, SelectionProbabilities, Table or QTable
        Result to show. A table is shown with its ``meta``; tables of `compare_allocators` and `compare_instruments`
        have special pages.
    path : str or path-like
        Path that ends in ``.html`` or ``.htm``.
    overwrite : bool, optional
        Whether to replace an existing file.
    title : str, optional
        Heading of the page; by default it describes the result.
    figures : matplotlib Figure or Axes, sequence of them, or dict, optional
        Further figures, for example ``rs.plot.plot_speed_accuracy(table)``. The keys of a dict are the captions of
        the figures; the first sentence of each caption is in bold.
    data : str or path-like, optional
        Path of the file that contains the whole result. If the page does not show all rows of a table, the page states
        the name of this file, without its folder.
    max_rows : int, optional
        Largest number of rows that the page shows of each table. If a table has more rows, the page states the number
        of shown rows and the number of all rows. By default, the page shows all assignments of a tile, and at most 1000
        rows of each other table.
    plans : dict of str to Tile, optional
        For a report on a `Tile`, other plans of the same tile; for a table of `compare_allocators`, all plans of the
        comparison. The keys are the names of the plans. The view of the focal plane shows the differences between any
        two plans.

    Raises
    ------
    InputError
        If there is no page for this type of result, if the path does not end in ``.html`` or ``.htm``, if the file
        exists and ``overwrite`` is False, if a figure is not valid, if ``plans`` have different positioners, or if
        ``plans`` are given although the result is neither a `Tile` nor a table of `compare_allocators`.

    Examples
    --------
    >>> import astropy.units as u
    >>> from pathlib import Path
    >>> from tempfile import TemporaryDirectory
    >>> import rfpsurvey as rs
    >>> box = rs.Region.box(ra=[100, 120] * u.deg, dec=[20, 30] * u.deg)
    >>> with TemporaryDirectory() as folder:
    ...     rs.write_report(rs.place_tiles(box, "lamost"), Path(folder) / "tiles.html", title="My tiles")
    ...     print((Path(folder) / "tiles.html").read_text().count("<svg"))
    1
    """
    path = check_report(path, overwrite=overwrite)
    if max_rows is not None:
        check_whole(max_rows, "max_rows")
    if not (title is None or isinstance(title, str)):
        raise refusal("title must be text", title, str)
    if not (plans is None or isinstance(plans, Mapping)):
        raise refusal("plans must be a dict of names to tiles", plans, Mapping)
    pictures = _pictures(figures)
    page = _page_of(result, "" if data is None else to_path(data).name, plans, max_rows)
    if title is not None:
        page = replace(page, title=str(title))  # subclasses of str can declare that they are safe HTML
    if pictures:
        page = replace(page, sections=[Section("Figures", pictures), *page.sections])
    content = html_of(page, max_rows).encode()
    with writing_to(path, ENDINGS, overwrite=overwrite) as temporary:
        temporary.write_bytes(content)


def _page_of(result, where: str, plans: Mapping[str, Tile] | None, max_rows: int | None) -> Page:
    """Return the page that describes a result; ``where`` is the name of the file that contains all rows."""
    build = next((build for kind, build in PAGES.items() if isinstance(result, kind)), None)
    if build is None:
        known = ", ".join(kind.__name__ for kind in PAGES)
        raise InputTypeError(f"result must be one of {known}, got {type(result).__name__}")
    if isinstance(result, Table):
        special, columns = MADE_BY.get(str(result.meta.get("made_by")), (build, set()))
        if is_designs(result):
            build = page_of_designs
        elif columns <= set(result.colnames):  # a table with missing columns gets a plain page
            build = special
    if build in WITH_PLANS:
        return build(result, where, plans=check_plans(result, plans), max_rows=max_rows)
    if plans is not None:
        raise InputError("plans must be given only for a Tile or a table of compare_allocators")
    return build(result, where)


def _pictures(figures) -> list[Picture]:
    """Return the figures with their captions; each caption is divided into its first sentence and further text."""
    named = figures if isinstance(figures, Mapping) else None
    if named is None:
        single = (type(figures),) if hasattr(getattr(figures, "figure", figures), "savefig") else ()
        several = items_of(figures, "figures must be Figures or Axes of matplotlib", *single)
        named = {f"Figure {k}.": figure for k, figure in enumerate(several, 1)}
    for figure in named.values():
        if not hasattr(getattr(figure, "figure", figure), "savefig"):
            raise InputTypeError(f"figures must be Figures or Axes of matplotlib, got {type(figure).__name__}")
    pictures = []
    for caption, figure in named.items():
        first, stop, description = str(caption).partition(". ")
        pictures.append(Picture(f"{first}." if stop else first, figure, description))
    return pictures
