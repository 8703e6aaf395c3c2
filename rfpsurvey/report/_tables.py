"""Pages on estimates, comparisons of allocators and of instruments, the claims of Chen et al. 2024, and any table."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from astropy.table import Table

from rfpsurvey._io import read_table
from rfpsurvey.compare import parts_of
from rfpsurvey.plot import draw_instruments, draw_reproduction, plot_allocators
from rfpsurvey.probability import Estimate
from rfpsurvey.report._blocks import Facts, Page, Picture, Rows, Section, Text
from rfpsurvey.report._facts import estimate_facts
from rfpsurvey.report._focal_plane_view import focal_plane_view
from rfpsurvey.reproduction import TABLES
from rfpsurvey.tile import Tile, versions

__all__ = ["page_of_allocators", "page_of_claims", "page_of_estimate", "page_of_instruments", "page_of_table"]

VERDICTS = {"reproduced": "good", "not reproduced": "bad", "cannot be decided from the text": "open"}
FIGURES = {
    "small": (
        "Collision probability as a function of arm ratio and pitch.",
        "Solid lines are simulations with shaded 95 % intervals, and dashed lines are the formula. The lower panels "
        "show the same values scaled to the range from 0 to 1, as in the paper.",
    ),
    "large": (
        "Comparison of the formula with the simulation.",
        "Left: each point is a design; the colors distinguish two choices of the area that contains the simulated "
        "targets. On the gray line, formula and simulation are equal. Right: the difference of formula and simulation, "
        "each scaled to the range from 0 to 1. Triangles point up where the formula is larger.",
    ),
    "poisson": (
        "Collision probability with uniform targets minus that with Poisson-distributed targets.",
        "Each panel shows the difference of the collision probabilities for one interpretation of the paper. Triangles "
        "point up where the probability is larger with uniform targets.",
    ),
    "poisson_disc": (
        "Comparison of uniform targets with Poisson-disc targets.",
        "The points show by how many percent the collision probability is larger with uniform targets than with "
        "Poisson-disc targets, for each minimum distance between Poisson-disc targets; bars are standard errors. The "
        "dashed line is the value of the paper, 2.6 %. The gray line marks 0 %.",
    ),
    "surrogate": (
        "The error of the surrogate.",
        "The surrogate is a spline that approximates the collision probability. The points are designs that were not "
        "used to make the surrogate. The error is the difference between the surrogate and a numerical quadrature; "
        "bars are the standard errors of the quadrature. The gray line marks an error of 0.",
    ),
    "intervals": (
        "How often each confidence interval contains the true collision probability.",
        "Bars extend two standard errors to each side. The gray line is the nominal fraction of 95 %, and the gray "
        "band extends from 93.5 to 96.5 %.",
    ),
    "one_sky": (
        "How often the confidence interval from one sky contains the mean collision probability of all skies.",
        "A sky is one random set of targets. Each combination of arms, number of targets per positioner and "
        "distribution of targets has its own line. Bars extend two standard errors to each side. The gray line is the "
        "nominal fraction of 95 %. Points with the same number of positioners are shifted sideways, so that they do "
        "not overlap.",
    ),
    "speed": (
        "Time and errors of each method.",
        "An arrow that points down marks an upper limit of the error: the method misclassified no pair of arms. The "
        "labels state the number of sample points per arm. Methods to the lower left are faster and more accurate.",
    ),
}
"""Captions and descriptions of figures, by the names of the figures."""


def page_of_estimate(estimate: Estimate, where: str) -> Page:
    """Return a page on an estimate of the collision probability."""
    facts = estimate_facts(estimate)
    kind = f"{estimate.method}, for {estimate.estimand} targets"
    likely = estimate.per_positioner[np.isfinite(estimate.per_positioner)]
    spread = {f"{q}th percentile over the positioners": float(np.percentile(likely, q)) for q in (5, 25, 50, 75, 95)}
    blocks = [Facts("", facts), *([Facts("Probabilities of individual positioners", spread)] if len(likely) else [])]
    highlights = {"collision probability": facts["collision probability"]}
    highlights |= {k.strip(): v for k, v in facts.items() if k.endswith("interval")}
    meta = {"method": estimate.method, "estimand": estimate.estimand, **estimate.meta, "software": versions()}
    return Page(
        "Estimate",
        "Collision probability",
        f"Method of the estimate: {kind}.",
        highlights,
        [Section("Result", blocks)],
        meta,
    )


def page_of_table(table: Table, where: str) -> Page:
    """Return a page that shows all values of a table."""
    made_by = table.meta.get("made_by")
    made_by = made_by if isinstance(made_by, str) else ""
    title = str(table.meta.get("title") or made_by.replace("_", " ").capitalize() or "Untitled table")
    size = f"{_count(len(table), 'row')} and {_count(len(table.colnames), 'column')}."
    rows = Rows(size, table, where or "the table itself")
    sections = [Section("All values", [rows if len(table) else Text("The table has no rows.")])]
    return Page("Table", title, "", {}, sections, _without_private(table.meta))


def _count(n, word) -> str:
    return f"{n} {word}{'' if n == 1 else 's'}"


def page_of_allocators(table: Table, where: str, plans: Mapping[str, Tile], max_rows: int | None) -> Page:
    """Return a page on a comparison of allocators; with ``plans``, it contains an interactive view of the plans."""
    meta = table.meta
    words = (
        f"One field of {meta['instrument']} was planned with {len(table)} allocators. If arms could pass each other, "
        f"{meta['blind_science']} science targets could be observed."
    )
    unmet = [f"{name}: {sentence}" for name, sentences in meta["unmet"].items() for sentence in sentences]
    notes = (
        "usable: number of science fibers without a collision. loss: fraction by which usable is smaller than the "
        "number of science targets that could be observed if arms could pass each other. gap: relative difference "
        "between the objective of the plan and its proven upper bound, if a bound is known. missing: number of fibers "
        "that the requirements demand, but that the plan lacks."
    )
    seen = (
        "Bars show the numbers of usable fibers on science targets, of fibers lost to collisions, and of fibers "
        "missing for requirements. The dashed line is the number of science fibers of the best plan that ignores "
        "collisions. The time on the right is the computing time of the allocation."
    )
    picture = Picture("Numbers of fibers for each allocator.", plot_allocators(table), seen)
    blocks = [picture, Rows("Comparison of the allocators.", table, where), Text(notes)]
    sections = [Section("Comparison", blocks)]
    if plans:
        still = [Text("The interactive view of the plans requires a browser that runs scripts.")]
        sections.append(Section("Focal plane", [focal_plane_view(plans, still, max_rows)]))
    if unmet:
        sections.append(Section("Requirements that are not met", [Text(unmet)]))
    provenance = {k: v for k, v in _without_private(meta).items() if k != "unmet"}
    return Page("Comparison", f"Allocators on a field of {meta['instrument']}", words, {}, sections, provenance)


def page_of_instruments(table: Table, where: str) -> Page:
    """Return a page on a comparison of instruments."""
    meta, names = table.meta, dict.fromkeys(np.asarray(table["instrument"]).tolist())
    lead = (
        f"{', '.join(names)}. Number of fields of each instrument: {meta['n_fields']}. Basis of the comparison: "
        f"{meta['way']}."
    )
    seen = (
        "Left: fractions of the footprint that are in reach of no, one, two, and at least three positioners. Middle: "
        "fractions of the positioners that have a science target and no collision, that have a science target but "
        "collide, and that have no science target; the number on the right is the fraction of targets lost to "
        "collisions. Right: the collision probability with its 95 % interval."
    )
    blocks = [
        Picture("Comparison of the instruments.", draw_instruments(table), seen),
        *(Rows(f"{title.capitalize()}.", part, where) for title, part in parts_of(table).items()),
        Text(meta["comparable"]),
    ]
    title = f"Comparison of {len(names)} instruments"
    provenance = {k: v for k, v in _without_private(meta).items() if k != "comparable"}
    return Page("Comparison", title, lead, {}, [Section("Comparison", blocks)], provenance)


def page_of_claims(table: Table, where: str) -> Page:
    """Return a page on the claims of the paper, with the tables and figures of each experiment."""
    verdicts = np.asarray(table["verdict"]).tolist()
    highlights = {verdict: verdicts.count(verdict) for verdict in VERDICTS}
    sections = []
    for name in dict.fromkeys(np.asarray(table["experiment"]).tolist()):
        claims = table[table["experiment"] == name]
        claims = claims[[c for c in claims.colnames if c != "experiment"]]
        blocks = [Rows("The claims of the paper, and the new results.", claims, where, marks=VERDICTS)]
        sections.append(Section(name.capitalize(), blocks + _experiment(name, table.meta.get("folder"))))
    quick = (
        " These results are from a quick run, which is not accurate enough to decide any claim."
        if table.meta.get("quick")
        else ""
    )
    lead = f"This page compares {len(table)} claims of a paper, Chen et al. (2024), with new results.{quick}"
    title = "Repetition of the experiments of the paper"
    return Page("Reproduction", title, lead, highlights, sections, _without_private(table.meta))


def _experiment(name, folder) -> list:
    """Return the figures and tables of an experiment, from the folder that contains its output."""
    if folder is None:
        return []
    tables = {key: read_table(Path(folder) / f"{key}.ecsv") for key in TABLES[name]}
    figures = draw_reproduction(name, tables)
    pictures = [Picture(FIGURES[key][0], figure, FIGURES[key][1]) for key, figure in figures.items()]
    return pictures + [Rows(f"Table {key}.", table, f"{key}.ecsv") for key, table in tables.items()]


def _without_private(meta) -> dict:
    """Return the ``meta`` of a table without the folder, and without the entries that readers of files add."""
    return {k: v for k, v in meta.items() if not str(k).startswith("__") and k != "folder"}
