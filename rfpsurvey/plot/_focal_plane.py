"""The plot of a focal plane: positioners, their arms, and obstacles."""

from typing import TYPE_CHECKING

import astropy.units as u

from rfpsurvey._units import to_points_mm
from rfpsurvey.errors import InputError
from rfpsurvey.focal_plane import FocalPlane
from rfpsurvey.instrument import Instrument
from rfpsurvey.plot._arms import draw_arms, draw_marks, draw_obstacles, draw_patrol_areas
from rfpsurvey.plot._axes import focal_plane_axes, legend_below, points_per_unit, spacing_of
from rfpsurvey.plot._compass import add_compass, position_angle_of
from rfpsurvey.plot._dots import arms_are_visible, draw_dots
from rfpsurvey.plot._groups import draw_groups
from rfpsurvey.plot._scene import GROUPS, scene_of, visible_part
from rfpsurvey.plot._style import OUTLINE
from rfpsurvey.tile import Tile

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["plot_focal_plane"]


def plot_focal_plane(
    thing: Tile | FocalPlane | Instrument | str,
    *,
    ax: "Axes | None" = None,
    region: u.Quantity | None = None,
    color: str | None = None,
    targets: u.Quantity | None = None,
    arms: bool | None = None,
    orientation: str = "sky",
    **kwargs: object,
) -> "Axes":
    """Draw a focal plane: patrol areas and obstacles and, of a tile, arms and collisions.

    The shade around an arm is half the minimum separation wide, to scale: two arms collide where their shades overlap.
    Arms in collision are thick, with a hatched shade; arms without a target are dashed. Marks on centers show units
    that are disabled, stuck, or whose target is out of reach.

    Where arms would be shorter than 5 points, as on the whole focal plane of an instrument with thousands of
    positioners, a dot stands for each positioner: on its target, or on its center if it has none. Diamonds are in
    collision.

    North and east are those of the tile; the arrows turn with its position angle. An instrument is drawn at position
    angle 0.

    Parameters
    ----------
    thing : Tile, FocalPlane, Instrument or str
        What to draw; a str is the name of a preset. Without a tile, the only arms are those that cannot move.
    ax : matplotlib.axes.Axes, optional
        Where to draw; a new figure by default. The legend stands below the axes: a figure of your own has room for it
        with ``layout="constrained"``.
    region : Quantity, shape (2, 2), optional
        Corners ((x0, y0), (x1, y1)) of the part to show; all by default.
    color : {"spectrograph", "fiber_type"}, optional
        Fill the cells of positioners by this column.
    targets : Quantity, shape (n, 2), optional
        Positions on the focal plane to draw as small crosses, for example those of all targets, by
        ``instrument.projection(center).to_focal_plane(coord)``.
    arms : bool, optional
        Draw arms, or a dot for each positioner; by default arms where they are long enough to be seen.
    orientation : {"sky", "focal plane"}, optional
        With ``"sky"``, east is to the left of north, as on the sky, and x increases to the left. With
        ``"focal plane"``, x increases to the right.
    **kwargs
        Passed to the collections of arms or dots or, without a tile, to that of patrol areas; for example ``alpha``.

    Returns
    -------
    matplotlib.axes.Axes
        The axes, in mm.

    Raises
    ------
    InputError
        If ``thing``, ``color`` or ``orientation`` is something else, or ``region`` or ``targets`` has another shape.

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
    if color not in (None, *GROUPS):
        raise InputError(f"color must be {' or '.join(GROUPS)}, got {color!r}")
    scene = scene_of(thing)
    moving, patrol = (kwargs, {}) if isinstance(thing, Tile) else ({}, kwargs)
    ax = focal_plane_axes(ax, scene.centers, scene.outer, region, orientation)
    if region is not None:
        scene = visible_part(scene, ax)
    large = arms_are_visible(ax, scene) if arms is None else arms
    handles = list(draw_groups(ax, scene, color, pale=large or isinstance(thing, Tile)))
    if large or not (color or isinstance(thing, Tile)):
        handles += draw_patrol_areas(ax, scene, color, patrol)
    handles += draw_obstacles(ax, scene)
    if targets is not None:
        handles.append(_draw_targets(ax, scene, targets))
    if large or not isinstance(thing, Tile):
        handles += draw_arms(ax, scene, moving)
    else:
        handles += draw_dots(ax, scene, moving)
    handles += draw_marks(ax, scene)
    add_compass(ax, position_angle_of(thing), scene.points if large else scene.centers)
    ax.set_title(scene.title + (f", by {color.replace('_', ' ')}" if color else ""))
    legend_below(ax, handles, columns=4)
    return ax


def _draw_targets(ax, scene, targets):
    """Draw small crosses below arms and dots, and return their legend entry."""
    points = to_points_mm(targets, "targets")
    size = min(max(0.35 * spacing_of(scene.centers, scene.outer) * points_per_unit(ax), 1.5), 5.0)
    return ax.scatter(
        *points.T, s=size**2, marker="+", color=OUTLINE, linewidths=0.5, alpha=0.6, zorder=2.2, label="target"
    )
