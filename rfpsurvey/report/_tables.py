"""The pages of estimates and of tables: any, allocators and instruments side by side, and the claims of the paper."""

from pathlib import Path

import numpy as np
from astropy.table import Table

from rfpsurvey._io import read_table
from rfpsurvey.compare import parts_of
from rfpsurvey.plot import draw_instruments, draw_reproduction, plot_allocators
from rfpsurvey.probability import Estimate
from rfpsurvey.report._blocks import Facts, Page, Picture, Rows, Section, Text
from rfpsurvey.report._facts import estimate_facts
from rfpsurvey.reproduction import TABLES
from rfpsurvey.tile import versions

__all__ = ["page_of_allocators", "page_of_claims", "page_of_estimate", "page_of_instruments", "page_of_table"]

VERDICTS = {"reproduced": "good", "not reproduced": "bad", "cannot be decided from the text": "open"}
FIGURES = {
    "small": "Probability against arm ratio and pitch, by simulation and formula; below, scaled as in the paper.",
    "large": "The formula against the simulation, and their difference over arm ratio and pitch.",
    "poisson": "What Poisson-distributed targets change, in every reading of the text.",
    "surrogate": "The error of the surrogate at designs that it never saw.",
    "intervals": "How often each interval holds the truth; the line is what it promises.",
    "speed": "The time of each method against its errors.",
}


def page_of_estimate(estimate: Estimate, where: str) -> Page:
    """Return a page on an estimate."""
    facts = estimate_facts(estimate)
    kind = f"{estimate.method}, for {estimate.estimand} targets"
    likely = estimate.per_positioner[np.isfinite(estimate.per_positioner)]
    spread = {f"{q} % of positioners at most": float(np.percentile(likely, q)) for q in (5, 25, 50, 75, 95)}
    blocks = [Facts("", facts), *([Facts("Probability of single positioners", spread)] if len(likely) else [])]
    highlights = {"collision probability": facts["collision probability"]}
    highlights |= {k.strip(): v for k, v in facts.items() if k.endswith("interval")}
    meta = {"method": estimate.method, "estimand": estimate.estimand, **estimate.meta, "software": versions()}
    return Page(
        "Estimate",
        "Collision probability",
        f"By the method {kind}.",
        highlights,
        [Section("What came out", blocks)],
        meta,
    )


def page_of_table(table: Table, where: str) -> Page:
    """Return a page on any table."""
    made_by = table.meta.get("made_by")
    made_by = made_by if isinstance(made_by, str) else ""
    title = str(table.meta.get("title") or made_by.replace("_", " ").capitalize() or "Untitled table")
    size = f"{_count(len(table), 'row')} and {_count(len(table.colnames), 'column')}."
    rows = Rows(size, table, where or "the table itself")
    sections = [Section("All values", [rows if len(table) else Text("The table has no rows.")])]
    return Page("Table", title, "", {}, sections, _without_private(table.meta))


def _count(n, word) -> str:
    return f"{n} {word}{'' if n == 1 else 's'}"


def page_of_allocators(table: Table, where: str) -> Page:
    """Return a page on methods of allocation side by side."""
    meta = table.meta
    words = (
        f"One field of {meta['instrument']}, planned in {len(table)} ways. If arms could pass each other, "
        f"{meta['blind_science']} science targets could be observed."
    )
    unmet = [f"{name}: {sentence}" for name, sentences in meta["unmet"].items() for sentence in sentences]
    notes = (
        "usable: science fibers without a collision. loss: what is lacking of the science targets that could be "
        "observed if arms could pass each other, as a part of these. gap: how far the plan may be from the best one, "
        "where that is known. missing: what the requirements lack."
    )
    seen = "Usable fibers and those lost to collisions; the line is what could be if arms could pass each other."
    picture = Picture("What each allocator gives.", plot_allocators(table), seen)
    blocks = [picture, Rows("Allocators side by side.", table, where), Text(notes)]
    sections = [Section("Side by side", blocks)]
    if unmet:
        sections.append(Section("Requirements that are not met", [Text(unmet)]))
    provenance = {k: v for k, v in _without_private(meta).items() if k != "unmet"}
    return Page("Comparison", f"Allocators on a field of {meta['instrument']}", words, {}, sections, provenance)


def page_of_instruments(table: Table, where: str) -> Page:
    """Return a page on instruments side by side."""
    meta, names = table.meta, dict.fromkeys(np.asarray(table["instrument"]).tolist())
    lead = f"{', '.join(names)}; fields of each: {meta['n_fields']}, {meta['way']}."
    seen = "Reach, what the positioners do, and the collision probability with its interval."
    blocks = [
        Picture("Instruments side by side.", draw_instruments(table), seen),
        *(Rows(f"{title.capitalize()}.", part, where) for title, part in parts_of(table).items()),
        Text(meta["comparable"]),
    ]
    title = f"Comparison of {len(names)} instruments"
    provenance = {k: v for k, v in _without_private(meta).items() if k != "comparable"}
    return Page("Comparison", title, lead, {}, [Section("Side by side", blocks)], provenance)


def page_of_claims(table: Table, where: str) -> Page:
    """Return a page on the claims of the paper, with the tables and figures of each experiment."""
    verdicts = np.asarray(table["verdict"]).tolist()
    highlights = {verdict: verdicts.count(verdict) for verdict in VERDICTS}
    sections = []
    for name in dict.fromkeys(np.asarray(table["experiment"]).tolist()):
        claims = table[table["experiment"] == name]
        claims = claims[[c for c in claims.colnames if c != "experiment"]]
        blocks = [Rows("What the paper says, and what came out here.", claims, where, marks=VERDICTS)]
        sections.append(Section(name.capitalize(), blocks + _experiment(name, table.meta.get("folder"))))
    quick = " A quick run, which decides nothing." if table.meta.get("quick") else ""
    lead = f"{len(table)} claims of the paper on collision probabilities beside what came out here.{quick}"
    title = "The paper's experiments, run again"
    return Page("Reproduction", title, lead, highlights, sections, _without_private(table.meta))


def _experiment(name, folder) -> list:
    """Return figures and tables of an experiment, from the folder that it was written to."""
    if folder is None:
        return []
    tables = {key: read_table(Path(folder) / f"{key}.ecsv") for key in TABLES[name]}
    figures = draw_reproduction(name, tables)
    pictures = [Picture(FIGURES.get(key, f"{key}."), figure) for key, figure in figures.items()]
    return pictures + [Rows(f"Table {key}.", table, f"{key}.ecsv") for key, table in tables.items()]


def _without_private(meta) -> dict:
    """Return what a table says of itself, without what readers of files add and where it was on disk."""
    return {k: v for k, v in meta.items() if not str(k).startswith("__") and k != "folder"}
