"""Pictures. matplotlib is imported when the first one is drawn; nothing is ever shown."""

from typing import TYPE_CHECKING

import astropy.units as u
import numpy as np
from astropy.table import QTable

from rfpsurvey._units import to_mm
from rfpsurvey.errors import InputError
from rfpsurvey.tile import Tile

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["plot_focal_plane", "plot_speed_accuracy"]

# the palette of Okabe and Ito, which color-blind people can tell apart, with a plain red for collisions
PATROL, ARM, IDLE, COLLISION, OBSTACLE = "#56B4E9", "#0072B2", "#9A9A9A", "#D00000", "#444444"
SERIES = ("#D00000", "#0072B2", "#E69F00", "#009E73", "#CC79A7", "#56B4E9", "#000000", "#F0E442")


def plot_focal_plane(
    tile: Tile, *, ax: "Axes | None" = None, region: u.Quantity | None = None, **kwargs: object
) -> "Axes":
    """Draw the focal plane of a tile: patrol areas, arms, collisions in red, unassigned positioners in gray.

    The shade around an arm is half the safe distance wide, to scale: two arms collide where their shades overlap.

    Parameters
    ----------
    tile : Tile
        What to draw.
    ax : matplotlib.axes.Axes, optional
        Where to draw; a new square figure by default.
    region : Quantity, shape (2, 2), optional
        Corners ((x0, y0), (x1, y1)) of the part to show; all by default.
    **kwargs
        Passed to the collection of arms, for example ``alpha``.

    Returns
    -------
    matplotlib.axes.Axes
        The axes, in mm.

    Raises
    ------
    InputError
        If ``tile`` is not a Tile or ``region`` has another shape.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astropy.coordinates import SkyCoord
    >>> import rfpsurvey as rs
    >>> center = SkyCoord("6h20m +23d")
    >>> sky = rs.synthetic_catalog("poisson", center, 1.5 * u.deg, density=300 / u.deg**2, rng=1)
    >>> ax = rs.plot_focal_plane(rs.plan_tile(sky, "sdss_apo", center))
    >>> ax.get_xlabel()
    'x (east at position angle 0) [mm]'
    """
    from matplotlib.collections import EllipseCollection, LineCollection, PolyCollection
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D

    if not isinstance(tile, Tile):
        raise InputError(f"tile must be a Tile, got {type(tile).__name__}")
    if ax is None:
        ax = Figure(figsize=(9, 9), layout="constrained").add_subplot()
    table, geometry = tile.table, tile.table.meta["geometry"]
    centers, elbows, tips, ends = (
        np.column_stack([table[f"{name}x"].to_value(u.mm), table[f"{name}y"].to_value(u.mm)])
        for name in ("", "elbow_", "tip_", "arm_")
    )
    assigned = np.isin(table["status"], ("assigned", "out_of_reach"))
    colliding = np.asarray(table["in_collision"])
    present = np.isfinite(tips).all(axis=1)

    def circles(points, radius, **style):
        size = np.broadcast_to(2 * np.asarray(radius, dtype=float), len(points))
        ax.add_collection(
            EllipseCollection(size, size, 0, units="xy", offsets=points, offset_transform=ax.transData, **style)
        )

    handles = []
    patrol = {"facecolors": "none", "linewidths": 0.4}
    outer, inner = (np.broadcast_to(geometry[f"{e}_radius_mm"], len(table)) for e in ("outer", "inner"))
    for rows, color, label in (
        (assigned, PATROL, "patrol area"),
        (~assigned, IDLE, "patrol area, no target"),
    ):
        circles(centers[rows], outer[rows], edgecolors=color, zorder=1, **patrol)
        if rows.any():
            handles.append(
                Line2D([], [], color=color, marker="o", markerfacecolor="none", linestyle="none", label=label)
            )
        if inner.any():
            circles(centers[rows], inner[rows], edgecolors=color, zorder=1, linestyles=":", **patrol)
    obstacles = np.array(geometry["obstacles_mm"]).reshape(-1, 3)
    if len(obstacles):
        circles(obstacles[:, :2], obstacles[:, 2], facecolors=OBSTACLE, zorder=2)
        handles.append(Line2D([], [], color=OBSTACLE, marker="o", linestyle="none", label="obstacle"))
    half = geometry["min_separation_mm"] / 2
    groups = (
        (present & ~assigned & ~colliding, IDLE, "arm, no target", 3),
        (present & assigned & ~colliding, ARM, "arm", 4),
        (present & colliding, COLLISION, "arm in collision", 5),
    )
    for rows, color, label, zorder in groups:
        if not rows.any():
            continue
        central = np.stack([centers[rows], elbows[rows]], axis=1)
        ax.add_collection(LineCollection(central, colors=color, linewidths=0.4, alpha=0.5, zorder=zorder))
        arms = np.stack([elbows[rows], tips[rows]], axis=1)
        style = {"linewidths": 1.0, "capstyle": "round", **kwargs}
        ax.add_collection(LineCollection(arms, colors=color, zorder=zorder, **style))
        # the space that an arm keeps free, to scale
        bodies = [_capsule(a, b, half) for a, b in zip(elbows[rows], ends[rows], strict=True)]
        ax.add_collection(PolyCollection(bodies, facecolors=color, edgecolors="none", alpha=0.2, zorder=zorder - 0.5))
        handles.append(Line2D([], [], color=color, label=label))
        circles(tips[rows], 0.06 * outer[rows], facecolors=color, zorder=zorder)
    _frame(ax, centers, outer.max(), region)
    summary = tile.summary
    ax.set_title(
        f"{tile.provenance['instrument']['name']}: {summary['n_assigned']} of {summary['n_positioners']} assigned, "
        f"{summary['n_colliding']} in collision"
    )
    ax.legend(handles=handles, loc="upper right", fontsize="small", framealpha=0.9)
    return ax


