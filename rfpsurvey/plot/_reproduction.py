"""Figures of the paper's experiments."""

from typing import TYPE_CHECKING

import astropy.units as u
import numpy as np
from astropy.table import QTable

from rfpsurvey.plot._speed_accuracy import plot_speed_accuracy
from rfpsurvey.plot._style import ARM, COLLISION, MARKERS, SERIES

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
        part = table[table["scan"] == scan]
        x = part["ratio"] if scan == "ratio" else part["pitch"].to_value(u.mm)
        for values, color, label in ((part["value"], ARM, "simulation"), (part["closed_form"], COLLISION, "formula")):
            above.plot(x, values, "o-", color=color, label=label)
            below.plot(x, _scaled(values), "o-", color=color)
        above.set_title(f"scan of {scan}")
        below.set_xlabel("arm ratio" if scan == "ratio" else "pitch [mm]")
    axes[0, 0].set_ylabel("collision probability")
    axes[1, 0].set_ylabel("scaled to 0 and 1")
    axes[0, 0].legend()
    return figure


def _scaled(values):
    values = np.asarray(values)
    return (values - values.min()) / (values.max() - values.min())


def _large(tables):
    """Draw formula against simulation, and their normalized difference over ratio and pitch."""
    table = tables["large"]
    figure, axes = _figure(1, 2, size=(10, 4.5))
    for k, way in enumerate(("range_200", "covered")):
        label = way.replace("_", " ")
        axes[0].plot(table[way], table["closed_form_corrected"], MARKERS[k], color=SERIES[k], label=label)
    axes[0].plot([0, 1], [0, 1], color="0.6", lw=0.8)
    axes[0].set_xlabel("simulation (conditional)")
    axes[0].set_ylabel("formula")
    axes[0].legend()
    away = _scaled(table["closed_form_corrected"]) - _scaled(table["covered"])
    _map(figure, axes[1], table, away, "formula - simulation, both scaled")
    return figure


def _poisson(tables):
    """Draw the relative difference of every reading of Poisson targets over ratio and pitch."""
    table = tables["poisson"]
    readings = [n for n in table.colnames if f"{n} error" in table.colnames and n != "uniform"]
    figure, axes = _figure(1, len(readings), size=(4 * len(readings), 4))
    for ax, reading in zip(axes, readings, strict=True):
        _map(figure, ax, table, np.asarray(table["uniform"]) - np.asarray(table[reading]), "uniform - this")
        ax.set_title(reading, fontsize="small")
    return figure


def _map(figure, ax, table, values, label):
    most = np.nanmax(np.abs(values)) or 1.0
    style = {"cmap": "RdBu_r", "vmin": -most, "vmax": most, "edgecolors": "0.5", "linewidths": 0.4}
    points = ax.scatter(table["ratio"], table["pitch"].to_value(u.mm), c=values, **style)
    figure.colorbar(points, ax=ax, label=label)
    ax.set_xlabel("arm ratio")
    ax.set_ylabel("pitch [mm]")


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
