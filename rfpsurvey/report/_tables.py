"""Pages on tables: scans of designs, comparisons of allocators and of instruments, estimates, and any table."""

from collections.abc import Mapping
from itertools import chain

import astropy.units as u
import numpy as np
from astropy.table import Table

from rfpsurvey._field.facts import versions
from rfpsurvey._field.tile import Tile
from rfpsurvey._studies.compare_instruments import parts_of
from rfpsurvey._studies.design_rows import instruments_of
from rfpsurvey._studies.losses import SURROGATE_ERROR
from rfpsurvey._studies.question import Estimate
from rfpsurvey._studies.surrogate import AXES, surrogate_spline
from rfpsurvey.errors import listed, number_of
from rfpsurvey.plot import draw_instruments, plot_allocators, plot_designs
from rfpsurvey.report._blocks import (
    Facts,
    Page,
    Picture,
    Rows,
    Section,
    Text,
    View,
    estimate_facts,
    pack,
    pack_texts,
    text_of,
)
from rfpsurvey.report._tile import draw_plane
from rfpsurvey.report._views import blocks_of_plans, focal_plane_view


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
    lacking = dict.fromkeys(chain(*meta["unmet"].values()))
    unmet = [f"{listed(n for n, own in meta['unmet'].items() if text in own)}: {text}" for text in lacking]
    words += f" Not met: {listed(unmet, 2)}." if unmet else ""
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


CAPTION = "The designs of the scan."
WORDS = (
    "Each point is a design. The color and the marker show the ratio of the arms or, if all ratios are equal, the "
    "parameter with the largest number of different values. Large points with an edge, connected by a line, are the "
    "Pareto front: no other design is better in both objectives than a design on the front. If the scan is around an "
    "instrument, the design of the instrument is marked by a star and its name."
)
ABOUT = (
    "The calculator evaluates the surrogate, a cubic spline through the collision probabilities of 3969 designs. These "
    "probabilities apply to positioners on a hexagonal lattice without an edge, and to independent targets that are "
    "uniform over each patrol area. The part of an arm that can collide is the segment from the elbow to the fiber. "
    "A click on a design sets the sliders to that design."
)
LARGEST_ERROR = 0.0016
"""Largest error of the surrogate for designs that were not used to make the surrogate (see docs/probability.rst)."""
DECIMALS = 8
"""Number of decimals of the coefficients of the spline."""
MEANINGS = {
    "central_arm": "length of the arm from the center of the positioner to the elbow",
    "eccentric_arm": "length of the arm from the elbow to the fiber",
    "ratio": "length of the eccentric arm divided by the length of the central arm",
    "pitch": "distance between the centers of adjacent positioners",
    "clearance": "width of the margin around each eccentric arm, which is half of the minimum separation",
    "min_separation": "smallest distance between two eccentric arms that do not collide",
    "collision_type": "1: no two arms can touch; 2: arms of adjacent positioners can touch; 3: arms of more distant "
    "positioners can also touch",
    "multiplicity": "patrol area divided by the area of the focal plane per positioner",
    "reach_0": "fraction of the focal plane that no positioner reaches",
    "reach_1": "fraction of the focal plane that exactly one positioner reaches",
    "reach_2": "fraction of the focal plane that exactly two positioners reach",
    "reach_3": "fraction of the focal plane that at least three positioners reach",
    "coverage": "fraction of the focal plane that at least one positioner reaches",
    "targets": "number of targets per positioner",
    "empty": "fraction of the positioners that have no target in reach",
    "assigned": "number of fibers per positioner that would have a target if arms could pass through each other",
    "loss": "fraction of the assigned fibers that are lost to collisions",
    "loss_error": "standard error of the loss",
    "usable": "number of assigned fibers per positioner that are not lost to collisions",
    "positioners_per_area": "number of positioners per area of the focal plane",
    "usable_per_area": "number of usable fibers per area of the focal plane",
    "n_unproven": "number of realizations of the targets in which the search for a plan ended at the time limit",
    "loss_gap": "upper limit of the decrease of the loss that better plans could achieve",
}
"""Definitions of the columns of numbers (see `explore_designs`)."""
NEED = {"central_arm", "ratio", "pitch", "clearance", "loss", "pareto"}


def is_designs(table: Table) -> bool:
    """Return whether a table was returned by `explore_designs` or `explore_around`."""
    return set(table.colnames) >= NEED and "objectives" in table.meta


def page_of_designs(table: Table, where: str) -> Page:
    """Return a page on a scan of designs."""
    picture = Picture(CAPTION, plot_designs(table), WORDS)
    still = [Text("The calculator requires a browser that runs scripts.")]
    sections = [
        Section("Designs", [View("designs", "Designs", _designs(table), [picture])]),
        Section("Calculator", [Text(ABOUT), View("calculator", "Calculator", calculator_data(_start(table)), still)]),
        all_values(table, where),
    ]
    about = [f"{name.replace('_', ' ')}: {MEANINGS[name]}." for name in table.colnames if name in MEANINGS]
    sections[-1].blocks.append(Text(about))
    best = number_of(int(np.count_nonzero(table["pareto"])), "design")
    goals = " and ".join(f"{aim} {name.replace('_', ' ')}" for name, aim in table.meta["objectives"].items())
    lead = f"The Pareto front has {best}; the objectives are {goals}."
    return Page("Designs", number_of(len(table), "design"), lead, {}, sections, without_private(table.meta))


def _designs(table):
    """Return the data of the scatter plots."""
    columns, units = {}, {}
    for name in table.colnames:
        values = np.asarray(getattr(table[name], "value", table[name]))
        if values.dtype.kind in "if" and values.ndim == 1:
            columns[name] = pack(np.ma.filled(values.astype(float), np.nan))
            units[name] = str(getattr(table[name], "unit", None) or "")
    return {
        "n": len(table),
        "columns": columns,
        "units": units,
        "meanings": {name: MEANINGS.get(name, "") for name in columns},
        "objectives": {str(name): str(aim) for name, aim in table.meta["objectives"].items()},
        "pareto": pack(np.asarray(table["pareto"])),
        "instrument": pack_texts([text_of(name) for name in instruments_of(table).tolist()]),
        "method": pack(table["method"]) if "method" in table.colnames else None,
    }


def _start(table):
    """Return the initial design of the calculator: the instrument, or the first design of the Pareto front."""
    named = np.flatnonzero(instruments_of(table) != "")
    front = np.flatnonzero(np.asarray(table["pareto"]))
    row = table[next(iter([*named.tolist(), *front.tolist(), 0]))]
    lengths = {name: float(row[name].to_value(u.mm)) for name in ("central_arm", "pitch", "clearance")}
    return {**lengths, "eccentric_arm": lengths["central_arm"] * float(row["ratio"])}


def calculator_data(start: dict) -> dict:
    """Return the spline of the surrogate with its limits and errors, and the initial design of the calculator."""
    spline = surrogate_spline()
    return {
        "axes": [[name, float(nodes[0]), float(nodes[-1])] for name, nodes in AXES.items()],
        "knots": [np.round(knots, 12).tolist() for knots in spline.t],
        "shape": list(spline.c.shape),
        "coefficients": pack(spline.c.reshape(-1), DECIMALS),
        "error": SURROGATE_ERROR,
        "largest_error": LARGEST_ERROR,
        "start": start,
    }
