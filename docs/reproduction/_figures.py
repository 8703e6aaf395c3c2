"""Figures of the experiments that reproduce the results of Chen et al. (2024)."""

from typing import TYPE_CHECKING

import numpy as np
from astropy.table import QTable

from rfpsurvey.plot._axes import ARM, MARKERS, SERIES, new_grid
from rfpsurvey.plot._designs import plot_probability, plot_residuals
from rfpsurvey.plot._speed_accuracy import plot_speed_accuracy

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["draw_reproduction"]

GROUPS = ("arms", "targets_per_positioner", "sky")
BESIDE = 1.025
"""Ratio of the x values of successive groups, which places their points beside each other on a logarithmic axis."""


def draw_reproduction(experiment: str, tables: dict[str, QTable]) -> "dict[str, Figure]":
    """Return the figures of an experiment, as a dict from the name of each figure to the figure."""
    return {name: draw(tables) for name, draw in FIGURES[experiment].items()}


def _small(tables):
    """Plot the collision probability, and below it the probability scaled to 0 to 1, against arm ratio and pitch."""
    table = tables["small"]
    scans = list(dict.fromkeys(np.asarray(table["scan"])))
    figure, axes = new_grid(2, len(scans), (4 * len(scans), 6.5))
    for above, below, scan in zip(*axes, scans, strict=True):
        part, x = table[table["scan"] == scan], "ratio" if scan == "ratio" else "pitch"
        columns = {"simulation": "value", "simulation_low": "low", "simulation_high": "high", "formula": "closed_form"}
        curves = QTable([part[name] for name in (x, *columns.values())], names=[x, *columns])
        plot_probability(curves, x, values=["simulation", "formula"], ax=above)
        for name, own in columns.items():
            curves[name] = _scaled(part[own], like=part["closed_form" if name == "formula" else "value"])
        plot_probability(curves, x, values=["simulation", "formula"], ax=below)
        above.set_title(f"scan of {scan}")
        below.get_legend().remove()
        for ax in (above, below):
            ax.set_ylabel("")
    axes[0, 0].set_ylabel("collision probability")
    axes[1, 0].set_ylabel("scaled to the range 0 to 1")
    return figure


def _scaled(values, like=None):
    values, like = np.asarray(values), np.asarray(values if like is None else like)
    return (values - like.min()) / (like.max() - like.min())


def _large(tables):
    """Plot the probability from the formula against the simulated one, and the difference after scaling to 0 to 1."""
    table = tables["large"]
    figure, (axes,) = new_grid(1, 2, (10, 4.5))
    for k, way in enumerate(("range_200", "covered")):
        label = way.replace("_", " ")
        axes[0].plot(table[way], table["closed_form_corrected"], MARKERS[k], color=SERIES[k], label=label)
    most = 1.05 * max(table["range_200"].max(), table["covered"].max())
    axes[0].plot([0, most], [0, most], color="0.6", lw=0.8)
    axes[0].set(xlabel="simulation (conditional)", ylabel="formula")
    axes[0].legend()
    scaled = table["ratio", "pitch"]
    scaled["formula"], scaled["simulation"] = _scaled(table["closed_form_corrected"]), _scaled(table["covered"])
    plot_residuals(scaled, "formula", "simulation", ax=axes[1]).set_title("both scaled to 0 to 1", fontsize="medium")
    return figure


