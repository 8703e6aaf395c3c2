"""The page on the claims of Chen et al. 2024, with the tables and figures of each experiment."""

from pathlib import Path

import numpy as np
from astropy.table import Table

from reproduction._figures import draw_reproduction
from rfpsurvey._common.read_tables import read_table
from rfpsurvey.report._blocks import Page, Picture, Rows, Section
from rfpsurvey.report._tables import without_private

__all__ = ["page_of_claims"]

TABLES = {
    "small": ("small",),
    "large": ("large", "large_differences", "large_plain"),
    "poisson": ("poisson", "poisson_disc"),
    "fit": ("fit", "surrogate"),
    "intervals": ("intervals", "one_sky"),
    "speed": ("speed",),
}
"""Names of the tables that each experiment writes, by the name of the experiment."""
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
    return Page("Reproduction", title, lead, highlights, sections, without_private(table.meta))


def _experiment(name, folder) -> list:
    """Return the figures and tables of an experiment, from the folder that contains its output."""
    if folder is None:
        return []
    tables = {key: read_table(Path(folder) / f"{key}.ecsv") for key in TABLES[name]}
    figures = draw_reproduction(name, tables)
    pictures = [Picture(FIGURES[key][0], figure, FIGURES[key][1]) for key, figure in figures.items()]
    return pictures + [Rows(f"Table {key}.", table, f"{key}.ecsv") for key, table in tables.items()]
