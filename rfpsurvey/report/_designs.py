"""The page of a scan of designs: interactive scatter plots, and a calculator of the collision probability."""

import astropy.units as u
import numpy as np
from astropy.table import Table

from rfpsurvey.design import SURROGATE_ERROR
from rfpsurvey.errors import number_of
from rfpsurvey.plot import plot_designs
from rfpsurvey.probability import AXES, surrogate_spline
from rfpsurvey.report._blocks import Page, Picture, Section, Text, View
from rfpsurvey.report._pack import pack, pack_texts
from rfpsurvey.report._tables import all_values, without_private
from rfpsurvey.report._text import text_of

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
    return Page("Designs", number_of(len(table), "design"), "", {}, sections, without_private(table.meta))


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
        "instrument": pack_texts(_names(table)),
        "method": pack(table["method"]) if "method" in table.colnames else None,
    }


def _names(table):
    if "instrument" not in table.colnames:
        return [""] * len(table)
    return [text_of(name) for name in np.asarray(np.ma.filled(table["instrument"], "")).astype(str).tolist()]


def _start(table):
    """Return the initial design of the calculator: the instrument, or the first design of the Pareto front."""
    named = np.flatnonzero(np.array(_names(table)) != "")
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
