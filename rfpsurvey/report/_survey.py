"""The report pages of surveys, of their status, of tilings, and of selection probabilities."""

from dataclasses import replace

from astropy.table import QTable, Table

from rfpsurvey.errors import number_of
from rfpsurvey.plot import draw_tiling, plot_completeness, plot_selection, plot_survey_status, plot_tiling
from rfpsurvey.report._blocks import Facts, Page, Picture, Rows, Section, Text
from rfpsurvey.report._facts import TILING, tiling_facts
from rfpsurvey.report._views import sky_view
from rfpsurvey.selection import SelectionProbabilities, selection_facts
from rfpsurvey.survey import Survey, status_facts, survey_facts
from rfpsurvey.tile import versions
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


NOT_PLANNED = "Events were recorded after the last plan. Planned visits are those of the last plan."


def page_of_status(status: Table, where: str) -> Page:
    """Return a page on the status of a survey."""
    total, tiles = status[0], QTable(rows=status.meta["tiles"])
    done = int(tiles["observed"].sum())
    highlights = {
        f"of {int(total['n_requested'])} visits observed": int(total["n_observed"]),
        "tiles observed": done,
        "visits planned": int(total["n_planned"]),
    }
    words = (
        "Left: the numbers of visits (left axis) and of tiles (right axis) that were observed up to each date. Right: "
        "for each class of targets, the fractions of the requested visits that are observed, planned, not assigned, "
        "lost to collisions, and not possible because the target is out of reach of all tiles or excluded by a limit."
    )
    picture = Picture("Progress of the survey.", plot_survey_status(status)[0].figure, words)
    progress = status.meta["progress"]
    dates = QTable({"date": progress["date"], "tiles": progress["n_tiles"], **_by_class(progress["n_observed"])})
    until = status.meta["events"].get("until")
    note = f"Observations until {until} are taken into account." if until else NOT_PLANNED
    blocks = [Facts("", status_facts(status)), *([] if status.meta["is_planned"] else [Text(note)])]
    sections = [
        Section("Result", blocks),
        Section("Progress", [picture, *([Rows("Observed tiles and visits up to each date.", dates)] if dates else [])]),
        Section("Classes", [Rows("The visits of each class of targets.", status, where or "survey_status")]),
        Section("Tiles", [Rows("The numbers of tiles of each pass by their state.", tiles)]),
    ]
    if failures := status.meta["failures"]:
        rows = Rows("Positioners whose visits failed in several tiles.", QTable(rows=failures))
        sections.append(Section("Failures", [rows]))
    if areas := status.meta["areas"]:
        sections.append(Section("Areas", [Rows("The visits of each area (degrees).", QTable(rows=areas))]))
    lead = (
        f"{int(total['n_observed'])} of {number_of(int(total['n_requested']), 'visit')} are observed on "
        f"{number_of(done, 'tile')}."
    )
    provenance = {"events": status.meta["events"], "software": versions()}
    title = f"Status of a survey with {status.meta['instrument']}"
    return Page("Status", title, lead, highlights, sections, provenance)


def _by_class(visits: dict) -> dict:
    """Return columns with the visits of each class."""
    return {"visits" if name == "all" else f"priority {name}": values for name, values in visits.items()}


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
    highlights = {
        "targets": s["n_targets"],
        "realizations": s["n_realizations"],
        "mean selection probability": s["mean_probability"],
        "targets never observed": s["n_never_observed"],
    }
    axes = plot_selection(selection)
    axes.set_title("")
    model = {"model": s["model"]} if s.get("model") else {}
    table = _first(selection).table
    table.remove_column("BITWEIGHTS")
    targets = Rows("Targets in the order of the catalog.", table, where, len(selection) - len(table))
    realizations = Rows("Realizations.", selection.realizations, "SelectionProbabilities.realizations")
    sections = [
        Section("Result", [Facts("", selection_facts(selection) | model)]),
        Section("Probabilities", [Picture("Selection probabilities of the targets.", axes, WORDS)]),
        Section("Targets", [targets, Text(list(ABOUT))]),
        Section("Realizations", [realizations]),
    ]
    lead = (
        f"The survey of {number_of(s['n_tiles'], 'tile')} was planned {s['n_realizations']} times with random "
        f"subpriorities. Of {number_of(s['n_targets'], 'target')}, {s['n_always_observed']} are observed in all "
        f"realizations, {s['n_sometimes_observed']} in some, and {s['n_never_observed']} in none."
    )
    return Page("Selection", f"Selection probabilities with {name}", lead, highlights, sections, selection.provenance)


def _first(selection):
    """Return the selection probabilities of the first targets."""
    columns = ("target_id", "requested", "n_tiles", "bits")
    return replace(selection, **{name: getattr(selection, name)[:MOST_TARGETS] for name in columns})
