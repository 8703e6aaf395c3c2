"""The report pages of the status of a survey, and of its state with all nights."""

from collections import Counter

import astropy.units as u
import numpy as np
from astropy.table import QTable, Table

from rfpsurvey._field.facts import versions
from rfpsurvey._survey.columns import PAST
from rfpsurvey._survey.history.diff import DIFF, OTHER, REASONS, diff_generations
from rfpsurvey._survey.history.events import WORDS, grouped
from rfpsurvey._survey.history.nights import NO_TARGET, History, codes_of
from rfpsurvey._survey.history.state import SurveyState
from rfpsurvey._survey.history.status import status_facts, survey_status
from rfpsurvey._survey.night.plan import Night, night_facts
from rfpsurvey._survey.survey import Survey
from rfpsurvey._survey.tiling.tiling import Tiling
from rfpsurvey.errors import listed, number_of
from rfpsurvey.plot import plot_survey_status, plot_tiling
from rfpsurvey.report._blocks import Facts, Page, Picture, Rows, Section, Text, View, pack, text_of
from rfpsurvey.report._html import deflated
from rfpsurvey.report._views import MM, sky_view

NOT_PLANNED = "Events were recorded after the last plan. Planned visits are those of the last plan."


def page_of_status(status: Table, where: str) -> Page:
    """Return a page on the status of a survey."""
    total, tiles = status[0], QTable(rows=status.meta["tiles"])
    done = int(tiles["observed"].sum())
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
        Section("Progress", [picture, *([Rows("Observed tiles and visits up to each date.", dates)] if dates else [])]),
        Section("Result", blocks),
        Section("Classes", [Rows("The visits of each class of targets.", status, where or "survey_status")]),
        Section("Tiles", [Rows("The numbers of tiles of each pass by their state.", tiles)]),
    ]
    if failures := status.meta["failures"]:
        rows = Rows("Positioners whose visits failed in several tiles.", QTable(rows=failures))
        sections.append(Section("Failures", [rows]))
    if reasons := status.meta.get("reasons"):
        words = "Remaining visits that are lost to collisions or impossible, and visits that expired, by reason."
        sections.append(Section("Lost and impossible targets", [Rows(words, QTable(rows=reasons))]))
    if areas := status.meta["areas"]:
        sections.append(Section("Areas", [Rows("The visits of each area (degrees).", QTable(rows=areas))]))
    lead = (
        f"{int(total['n_observed'])} of {number_of(int(total['n_requested']), 'visit')} are observed on "
        f"{number_of(done, 'tile')}, and {int(total['n_planned'])} are planned."
    )
    provenance = {"layout": status.meta.get("layout", "not recorded"), "events": status.meta["events"]}
    title = f"Status of a survey with {status.meta['instrument']}"
    return Page("Status", title, lead, {}, sections, provenance | {"software": versions()})


def _by_class(visits: dict) -> dict:
    """Return columns with the visits of each class."""
    return {"visits" if name == "all" else f"priority {name}": values for name, values in visits.items()}


STATES = (*WORDS.values(), PAST)
"""States of tiles, in the order of their codes in the data of the view."""
PLACES = ("tile", "ra", "dec", "position_angle", "pass", "state")
LABELS = {"state": "last_state"}
"""Other names of columns of the table of tiles, because the view also shows the state at a night."""
CODES = "0123456789abcdefghijklmnopqrstuvwxyz"
"""Codes of changes of fibers: 0 for none, or else 1 plus three times the reason plus the kind of the change."""
MOST_CHARACTERS = 1_500_000
"""Largest length of all identifiers of targets on a page; those of changed tiles are the first."""


