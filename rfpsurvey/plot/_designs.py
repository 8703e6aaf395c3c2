"""Coverage against loss of many designs, and the front among them."""

from typing import TYPE_CHECKING

import numpy as np
from astropy.table import QTable

from rfpsurvey.errors import InputError, check_choice
from rfpsurvey.plot._style import COLLISION

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["plot_designs"]

LABELS = {
    "l1": "central arm", "l2": "eccentric arm", "ratio": "eccentric over central arm", "clearance": "clearance",
    "min_separation": "safe distance D", "multiplicity": "patrol area over cell", "loss": "fibers lost to collisions",
    "coverage": "part of the focal plane in reach", "usable": "fibers on targets, per positioner",
    "usable_per_area": "fibers on targets, per area", "positioners_per_area": "positioners per area",
}  # fmt: skip


def plot_designs(
    table: QTable,
    *,
    x: str | None = None,
    y: str | None = None,
    color: str | None = None,
    mark: dict[str, QTable] | None = None,
    ax: "Axes | None" = None,
    **kwargs: object,
) -> "Axes":
    """Draw two figures of all designs against each other, and those that no other design beats.

    Parameters
    ----------
    table : QTable
        What `explore_designs` returns.
    x, y : str, optional
        Columns; the objectives by default. The front is that of the objectives, whatever is drawn, and is joined by
        a line where these are drawn.
    color : str, optional
        Column that gives the color; by default the parameter with most values, ``ratio`` before others.
    mark : dict of str to QTable, optional
        Designs to point out by name, such as an instrument that is there: tables of one design, or of a few, by
        `explore_designs` with the same targets.
    ax : matplotlib.axes.Axes, optional
        Where to draw; a new figure by default.
    **kwargs
        Passed to ``Axes.scatter``.

    Returns
    -------
    matplotlib.axes.Axes
        The axes.

    Raises
    ------
    InputError
        If a table does not come from `explore_designs`, a column is missing, or designs to mark answer another
        question.

    Examples
    --------
    >>> import astropy.units as u
    >>> import rfpsurvey as rs
    >>> table = rs.explore_designs(l1=[7, 8, 9] * u.mm, ratio=1.5, pitch=25 * u.mm, clearance=2 * u.mm)
    >>> rs.plot_designs(table).get_ylabel()
    'fibers lost to collisions (independent)'
    """
    from matplotlib.figure import Figure

    for one in (table, *(mark or {}).values()):
        if not isinstance(one, QTable) or "loss" not in one.colnames or "objectives" not in one.meta:
            raise InputError("table, and each in mark, must be what explore_designs returns")
        if _question(one) != _question(table):
            raise InputError(f"mark must answer the same question as table: {_question(one)}, not {_question(table)}")
    objectives = list(table.meta["objectives"])
    x, y = (o if name is None else name for name, o in zip((x, y), objectives, strict=True))
    numbers = [name for name in table.colnames if table[name].dtype.kind in "if"]
    color = _parameter(table) if color is None else color
    for name in (x, y, color):
        check_choice(name, numbers, "column of designs")
    if ax is None:
        ax = Figure(figsize=(7, 5), layout="constrained").add_subplot()
    front, values, (across, up) = np.asarray(table["pareto"]), _plain(table, color), (_plain(table, n) for n in (x, y))
    style = {"vmin": np.nanmin(values), "vmax": np.nanmax(values), "cmap": "viridis", "s": 14, "linewidths": 0}
    style |= {"alpha": 0.35, **kwargs}
    ax.scatter(across, up, c=values, **style)
    if {x, y} == set(objectives):
        order = np.flatnonzero(front)[np.argsort(across[front], kind="stable")]
        ax.plot(across[order], up[order], color="black", linewidth=0.8, zorder=2.5)
    style |= {"s": 3 * style["s"], "linewidths": 0.8, "edgecolors": "black", "alpha": 1.0, "zorder": 3}
    points = ax.scatter(across[front], up[front], c=values[front], **style)
    for name, one in (mark or {}).items():
        ax.scatter(_plain(one, x), _plain(one, y), marker="*", s=140, color=COLLISION, edgecolors="white", zorder=4)
        where = {"textcoords": "offset points", "xytext": (7, 5), "fontsize": "small", "zorder": 5}
        ax.annotate(name, (_plain(one, x)[0], _plain(one, y)[0]), **where)
    ax.set_xlabel(_label(table, x))
    ax.set_ylabel(_label(table, y))
    ax.figure.colorbar(points, ax=ax, label=_label(table, color))
    return ax


def _question(table):
    """Return what the losses of a table are, in words."""
    asked = table.meta["request"]
    targets = f", {asked['targets']:g} targets a {'mm^2' if asked['by_area'] else 'positioner'}"
    return asked["estimand"] + ("" if asked["estimand"] == "independent" else targets)


def _plain(table, name):
    return np.asarray(getattr(table[name], "value", table[name]), dtype=float)


def _parameter(table):
    """Return the parameter that has most values."""
    return max(("ratio", "pitch", "l1", "clearance"), key=lambda name: len(np.unique(_plain(table, name))))


def _label(table, name):
    text, unit = LABELS.get(name, name.replace("_", " ")), getattr(table[name], "unit", None)
    of = f" ({_question(table).replace('_', ' ')})" if name in ("loss", "usable", "usable_per_area") else ""
    return f"{text}{of}" + (f" [{unit:unicode}]" if unit else "")
