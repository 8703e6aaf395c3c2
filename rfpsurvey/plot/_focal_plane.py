"""Plots of focal planes with their arms, and plots of the targets of a tile or of a survey on the sky."""

import astropy.units as u
import numpy as np
from astropy.coordinates import SkyCoord
from matplotlib.axes import Axes

from rfpsurvey._common.units import to_points_mm
from rfpsurvey._field.tile import Tile
from rfpsurvey._field.verdicts import OUTCOMES
from rfpsurvey._instruments.focal_plane import FocalPlane
from rfpsurvey._instruments.instrument import Instrument
from rfpsurvey._sky.catalog import Catalog
from rfpsurvey._sky.partitions import PartitionedCatalog, as_catalog
from rfpsurvey._survey.survey import Survey
from rfpsurvey.errors import InputError, InputTypeError, check_choice
from rfpsurvey.plot import _axes, _scene
from rfpsurvey.plot._classes import ASSIGNED, COLORINGS, draw_layers, layers_of, legend_options
from rfpsurvey.plot._sky import draw_rims, map_and_rims, radius_of
from rfpsurvey.plot._sky_map import SkyMap

LARGEST = 6.2  # inches: longer side of the axes
SMALLEST, NARROWEST = 0.1, 0.1
"""Smallest extent of the axes in deg, and smallest ratio of the shorter side to the longer side."""
HEIGHT_OF_ROW = 0.23  # inches, height of a row of the legend


