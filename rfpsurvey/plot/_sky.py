"""Tiles on the sky, and how far a survey has come."""

from typing import TYPE_CHECKING

import astropy.units as u
import numpy as np
from astropy.coordinates import SkyCoord

from rfpsurvey._units import to_scalar
from rfpsurvey.errors import InputError
from rfpsurvey.plot._axes import new_axes
from rfpsurvey.plot._style import MARKERS, SEQUENTIAL, SERIES
from rfpsurvey.survey import Survey
from rfpsurvey.tiling import Tiling

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["draw_survey", "plot_completeness", "plot_tiling"]

CORNERS = 36
MOST_STEPS = 12
WIDE = 60.0  # deg about the middle: beyond it, the whole sky
POLAR = 75.0


def plot_tiling(
    tiles: Tiling | Survey,
    *,
    color: str | None = None,
    radius: u.Quantity | None = None,
    ax: "Axes | None" = None,
    **kwargs: object,
) -> "Axes":
    """Draw tiles on the sky.

    In right ascension and declination; near a pole in distances from their middle; as a map of the whole sky where they
    are more than 60 deg away from their middle.

    Parameters
    ----------
    tiles : Tiling or Survey
        What to draw.
    color : str, optional
        Column that gives the color; by default the completeness of a survey, and the pass of a tiling.
    radius : Quantity, optional
        Radius of a field; by default that of the survey, or the one that the tiling was made for, else 1 deg.
    ax : matplotlib.axes.Axes, optional
        Where to draw; a new figure by default. Axes of the projection ``aitoff`` show the whole sky.
    **kwargs
        Passed to the collection of fields, for example ``cmap`` or ``alpha``.

    Returns
    -------
    matplotlib.axes.Axes
        The axes, east to the left.

    Raises
    ------
    InputError
        If there are no tiles, no such column of numbers, or the radius is impossible.

    Examples
    --------
    >>> import astropy.units as u
    >>> import rfpsurvey as rs
    >>> region = rs.Region.box(ra=[100, 120] * u.deg, dec=[20, 30] * u.deg)
    >>> ax = rs.plot_tiling(rs.place_tiles(region, "lamost"))
    >>> ax.get_xlabel()
    'right ascension [deg]'
    """
    from matplotlib.figure import Figure

    if not isinstance(tiles, Tiling | Survey):
        raise InputError(f"tiles must be a Tiling or a Survey, got {type(tiles).__name__}")
    table = tiles.tiles if isinstance(tiles, Survey) else tiles.table
    if len(table) == 0:
        raise InputError("there must be at least one tile to draw, got none")
    color = color or ("completeness" if isinstance(tiles, Survey) else "pass")
    if color not in table.colnames or np.asarray(table[color]).dtype.kind not in "iufb":
        raise InputError(f"color must be a column of numbers ({', '.join(table.colnames)}), got {color!r}")
    radius = _radius(tiles) if radius is None else to_scalar(radius, u.deg, "radius", low=0, high=90)
    centers = SkyCoord(table["ra"], table["dec"])
    middle, wide = _view(centers, radius)
    if ax is None:
        figure = Figure(figsize=(8, 4.5) if wide else (7, 5.5), layout="constrained")
        ax = figure.add_subplot(projection="aitoff" if wide else None)
    if ax.name == "aitoff":
        polygons, tile_of = _draw_sky(ax, centers, radius)
    elif np.abs(centers.dec.deg).max() + radius > POLAR:
        polygons, tile_of = _draw_offsets(ax, centers, radius, middle)
    else:
        polygons, tile_of = _draw_region(ax, centers, radius, middle)
    values = np.asarray(table[color], dtype=float)
    _color(ax, polygons, values[tile_of], np.unique(values[np.isfinite(values)]), color, kwargs)
    ax.set_title(f"{len(table)} tiles", pad=14 if ax.name == "aitoff" else None)
    return ax


