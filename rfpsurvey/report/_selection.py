"""The report page of selection probabilities."""

from dataclasses import replace

from rfpsurvey.errors import number_of
from rfpsurvey.plot import plot_selection
from rfpsurvey.report._blocks import Facts, Page, Picture, Rows, Section, Text
from rfpsurvey.report._facts import selection_facts
from rfpsurvey.selection import SelectionProbabilities

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


def page_of_selection(found: SelectionProbabilities, where: str) -> Page:
    """Return the report page of selection probabilities."""
    s, name = found.summary, found.provenance["instrument"]["name"]
    highlights = {
        "targets": s["n_targets"],
        "realizations": s["n_realizations"],
        "mean selection probability": s["mean_probability"],
        "targets never observed": s["n_never_observed"],
    }
    axes = plot_selection(found)
    axes.set_title("")
    model = {"model": s["model"]} if s.get("model") else {}
    table = _first(found).table
    table.remove_column("BITWEIGHTS")
    targets = Rows("Targets in the order of the catalog.", table, where, len(found) - len(table))
    realizations = Rows("Realizations.", found.realizations, "SelectionProbabilities.realizations")
    sections = [
        Section("Result", [Facts("", selection_facts(found) | model)]),
        Section("Probabilities", [Picture("Selection probabilities of the targets.", axes, WORDS)]),
        Section("Targets", [targets, Text(list(ABOUT))]),
        Section("Realizations", [realizations]),
    ]
    lead = (
        f"The survey of {number_of(s['n_tiles'], 'tile')} was planned {s['n_realizations']} times with random "
        f"subpriorities. Of {number_of(s['n_targets'], 'target')}, {s['n_always_observed']} are observed in all "
        f"realizations, {s['n_sometimes_observed']} in some, and {s['n_never_observed']} in none."
    )
    return Page("Selection", f"Selection probabilities with {name}", lead, highlights, sections, found.provenance)


def _first(found):
    """Return the selection probabilities of the first targets."""
    columns = ("target_id", "requested", "n_tiles", "bits")
    return replace(found, **{name: getattr(found, name)[:MOST_TARGETS] for name in columns})