def plot_targets(
    result: Tile | Survey,
    catalog: Catalog | PartitionedCatalog | None = None,
    *,
    color: str = "outcome",
    ax: Axes | None = None,
    **kwargs: object,
) -> Axes:
    """Plot all targets of a tile or of a survey on the sky, with east to the left, by outcome or by class.

    The legend contains the numbers of targets. In plots by kind, category or priority, assigned targets are larger
    dots, and other targets are smaller dots of the same color. The axes of a tile are offsets from its center. The axes
    of a survey are the same as in `plot_tiling`. Circles show the fields of the survey, except on a map of the whole
    sky.

    Parameters
    ----------
    result : Tile or Survey
        Tile or survey to plot. A tile must have `outcomes <rfpsurvey.Tile.outcomes>`.
    catalog : Catalog or PartitionedCatalog, optional
        The catalog of the survey, which contains the positions of its targets. For a tile, ``catalog`` must be None.
    color : {"outcome", "kind", "category", "priority"}, optional
        Property of targets that determines the colors.
    ax : matplotlib.axes.Axes, optional
        Axes to draw on; by default, a new figure is created. The legend is below the axes. Axes with the projection
        ``aitoff`` show the whole sky.
    **kwargs
        Passed to the dots, for example ``s`` or ``alpha``.

    Returns
    -------
    matplotlib.axes.Axes
        The axes, in deg.

    Raises
    ------
    InputError
        If the tile has no outcomes, if the catalog is missing or is not the catalog of the survey, or if the targets do
        not have the property ``color``.

    See Also
    --------
    plot_focal_plane : Plot targets on the focal plane, with ``targets="outcome"``.
    plot_quality : Plot the numbers of assigned targets of each class.
    plot_tiling : Plot the tiles of a survey on the sky.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astropy.coordinates import SkyCoord
    >>> import rfpsurvey as rs
    >>> center = SkyCoord("6h20m +23d")
    >>> sky = rs.synthetic_catalog("poisson", center, 1.4 * u.deg, density=300 / u.deg**2, rng=1)
    >>> ax = rs.plot.plot_targets(rs.plan_tile(sky, "sdss_apo", center))
    >>> ax.get_xlabel()
    'east of 95.0 +23.0 [deg]'
    """
    check_choice(color, COLORINGS, "color")
    if isinstance(result, Tile):
        if catalog is not None:
            raise InputError("catalog must be None for a Tile, which has the positions of its targets")
        table = outcomes_of(result)
        coord, outcome = SkyCoord(table["ra"], table["dec"]), codes_of(table)
        columns = {name: table[name] for name in COLORINGS[1:] if name in table.colnames}
        sky_map, rims = SkyMap("offsets", result.center), None
    elif isinstance(result, Survey):
        catalog = _catalog_of(result, catalog)
        coord, outcome = catalog.coord, np.asarray(result.outcomes["outcome"])
        columns = {name: getattr(catalog, name) for name in COLORINGS[1:]}
        sky_map, rims = map_and_rims(result.tiles, radius_of(result), ax)
    else:
        raise InputTypeError(f"result must be a Tile or a Survey, got {type(result).__name__}")
    layers = layers_of(color, outcome, columns)
    xy = sky_map.to_xy(coord.icrs)
    labels = [layer.label for layer in layers if layer.label]
    options = legend_options(color, labels)
    if ax is None:
        ax = _new_axes(sky_map, xy, rims, -(-len(labels) // options["columns"]) + 1)
    sky_map.label(ax)
    sky_map.show(ax, *_extent(xy, rims))
    if rims is not None:
        draw_rims(ax, rims, zorder=4)
    _axes.legend_below(ax, list(draw_layers(ax, xy, layers, kwargs, below=2.0, above=3.0)), **options)
    name, done = result.provenance["instrument"]["name"], np.isin(outcome, ASSIGNED).sum()
    ax.set_title(f"{name}: {done} of {len(xy)} targets assigned", pad=14 if sky_map.kind == "whole" else None)
    return ax


def outcomes_of(tile: Tile):
    """Return the outcomes of a tile, or raise an error if it has none."""
    if tile.outcomes is None:
        raise InputError("the tile must have outcomes of targets, got none: plan it, or read it from a FITS file")
    return tile.outcomes


def codes_of(outcomes) -> np.ndarray:
    """Return the outcome of each target as an index of ``OUTCOMES``."""
    text = np.asarray(outcomes["outcome"])
    codes = np.zeros(len(text), dtype=np.uint8)
    for k, name in enumerate(OUTCOMES):
        codes[text == name] = k
    return codes


def _catalog_of(survey, catalog) -> Catalog:
    if catalog is None:
        raise InputError("catalog must be the catalog of the survey, which has the positions of the targets, got None")
    catalog = as_catalog(catalog)
    known = survey.outcomes["target_id"]
    if len(catalog) != len(known) or not (np.asarray(catalog.id).astype(str) == np.asarray(known).astype(str)).all():
        raise InputError(
            f"catalog must have the {len(known)} targets of the survey in the same order, got a different catalog"
        )
    return catalog


def _extent(xy, rims) -> tuple[np.ndarray, np.ndarray]:
    points = xy if rims is None else np.vstack([xy, rims.reshape(-1, 2)])
    if len(points) == 0:
        return np.full(2, -1.0), np.full(2, 1.0)
    low, high = points.min(axis=0), points.max(axis=0)
    half = np.maximum(high - low, max(SMALLEST, NARROWEST * np.max(high - low))) / 2
    return (low + high) / 2 - half, (low + high) / 2 + half


def _new_axes(sky_map, xy, rims, rows):
    """Return the axes of a new figure, with room for the rows of a legend."""
    below = HEIGHT_OF_ROW * rows
    if sky_map.kind == "whole":
        return _axes.new_axes(8, 4.8 + below, projection="aitoff")
    low, high = _extent(xy, rims)
    wide, tall = high - low
    height = min(LARGEST * tall * sky_map.aspect / wide, LARGEST)
    width = min(LARGEST, height * wide / (tall * sky_map.aspect))
    ax = _axes.new_axes(max(width, 4.5) + 0.9, max(height, 1.4) + 1.1 + below)
    ax.set_anchor("N")  # the remaining height is for the legend
    return ax


WITH_TARGET = ("assigned", "out_of_reach", "stuck")
BLANK_SKY = _axes.SERIES[3]
ROW = 0.22  # inches, height of a row of the legend


def plot_focal_plane(
    thing: Tile | FocalPlane | Instrument | str,
    *,
    ax: Axes | None = None,
    region: u.Quantity | None = None,
    color: str | None = None,
    targets: str | u.Quantity | None = None,
    arms: bool | None = None,
    orientation: str = "sky",
    **kwargs: object,
) -> Axes:
    """Plot a focal plane: patrol areas and obstacles and, for a tile, arms and collisions.

    The shade around an arm extends to half the minimum separation on each side, to scale; two arms collide if their
    shades overlap. Arms in collision are thick, with a hatched shade; arms without a target are dashed. Marks at
    the centers of positioners show that a positioner is disabled or stuck, or that its target is out of reach.

    If arms would be shorter than 5 points (5/72 inch), as on the whole focal plane of an instrument with thousands of
    positioners, each positioner is drawn as a dot. The dot is at the fiber if the positioner has a target, and
    otherwise at the center of the positioner. Diamonds are positioners in collision.

    With ``targets="outcome"``, there is a dot for each target of the field, and the legend contains the numbers of
    targets; the positioners of a large instrument are then drawn as a gray background. With ``targets="kind"``,
    ``"category"`` or ``"priority"``, each class of targets has its own color; assigned targets are larger dots, and
    targets that are not assigned are smaller dots.

    The arrows show north and east, which depend on the position angle of the tile. An instrument is drawn at
    position angle 0.

    Parameters
    ----------
    thing : Tile, FocalPlane, Instrument or str
        Tile or focal plane to plot; a str is the name of a preset. Without a tile, only arms that cannot move are
        drawn.
    ax : matplotlib.axes.Axes, optional
        Axes to draw on; by default, a new figure is created. The legend is below the axes; a figure with
        ``layout="constrained"`` reserves space for it.
    region : Quantity, shape (2, 2), optional
        Corners ((x0, y0), (x1, y1)) of the part to show; the whole focal plane by default.
    color : {"spectrograph", "fiber_type"}, optional
        Property of positioners that determines the colors of the disks around their centers.
    targets : {"outcome", "kind", "category", "priority"} or Quantity, shape (n, 2), optional
        Column of `outcomes <rfpsurvey.Tile.outcomes>` that determines the colors of all targets of a planned tile.
        Targets that were not requested are not drawn, because they have no position on the focal plane. A Quantity
        contains positions to draw as small crosses; ``instrument.projection(center).to_focal_plane(coord)`` returns
        such positions.
    arms : bool, optional
        True: draw arms; False: draw a dot for each positioner. By default, arms are drawn if they are long enough to
        be visible.
    orientation : {"sky", "focal plane"}, optional
        With ``"sky"``, east is to the left of north, as on the sky, and x increases to the left. With
        ``"focal plane"``, x increases to the right.
    **kwargs
        Passed to the collections of arms or dots or, if there is no tile, to the collection of patrol areas; for
        example ``alpha``.

    Returns
    -------
    matplotlib.axes.Axes
        The axes, in mm.

    Raises
    ------
    InputError
        If ``thing``, ``color`` or ``orientation`` is not one of the listed types or values, if ``region`` or
        ``targets`` has a wrong shape, if the tile has no outcomes, or if its outcomes do not have the column
        that ``targets`` names.

    See Also
    --------
    plot_targets : Plot all targets of a tile or of a survey on the sky.
    plot_quality : Plot the numbers of assigned targets of each class.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astropy.coordinates import SkyCoord
    >>> import rfpsurvey as rs
    >>> center = SkyCoord("6h20m +23d")
    >>> sky = rs.synthetic_catalog("poisson", center, 1.5 * u.deg, density=300 / u.deg**2, rng=1)
    >>> ax = rs.plot.plot_focal_plane(rs.plan_tile(sky, "sdss_apo", center))
    >>> ax.get_xlabel()
    'x [mm]'
    >>> rs.plot.plot_focal_plane("sdss_apo", color="fiber_type").get_title()
    'sdss_apo: 500 positioners, 46 obstacles, by fiber type'
    """
    if color not in (None, *_scene.GROUPS):
        raise InputError(f"color must be {' or '.join(_scene.GROUPS)}, got {color!r}")
    scene = _scene.scene_of(thing)
    by_class = _targets_of(thing, targets) if isinstance(targets, str) else None
    shown = scene.centers if by_class is None else np.vstack([scene.centers, by_class[0]])
    moving, patrol = (kwargs, {}) if isinstance(thing, Tile) else ({}, kwargs)
    makes_figure = ax is None
    ax = _axes.focal_plane_axes(ax, shown, scene.outer, region, orientation)
    if region is not None:
        scene = _scene.visible_part(scene, ax)
    large = _scene.arms_are_visible(ax, scene) if arms is None else arms
    handles = list(_scene.draw_groups(ax, scene, color, pale=large or isinstance(thing, Tile)))
    if large or not (color or isinstance(thing, Tile)):
        handles += _scene.draw_patrol_areas(ax, scene, patrol, gray=bool(color), alike=by_class is not None)
    handles += _scene.draw_obstacles(ax, scene)
    if by_class is None and targets is not None:
        handles.append(_draw_targets(ax, scene, targets))
    if large or not isinstance(thing, Tile):
        handles += _scene.draw_arms(ax, scene, moving)
    elif by_class is None:
        handles += _scene.draw_dots(ax, scene, moving)
    else:
        _scene.draw_cells(ax, scene)
    if by_class is not None:
        handles += _draw_classes(ax, thing, targets, *by_class, {} if large else moving, large)
    handles += _scene.draw_marks(ax, scene)
    _axes.add_compass(ax, _axes.position_angle_of(thing), scene.points if large else scene.centers)
    ax.set_title(scene.title + (f", by {color.replace('_', ' ')}" if color else ""))
    if by_class is None:
        _axes.legend_below(ax, handles, columns=4)
        return ax
    options = legend_options(targets, [handle.get_label() for handle in handles])
    if makes_figure:  # make room for more rows of the legend
        width, height = ax.figure.get_size_inches()
        rows = -(-len(handles) // options["columns"]) + (targets != "outcome")
        ax.figure.set_size_inches(width, height + ROW * max(rows - 2, 0))
    _axes.legend_below(ax, handles, **options)
    return ax


def _draw_targets(ax, scene, targets):
    """Draw targets as small crosses below arms and dots, and return their legend entry."""
    points = to_points_mm(targets, "targets")
    size = min(max(0.35 * _axes.spacing_of(scene.centers, scene.outer) * _axes.points_per_unit(ax), 1.5), 5.0)
    return ax.scatter(
        *points.T, s=size**2, marker="+", color=_axes.OUTLINE, linewidths=0.5, alpha=0.6, zorder=2.2, label="target"
    )


def _targets_of(thing, color):
    """Return the positions (mm) of the targets that have a position, and the outcomes of these targets as a table."""
    check_choice(color, COLORINGS, "targets")
    if not isinstance(thing, Tile):
        raise InputTypeError(f"thing must be a Tile to draw its targets by {color}, got {type(thing).__name__}")
    table = outcomes_of(thing)
    xy = np.column_stack([table["x"].to_value(u.mm), table["y"].to_value(u.mm)])
    known = np.isfinite(xy).all(axis=1)
    return xy[known], table[known]


def _draw_classes(ax, tile, color, xy, table, kwargs, on_arms):
    """Draw the targets inside the axes, colored by class, and the fibers on blank sky; yield legend entries."""
    low, high = _axes.limits_of(ax)
    seen = ((xy >= low) & (xy <= high)).all(axis=1)
    xy, table = xy[seen], table[seen]
    columns = {name: table[name] for name in COLORINGS[1:] if name in table.colnames}
    layers = layers_of(color, codes_of(table), columns)
    on_arms = on_arms and color != "outcome"
    yield from draw_layers(ax, xy, layers, kwargs, below=2.2, above=6.0, on_arms=on_arms)
    t = tile.table
    blank = np.isin(np.asarray(t["status"]), WITH_TARGET) & ~np.isin(np.asarray(t["id"]), _positioners(tile.outcomes))
    fibers = np.column_stack([t["tip_x"].to_value(u.mm), t["tip_y"].to_value(u.mm)])[blank]
    fibers = fibers[((fibers >= low) & (fibers <= high)).all(axis=1)]
    if len(fibers):
        style = {"s": 6, "marker": "s", "facecolors": "none", "edgecolors": BLANK_SKY, "linewidths": 0.6, "zorder": 5.9}
        yield ax.scatter(*fibers.T, **style, label=f"fiber on blank sky: {len(fibers)}")


def _positioners(outcomes) -> np.ndarray:
    """Return the identifiers of the positioners that have a target of the catalog."""
    column = outcomes["positioner"]
    return column.compressed() if hasattr(column, "compressed") else np.asarray(column)
