"""The function that writes reports, and the report pages of surveys, tilings and selection probabilities."""

import os
from collections.abc import Callable, Mapping
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING

from astropy.table import Table

from rfpsurvey._common.files import check_output, to_path
from rfpsurvey._common.io import writing_to
from rfpsurvey._field.tile import Tile
from rfpsurvey._studies.compare_instruments import PARTS
from rfpsurvey._studies.question import Estimate
from rfpsurvey._survey.columns import survey_facts
from rfpsurvey._survey.history.state import SurveyState
from rfpsurvey._survey.night.plan import Night
from rfpsurvey._survey.selection.probabilities import SelectionProbabilities, part_of, selection_facts
from rfpsurvey._survey.survey import Survey
from rfpsurvey._survey.tiling.tiling import Tiling
from rfpsurvey.errors import (
    InputError,
    InputTypeError,
    check_keywords,
    check_whole,
    items_of,
    listed,
    number_of,
    refusal,
    short,
)
from rfpsurvey.plot import draw_tiling, plot_completeness, plot_selection, plot_tiling
from rfpsurvey.report import _tables
from rfpsurvey.report._blocks import TILING, Facts, Page, Picture, Rows, Section, Text, tiling_facts
from rfpsurvey.report._html import html_of
from rfpsurvey.report._status import page_of_state, page_of_status
from rfpsurvey.report._tile import check_paths, page_of_tile
from rfpsurvey.report._views import check_plans, sky_view

if TYPE_CHECKING:
    from rfpsurvey._instruments.paths import Paths


def page_of_survey(survey: Survey, where: str) -> Page:
    """Return the report page of a survey."""
    s, provenance = survey.summary, survey.provenance
    name = provenance["instrument"]["name"]
    if not where:
        where = "Survey.tiles" if survey.folder is None else f"tiles.fits of the folder {survey.folder.name}"
    highlights = {
        "completeness": s["completeness"],
        "fraction of usable positioners": s["fiber_use"],
        "collision rate of assigned arms": s.get("collision_rate_assigned", "unknown"),
    }
    pictures = [
        Picture("The tiles on the sky.", plot_tiling(survey), _about_tiles(survey.tiles, "completeness of the field")),
        Picture("The completeness of the survey after each tile.", plot_completeness(survey), _about_curves(survey)),
    ]
    model = {"model": s["model"]} if "model" in s else {}  # summaries of older versions have no model
    columns = survey.provenance.get("catalog", {}).get("columns")
    model |= {"columns of the catalog": columns} if columns else {}
    after = "The table lists the completeness after each pass, for each priority class and for all targets."
    sections = [
        Section("On the sky", [sky_view(survey.tiles, survey.provenance["parameters"]["radius_deg"], pictures[:1])]),
        Section("Result", [Facts("", survey_facts(survey) | model)]),
        Section("Completeness", [pictures[1], Rows(after, survey.completeness, "Survey.completeness")]),
        Section("Tiles", [Rows("The tiles of the survey in the order of the tiling.", survey.tiles, where)]),
    ]
    if s.get("unmet") or survey.rules is not None:
        blocks = [Text(list(s["unmet"]))] if len(s.get("unmet", ())) > 2 else []  # else see the lead
        if survey.rules is not None:
            blocks.append(Rows("Number of tiles with each verdict, for each constraint.", survey.rules))
        sections[2:2] = [Section("Constraints", blocks)] if blocks else []
    visits = f"{s['n_visits_observed']} of {number_of(s['n_visits_requested'], 'visit')}"
    lead = f"{visits} of {number_of(s['n_targets'], 'target')} are observed on {number_of(s['n_tiles'], 'tile')}."
    lead += f" Not met: {listed(s['unmet'], 2)}." if s.get("unmet") else ""
    return Page("Survey", f"A survey with {name}", lead, highlights, sections, provenance)


def page_of_tiling(tiling: Tiling, where: str) -> Page:
    """Return the report page of a tiling."""
    summary, table = tiling.summary, tiling.table
    highlights = {TILING[k]: summary[k] for k in ("completeness", "fiber_use") if isinstance(summary.get(k), float)}
    rows = Rows("The tiles in the order in which they are to be observed.", table, where or "Tiling.table")
    figure = draw_tiling(tiling)
    picture = Picture("The tiles on the sky.", figure, _about_passes(table, len(figure.axes)))
    sections = [
        Section("On the sky", [sky_view(table, summary.get("radius_deg", 1.0), [picture])]),
        Section("Tiles", [rows]),
    ]
    if summary:
        sections.insert(1, Section("Result", [Facts("", tiling_facts(tiling))]))
    title = f"Tiles for {summary['instrument']}" if "instrument" in summary else "Tiles"
    n = len(set(table["pass"].tolist()))
    lead = f"The tiling has {number_of(len(tiling), 'tile')} in {number_of(n, 'pass', 'passes')}."
    return Page("Tiling", title, lead, highlights, sections, dict(table.meta))