def _poisson(tables):
    """Plot the collision probability with uniform targets minus the collision probability with Poisson targets.

    Each panel shows one interpretation of the Poisson-distributed targets in the paper.
    """
    table = tables["poisson"]
    readings = [n for n in table.colnames if f"{n} error" in table.colnames and n != "uniform"]
    rows = -(-len(readings) // 3)
    figure, axes = new_grid(rows, 3, (14, 4.2 * rows))
    for ax in axes.flat[len(readings) :]:
        ax.remove()
    for ax, reading in zip(axes.flat, readings, strict=False):
        plot_residuals(table, "uniform", reading, ax=ax)
    return figure


def _surrogate(tables):
    """Plot the error of the surrogate model for designs to which the model was not fitted."""
    table = tables["surrogate"]
    figure, ((ax,),) = new_grid(1, 1, (6, 4))
    ax.errorbar(
        table["quadrature"],
        np.asarray(table["surrogate"] - table["quadrature"]),
        table["quadrature_error"],
        fmt="o",
        color=ARM,
        ms=3,
        lw=0.6,
    )
    ax.axhline(0, color="0.6", lw=0.8)
    ax.set(xlabel="collision probability (quadrature)", ylabel="surrogate - quadrature")
    return figure


def _intervals(tables):
    """Plot, with error bars, the fraction of runs in which the confidence interval contains the true value."""
    table = tables["intervals"]
    figure, ((ax,),) = new_grid(1, 1, (8, 4.5))
    labels = [f"{r['scene']}, {r['method']}\n{r['interval']}, {r['stop']}" for r in table]
    ax.errorbar(table["coverage"], np.arange(len(table)), xerr=_within_one(table), fmt="o", color=ARM)
    ax.set_yticks(np.arange(len(table)), labels, fontsize="x-small")
    ax.axvline(0.95, color="0.4", lw=0.8)
    ax.axvspan(0.935, 0.965, color="0.8", alpha=0.5, lw=0)
    ax.set_xlabel("fraction of runs whose interval contains the true value")
    return figure


def _within_one(table):
    """Return the lengths of error bars (two standard errors) below and above a fraction; the bars end at 0 and 1."""
    value, bar = np.asarray(table["coverage"], float), 2 * np.asarray(table["coverage_error"], float)
    return [np.minimum(bar, value).tolist(), np.minimum(bar, 1 - value).tolist()]


def _one_sky(tables):
    """Plot the fraction of skies whose interval contains the true value, against the number of positioners.

    A sky is one random set of targets. The interval is the confidence interval that is computed from this sky. The true
    value is the mean over all skies of the same kind.
    """
    table = tables["one_sky"]
    figure, ((ax,),) = new_grid(1, 1, (7.5, 6))
    groups = list(dict.fromkeys(zip(*(np.asarray(table[c]).tolist() for c in GROUPS), strict=True)))
    for k, group in enumerate(groups):
        rows = np.all([np.asarray(table[c]) == value for c, value in zip(GROUPS, group, strict=True)], axis=0)
        part = table[rows & np.isfinite(table["coverage"])]
        style = {"color": SERIES[k % 8], "marker": MARKERS[(k + k // 8) % 8], "linestyle": ":", "capsize": 2}
        label = f"{group[0]}, {group[1]:g} target{'' if group[1] == 1 else 's'} per positioner, {group[2]}"
        # draw groups beside each other, because many groups have the same value
        beside = np.asarray(part["positioners"]) * BESIDE ** (k - (len(groups) - 1) / 2)
        ax.errorbar(beside, part["coverage"], yerr=_within_one(part), label=label, **style)
    ax.axhline(0.95, color="0.4", lw=0.8)
    numbers = sorted(set(np.asarray(table["positioners"]).tolist()))
    ax.set_xscale("log")
    ax.set_xticks(numbers, [str(n) for n in numbers])
    ax.set_xticks([], minor=True)
    ax.set(xlabel="number of positioners", ylabel="fraction of skies whose interval contains the expectation")
    figure.legend(fontsize="small", ncols=2, loc="outside lower center")
    return figure


def _poisson_disc(tables):
    """Plot by how many percent uniform targets cause more collisions than Poisson-disc targets, against arm ratio."""
    table, summary = tables["poisson"], tables["poisson_disc"]
    figure, ((ax,),) = new_grid(1, 1, (7, 4.8))
    for k, separation in enumerate(summary["min_separation"].to_value("mm")):
        name = f"disc, separation {separation:.2f} mm"
        some = table[np.isfinite(table[name])]
        drop = 100 * np.asarray(some["uniform"] / some[name] - 1)
        error = 100 * np.hypot(some["uniform error"] / some["uniform"], some[f"{name} error"] / some[name])
        style = {
            "color": SERIES[k % len(SERIES)],
            "marker": MARKERS[k % 8],
            "linestyle": "",
            "ms": 5,
            "elinewidth": 0.8,
        }
        ax.errorbar(some["ratio"], drop, yerr=error, label=f"{separation:g} mm", **style)
    ax.axhline(2.6, color="0.4", lw=0.8, ls="--")
    ax.text(0.99, 2.6, "paper: 2.6 %", transform=ax.get_yaxis_transform(), ha="right", va="bottom", fontsize="small")
    ax.axhline(0, color="0.6", lw=0.8)
    ax.set(xlabel="eccentric over central arm", ylabel="excess of collisions with uniform targets [%]")
    ax.legend(title="minimum separation of targets", fontsize="small")
    return figure


def _speed(tables):
    """Plot the errors of each method against its computing time."""
    figure, axes = new_grid(2, 1, (7.5, 7))
    plot_speed_accuracy(tables["speed"], axes=tuple(axes.flat))
    return figure


FIGURES = {
    "small": {"small": _small},
    "large": {"large": _large},
    "fit": {"surrogate": _surrogate},
    "poisson": {"poisson": _poisson, "poisson_disc": _poisson_disc},
    "intervals": {"intervals": _intervals, "one_sky": _one_sky},
    "speed": {"speed": _speed},
}
