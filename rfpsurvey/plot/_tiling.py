"""Plot of a tiling with a panel for each pass."""

import numpy as np
from astropy.coordinates import SkyCoord
from matplotlib.figure import Figure

from rfpsurvey._units import to_direction
from rfpsurvey.catalog import Catalog
from rfpsurvey.errors import InputTypeError
from rfpsurvey.plot._sky import draw_field, draw_tiles, plot_tiling, radius_of
from rfpsurvey.plot._sky_map import is_wide, map_of, outline_of_region, rims_of
from rfpsurvey.region import Region
from rfpsurvey.tiling import Tiling

MOST_PANELS = 8
WIDTH, PAD = 7.0, 0.08  # inches: width of a page, and margin around the figure
WIDE = 1.6
"""Panels with a larger ratio of width to height are arranged in one column, and all other panels in two columns."""


def draw_tiling(tiling: Tiling, *, targets: Catalog | SkyCoord | None = None, region: Region | None = None) -> Figure:
    """Plot the tiles of each pass in a separate panel; all panels show the same part of the sky.

    Tilings with one pass or with more than eight passes are plotted in one panel, with `plot_tiling`.

    Parameters
    ----------
    tiling : Tiling
        Tiling to plot.
    targets : Catalog or SkyCoord, optional
        Targets to draw as dots.
    region : Region, optional
        Region whose border is drawn.

    Returns
    -------
    matplotlib.figure.Figure
        The figure.

    Raises
    ------
    InputError
        If there are no tiles, or if ``targets`` or ``region`` has a wrong type.

    Examples
    --------
    >>> import rfpsurvey as rs
    >>> tiling = rs.place_tiles(rs.Region.parse("box 100 120 20 30"), "lamost", passes=2)
    >>> [ax.get_title() for ax in rs.plot.draw_tiling(tiling).axes]
    ['pass 1: 23 tiles', 'pass 2: 22 tiles']
    """
    if not isinstance(tiling, Tiling):
        raise InputTypeError(f"tiling must be a Tiling, got {type(tiling).__name__}")
    number = np.asarray(tiling.table["pass"])
    passes = np.unique(number)
    if not 1 < len(passes) <= MOST_PANELS:
        return plot_tiling(tiling, targets=targets, region=region).figure
    if not (region is None or isinstance(region, Region)):
        raise InputTypeError(f"region must be a Region, got {type(region).__name__}")
    if targets is not None:
        targets = to_direction(targets.coord if isinstance(targets, Catalog) else targets, "targets").reshape(-1).icrs
    radius = radius_of(tiling)
    centers = SkyCoord(tiling.table["ra"], tiling.table["dec"])
    whole = is_wide(centers, radius)
    sky_map = map_of(centers, radius, whole=whole)
    low, high = (0, 0), (2, 1)
    if not whole:
        lines = [] if region is None else outline_of_region(region, sky_map)
        points = np.vstack([sky_map.to_xy(rims_of(centers, radius)).reshape(-1, 2), *lines])
        low, high = np.nanmin(points, axis=0), np.nanmax(points, axis=0)
    size = np.subtract(high, low) * (1, sky_map.aspect)
    columns = 1 if size[0] > WIDE * size[1] and not whole else 2
    rows = -(-len(passes) // columns)
    wide = WIDTH / columns
    tall = float(np.clip((wide - 0.8) * size[1] / size[0], 1.0, 1.6 * WIDTH / columns))
    legend = 0.0 if targets is None and region is None else 0.3
    figure = Figure(figsize=(WIDTH, rows * (tall + 0.6) + 0.2 + legend), layout="constrained")
    figure.get_layout_engine().set(w_pad=PAD, h_pad=PAD)
    for k, one in enumerate(passes):
        ax = figure.add_subplot(rows, columns, k + 1, projection="aitoff" if whole else None)
        sky_map.label(ax)
        table = tiling.table[number == one]
        draw_tiles(ax, sky_map, table, radius, "pass", {})
        if not whole:
            margin = 0.03 * (np.asarray(high) - low)
            ax.set(xlim=(high[0] + margin[0], low[0] - margin[0]), ylim=(low[1] - margin[1], high[1] + margin[1]))
            if k + columns < len(passes):
                ax.set_xlabel("")
            if k % columns:
                ax.set_ylabel("")
        handles = list(draw_field(ax, sky_map, targets, region))
        words = f"pass {one}: {len(table)} tile{'' if len(table) == 1 else 's'}"
        ax.set_title(words, pad=12 if whole else None, fontsize="medium")
    if handles:
        figure.legend(handles=handles, loc="outside lower center", ncols=2, fontsize="small", frameon=False)
    return figure
