"""Figures of the paper's experiments."""

from typing import TYPE_CHECKING

import numpy as np
from astropy.table import QTable

from rfpsurvey.plot._probability import plot_probability, plot_residuals
from rfpsurvey.plot._speed_accuracy import plot_speed_accuracy
from rfpsurvey.plot._style import ARM, MARKERS, SERIES

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["draw_reproduction"]


def draw_reproduction(experiment: str, tables: dict[str, QTable]) -> "dict[str, Figure]":
    """Return the figures of an experiment by name."""
    return {name: draw(tables) for name, draw in FIGURES[experiment].items()}


def _figure(*shape, size):
    from matplotlib.figure import Figure

    figure = Figure(figsize=size, layout="constrained")
    return figure, np.atleast_1d(figure.subplots(*shape))


def _small(tables):
    """Draw probability against arm ratio and pitch, formula and simulation each scaled to 0 and 1 as in the paper."""
    table = tables["small"]
    scans = list(dict.fromkeys(np.asarray(table["scan"])))
    figure, axes = _figure(2, len(scans), size=(4 * len(scans), 6.5))
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
    axes[1, 0].set_ylabel("scaled to 0 and 1")
    return figure


def _scaled(values, like=None):
    values, like = np.asarray(values), np.asarray(values if like is None else like)
    return (values - like.min()) / (like.max() - like.min())


def _large(tables):
    """Draw formula against simulation, and their normalized difference over ratio and pitch."""
    table = tables["large"]
    figure, axes = _figure(1, 2, size=(10, 4.5))
    for k, way in enumerate(("range_200", "covered")):
        label = way.replace("_", " ")
        axes[0].plot(table[way], table["closed_form_corrected"], MARKERS[k], color=SERIES[k], label=label)
    most = 1.05 * max(table["range_200"].max(), table["covered"].max())
    axes[0].plot([0, most], [0, most], color="0.6", lw=0.8)
    axes[0].set_xlabel("simulation (conditional)")
    axes[0].set_ylabel("formula")
    axes[0].legend()
    scaled = table["ratio", "pitch"]
    scaled["formula"], scaled["simulation"] = _scaled(table["closed_form_corrected"]), _scaled(table["covered"])
    plot_residuals(scaled, "formula", "simulation", ax=axes[1]).set_title("both scaled to 0 and 1", fontsize="medium")
    return figure


def _poisson(tables):
    """Draw the relative difference of every reading of Poisson targets over ratio and pitch."""
    table = tables["poisson"]
    readings = [n for n in table.colnames if f"{n} error" in table.colnames and n != "uniform"]
    rows = -(-len(readings) // 3)
    figure, axes = _figure(rows, 3, size=(14, 4.2 * rows))
    for ax in axes.flat[len(readings) :]:
        ax.remove()
    for ax, reading in zip(axes.flat, readings, strict=False):
        plot_residuals(table, "uniform", reading, ax=ax)
    return figure


def _surrogate(tables):
    """Draw the error of the surrogate at designs it never saw."""
    table = tables["surrogate"]
    figure, (ax,) = _figure(size=(6, 4))
    ax.errorbar(
        table["quadrature"], np.asarray(table["surrogate"] - table["quadrature"]), table["quadrature_error"], fmt="o",
        color=ARM, ms=3, lw=0.6,
    )  # fmt: skip
    ax.axhline(0, color="0.6", lw=0.8)
    ax.set_xlabel("collision probability (quadrature)")
    ax.set_ylabel("surrogate - quadrature")
    return figure


def _intervals(tables):
    """Draw the coverage of each interval, with its own error."""
    table = tables["intervals"]
    figure, (ax,) = _figure(size=(8, 4.5))
    labels = [f"{r['scene']}, {r['method']}\n{r['interval']}, {r['stop']}" for r in table]
    ax.errorbar(table["coverage"], np.arange(len(table)), xerr=2 * table["coverage_error"], fmt="o", color=ARM)
    ax.set_yticks(np.arange(len(table)), labels, fontsize="x-small")
    ax.axvline(0.95, color="0.4", lw=0.8)
    ax.axvspan(0.935, 0.965, color="0.8", alpha=0.5, lw=0)
    ax.set_xlabel("how often the interval holds the truth")
    return figure


def _speed(tables):
    """Draw the time of methods against their errors."""
    figure, axes = _figure(2, size=(7.5, 7))
    plot_speed_accuracy(tables["speed"], axes=tuple(axes))
    return figure


FIGURES = {
    "small": {"small": _small}, "large": {"large": _large}, "poisson": {"poisson": _poisson},
    "fit": {"surrogate": _surrogate}, "intervals": {"intervals": _intervals}, "speed": {"speed": _speed},
}  # fmt: skip
