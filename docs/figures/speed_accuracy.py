"""Plot the error of each method against its time, for four tasks and one instrument.

``python docs/figures/speed_accuracy.py INSTRUMENT FILE`` plots the results for another instrument (a preset or a file).
"""

from time import perf_counter

import astropy.units as u
import matplotlib.pyplot as plt
import numpy as np
import trade_offs

import rfpsurvey as rs
from rfpsurvey.observing import MODELS, field_of_model

NAMES = {"close_pair": "close pair", "overlap_ratio": "overlap", "closed_form": "closed form", "sweep 65": "sweep"}
NAMES |= {"lamost_rule": "LAMOST's rule", "network_flow": "flow", "monte_carlo": "Monte Carlo"}
EFFORTS = {"overlap_ratio": [0], "close_pair": [0], "closed_form": [0], "quadrature": [4, 16, 64]}
EFFORTS |= {"monte_carlo": [4, 32, 256], "conditional": [2, 16, 128]}
SHOWN = ("exact", "endpoints", "shapely", "sampled 3", "sampled 9", "sampled 65", "sweep 65")
SELECTED = {"quadrature", "monte_carlo", "conditional"}
N_TARGETS = 10_000


def collisions():
    """Return the time and the fraction of misclassified pairs of each method, and the smallest nonzero fraction."""
    table = rs.benchmark.benchmark_collisions(instrument, repeats=5, seconds=0.2)
    found = {}
    for row in table:
        points = "" if row["n_points"] is np.ma.masked else f" {row['n_points']}"
        if row["method"] + points in SHOWN:
            found[row["method"] + points] = [(row["time"].to_value(u.s), row["misclassified"])]
    return found, 1 / max(table["n_colliding_true"][0], 1)


def probabilities():
    """Return the times and errors of each method for a few positioners with the arms of the instrument."""
    plane = trade_offs.simple_plane(instrument, pitch, rings=4)
    table = rs.benchmark.benchmark_probability(plane, efforts=EFFORTS, repeats=5, precision=1e-3)
    found = {name: [] for name in EFFORTS}
    for row in table:
        found[row["method"]].append((row["time"].to_value(u.s), row["error"]))
    return found, 1e-3


def allocations():
    """Return the time of each allocator, and the fraction of targets that its plan lacks."""
    targets = rs.synthetic_catalog("uniform", CENTER, instrument.field_radius, n_targets=len(instrument.focal_plane))
    options = rs.AllocationOptions(time_limit=5 * u.s)
    runs = [rs.compare_allocators(targets, instrument, CENTER, options=options) for _ in range(2)]
    best = int(np.flatnonzero(runs[0]["allocator"] == "optimal")[0])
    bound = runs[0]["usable"][best] / (1 - runs[0]["gap"][best])
    seconds = np.min([run["seconds"] for run in runs], axis=0)
    lost = 1 - runs[0]["usable"] / bound
    found = {str(n): [(s, v)] for n, s, v in zip(runs[0]["allocator"], seconds, lost, strict=True)}
    return found, 1 / bound


def projections():
    """Return the time of each model of the projection, and the largest error of the position of a target (um)."""
    conditions, center = trade_offs.conditions_at(instrument.name, 45)
    errors = rs.instrument.compare_projections(instrument, center, conditions).table["max"].to_value(u.um)
    plane, radius = instrument.projection(center), instrument.field_radius
    targets = rs.synthetic_catalog("uniform", center, 0.98 * radius, n_targets=N_TARGETS, rng=1)
    kinds = np.resize(instrument.focal_plane.fiber_types, N_TARGETS)
    vectors = targets.coord.cartesian.xyz.value.T.copy()
    scale, found = instrument.plate_scale.to_value(u.mm / u.rad), {}
    for model, error in zip(MODELS, errors, strict=True):
        times = []
        for _ in range(5):
            begin = perf_counter()
            known = (plane.plain.basis, scale, instrument.distortion, conditions, radius.to_value("rad"))
            field_of_model(model, *known).project(vectors, kinds)
            times.append(perf_counter() - begin)
        found[model] = [(min(times), error)]
    return found, 0.1


instrument, pitch = trade_offs.start()
CENTER = "10h00m00s +30d00m00s"
figure, axes = plt.subplots(2, 2, figsize=(7, 6.6), layout="constrained")
entries = {}
for ax, task, title, form, default in (
    (axes[0, 0], collisions, "Collisions: wrong pairs", trade_offs.percent, {"exact"}),
    (axes[0, 1], probabilities, "Collision probability: error", trade_offs.percent, SELECTED),
    (axes[1, 0], allocations, "Allocation: fibers lost", trade_offs.percent, {"repair"}),
    (axes[1, 1], projections, "Position of a target: error", trade_offs.micrometers, {"full"}),
):
    found, limit = task()
    entries[ax] = []
    for k, (name, values) in enumerate(found.items()):
        time, error = np.transpose(values)
        color = trade_offs.COLORS[k % len(trade_offs.COLORS)]
        shown = np.maximum(error, limit)
        ax.plot(time, shown, "o-", color=color, ms=7 if name in default else 4)
        for x, y in zip(time[error < limit], shown[error < limit], strict=True):
            arrow = {"arrowstyle": "<-", "color": color}
            ax.annotate("", (x, y), (0, -18), textcoords="offset points", arrowprops=arrow)
        style = {"color": color, "weight": "bold" if name in default else "normal"}
        entries[ax].append((NAMES.get(name, name), style, np.transpose([time, shown])))
    ax.margins(0.22, 0.15)
    trade_offs.logarithmic(ax.xaxis, trade_offs.duration)
    trade_offs.logarithmic(ax.yaxis, form)
    low, high = ax.get_ylim()
    ax.set_ylim(low / (high / low) ** 0.12, high)
    ax.set_title(title, loc="left", weight="bold")
    ax.grid(color="0.92")
    ax.set_axisbelow(True)
figure.supxlabel(f"computing time   ({instrument.name}; bold: default; arrow: no error found)", fontsize=10)
for ax, own in entries.items():
    trade_offs.label(ax, own)
trade_offs.finish(figure)
