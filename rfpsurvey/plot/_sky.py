"""Plots of tiles on the sky, and functions that draw fields, targets and regions."""

import astropy.units as u
import numpy as np
from astropy.coordinates import SkyCoord
from astropy.table import QTable
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.figure import Figure

from rfpsurvey._common.units import to_direction, to_scalar
from rfpsurvey._sky.catalog import Catalog
from rfpsurvey._sky.region import Region
from rfpsurvey._survey.history.events import WORDS
from rfpsurvey._survey.survey import Survey
from rfpsurvey._survey.tiling.tiling import Tiling
from rfpsurvey.errors import InputError, InputTypeError, listed, number_of
from rfpsurvey.plot._axes import (
    COLLISION,
    OPEN_CIRCLE,
    WIDTH,
    legend_below,
    legend_line,
    light_scale,
    new_axes,
    new_figure,
)
from rfpsurvey.plot._classes import STATE_COLORS
from rfpsurvey.plot._sky_map import SkyMap, is_wide, map_of, outline_of_region, outlines_of_whole_sky, rims_of

STATES = {"", *WORDS, *STATE_COLORS}
MOST_STEPS = 12
LARGEST = 7.0  # inches: longer side of the axes
FLAT = 0.45
"""Opacity of tiles that all have the same color, so that their overlaps are visible.

If tiles have several colors, the tiles are opaque, so that their colors match the color bar on every background.
"""


def plot_tiling(
    tiles: Tiling | Survey,
    *,
    color: str | None = None,
    radius: u.Quantity | None = None,
    targets: Catalog | SkyCoord | None = None,
    region: Region | None = None,
    ax: Axes | None = None,
    **kwargs: object,
) -> Axes:
    """Plot tiles on the sky, with east to the left.

    The axes are right ascension and declination or, near a pole, offsets from the mean direction of the tiles. If
    tiles extend to more than 60 deg from their mean direction, the plot is a map of the whole sky. The color scale
    extends from the smallest to the largest value. If tiles overlap, their fields are filled up to a smaller radius, so
    that no tile hides another one; ``rfpsurvey.plot.draw_tiling`` draws a panel for each pass.

    Parameters
    ----------
    tiles : Tiling or Survey
        Tiles to plot.
    color : str, optional
        Column that determines the color; by default the completeness of a survey, or the pass of a tiling. The colors
        of the column ``state`` are those of the report on the state of a survey.
    radius : Quantity, optional
        Radius of a field; by default, the field radius of the survey or of the tiling, or 1 deg if it is unknown.
    targets : Catalog or SkyCoord, optional
        Targets to draw as dots.
    region : Region, optional
        Region whose border is drawn.
    ax : matplotlib.axes.Axes, optional
        Axes to draw on; by default, a new figure is created. Axes with the projection ``aitoff`` show the whole sky.
    **kwargs
        Passed to the collection of fields, for example ``cmap`` or ``alpha``.

    Returns
    -------
    matplotlib.axes.Axes
        The axes.

    Raises
    ------
    InputError
        If there are no tiles, if ``color`` is not a column of numbers, if the radius is out of range, or if ``targets``
        or ``region`` has a wrong type.

    Examples
    --------
    >>> import astropy.units as u
    >>> import rfpsurvey as rs
    >>> region = rs.Region.box(ra=[100, 120] * u.deg, dec=[20, 30] * u.deg)
    >>> ax = rs.plot.plot_tiling(rs.place_tiles(region, "lamost"), region=region)
    >>> ax.get_xlabel()
    'right ascension [deg]'
    """
    if not isinstance(tiles, Tiling | Survey):
        raise InputTypeError(f"tiles must be a Tiling or a Survey, got {type(tiles).__name__}")
    table = tiles.tiles if isinstance(tiles, Survey) else tiles.table
    if len(table) == 0:
        raise InputError("there must be at least one tile to draw, got none")
    color = color or ("completeness" if isinstance(tiles, Survey) else "pass")
    numbers = [name for name in table.colnames if np.asarray(table[name]).dtype.kind in "iufb"]
    states: list[str] = []
    if color == "state" and color in table.colnames and {*table["state"].tolist()} <= STATES:
        table, states, style = _by_state(table)
        kwargs = style | kwargs
    elif color not in numbers:
        raise InputError(f"color must be a column of numbers ({listed(numbers)}), got {color!r}")
    targets = _checked(targets, region)
    radius = radius_of(tiles) if radius is None else to_scalar(radius, u.deg, "radius", low=0, high=90)
    values = np.asarray(table[color], dtype=float)
    levels = np.unique(values[np.isfinite(values)])
    sky_map, rims = map_and_rims(table, radius, ax)
    whole = rims is None
    several = not whole and len(np.unique(np.asarray(table["pass"]))) > 1
    if ax is None:
        ax = _new_axes(sky_map, rims, scale=len(levels) > 1, legend=several or not (targets is None and region is None))
    sky_map.label(ax)
    draw_tiles(ax, sky_map, table, radius, color, kwargs)
    for scale in ax.child_axes if states else ():
        scale.set_yticks(range(len(states)), labels=states)
    handles = list(draw_field(ax, sky_map, targets, region))
    if several:
        style = {**OPEN_CIRCLE, "markersize": 8, "markeredgecolor": "0.3"}
        handles.insert(0, legend_line(label="field (the fill is smaller where tiles overlap)", **style))
    legend_below(ax, handles)
    only = f", {color.replace('_', ' ')} {levels[0]:.4g}" if len(levels) == 1 and color != "pass" else ""
    ax.set_title(number_of(len(table), "tile") + only, pad=14 if whole else None)
    return ax