def plot_speed_accuracy(table: QTable, *, axes: "tuple[Axes, Axes] | None" = None) -> "tuple[Axes, Axes]":
    """Draw the time of a tile against errors, a point for each method and number of points.

    Parameters
    ----------
    table : QTable
        What `benchmark_collisions` returns.
    axes : tuple of matplotlib.axes.Axes, optional
        Where to draw misclassified pairs, and the largest error of a distance; a new figure by default.

    Returns
    -------
    tuple of matplotlib.axes.Axes
        Both axes. Zeros are drawn at the lower edge.

    Raises
    ------
    InputError
        If the table has other columns, or there are not two axes.

    Examples
    --------
    >>> import rfpsurvey as rs
    >>> table = rs.benchmark_collisions("sdss_apo", methods=["exact", "sampled"], repeats=1)
    >>> above, below = rs.plot_speed_accuracy(table)
    >>> below.get_xlabel()
    'time of a tile [ms]'
    """
    from matplotlib.figure import Figure

    if not isinstance(table, QTable):
        raise InputError(f"table must be a QTable, got {type(table).__name__}")
    missing = {"method", "n_points", "time", "misclassified", "max_error"} - set(table.colnames)
    if missing:
        raise InputError(f"table must come from benchmark_collisions, but it has no {', '.join(sorted(missing))}")
    if axes is None:
        axes = tuple(Figure(figsize=(7.5, 7), layout="constrained").subplots(2, sharex=True))
    if len(axes) != 2:
        raise InputError(f"axes must be two Axes, got {len(axes)}")
    time, points = table["time"].to_value(u.ms), np.ma.asarray(table["n_points"])
    panels = (
        (np.asarray(table["misclassified"]), "misclassified pairs, for each colliding one"),
        (table["max_error"].to_value(u.mm), "largest error of a distance [mm]"),
    )
    for ax, (values, label) in zip(axes, panels, strict=True):
        seen = values[values > 0]
        floor = 10.0 ** (np.floor(np.log10(seen.min())) - 1) if len(seen) else 1e-16
        for k, method in enumerate(dict.fromkeys(table["method"])):
            rows = np.flatnonzero(table["method"] == method)
            y = np.where(values[rows] > 0, values[rows], floor)
            style = {"color": SERIES[k % len(SERIES)], "marker": "osD^vP*X"[k % 8], "linestyle": ":", "label": method}
            style["markerfacecolor"] = style["color"] if k == 0 else "none"  # let others shine through
            ax.plot(time[rows], y, **style)
            for row, height in zip(rows, y, strict=True):
                if points[row] is not np.ma.masked:
                    where = {"textcoords": "offset points", "xytext": (4, 4), "fontsize": "x-small"}
                    ax.annotate(str(points[row]), (time[row], height), **where)
        ax.set_yscale("log")
        ax.set_xscale("log")
        ax.set_ylabel(label)
        ax.set_ylim(bottom=floor / 2)
        ax.axhspan(floor / 2, 2 * floor, color=IDLE, alpha=0.2, linewidth=0)
        ax.text(0.99, floor, "none", transform=ax.get_yaxis_transform(), ha="right", va="center", fontsize="small")
    axes[0].legend(fontsize="small", ncols=2)
    axes[1].set_xlabel("time of a tile [ms]")
    title = table.meta.get("instrument", "")
    axes[0].set_title(f"{title}: {table.meta.get('n_neighbor_pairs', '?')} pairs of neighbors; labels: points an arm")
    return axes


def _capsule(a, b, radius):
    """Outline of all points within ``radius`` of the segment from a to b."""
    angle = np.arctan2(*(b - a)[::-1]) + np.linspace(-np.pi / 2, np.pi / 2, 9)
    arc = radius * np.column_stack([np.cos(angle), np.sin(angle)])
    return np.vstack([b + arc, a - arc])


def _frame(ax, centers, outer, region):
    if region is None:
        low, high = centers.min(axis=0) - 1.1 * outer, centers.max(axis=0) + 1.1 * outer
    else:
        corners = to_mm(region, "region")
        if corners.shape != (2, 2) or not np.isfinite(corners).all():
            raise InputError(f"region must be two finite corners ((x0, y0), (x1, y1)), got {region}")
        low, high = corners.min(axis=0), corners.max(axis=0)
    ax.set_xlim(low[0], high[0])
    ax.set_ylim(low[1], high[1])
    ax.set_aspect("equal")
    ax.set_xlabel("x (east at position angle 0) [mm]")
    ax.set_ylabel("y (north at position angle 0) [mm]")
