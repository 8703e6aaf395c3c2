"""Map of collisions on the focal plane."""

import astropy.units as u
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.patches import Patch

from rfpsurvey._units import to_plain
from rfpsurvey.collision import CollisionCounts, CollisionReport
from rfpsurvey.errors import InputError, number_of
from rfpsurvey.focal_plane import FocalPlane
from rfpsurvey.instrument import Instrument, as_focal_plane
from rfpsurvey.plot._axes import add_circles, focal_plane_axes, legend_below, legend_line, points_per_unit, spacing_of
from rfpsurvey.plot._compass import add_compass, position_angle_of
from rfpsurvey.plot._style import COLLISION, HATCH, IDLE, OPEN_CIRCLE, OUTLINE, PROBABILITY_COLORS
from rfpsurvey.probability import Estimate
from rfpsurvey.tile import Tile

COLOR_BAR = 0.95  # inches
SMALL = 4.0
"""Disks with a smaller diameter (points, 1/72 inch) have no edges, because edges would hide their colors."""


def plot_collision_map(
    collisions: Estimate | CollisionCounts | CollisionReport | Tile | np.ndarray,
    instrument: FocalPlane | Instrument | str | None = None,
    *,
    ax: Axes | None = None,
    region: u.Quantity | None = None,
    orientation: str = "sky",
    **kwargs: object,
) -> Axes:
    """Plot the collision probability of each positioner or, for one configuration, the positioners in collision.

    Each positioner is a disk. The disk is not filled if the positioner is not counted, which means that the
    positioner never has a target and is never parked. The color scale extends from the smallest to the largest
    probability. Inside a regular lattice without gaps, the expected probability is the same everywhere; the values of a
    simulation then differ only by chance. For one configuration, the disks of positioners in collision are hatched, and
    lines connect the positioners that collide with each other.

    Parameters
    ----------
    collisions : Estimate, CollisionCounts, CollisionReport, Tile or array_like, shape (n,)
        Result to plot. An array contains a probability (NaN if the positioner is not counted) or a boolean for each
        positioner.
    instrument : FocalPlane, Instrument or str, optional
        The positioners; a str is the name of a preset. If ``collisions`` is a Tile, which contains its own positioners,
        ``instrument`` must be None.
    ax : matplotlib.axes.Axes, optional
        Axes to draw on; by default, a new figure is created.
    region : Quantity, shape (2, 2), optional
        Corners ((x0, y0), (x1, y1)) of the part to show; the whole focal plane by default.
    orientation : {"sky", "focal plane"}, optional
        With ``"sky"``, east is to the left of north, as on the sky, and x increases to the left. With
        ``"focal plane"``, x increases to the right.
    **kwargs
        Passed to the collection of disks, for example ``cmap`` or ``clim``.

    Returns
    -------
    matplotlib.axes.Axes
        The axes, in mm.

    Raises
    ------
    InputError
        If the focal plane is missing, if its number of positioners differs from the number of values, or if a value is
        not a probability.

    Examples
    --------
    >>> import astropy.units as u
    >>> import rfpsurvey as rs
    >>> robot = rs.Positioner(8.25 * u.mm, 8.25 * u.mm, 2.25 * u.mm)
    >>> plane = rs.FocalPlane.hexagonal(robot, rings=3, pitch=25.6 * u.mm)
    >>> estimate = rs.collision_probability(plane, method="quadrature")
    >>> rs.plot.plot_collision_map(estimate, plane).get_title().split(":")[0]
    'quadrature, independent targets'
    """
    centers, outer = _places(collisions, instrument)
    values, pairs, label, title = _values(collisions)
    if values.shape != (len(centers),):
        raise InputError(f"collisions must have a value for each of the {len(centers)} positioners, got {values.shape}")
    with np.errstate(invalid="ignore"):
        if values.dtype.kind == "f" and ((values < 0) | (values > 1)).any():
            raise InputError(f"probabilities must lie from 0 to 1, got {np.nanmin(values):g} to {np.nanmax(values):g}")
    one = values.dtype.kind == "b"
    beside = 0.0 if one else COLOR_BAR
    ax = focal_plane_axes(ax, centers, outer, region, orientation, beside=beside)
    radius = 0.48 * spacing_of(centers, outer)
    if one:
        _draw_flags(ax, centers, radius, values, pairs, kwargs)
    else:
        _draw_probabilities(ax, centers, radius, values, label, kwargs)
    add_compass(ax, position_angle_of(collisions), centers)
    ax.set_title(title)
    return ax