def plot_completeness(survey: Survey, *, ax: "Axes | None" = None, **kwargs: object) -> "Axes":
    """Draw the completeness of a survey against the number of tiles, and that of each priority after each pass.

    Parameters
    ----------
    survey : Survey
        What to draw.
    ax : matplotlib.axes.Axes, optional
        Where to draw; a new figure by default.
    **kwargs
        Passed to ``plot`` of the line of all visits, for example ``linewidth``.

    Returns
    -------
    matplotlib.axes.Axes
        The axes.

    Raises
    ------
    InputError
        If it is no survey.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astropy.coordinates import SkyCoord
    >>> import rfpsurvey as rs
    >>> sky = rs.synthetic_catalog("poisson", SkyCoord("6h20m +23d"), 1 * u.deg, density=500 / u.deg**2, rng=1)
    >>> survey = rs.plan_survey(sky, SkyCoord([94.9, 95.1] * u.deg, [23, 23] * u.deg), "moons")
    >>> rs.plot_completeness(survey).get_xlabel()
    'tiles'
    """
    if not isinstance(survey, Survey):
        raise InputError(f"survey must be a Survey, got {type(survey).__name__}")
    ax = new_axes(7, 4.5) if ax is None else ax
    tiles, after = survey.tiles, survey.completeness
    order = np.lexsort((np.arange(len(tiles)), tiles["round"]))
    share = np.cumsum(tiles["n_observed"][order]) / max(survey.summary["n_visits_wanted"], 1)
    ax.plot(np.arange(len(tiles) + 1), np.append(0, share), **{"color": "k", "label": "all visits", **kwargs})
    classes = [name for name in dict.fromkeys(after["priority"]) if name != "all"]
    for k, name in enumerate(classes):
        rows = after["priority"] == name
        style = {"color": SERIES[k % len(SERIES)], "marker": MARKERS[k % len(MARKERS)], "ls": ":", "clip_on": False}
        ax.plot(after["n_tiles"][rows], after["completeness"][rows], label=f"priority {name}", **style)
    every = after["priority"] == "all"
    complete = after["n_complete"][every] / np.maximum(after["n_targets"][every], 1)
    ax.plot(after["n_tiles"][every], complete, "kX", clip_on=False, label="targets complete")
    for number, end in zip(after["pass"][every], after["n_tiles"][every], strict=True):
        ax.axvline(end, color="0.8", lw=0.8, zorder=0)
        ax.annotate(
            f"pass {number}", (end, 0.01), rotation=90, ha="right", va="bottom", fontsize="x-small", color="0.4"
        )
    ax.set_xlim(0, 1.03 * len(tiles))
    ax.set_ylim(0, 1.02)
    ax.set_xlabel("tiles")
    ax.set_ylabel("completeness")
    ax.legend(fontsize="small", loc="best")
    return ax


def draw_survey(survey: Survey) -> "Figure":
    """Return a figure with the tiles of a survey, colored by completeness, beside its completeness by tiles."""
    from matplotlib.figure import Figure

    _, wide = _view(SkyCoord(survey.tiles["ra"], survey.tiles["dec"]), _radius(survey))
    figure = Figure(figsize=(14, 4.8), layout="constrained")
    left, right = figure.add_gridspec(1, 2, width_ratios=(1.3, 1))
    plot_tiling(survey, ax=figure.add_subplot(left, projection="aitoff" if wide else None))
    plot_completeness(survey, ax=figure.add_subplot(right))
    return figure


def _radius(tiles) -> float:
    """Radius of a field in deg, as far as it is known."""
    if isinstance(tiles, Survey):
        return tiles.provenance["parameters"]["radius_deg"]
    return float(tiles.summary.get("radius_deg", 1.0))


def _view(centers: SkyCoord, radius: float):
    """Mean direction, and whether only a map of the whole sky will do."""
    mean = centers.cartesian.mean()
    if mean.norm() < 1e-6:
        return centers[0], True
    middle = SkyCoord(mean, frame="icrs").spherical
    middle = SkyCoord(middle.lon, middle.lat)
    return middle, bool(centers.separation(middle).max().deg + radius > WIDE)


def _rims(centers: SkyCoord, radius: float) -> SkyCoord:
    """Points on the edge of each field, shape (n, CORNERS)."""
    angles = np.linspace(0, 360, CORNERS, endpoint=False) * u.deg
    return centers[:, None].directional_offset_by(angles[None, :], radius * u.deg)


def _draw_region(ax, centers, radius, middle):
    """Return outlines in right ascension and declination, and the tile of each."""
    rims = _rims(centers, radius)
    lon = (rims.ra - middle.ra).wrap_at(180 * u.deg).deg + middle.ra.deg
    ax.set_aspect(1 / np.cos(middle.dec.rad))
    ax.xaxis.set_major_formatter(lambda lon, _: f"{lon % 360:g}")
    ax.set_xlabel("right ascension [deg]")
    ax.set_ylabel("declination [deg]")
    return list(np.stack([lon, rims.dec.deg], axis=2)), np.arange(len(centers))


