"""The targets of a tile or of a survey on the sky, by outcome or by class."""

import numpy as np
from astropy.coordinates import SkyCoord
from matplotlib.axes import Axes

from rfpsurvey.catalog import Catalog, PartitionedCatalog, as_catalog
from rfpsurvey.errors import InputError, InputTypeError, check_choice
from rfpsurvey.pipeline import OUTCOMES
from rfpsurvey.plot._axes import legend_below, new_axes
from rfpsurvey.plot._classes import ASSIGNED, COLORINGS, draw_layers, layers_of, legend_options
from rfpsurvey.plot._sky import draw_rims, radius_of
from rfpsurvey.plot._sky_map import SkyMap, is_wide, map_of, rims_of
from rfpsurvey.survey import Survey
from rfpsurvey.tile import Tile

LARGEST = 6.2  # inches: longer side of the axes
SMALLEST, NARROWEST = 0.1, 0.1
"""Smallest extent of the axes in deg, and smallest ratio of the shorter side to the longer side."""
ROW = 0.23  # inches, height of a row of the legend


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
        sky_map, rims = _map_of_survey(result, ax)
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
    legend_below(ax, list(draw_layers(ax, xy, layers, kwargs, below=2.0, above=3.0)), **options)
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


def _map_of_survey(survey, ax):
    """Return the map of a survey and the edges of its fields; the edges are None on a map of the whole sky."""
    centers, radius = SkyCoord(survey.tiles["ra"], survey.tiles["dec"]), radius_of(survey)
    whole = is_wide(centers, radius) if ax is None else ax.name == "aitoff"
    sky_map = map_of(centers, radius, whole=whole)
    return sky_map, None if whole else sky_map.to_xy(rims_of(centers, radius))


def _extent(xy, rims) -> tuple[np.ndarray, np.ndarray]:
    points = xy if rims is None else np.vstack([xy, rims.reshape(-1, 2)])
    if len(points) == 0:
        return np.full(2, -1.0), np.full(2, 1.0)
    low, high = points.min(axis=0), points.max(axis=0)
    half = np.maximum(high - low, max(SMALLEST, NARROWEST * np.max(high - low))) / 2
    return (low + high) / 2 - half, (low + high) / 2 + half


def _new_axes(sky_map, xy, rims, rows):
    """Return the axes of a new figure, with room for the rows of a legend."""
    below = ROW * rows
    if sky_map.kind == "whole":
        return new_axes(8, 4.8 + below, projection="aitoff")
    low, high = _extent(xy, rims)
    wide, tall = high - low
    height = min(LARGEST * tall * sky_map.aspect / wide, LARGEST)
    width = min(LARGEST, height * wide / (tall * sky_map.aspect))
    ax = new_axes(max(width, 4.5) + 0.9, max(height, 1.4) + 1.1 + below)
    ax.set_anchor("N")  # the remaining height is for the legend
    return ax