def map_and_rims(table: QTable, radius: float, ax: Axes | None) -> tuple[SkyMap, np.ndarray | None]:
    """Return the map of the tiles in a table and the edges of their fields; None for edges on a map of the whole sky.

    The map shows the whole sky if the given axes do or, without axes, if the fields require it.
    """
    centers = SkyCoord(table["ra"], table["dec"])
    whole = is_wide(centers, radius) if ax is None else ax.name == "aitoff"
    sky_map = map_of(centers, radius, whole=whole)
    return sky_map, None if whole else sky_map.to_xy(rims_of(centers, radius))


def _checked(targets, region) -> SkyCoord | None:
    """Return the directions of targets; raise an error if the targets or the region have a wrong type."""
    if not (region is None or isinstance(region, Region)):
        raise InputTypeError(f"region must be a Region, got {type(region).__name__}")
    if targets is None:
        return None
    return to_direction(targets.coord if isinstance(targets, Catalog) else targets, "targets").reshape(-1).icrs


def radius_of(tiles: Tiling | Survey) -> float:
    """Return the radius of a field in deg, or 1 deg if it is unknown."""
    if isinstance(tiles, Survey):
        return tiles.provenance["parameters"]["radius_deg"]
    return float(tiles.summary.get("radius_deg", 1.0))


def _new_axes(sky_map, rims, *, scale, legend):
    """Return the axes of a new figure, with the aspect ratio of the tiled area."""
    if rims is None:
        return new_axes(8, 5.0 if legend else 4.6, projection="aitoff")
    beside = 1.9 if scale else 1.0
    wide, tall = np.ptp(rims.reshape(-1, 2), axis=0)
    inside = 7.0 - beside
    height = min(inside * tall * sky_map.aspect / wide, LARGEST)
    width = min(inside, height * wide / (tall * sky_map.aspect))
    return new_axes(max(width, 2.5) + beside, max(height, 1.4) + (1.35 if legend else 1.0))


def _filled(centers: SkyCoord, number: np.ndarray, radius: float) -> np.ndarray:
    """Return the radius up to which each field is filled, so that no tile hides another one.

    The fill of a field ends half way to the next tile of its pass, and is smaller in later passes.
    """
    passes, rank = np.unique(number, return_inverse=True)
    step, half = min(0.25, 0.6 / max(len(passes) - 1, 1)), np.full(len(number), np.inf)
    for k in range(len(passes)):
        if (rows := np.flatnonzero(rank == k)).size > 1:
            half[rows] = centers[rows].match_to_catalog_sky(centers[rows], 2)[1].deg / 2
    return np.clip(half, SMALLEST * radius, radius) * (1 - step * rank.reshape(-1))


def draw_tiles(ax: Axes, sky_map: SkyMap, table: QTable, radius: float, name: str, kwargs: dict) -> None:
    """Draw tiles that are colored by the values of a column.

    If there are several values, draw a color bar. If the values are a few whole numbers, each value has its own color.
    """
    order = np.argsort(np.asarray(table["pass"]), kind="stable")
    table = table[order]
    centers, values = SkyCoord(table["ra"], table["dec"]), np.asarray(table[name], dtype=float)
    levels = np.unique(values[np.isfinite(values)])
    inner = _filled(centers, np.asarray(table["pass"]), radius) if len(levels) > 1 else np.full(len(table), radius)
    if sky_map.kind == "whole":
        rims = None
        polygons, row_of = outlines_of_whole_sky(centers, inner)
        values = values[row_of]
    else:
        rims, polygons = sky_map.to_xy(rims_of(centers, radius)), list(sky_map.to_xy(rims_of(centers, inner)))
    whole = rims is None
    steps = 1 < len(levels) <= MOST_STEPS and (levels == np.rint(levels)).all()
    style = {"cmap": light_scale(), "alpha": None if len(levels) > 1 else FLAT, "ec": "face", "lw": 0.2 if whole else 0}
    if steps:
        edges = np.concatenate([[levels[0] - 0.5], (levels[1:] + levels[:-1]) / 2, [levels[-1] + 0.5]])
        style["norm"] = BoundaryNorm(edges, 256)
    elif len(levels) == 1:
        style["clim"] = (levels[0] - 1, levels[0] + 1)  # the color at the center of the scale
    elif len(levels):
        style["clim"] = (levels[0], levels[-1])
    if whole:  # the edges are projected here, because the axes would put thousands of points on every edge
        polygons = [ax.transProjection.transform(polygon) for polygon in polygons]
        style["transform"] = ax.transAffine + ax.transAxes
    drawn = PolyCollection(polygons, array=values, **{**style, **kwargs})
    ax.add_collection(drawn, autolim=not whole)
    if not whole:
        draw_rims(ax, rims, zorder=2)
        ax.autoscale_view()
        ax.xaxis.set_inverted(True)
    if len(levels) > 1:
        place = ax.inset_axes([1.04, 0.1, 0.025, 0.8] if whole else [1.02, 0, 0.025, 1])
        scale = ax.figure.colorbar(drawn, cax=place, label=name.replace("_", " "))
        if steps:
            scale.set_ticks(levels, labels=[f"{level:g}" for level in levels])