def _draw_offsets(ax, centers, radius, middle):
    """Return outlines about a field near a pole: distance from the middle true, and the tile of each."""
    rims = _rims(centers, radius)
    distance, angle = middle.separation(rims).deg, middle.position_angle(rims).rad
    ax.set_aspect(1)
    where = f"{middle.ra.deg:.1f} {middle.dec.deg:+.1f}"
    ax.set_xlabel(f"east of {where} [deg]")
    ax.set_ylabel(f"north of {where} [deg]")
    return list(np.stack([distance * np.sin(angle), distance * np.cos(angle)], axis=2)), np.arange(len(centers))


def _draw_sky(ax, centers, radius):
    """Return outlines on a map of the whole sky, 180 deg in the middle, cut at its edge, and the tile of each."""
    from matplotlib.patheffects import Normal, Stroke

    rims = _rims(centers, radius)
    # x on the map, to the left with right ascension, unwrapped about the center of each field
    middle = -(centers.ra - 180 * u.deg).wrap_at(180 * u.deg).rad
    turn = (centers.ra[:, None] - rims.ra).wrap_at(180 * u.deg).rad
    polar = np.abs(centers.dec.deg) + radius >= 90
    polygons, tile_of = [], []
    for k in range(len(centers)):
        x, y = middle[k] + turn[k], rims.dec.rad[k]
        if polar[k]:  # a field with a pole in it spans all right ascensions
            x = (x + np.pi) % (2 * np.pi) - np.pi
            order, pole = np.argsort(x), np.copysign(np.pi / 2, centers.dec.rad[k])
            x = np.concatenate([[-np.pi, -np.pi], x[order], [np.pi, np.pi]])
            y = np.concatenate([[pole, y[order[0]]], y[order], [y[order[-1]], pole]])
        for shift in (0, -2 * np.pi, 2 * np.pi):
            if (x + shift).min() < np.pi and (x + shift).max() > -np.pi:
                polygons.append(np.column_stack([np.clip(x + shift, -np.pi, np.pi), y]))
                tile_of.append(k)
            if polar[k]:
                break
    hours = np.arange(30, 360, 60)
    ax.set_xticks(np.deg2rad(180 - hours), [f"{h}°" for h in hours], fontsize="small")
    halo = [Stroke(linewidth=2.5, foreground="white"), Normal()]  # labels stand on tiles
    for label in ax.get_xticklabels():
        label.set_path_effects(halo)
    ax.set_yticks(np.deg2rad(np.arange(-60, 61, 30)))
    ax.grid(color="0.85", lw=0.5)
    return polygons, np.array(tile_of)


def _color(ax, polygons, values, levels, name, kwargs):
    """Fill outlines by value, with a scale beside the axes: steps for a few whole numbers, none for one."""
    from matplotlib.collections import PolyCollection
    from matplotlib.colors import BoundaryNorm

    sky = ax.name == "aitoff"
    steps = 1 < len(levels) <= MOST_STEPS and (levels == np.rint(levels)).all()
    style = {"alpha": 0.6, "ec": "face" if sky else "0.3", "lw": 0.2 if sky else 0.5}
    if steps:
        edges = np.concatenate([[levels[0] - 0.5], (levels[1:] + levels[:-1]) / 2, [levels[-1] + 0.5]])
        style["norm"] = BoundaryNorm(edges, 256)
    if name == "completeness":
        style["clim"] = (0, 1)
    elif len(levels) == 1:
        style["clim"] = (levels[0] - 1, levels[0] + 1)  # the middle of the scale, neither dark nor pale
    if sky:  # projected here: the axes would put thousands of points on every edge
        polygons = [ax.transProjection.transform(polygon) for polygon in polygons]
        style["transform"] = ax.transAffine + ax.transAxes
    drawn = PolyCollection(polygons, array=values, **{"cmap": SEQUENTIAL, **style, **kwargs})
    ax.add_collection(drawn, autolim=not sky)
    if not sky:
        ax.autoscale_view()
        ax.xaxis.set_inverted(True)
    if len(levels) > 1 or name == "completeness":
        place = ax.inset_axes([1.04, 0.1, 0.025, 0.8] if sky else [1.02, 0, 0.025, 1])
        scale = ax.figure.colorbar(drawn, cax=place, label=name.replace("_", " "))
        if steps:
            scale.set_ticks(levels, labels=[f"{level:g}" for level in levels])