def page_of_state(state: SurveyState, where: str, changes: Table | None = None, night: Night | None = None) -> Page:
    """Return a page on all nights of a survey; by default, the last plan of the rest determines the changed fibers."""
    survey = Survey.read(state.folder)
    status = survey_status(survey, state)
    changes = diff_generations(survey, state) if changes is None else changes
    page, blocks = page_of_status(status, where), [status_view(History(survey, state), status, changes)]
    if unknown := changes.meta.get("unknown"):
        blocks.append(Text(f"Changed fibers of tiles without an earlier plan are not known: {listed(unknown, 20)}."))
    page.sections.insert(0, Section("Nights and tiles", blocks))
    if night is not None:
        page.sections.insert(1, Section(f"Plan of the night {night.summary['date']}", blocks_of_night(night)))
    return page


def blocks_of_night(night: Night) -> list:
    """Return the tiles of a night with their times, and the reasons of the other tiles."""
    reasons = Counter(night.not_observed["reason"].tolist())
    others = QTable(rows=reasons.most_common(), names=("reason", "n_tiles")) if reasons else None
    rest = [] if others is None else [Rows("The numbers of other tiles, by the reason.", others)]
    return [Facts("", night_facts(night)), Rows("The tiles of the night (UTC).", night.as_text(), "plan_night"), *rest]


def status_view(history: History, status: Table, changes: Table) -> View:
    """Return the interactive view of the nights, the tiles and the fibers of a survey."""
    plane, number = history.plane, {row: k for k, row in enumerate(history.tiles)}
    names = {} if plane is None else {name: k for k, name in enumerate(plane.id.astype(str).tolist())}
    rows, n_placed = zip(*(changes[name].tolist() for name in DIFF), strict=True), len(names)
    changed = grouped((tile, change) for tile, *change in rows if change[0])
    fibers = _fibers(history, changed, names)
    tiles = tiles_of(history, changed, fibers.pop("generation"))
    attempts, failures, number_of_plan = history.state.attempts, history.failures, changes.meta.get("generation")
    data = sky_view(tiles, history.survey.provenance["parameters"]["radius_deg"], []).data | {
        "columns": {LABELS.get(name, name): pack(tiles[name]) for name in tiles.colnames if name not in ("ra", "dec")},
        "nights": history.nights,
        "names": list(STATES),
        "plan": f"changed by generation {number_of_plan}" if number_of_plan else "that differ from the other plan",
        "states": [[[night, STATES.index(word)] for night, word in own] for own in history.states.values()],
        "attempts": [[number[e.row], history.night(e.date), STATES.index(WORDS[e.state])] for e in attempts],
        "failures": [[number[k], n, names.setdefault(i, len(names)), text_of(why)] for k, n, i, why in failures],
        "classes": _classes(history.nights, status),
        "reasons": [*REASONS, OTHER],
        "positioner": {"id": [text_of(name) for name in names]},
        **fibers,
    }
    xy = np.full((2, len(names)), np.nan)
    if plane is not None:
        xy[:, :n_placed] = plane.xy.to_value(u.mm).T
    data["positioner"] |= {axis: pack(values, MM) for axis, values in zip("xy", xy, strict=True)}
    data["positioner"]["outer"] = 1.0 if plane is None else float(np.max(plane.arrays.outer_radius))
    # several tiles may have the same place, such as a tile that was added in place of a dropped one
    places = Tiling(QTable({**{name: tiles[name] for name in PLACES}, "program": np.arange(len(tiles))}))
    words = "The color of a field shows its state after the last night. East is to the left."
    still = [
        Picture("The tiles on the sky.", plot_tiling(places, color="state", radius=data["radius"] * u.deg), words),
        Rows("The tiles of the survey.", tiles, "rfpsurvey.survey.SurveyState"),
        Text("The calendar and the focal planes of tiles require a browser that runs scripts."),
    ]
    return View("status", "Nights and tiles", deflated(data), still)


