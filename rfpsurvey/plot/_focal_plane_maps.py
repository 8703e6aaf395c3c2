"""Maps of the focal plane: the number of positioners that reach each point, and collisions."""

import astropy.units as u
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.patches import Patch

from rfpsurvey._common.units import to_plain
from rfpsurvey._field.tile import Tile
from rfpsurvey._instruments.count_collisions import CollisionCounts
from rfpsurvey._instruments.focal_plane import FocalPlane
from rfpsurvey._instruments.instrument import Instrument, as_focal_plane
from rfpsurvey._instruments.motion import CollisionReport
from rfpsurvey._studies.question import Estimate
from rfpsurvey.errors import InputError, check_whole, number_of
from rfpsurvey.plot._axes import (
    COLLISION,
    HATCH,
    IDLE,
    LEVELS,
    OPEN_CIRCLE,
    OUTLINE,
    PROBABILITY_COLORS,
    add_circles,
    add_compass,
    focal_plane_axes,
    legend_below,
    legend_line,
    limits_of,
    named_plane,
    points_per_unit,
    position_angle_of,
    spacing_of,
)

N_POINTS = 2**18
"""Number of random points from which the fractions in the legend are computed, with standard errors below 0.001."""
FEWEST, MOST = 600, 1400  # limits of the default number of pixels along the longer side


def plot_coverage(
    instrument: FocalPlane | Instrument | str,
    *,
    ax: Axes | None = None,
    region: u.Quantity | None = None,
    n_pixels: int | None = None,
    orientation: str = "sky",
    **kwargs: object,
) -> Axes:
    """Plot the number of positioners that reach each point; darker colors show larger numbers.

    The dashed line is the edge of the footprint, which is the convex hull of the centers of the positioners. White
    points inside the footprint are points that no positioner reaches. The legend shows the fraction of the footprint
    for each number of positioners, as computed by `~rfpsurvey.FocalPlane.coverage`. The darkest blue shows the largest
    number.

    Parameters
    ----------
    instrument : FocalPlane, Instrument or str
        The positioners; a str is the name of a preset. Positioners that are disabled or stuck reach no points.
    ax : matplotlib.axes.Axes, optional
        Axes to draw on; by default, a new figure with the legend below the axes is created.
    region : Quantity, shape (2, 2), optional
        Corners ((x0, y0), (x1, y1)) of the part to show; the whole focal plane by default. The legend always refers
        to the whole footprint.
    n_pixels : int, optional
        Number of pixels along the longer side; by default from 600 to 1400, depending on the size of the patrol areas.
    orientation : {"sky", "focal plane"}, optional
        With ``"sky"``, east is to the left of north, as on the sky, and x increases to the left. With
        ``"focal plane"``, x increases to the right.
    **kwargs
        Passed to ``imshow``, for example ``alpha``.

    Returns
    -------
    matplotlib.axes.Axes
        The axes, in mm.

    Raises
    ------
    InputError
        If ``instrument`` is not an instrument, or if ``region`` or ``n_pixels`` is out of range.

    Examples
    --------
    >>> import rfpsurvey as rs
    >>> ax = rs.plot.plot_coverage("lamost")
    >>> [text.get_text() for text in ax.get_legend().get_texts()][1]
    '1 positioner (54 %)'
    """
    if n_pixels is not None:
        check_whole(n_pixels, "n_pixels", 1, 5000)
    name, plane = named_plane(instrument)
    ax = focal_plane_axes(ax, plane.arrays.xy, plane.arrays.outer_radius, region, orientation)
    low, high = limits_of(ax)
    if n_pixels is None:
        n_pixels = np.clip(10 * (high - low).max() / np.min(plane.arrays.outer_radius), FEWEST, MOST)
    nx, ny = np.maximum(1, np.rint(n_pixels * (high - low) / (high - low).max())).astype(int)
    x, y = (a + (b - a) * (np.arange(k) + 0.5) / k for a, b, k in zip(low, high, (nx, ny), strict=True))
    points = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    counts = plane.multiplicity(points * u.mm).reshape(ny, nx)
    top = len(LEVELS) - 1
    parts = _parts(plane, top)
    most = min(top, max(counts.max(), 0 if parts is None else np.flatnonzero(parts).max()))
    colors = _colors(most)
    style = {"cmap": ListedColormap(colors), "norm": BoundaryNorm(np.arange(most + 2) - 0.5, most + 1)}
    # average the colors of data pixels that share a pixel of the screen
    style |= {"interpolation": "auto", "interpolation_stage": "rgba", **kwargs}
    extent = (low[0], high[0], low[1], high[1])
    ax.imshow(np.minimum(counts, top), origin="lower", extent=extent, zorder=0, **style)
    if parts is not None:
        _outline(ax, plane)
    handles = []
    for k in range(most + 1):
        label = number_of(k, "positioner") if k else "no positioner"
        label = f"{k} or more" if k == top else label
        if parts is not None:
            label += f" ({_percent(parts[k])})"
        handles.append(Patch(facecolor=colors[k], edgecolor="0.5", linewidth=0.5, label=label))
    legend_below(ax, handles)
    add_compass(ax, 0.0, plane.arrays.xy)
    ax.set_title(f"{name}: positioners that reach each point" if name else "positioners that reach each point")
    return ax


def _colors(most):
    """Return a color for each number of positioners from 0 to ``most``; the colors are as different as possible."""
    last = min(len(LEVELS) - 1, 2 * most + 1)
    return [LEVELS[k] for k in np.rint(np.linspace(0, last, most + 1)).astype(int)] if most else [LEVELS[0]] * 2


def _parts(plane, top):
    """Return the fractions of the footprint that exactly 0, 1, 2, ... positioners reach.

    The last fraction is for ``top`` or more positioners.
    """
    try:
        parts = plane.coverage(n_points=N_POINTS)
    except InputError:
        return None
    full = np.zeros(top + 1)
    full[: len(parts)] = parts[: top + 1]
    full[top] += parts[top + 1 :].sum()
    return full


def _outline(ax, plane):
    """Draw the footprint: the convex hull of the centers."""
    from scipy.spatial import ConvexHull

    corners = plane.arrays.xy[ConvexHull(plane.arrays.xy).vertices]
    ax.plot(*np.vstack([corners, corners[:1]]).T, color=OUTLINE, linestyle="--", linewidth=0.9, label="footprint")


def _percent(part):
    """Return a fraction as text in percent with two significant digits, or as ``< 0.1 %`` or ``100 %``."""
    percent = 100 * part
    return "0 %" if percent == 0 else "< 0.1 %" if percent < 0.1 else f"{percent:.2g} %" if percent < 99.5 else "100 %"


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
    is_one_configuration = values.dtype.kind == "b"
    beside = 0.0 if is_one_configuration else COLOR_BAR
    ax = focal_plane_axes(ax, centers, outer, region, orientation, beside=beside)
    radius = 0.48 * spacing_of(centers, outer)
    if is_one_configuration:
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
    title = f"{int(flags.sum())} of {len(flags)} positioners in collision, {number_of(len(pairs), 'pair')}"
    return flags, pairs, "", title


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