def _about_passes(table, n_panels: int) -> str:
    """Return a description of the map of a tiling."""
    n = len(set(table["pass"].tolist()))
    if n_panels != n:
        return _about_tiles(table, "pass")
    each = f" There is a panel for each of the {n} passes." if n > 1 else ""
    return f"Each circle is a field. East is to the left. The color is stronger where fields overlap.{each}"


def _about_tiles(table, color) -> str:
    """Return a description of a map of tiles; ``color`` is the quantity that the colors of the tiles show."""
    words = f"Each circle is a field. East is to the left. The color of a field shows the {color}."
    if len(set(table["pass"].tolist())) > 1:
        words += " Fields of later passes are drawn with a smaller radius, so that they do not hide earlier fields."
    return words


def _about_curves(survey) -> str:
    """Return a description of the plot of the completeness."""
    words = (
        "The line shows, after each tile, the fraction of all requested visits that have been observed; the tiles are "
        "in the order in which they are planned. Crosses show, after each pass, the fraction of the targets whose "
        "requested visits have all been observed. Gray lines mark the ends of passes."
    )
    if len(set(survey.completeness["priority"].tolist())) > 2:  # one of these names is "all"
        words += " Dotted lines connect the completeness of each priority class after each pass."
    return words


MOST_TARGETS = 10_000
"""Largest number of targets that are converted to a table for a page, because a survey can have millions of targets."""
WORDS = (
    "The bars show the numbers of targets with each selection probability, the fraction of the realizations that "
    "observed the target. The colors show the number of tiles in which at least one positioner reaches the target. "
    "Targets that no tile reaches are not drawn."
)
ABOUT = (
    "probability: fraction of the realizations that observed the target.",
    "weight: inverse probability (n + 1) / (k + 1) of a target that k of n realizations observed.",
    "n tiles: number of tiles in which at least one positioner reaches the target.",
    "The columns probability error and weight error are standard errors.",
)


def page_of_selection(selection: SelectionProbabilities, where: str) -> Page:
    """Return the report page of selection probabilities."""
    s, name = selection.summary, selection.provenance["instrument"]["name"]
    axes = plot_selection(selection)
    axes.set_title("")
    model = {"model": s["model"]} if s.get("model") else {}
    table = part_of(selection, slice(MOST_TARGETS)).table
    table.remove_columns([name for name in table.colnames if table[name].ndim > 1])
    targets = Rows("Targets in the order of the catalog.", table, where, len(selection) - len(table))
    realizations = Rows("Realizations.", selection.realizations, "SelectionProbabilities.realizations")
    sections = [
        Section("Probabilities", [Picture("Selection probabilities of the targets.", axes, WORDS)]),
        Section("Result", [Facts("", selection_facts(selection) | model)]),
        Section("Targets", [targets, Text(list(ABOUT))]),
        Section("Realizations", [realizations]),
    ]
    lead = (
        f"The survey of {number_of(s['n_tiles'], 'tile')} was planned {s['n_realizations']} times with random "
        f"subpriorities. Of {number_of(s['n_targets'], 'target')}, {s['n_always_observed']} are observed in all "
        f"realizations, {s['n_sometimes_observed']} in some, and {s['n_never_observed']} in none."
    )
    highlights = {"mean selection probability": s["mean_probability"]}
    return Page("Selection", f"Selection probabilities with {name}", lead, highlights, sections, selection.provenance)


PAGES: dict[type, Callable[..., Page]] = {
    Tile: page_of_tile,
    Survey: page_of_survey,
    Tiling: page_of_tiling,
    Estimate: _tables.page_of_estimate,
    SelectionProbabilities: page_of_selection,
    SurveyState: page_of_state,
    Table: _tables.page_of_table,
}
"""For each type of result, the function that makes its page.

The arguments of the function are the result, and the name of the file that contains all rows.
"""
MADE_BY: dict[str, tuple[Callable[..., Page], set[str]]] = {
    "compare_allocators": (_tables.page_of_allocators, {"allocator", "usable", "science", "missing", "seconds"}),
    "survey_status": (page_of_status, {"priority", "n_requested", "n_observed", "n_planned", "n_lost", "n_impossible"}),
    "compare_instruments": (_tables.page_of_instruments, {"instrument", *chain(*PARTS.values())}),
}
"""For each value of ``meta["made_by"]`` of a table, the function that makes its page, and the required columns."""
WITH_PLANS = (page_of_tile, _tables.page_of_allocators)
"""Functions that make pages with an interactive focal plane."""
ENDINGS = (".html", ".htm")