def _classes(nights: list[str], status: Table) -> list[list]:
    """Return the label, the requested visits, and the visits up to each night of each class of targets."""
    progress, labels = status.meta["progress"], ["all targets"]
    place = np.searchsorted(np.array(progress["date"], dtype=str), ["", *nights], side="right")
    for row in status[1:]:
        labels.append(f"category {row['category']}" if row["priority"] == "all" else f"priority {row['priority']}")
    seen = np.pad(np.array(progress["n_counted"], dtype=int), ((0, 0), (1, 0)))[:, place].tolist()
    return [list(one) for one in zip(map(text_of, labels), status["n_requested"].tolist(), seen, strict=True)]


def tiles_of(history: History, changed: dict, generations: dict) -> QTable:
    """Return a table with the state, the observations, the failed visits and the changed fibers of each tile."""
    rows, failures = [], grouped((row, reason) for row, _, _, reason in history.failures)
    for row, (name, (*place, number)) in history.tiles.items():
        past, reasons, own = history.attempts.get(row, []), failures.get(row, []), changed.get(name, [])
        dates = ", ".join(f"{event.date or 'no date'} {WORDS[event.state]} {event.fraction:g}" for event in past)
        numbers = past[-1].fraction if past else np.nan, len(reasons), len(own), generations.get(row, np.ma.masked)
        texts = _counts(reasons), _counts(reason for *_, reason in own)
        rows.append((name, *place, int(number), history.states[row][-1][1], dates, *numbers, *texts))
    names = ("tile", "ra", "dec", "position_angle", "pass", "state", "observations", "fraction")
    names += ("n_failed", "n_changed", "generation", "failures", "changes")
    return QTable(rows=rows, names=names, units=dict.fromkeys(names[1:4], u.deg))


def _counts(reasons) -> str:
    """Return the number of times that each reason occurs as text."""
    return ", ".join(f"{n} {reason or 'without a reason'}" for reason, n in Counter(reasons).most_common())


def _fibers(history: History, changed: dict, names: dict[str, int]) -> dict:
    """Return the fibers of all tiles, which add unknown positioners to ``names``, and the generations of their plans.

    ``fibers`` contains text with the code of each positioner (see `codes_of`), and ``changes`` text with a character of
    ``CODES``. ``targets`` and ``former`` are the identifiers of the targets of fibers that have one, and of the former
    targets of changed fibers; they are None for tiles without a plan, and after the first ``MOST_CHARACTERS``.
    """
    plans, reasons = {}, [*REASONS, OTHER]
    found = {"fibers": [], "changes": [], "targets": [], "former": [], "generation": {}}
    for row, visits, cards in history.fibers():
        places = [names.setdefault(name, len(names)) for name in visits["positioner"].astype(str).tolist()]
        order = np.argsort(places)
        plans[row] = np.array(places)[order], codes_of(visits)[order], visits["target_id"].astype(str)[order]
        found["generation"][row] = cards.get("GENER", 1)
    letters, former = np.frombuffer(CODES.encode(), np.uint8), {}
    for row, (name, _) in history.tiles.items():
        own = sorted((names.setdefault(one, len(names)), *change) for one, *change in changed.get(name, ()))
        codes, changes = np.full((2, len(names)), NO_TARGET)
        if row in plans:
            codes[plans[row][0]] = plans[row][1]
        for k, before, after, reason in own:
            changes[k] = 1 + 3 * reasons.index(reason) + (0 if before and after else 1 if before else 2)
        former[row] = [text_of(before) for _, before, *_ in own]
        for key, values in (("fibers", codes), ("changes", changes)):
            found[key].append(letters[values].tobytes().decode() if values.any() else "")
    room, kept = MOST_CHARACTERS, {}
    for row in sorted(plans, key=lambda row: not former[row]):  # the tiles with changes are first
        kept[row] = [text_of(name) for name in plans[row][2].tolist()]
        room -= sum(map(len, [*kept[row], *former[row]]))
        if room < 0:
            del kept[row]
            break
    found["targets"] = [kept.get(row) for row in history.tiles]
    found["former"] = [former[row] if row in kept else None for row in history.tiles]
    return found
