"""Pages on estimates, comparisons of allocators and of instruments, and any table."""

from collections.abc import Mapping

import numpy as np
from astropy.table import Table

from rfpsurvey.compare import parts_of
from rfpsurvey.errors import number_of
from rfpsurvey.plot import draw_instruments, plot_allocators
from rfpsurvey.probability import Estimate
from rfpsurvey.report._blocks import Facts, Page, Picture, Rows, Section, Text
from rfpsurvey.report._facts import estimate_facts
from rfpsurvey.report._focal_plane_view import focal_plane_view
from rfpsurvey.report._plans import blocks_of_plans
from rfpsurvey.report._tile import draw_plane
from rfpsurvey.tile import Tile, versions


def page_of_estimate(estimate: Estimate, where: str) -> Page:
    """Return a page on an estimate of the collision probability."""
    facts = estimate_facts(estimate)
    lead = f"Method of the estimate: {estimate.method}, for {estimate.estimand} targets."
    likely = estimate.per_positioner[np.isfinite(estimate.per_positioner)]
    spread = {f"{q}th percentile over the positioners": float(np.percentile(likely, q)) for q in (5, 25, 50, 75, 95)}
    blocks = [Facts("", facts), *([Facts("Probabilities of individual positioners", spread)] if len(likely) else [])]
    highlights = {"collision probability": facts["collision probability"]}
    highlights |= {k.strip(): v for k, v in facts.items() if k.endswith("interval")}
    meta = {"method": estimate.method, "estimand": estimate.estimand, **estimate.meta, "software": versions()}
    return Page("Estimate", "Collision probability", lead, highlights, [Section("Result", blocks)], meta)


def page_of_table(table: Table, where: str) -> Page:
    """Return a page that shows all values of a table."""
    made_by = table.meta.get("made_by")
    made_by = made_by if isinstance(made_by, str) else ""
    title = str(table.meta.get("title") or made_by.replace("_", " ").capitalize() or "Untitled table")
    return Page("Table", title, "", {}, [all_values(table, where)], without_private(table.meta))


def all_values(table: Table, where: str) -> Section:
    """Return a section that shows all values of a table."""
    size = f"{number_of(len(table), 'row')} and {number_of(len(table.colnames), 'column')}."
    rows = Rows(size, table, where or "the table itself")
    return Section("All values", [rows if len(table) else Text("The table has no rows.")])


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
        still = [
            *blocks_of_plans(plans, draw_plane),
            Text("The interactive view requires a browser that runs scripts."),
        ]
        sections.append(Section("Focal plane", [focal_plane_view(plans, still, max_rows)]))
    if unmet:
        sections.append(Section("Constraints that are not met", [Text(unmet)]))
    title = f"Allocators on a field of {meta['instrument']}"
    return Page("Comparison", title, words, {}, sections, without_private(meta, "unmet"))


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
    return Page("Comparison", title, lead, {}, [Section("Comparison", blocks)], without_private(meta, "comparable"))


def without_private(meta: Mapping, *others: str) -> dict:
    """Return the ``meta`` of a table without the folder, the entries that readers of files add, and ``others``."""
    return {k: v for k, v in meta.items() if not str(k).startswith("__") and k not in ("folder", *others)}
