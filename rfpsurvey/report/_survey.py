"""The report pages of surveys and tilings."""

from rfpsurvey.errors import number_of
from rfpsurvey.plot import draw_tiling, plot_completeness, plot_tiling
from rfpsurvey.report._blocks import Facts, Page, Picture, Rows, Section, Text
from rfpsurvey.report._facts import TILING, survey_facts, tiling_facts
from rfpsurvey.report._sky_view import sky_view
from rfpsurvey.survey import Survey
from rfpsurvey.tiling import Tiling


def page_of_survey(survey: Survey, where: str) -> Page:
    """Return the report page of a survey."""
    s, provenance = survey.summary, survey.provenance
    name = provenance["instrument"]["name"]
    if not where:
        where = "Survey.tiles" if survey.folder is None else f"tiles.fits of the folder {survey.folder.name}"
    highlights = {
        "tiles": s["n_tiles"],
        f"of {s['n_visits_requested']} visits observed": s["n_visits_observed"],
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
        Section("Result", [Facts("", survey_facts(survey) | model)]),
        Section("On the sky", [sky_view(survey.tiles, survey.provenance["parameters"]["radius_deg"], pictures[:1])]),
        Section("Completeness", [pictures[1], Rows(after, survey.completeness, "Survey.completeness")]),
        Section("Tiles", [Rows("The tiles of the survey in the order of the tiling.", survey.tiles, where)]),
    ]
    if s.get("unmet") or survey.rules is not None:
        blocks = [Text(list(s["unmet"]))] if s.get("unmet") else []
        if survey.rules is not None:
            blocks.append(Rows("Number of tiles with each verdict, for each constraint.", survey.rules))
        sections.insert(1, Section("Constraints", blocks))
    visits = f"{s['n_visits_observed']} of {number_of(s['n_visits_requested'], 'visit')}"
    lead = f"{visits} of {number_of(s['n_targets'], 'target')} are observed on {number_of(s['n_tiles'], 'tile')}."
    return Page("Survey", f"A survey with {name}", lead, highlights, sections, provenance)


def page_of_tiling(tiling: Tiling, where: str) -> Page:
    """Return the report page of a tiling."""
    summary, table = tiling.summary, tiling.table
    highlights = {"tiles": len(tiling)}
    highlights |= {TILING[k]: summary[k] for k in ("completeness", "fiber_use") if isinstance(summary.get(k), float)}
    rows = Rows("The tiles in the order in which they are to be observed.", table, where or "Tiling.table")
    figure = draw_tiling(tiling)
    picture = Picture("The tiles on the sky.", figure, _about_passes(table, len(figure.axes)))
    sections = [
        Section("On the sky", [sky_view(table, summary.get("radius_deg", 1.0), [picture])]),
        Section("Tiles", [rows]),
    ]
    if summary:
        sections.insert(0, Section("Result", [Facts("", tiling_facts(tiling))]))
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
