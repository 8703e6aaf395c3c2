"""The report page of the status of a survey."""

from astropy.table import QTable, Table

from rfpsurvey.errors import number_of
from rfpsurvey.plot import plot_survey_status
from rfpsurvey.report._blocks import Facts, Page, Picture, Rows, Section, Text
from rfpsurvey.report._facts import status_facts
from rfpsurvey.tile import versions

NOT_PLANNED = "Events were recorded after the last plan. Planned visits are those of the last plan."


def page_of_status(status: Table, where: str) -> Page:
    """Return a page on the status of a survey."""
    one, tiles = status[0], QTable(rows=status.meta["tiles"])
    done = int(tiles["observed"].sum())
    highlights = {
        f"of {int(one['n_requested'])} visits observed": int(one["n_observed"]),
        "tiles observed": done,
        "visits planned": int(one["n_planned"]),
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
    if areas := status.meta["areas"]:
        sections.append(Section("Areas", [Rows("The visits of each area (degrees).", QTable(rows=areas))]))
    lead = (
        f"{int(one['n_observed'])} of {number_of(int(one['n_requested']), 'visit')} are observed on "
        f"{number_of(done, 'tile')}."
    )
    provenance = {"events": status.meta["events"], "software": versions()}
    title = f"Status of a survey with {status.meta['instrument']}"
    return Page("Status", title, lead, highlights, sections, provenance)


def _by_class(visits: dict) -> dict:
    """Return columns with the visits of each class."""
    return {"visits" if name == "all" else f"priority {name}": values for name, values in visits.items()}
