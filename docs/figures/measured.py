"""Measurements of the time and the error of each method, for four tasks; several figures use them.

Each function returns a dict from the name of a method to its times (s) and errors, and the smallest measurable error.
"""

from functools import cache
from time import perf_counter

import astropy.units as u
import numpy as np
import trade_offs

import rfpsurvey as rs
from rfpsurvey._sky.conditions import MODELS
from rfpsurvey._sky.models import field_of_model

CENTER = "10h00m00s +30d00m00s"
EFFORTS = {"overlap_ratio": [0], "close_pair": [0], "closed_form": [0], "quadrature": [4, 16, 64]}
EFFORTS |= {"monte_carlo": [4, 32, 256], "conditional": [2, 16, 128]}
SHOWN = ("exact", "endpoints", "shapely", "sampled 3", "sampled 9", "sampled 65", "sweep 65")
N_TARGETS = 10_000


@cache
def collisions(instrument):
    """Return the time and the fraction of misclassified pairs of each method, and the smallest nonzero fraction."""
    table = rs.benchmark.benchmark_collisions(instrument, repeats=5, seconds=0.2)
    found = {}
    for row in table:
        points = "" if row["n_points"] is np.ma.masked else f" {row['n_points']}"
        if row["method"] + points in SHOWN:
            found[row["method"] + points] = [(row["time"].to_value(u.s), row["misclassified"])]
    return found, 1 / max(table["n_colliding_true"][0], 1)


@cache
def probabilities(instrument):
    """Return the times and errors of each method for a few positioners with the arms of the instrument.

    The error is ``excess`` of the ratio to the true value, or the relative root mean square error for several runs.
    """
    plane = trade_offs.simple_plane(instrument, instrument.facts()["pitch"], rings=4)
    table = rs.benchmark.benchmark_probability(plane, efforts=EFFORTS, repeats=5, precision=1e-3)
    found = {name: [] for name in EFFORTS}
    for row in table:
        scatter, ratio = row["error"] / row["truth"], row["value"] / row["truth"]
        error = scatter if row["effort"] else trade_offs.excess(ratio)
        found[row["method"]].append((row["time"].to_value(u.s), error))
    return found, float(np.max(table["truth_error"] / table["truth"]))


@cache
def allocations(instrument):
    """Return the time of each allocator, and the fraction of targets that its plan lacks."""
    targets = rs.synthetic_catalog(
        "uniform", CENTER, instrument.field_radius, n_targets=len(instrument.focal_plane), rng=1
    )
    options = rs.AllocationOptions(time_limit=5 * u.s)
    runs = [rs.compare_allocators(targets, instrument, CENTER, options=options) for _ in range(2)]
    best = int(np.flatnonzero(runs[0]["allocator"] == "optimal")[0])
    bound = runs[0]["usable"][best] / (1 - runs[0]["gap"][best])
    seconds = np.min([run["seconds"] for run in runs], axis=0)
    lost = 1 - runs[0]["usable"] / bound
    found = {str(n): [(s, v)] for n, s, v in zip(runs[0]["allocator"], seconds, lost, strict=True)}
    return found, 1 / bound


@cache
def projections(instrument):
    """Return the time of each model of the projection, and the largest error of the position of a target (um)."""
    conditions, center = trade_offs.conditions_at(instrument.name, 45)
    errors = rs.instrument.compare_projections(instrument, center, conditions).table["max"].to_value(u.um)
    plane, radius = instrument.projection(center), instrument.field_radius
    targets = rs.synthetic_catalog("uniform", center, 0.98 * radius, n_targets=N_TARGETS, rng=1)
    kinds = np.resize(instrument.focal_plane.fiber_types, N_TARGETS)
    vectors = targets.coord.cartesian.xyz.value.T.copy()
    found = {}
    for model, error in zip(MODELS, errors, strict=True):
        times = []
        for _ in range(5):
            begin = perf_counter()
            field_of_model(model, plane.plain.basis, instrument.optics, conditions).project(vectors, kinds)
            times.append(perf_counter() - begin)
        found[model] = [(min(times), error)]
    return found, 0.1
