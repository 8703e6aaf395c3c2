"""The focal plane of a tile."""

from typing import TYPE_CHECKING

import astropy.units as u
import numpy as np

from rfpsurvey._units import to_mm
from rfpsurvey.errors import InputError
from rfpsurvey.plot._style import ARM, COLLISION, IDLE, OBSTACLE, PATROL
from rfpsurvey.tile import Tile

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["plot_focal_plane"]


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