def _by_state(table: QTable) -> tuple[QTable, list[str], dict]:
    """Return a table of tiles whose states are numbers, the names of these states, and the style of the tiles."""
    words = [WORDS.get(state, state) or "planned" for state in table["state"].tolist()]
    names = [name for name in STATE_COLORS if name in words]
    table = table.copy()
    table["state"] = [names.index(word) for word in words]
    norm = BoundaryNorm(np.arange(-0.5, len(names)), len(names))
    return table, names, {"cmap": ListedColormap([STATE_COLORS[name] for name in names]), "norm": norm, "alpha": None}


def draw_rims(ax: Axes, rims: np.ndarray, zorder: float) -> None:
    """Draw the edges of fields."""
    closed = np.concatenate([rims, rims[:, :1]], axis=1)
    ax.add_collection(LineCollection(closed, colors="0.3", linewidths=0.6 if len(rims) < 300 else 0.3, zorder=zorder))


def draw_field(ax, sky_map: SkyMap, targets, region):
    """Draw targets and the border of a region, and yield legend entries."""
    lines = [] if region is None else outline_of_region(region, sky_map)
    for line in lines:
        ax.plot(*line.T, color=COLLISION, linewidth=1.6, zorder=3)
    if lines:
        yield legend_line(color=COLLISION, linewidth=1.6, label="region")
    if targets is not None and len(targets):
        limits = ax.get_xlim(), ax.get_ylim()
        size = float(np.clip(60 / np.sqrt(len(targets)), 0.5, 2.5))
        style = {"linestyle": "none", "marker": "o", "markeredgewidth": 0, "color": "black"}
        ax.plot(*sky_map.to_xy(targets).T, markersize=size, alpha=0.6, zorder=2.5, **style)
        if sky_map.kind != "whole":  # maps of the whole sky have fixed limits
            ax.set(xlim=limits[0], ylim=limits[1])
        yield legend_line(markersize=3, label=number_of(len(targets), "target"), **style)


SMALLEST = 0.3
"""Smallest part of the radius of a field that is filled."""
MOST_PANELS = 8
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
    targets = _checked(targets, region)
    radius = radius_of(tiling)
    sky_map, rims = map_and_rims(tiling.table, radius, None)
    whole, low, high = rims is None, (0, 0), (2, 1)
    if not whole:
        lines = [] if region is None else outline_of_region(region, sky_map)
        points = np.vstack([rims.reshape(-1, 2), *lines])
        low, high = np.nanmin(points, axis=0), np.nanmax(points, axis=0)
    size = np.subtract(high, low) * (1, sky_map.aspect)
    columns = 1 if size[0] > WIDE * size[1] and not whole else 2
    rows = -(-len(passes) // columns)
    wide = WIDTH / columns
    tall = float(np.clip((wide - 0.8) * size[1] / size[0], 1.0, 1.6 * WIDTH / columns))
    legend = 0.0 if targets is None and region is None else 0.3
    figure = new_figure(WIDTH, rows * (tall + 0.6) + 0.2 + legend)
    for k, pass_number in enumerate(passes):
        ax = figure.add_subplot(rows, columns, k + 1, projection="aitoff" if whole else None)
        sky_map.label(ax)
        table = tiling.table[number == pass_number]
        draw_tiles(ax, sky_map, table, radius, "pass", {})
        if not whole:
            sky_map.show(ax, low, high)
            if k + columns < len(passes):
                ax.set_xlabel("")
            if k % columns:
                ax.set_ylabel("")
        handles = list(draw_field(ax, sky_map, targets, region))
        words = f"pass {pass_number}: {len(table)} tile{'' if len(table) == 1 else 's'}"
        ax.set_title(words, pad=12 if whole else None, fontsize="medium")
    if handles:
        figure.legend(handles=handles, loc="outside lower center", ncols=2, fontsize="small", frameon=False)
    return figure
