"""The pages of surveys and tilings."""

from rfpsurvey.plot import plot_completeness, plot_tiling
from rfpsurvey.report._blocks import Facts, Page, Picture, Rows, Section
from rfpsurvey.report._facts import survey_facts
from rfpsurvey.survey import Survey
from rfpsurvey.tiling import Tiling

__all__ = ["page_of_survey", "page_of_tiling"]


def page_of_survey(survey: Survey, where: str) -> Page:
    """Return a page on a survey."""
    s, provenance = survey.summary, survey.provenance
    name = provenance["instrument"]["name"]
    if not where:
        where = "Survey.tiles" if survey.folder is None else f"tiles.fits of the folder {survey.folder.name}"
    highlights = {
        "tiles": s["n_tiles"],
        f"of {s['n_visits_wanted']} visits observed": s["n_visits_observed"],
        "completeness": s["completeness"],
        "fraction of the fibers used": s["fiber_use"],
        "collision rate": s["collision_rate"],
    }
    pictures = [
        Picture("The tiles on the sky.", plot_tiling(survey), "Their color is the completeness of each field."),
        Picture(
            "Completeness, tile after tile.", plot_completeness(survey), "In the order in which tiles are planned."
        ),
    ]
    after = "Completeness after each pass, of each class of priority and of all."
    sections = [
        Section("What came out", [Facts("", survey_facts(survey))]),
        Section("On the sky", pictures[:1]),
        Section("Completeness", [pictures[1], Rows(after, survey.completeness, "Survey.completeness")]),
        Section("Tiles", [Rows("The tiles of the survey, in the order of the tiling.", survey.tiles, where)]),
    ]
    visits = f"{s['n_visits_observed']} of {s['n_visits_wanted']} visits"
    lead = f"{visits} to {s['n_targets']} targets on {s['n_tiles']} tiles."
    return Page("Survey", f"A survey with {name}", lead, highlights, sections, provenance)


def page_of_tiling(tiling: Tiling, where: str) -> Page:
    """Return a page on where tiles are."""
    summary, table = tiling.summary, tiling.table
    numbers = {k.replace("_", " "): v for k, v in summary.items() if v != ""}
    names = {"n_tiles": "tiles", "completeness": "completeness", "fiber_use": "fiber use"}
    highlights = {"tiles": len(tiling)}
    for key, label in names.items():
        if isinstance(summary.get(key), float):
            highlights[label] = summary[key]
    rows = Rows("The tiles, in the order in which they are to be observed.", table, where or "Tiling.table")
    picture = Picture("The tiles on the sky.", plot_tiling(tiling), "Their color is the pass.")
    sections = [Section("On the sky", [picture]), Section("Tiles", [rows])]
    if numbers:
        sections.insert(0, Section("What came out", [Facts("", numbers)]))
    title = f"Tiles for {summary['instrument']}" if "instrument" in summary else "Tiles"
    n = len(set(table["pass"].tolist()))
    lead = f"{len(tiling)} tiles in {n} pass{'' if n == 1 else 'es'}."
    return Page("Tiling", title, lead, highlights, sections, dict(table.meta))
