"""Plot the error of each method against the property of the scene that makes the method fail, for one instrument.

``python docs/figures/failures.py INSTRUMENT FILE`` plots the errors for another instrument (a preset or a file).
"""

import astropy.units as u
import matplotlib.pyplot as plt
import numpy as np
import trade_offs

import rfpsurvey as rs

POINTS = {"endpoints": "endpoints", "sampled, 3 points": 3, "sampled, 9 points": 9}
FORMULAS = {"closed_form": "closed form", "overlap_ratio": "overlap", "close_pair": "close pair"}
ALTITUDES = (85, 70, 55, 40, 30, 20)
TARGETS = (0.5, 1, 2, 4, 8)
N_POSITIONERS = 250


def collisions():
    """Return the fraction of collisions that each method misses, for arms of different lengths."""
    reach = np.array([0.7, 0.85, 1, 1.2, 1.4])
    missed = {name: [] for name in POINTS}
    for length in reach:
        plane = trade_offs.simple_plane(instrument, pitch, rings=9, scale=length * pitch / longest)
        options = {"methods": ["endpoints", "sampled"], "n_configurations": 8, "repeats": 1, "seconds": 0}
        table = rs.benchmark.benchmark_collisions(plane, **options)
        for name, row in POINTS.items():
            chosen = table["method"] == row if row == "endpoints" else table["n_points"].filled(0) == row
            missed[name].append(float(table["n_missed"][chosen][0] / table["n_colliding_true"][chosen][0]))
    return reach, missed, "reach of the arms / pitch"


def probabilities():
    """Return the error of the collision probability from each formula, for different pitches."""
    ratio = np.array([1.05, 1.2, 1.35, 1.5, 1.65, 1.8, 1.95])
    errors = {name: [] for name in FORMULAS.values()}
    for one in ratio:
        plane = trade_offs.simple_plane(instrument, one * longest, rings=3)
        true = rs.collision_probability(plane, method="quadrature", precision=1e-4).value
        for name, text in FORMULAS.items():
            errors[text].append(trade_offs.excess(rs.collision_probability(plane, method=name).value / true))
    return ratio, errors, "pitch / reach of the arms"


def allocations():
    """Return the fraction of fibers that each allocator loses relative to the best plan, for numbers of targets."""
    center = "10h00m00s +30d00m00s"
    lost = {"LAMOST's rule": [], "nearest": [], "repair (default)": []}
    for number in TARGETS:
        n = int(number * len(instrument.focal_plane))
        targets = rs.synthetic_catalog("uniform", center, instrument.field_radius, n_targets=n, rng=1)
        options = rs.AllocationOptions(time_limit=1 * u.s)
        names = ["lamost_rule", "nearest", "repair", "optimal"]
        table = rs.compare_allocators(targets, instrument, center, allocators=names, options=options)
        bound = table["usable"][-1] / (1 - table["gap"][-1])
        for values, usable in zip(lost.values(), table["usable"], strict=False):
            values.append(float(1 - usable / bound))
    return TARGETS, lost, "targets per positioner"


def projections():
    """Return the largest error of the position of a target (um) in each model, for different altitudes."""
    errors = {name: [] for name in ("tangent", "radial", "refraction")}
    for altitude in ALTITUDES:
        conditions, center = trade_offs.conditions_at(instrument.name, altitude)
        result = rs.instrument.compare_projections(instrument, center, conditions)
        for name, value in zip(errors, result.table["max"].to_value(u.um), strict=False):
            errors[name].append(value)
    return ALTITUDES, errors, "altitude of the field (deg)"


instrument, pitch = trade_offs.start()
arms = instrument.focal_plane.positioner
longest = arms.central_arm + arms.eccentric_arm
tolerance = trade_offs.tolerance(instrument)
figure, axes = plt.subplots(2, 2, figsize=(7, 6.6), layout="constrained")
entries = {}
for ax, task, title, form, green, limit, low in (
    (axes[0, 0], collisions, "Collisions that are missed", trade_offs.percent, "exact: none", 1e-3, 2e-4),
    (axes[0, 1], probabilities, "Error of the probability", trade_offs.percent, "auto: as requested", 0.01, 1e-3),
    (axes[1, 0], allocations, "Fibers lost by the plan", trade_offs.percent, "less than 1 %", 0.01, 1e-3),
    (axes[1, 1], projections, "Error of the position", trade_offs.micrometers, "auto", tolerance, 1),
):
    x, found, title_x = task()
    ax.axhspan(low, limit, color="#009E73", alpha=0.18, lw=0)
    trade_offs.logarithmic(ax.yaxis, form)
    own = [(green, {"color": "#00684C", "weight": "bold"}, np.transpose([x, np.full(len(x), 4 * low)]))]
    for color, (name, values) in zip(trade_offs.COLORS, found.items(), strict=False):
        shown = np.maximum(values, 2 * low)
        ax.plot(x, shown, "o-", color=color, ms=4)
        for where in np.compress(shown > values, x):
            trade_offs.point_down(ax, where, 2 * low, color)
        values = shown
        own.append((name, {"color": color}, np.transpose([x, values])))
    ax.set(xlabel=title_x, ylim=(low, 3 * np.max([line.get_ydata() for line in ax.lines])))
    ax.set_title(title, loc="left", weight="bold")
    ax.set_ylabel(trade_offs.FACTOR if task == probabilities else "")
    entries[ax] = own
axes[1, 0].set_xscale("log", base=2)
axes[1, 0].set_xticks(TARGETS, map(str, TARGETS))
axes[1, 1].invert_xaxis()
figure.supxlabel(f"{instrument.name}; green: accurate enough; arrow: no error found", fontsize=10)
for ax in entries:
    trade_offs.label(ax, entries[ax])
trade_offs.finish(figure)
