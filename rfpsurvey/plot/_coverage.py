"""Map of the number of positioners that reach each point."""

import astropy.units as u
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.patches import Patch

from rfpsurvey.errors import InputError, check_whole, number_of
from rfpsurvey.focal_plane import FocalPlane
from rfpsurvey.instrument import Instrument
from rfpsurvey.plot._axes import focal_plane_axes, legend_below, limits_of, named_plane
from rfpsurvey.plot._compass import add_compass
from rfpsurvey.plot._style import LEVELS, OUTLINE

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