def _places(collisions, instrument):
    """Return the centers of the positioners and the outer radii of their patrol areas, in mm."""
    if isinstance(collisions, Tile):
        if instrument is not None:
            raise InputError("instrument must be None for a Tile, which has its own positioners")
        table = collisions.table
        centers = np.column_stack([table["x"].to_value(u.mm), table["y"].to_value(u.mm)])
        return centers, np.asarray(table.meta["geometry"]["outer_radius_mm"])
    if instrument is None:
        raise InputError(
            f"instrument must be given: {type(collisions).__name__} does not contain the positions of the positioners"
        )
    plane = as_focal_plane(instrument)
    return plane.arrays.xy, plane.arrays.outer_radius


def _values(collisions):
    """Return the value of each positioner, the colliding pairs, and the labels of the color bar and of the plot."""
    none = np.empty((0, 2), dtype=int)
    if isinstance(collisions, Estimate):
        e = collisions
        interval = "" if np.isnan(e.low) else f" [{e.low:.4f}, {e.high:.4f}]"
        title = f"{e.method}, {e.estimand} targets: {e.value:.4f}{interval}"
        return e.per_positioner, none, "collision probability", title
    if isinstance(collisions, CollisionCounts):
        n = len(collisions)
        if n == 0:
            raise InputError("there must be at least one configuration, got none")
        return collisions.per_positioner / n, none, "fraction of configurations in collision", f"{n} configurations"
    if isinstance(collisions, CollisionReport):
        return _flags(collisions.in_collision, collisions.pairs)
    if isinstance(collisions, Tile):
        row = {name: k for k, name in enumerate(collisions.table["id"].astype(str).tolist())}
        partners = enumerate(collisions.table["colliding_with"].tolist())
        pairs = [(k, row[name]) for k, names in partners for name in names.split() if k < row.get(name, -1)]
        return _flags(np.asarray(collisions.table["in_collision"]), np.array(pairs, dtype=int).reshape(-1, 2))
    try:
        values = to_plain(collisions)
        values = values if values.dtype.kind == "b" else values.astype(float)
    except (TypeError, ValueError):
        raise InputError(
            "collisions must be an Estimate, CollisionCounts, a CollisionReport, a Tile or one number per positioner, "
            f"got {type(collisions).__name__}"
        ) from None
    return values, none, "collision probability", ""


def _flags(flags, pairs):
    return (
        flags,
        pairs,
        "",
        f"{int(flags.sum())} of {len(flags)} positioners in collision, {number_of(len(pairs), 'pair')}",
    )


def _draw_probabilities(ax, centers, radius, values, label, kwargs):
    """Draw a disk for each positioner, colored by its value, and draw a color bar."""
    known = np.isfinite(values)
    low, high = values[known].min(initial=1.0), values[known].max(initial=0.0)
    # the scale starts below the smallest value, which would otherwise have the color of the background
    limits = (max(low - 0.15 * (high - low), 0.0), high) if low < high else (0.0, high or 1.0)
    small = radius * points_per_unit(ax) < SMALL
    edges = {"edgecolors": "none"} if small else {"edgecolors": "0.6", "linewidths": 0.2}
    style = {"cmap": PROBABILITY_COLORS, "clim": limits, **edges, **kwargs}
    drawn = add_circles(ax, centers[known], radius / 0.96 if small else radius, array=values[known], **style)
    ax.figure.colorbar(drawn, cax=ax.inset_axes([1.02, 0, 0.03, 1]), label=label)
    if not known.all():
        add_circles(ax, centers[~known], radius, facecolors="none", edgecolors=IDLE, linestyles="--", linewidths=0.8)
        legend_below(ax, [legend_line(color=IDLE, label="not counted", **OPEN_CIRCLE)])


def _draw_flags(ax, centers, radius, flags, pairs, kwargs):

    add_circles(ax, centers[~flags], radius, facecolors="none", edgecolors=IDLE, linewidths=0.5)
    handles = [legend_line(color=IDLE, label="no collision", **OPEN_CIRCLE)]
    if flags.any():
        style = {"facecolors": COLLISION, "edgecolors": "white", "hatch": HATCH, "linewidths": 0, **kwargs}
        add_circles(ax, centers[flags], radius, **style)
        handles.append(Patch(facecolor=COLLISION, edgecolor="white", hatch=HATCH, linewidth=0, label="in collision"))
    if len(pairs):
        ax.add_collection(LineCollection(centers[pairs], colors=OUTLINE, linewidths=1.5, zorder=3))
        handles.append(legend_line(color=OUTLINE, linewidth=1.5, label="colliding pair"))
    legend_below(ax, handles)