def check_report(path: str | os.PathLike, *, overwrite: bool = False) -> Path:
    """Return the path if a report can be written to it, or raise an error."""
    return check_output(path, ENDINGS, overwrite=overwrite)


@check_keywords
def write_report(
    result: "Tile | Survey | SurveyState | Tiling | Estimate | SelectionProbabilities | Table",
    path: str | os.PathLike,
    *,
    overwrite: bool = False,
    title: str | None = None,
    figures: object = (),
    data: str | os.PathLike | None = None,
    max_rows: int | None = None,
    plans: Mapping[str, Tile] | None = None,
    paths: "Paths | bool | None" = None,
    changes: Table | None = None,
    night: Night | None = None,
) -> None:
    """Write an HTML page on a result, with figures, tables that can be sorted, and the provenance.

    The page is a single file that contains its styles, script and figures (as SVG), and loads nothing from a network.
    If the same result is written twice, the two files have the same bytes.

    Parameters
    ----------
    result : Tile, Survey, SurveyState, Tiling, Estimate, SelectionProbabilities, Table or QTable
        Result to show. A table is shown with its ``meta``; tables of `compare_allocators` and `compare_instruments`
        have special pages. The page of a state (`Survey.state`) shows all nights of the survey in its folder.
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
    paths : Paths or bool, optional
        For a report on a `Tile`, paths of the arms to the poses of the tile, such as those of `Tile.paths`. The view of
        the focal plane then shows the motion of the arms. If ``paths`` is True, `Tile.paths` plans them.
    changes : QTable, optional
        For a report on a state, the differences of another plan and the plan of the survey
        (`rfpsurvey.survey.diff_surveys`), which the page shows. By default, the page shows the fibers that the last
        plan of the rest changed.
    night : Night, optional
        For a report on a state, the plan of a night (`rfpsurvey.night.plan_night`), which the page shows.

    Raises
    ------
    InputError
        If there is no page for this type of result, if the path does not end in ``.html`` or ``.htm``, if the file
        exists and ``overwrite`` is False, if a figure is not valid, if ``plans`` have different positioners, if
        ``plans`` are given although the result is neither a `Tile` nor a table of `compare_allocators`, if ``paths``
        are given although the result is no `Tile`, or do not lead to the poses of this tile, or if ``changes`` or a
        ``night`` are given although the result is no state of a survey, or are another object.

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
    options = {} if (paths := check_paths(result, paths)) is None else {"paths": paths}
    if changes is not None:
        if not isinstance(changes, Table):
            raise refusal("changes must be the table of diff_surveys", changes, Table)
        if not isinstance(result, SurveyState) or changes.meta.get("made_by") != "diff_surveys":
            text = "changes must be the table of diff_surveys, for the state of a survey, got "
            raise InputError(f"{text}{short(changes)} for {short(result)}")
        options["changes"] = changes
    if night is not None:
        if not isinstance(night, Night) or not isinstance(result, SurveyState):
            raise refusal("night must be a Night, for the state of a survey", night, Night)
        options["night"] = night
    page = _page_of(result, "" if data is None else to_path(data).name, plans, max_rows, options)
    if title is not None:
        page = replace(page, title=str(title))  # subclasses of str can declare that they are safe HTML
    if pictures:
        page = replace(page, sections=[Section("Figures", pictures), *page.sections])
    content = html_of(page, max_rows).encode()
    with writing_to(path, ENDINGS, overwrite=overwrite) as temporary:
        temporary.write_bytes(content)


def _page_of(result, where: str, plans: Mapping[str, Tile] | None, max_rows: int | None, options: dict) -> Page:
    """Return the page that describes a result; ``where`` is the name of the file that contains all rows.

    ``options`` are further parameters of the function that makes the page.
    """
    build = next((build for kind, build in PAGES.items() if isinstance(result, kind)), None)
    if build is None:
        known = ", ".join(kind.__name__ for kind in PAGES)
        raise InputTypeError(f"result must be one of {known}, got {type(result).__name__}")
    if isinstance(result, Table):
        special, columns = MADE_BY.get(str(result.meta.get("made_by")), (build, set()))
        if _tables.is_designs(result):
            build = _tables.page_of_designs
        elif columns <= set(result.colnames):  # a table with missing columns gets a plain page
            build = special
    if build in WITH_PLANS:
        return build(result, where, plans=check_plans(result, plans), max_rows=max_rows, **options)
    if plans is not None:
        raise InputError("plans must be given only for a Tile or a table of compare_allocators")
    return build(result, where, **options)


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
