"""Positioners, their arms, and what is in their way."""

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import astropy.units as u
import numpy as np

from rfpsurvey.collision import place_arms
from rfpsurvey.errors import InputError
from rfpsurvey.focal_plane import FocalPlane
from rfpsurvey.instrument import Instrument
from rfpsurvey.plot._axes import add_circles, focal_plane_axes, legend_below, named_plane
from rfpsurvey.plot._style import ARM, COLLISION, HATCH, IDLE, OBSTACLE, OUTLINE, PATROL, SERIES
from rfpsurvey.tile import Tile

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["capsules", "plot_focal_plane"]

MARKS = {"disabled": ("x", "disabled"), "stuck": ("s", "stuck"), "out_of_reach": ("^", "target out of reach")}
"""Status to the marker and the words that stand for it."""
GROUPS = ("spectrograph", "fiber_type")
MOST_GROUPS = 24


@dataclass(frozen=True, eq=False)
class _Scene:
    """What is drawn, in mm; arms that are not there are NaN."""

    title: str
    centers: np.ndarray
    inner: np.ndarray
    outer: np.ndarray
    elbows: np.ndarray
    tips: np.ndarray
    bodies: np.ndarray
    """What can collide, rows (x0, y0, x1, y1)."""
    half: float
    status: np.ndarray
    colliding: np.ndarray
    obstacles: np.ndarray
    groups: dict[str, np.ndarray]

    @property
    def with_target(self):
        return np.isin(self.status, ("assigned", "out_of_reach"))


def plot_focal_plane(
    thing: Tile | FocalPlane | Instrument | str,
    *,
    ax: "Axes | None" = None,
    region: u.Quantity | None = None,
    color: str | None = None,
    **kwargs: object,
) -> "Axes":
    """Draw a focal plane: patrol areas and obstacles and, of a tile, arms and collisions.

    The shade around an arm is half the safe distance wide, to scale: two arms collide where their shades overlap. Arms
    in collision are thick, with a hatched shade; arms without a target are dashed. Marks on centers show units that are
    disabled, stuck, or whose target is out of reach.

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
        Fill patrol areas by this column.
    **kwargs
        Passed to the collections of arms or, without a tile, to that of patrol areas; for example ``alpha``.

    Returns
    -------
    matplotlib.axes.Axes
        The axes, in mm.

    Raises
    ------
    InputError
        If ``thing`` or ``color`` is something else, or ``region`` has another shape.

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
    >>> rs.plot_focal_plane("sdss_apo", color="fiber_type").get_title()
    'sdss_apo: 500 positioners, 46 obstacles, by fiber type'
    """
    if color not in (None, *GROUPS):
        raise InputError(f"color must be {' or '.join(GROUPS)}, got {color!r}")
    scene = _of_tile(thing) if isinstance(thing, Tile) else _of_plane(thing)
    arms, patrol = (kwargs, {}) if isinstance(thing, Tile) else ({}, kwargs)
    ax = focal_plane_axes(ax, scene.centers, scene.outer, region)
    if region is not None:
        scene = _in_sight(scene, ax)
    handles = [
        *_draw_groups(ax, scene, color),
        *_draw_patrol_areas(ax, scene, color, patrol),
        *_draw_obstacles(ax, scene),
    ]
    handles += [*_draw_arms(ax, scene, arms), *_draw_marks(ax, scene)]
    ax.set_title(scene.title + (f", by {color.replace('_', ' ')}" if color else ""))
    legend_below(ax, handles, columns=4)
    return ax


def _of_tile(tile):
    table, geometry, summary = tile.table, tile.table.meta["geometry"], tile.summary
    centers, elbows, tips, ends = (
        np.column_stack([table[f"{name}x"].to_value(u.mm), table[f"{name}y"].to_value(u.mm)])
        for name in ("", "elbow_", "tip_", "arm_")
    )
    starts = tips if geometry.get("arm_model") == "fiber_tip" else elbows
    counts = f"{summary['n_assigned']} of {summary['n_positioners']} assigned, {summary['n_colliding']} in collision"
    title = f"{tile.provenance['instrument']['name']}: {counts}"
    return _Scene(
        title,
        centers, *(np.broadcast_to(geometry[f"{e}_radius_mm"], len(table)) for e in ("inner", "outer")), elbows, tips,
        np.hstack([starts, ends]), geometry["min_separation_mm"] / 2, np.asarray(table["status"]),
        np.asarray(table["in_collision"]), np.array(geometry["obstacles_mm"]).reshape(-1, 3),
        {group: np.asarray(table[group]) for group in GROUPS},
    )  # fmt: skip


def _of_plane(thing):
    if not isinstance(thing, Tile | FocalPlane | Instrument | str):
        raise InputError(f"thing must be a Tile, a FocalPlane, an Instrument or its name, got {type(thing).__name__}")
    name, plane = named_plane(thing)
    name = f"{name}: " if name else ""
    n, obstacles = len(plane), len(plane._obstacles_mm)
    posed = place_arms(plane, np.full((n, 2), np.nan) * u.mm, parked_obstacles=False)
    status = np.where(plane.disabled, "disabled", "usable")
    status[plane._is_stuck] = "stuck"
    spectrograph = plane.spectrograph if plane.spectrograph.ndim == 1 else plane.spectrograph[:, 0]
    return _Scene(
        f"{name}{n} positioners" + (f", {obstacles} obstacles" if obstacles else ""),
        plane._xy_mm, plane._inner_mm, plane._outer_mm, posed.elbow, posed.tip, posed.segments,
        plane.positioner._separation_mm / 2, status, np.zeros(n, bool), plane._obstacles_mm,
        {"spectrograph": spectrograph, "fiber_type": plane.fiber_type},
    )  # fmt: skip


def _in_sight(scene, ax):
    """Return what can be seen of a scene, so that nothing else is drawn or has an entry in the legend."""
    corners = np.array([ax.get_xlim(), ax.get_ylim()])

    def near(points, margin):
        return ((points > corners[:, 0] - margin) & (points < corners[:, 1] + margin)).all(axis=1)

    rows = near(scene.centers, 2 * scene.outer.max())  # arms end where patrol areas do
    columns = ("centers", "inner", "outer", "elbows", "tips", "bodies", "status", "colliding")
    own = {name: getattr(scene, name)[rows] for name in columns}
    own["groups"] = {name: values[rows] for name, values in scene.groups.items()}
    seen = near(scene.obstacles[:, :2], scene.obstacles[:, 2:])
    return replace(scene, obstacles=scene.obstacles[seen], **own)


def _draw_groups(ax, scene, color):
    """Fill the patrol areas of each group of positioners, write its name there or yield a legend entry."""
    from matplotlib.patches import Patch

    if color is None:
        return
    values = scene.groups[color]
    names = np.unique(values)
    if len(names) > MOST_GROUPS:
        raise InputError(f"{color} must have at most {MOST_GROUPS} values to be told apart, got {len(names)}")
    for k, name in enumerate(names):
        # hatches tell apart what shares a color
        style = {"facecolor": SERIES[k % 8], "alpha": 0.45, "hatch": (None, "////", "....")[k // 8], "linewidth": 0}
        rows = values == name
        add_circles(ax, scene.centers[rows], 0.5 * scene.outer[rows], zorder=0.9, edgecolors="white", **style)
        middle = scene.centers[rows].mean(axis=0)
        together = len(names) > 2 and rows[np.argmin(np.hypot(*(scene.centers - middle).T))]
        if together and ax.viewLim.contains(*middle):
            label = ax.text(*middle, str(name), ha="center", va="center", weight="bold", zorder=7, clip_on=True)
            label.set_bbox({"facecolor": "white", "alpha": 0.8, "linewidth": 0, "pad": 1.5})
            continue
        yield Patch(edgecolor="white", label=f"{color.replace('_', ' ')} {name}".strip(), **style)


def _draw_patrol_areas(ax, scene, color, kwargs):
    """Draw both edges of each patrol area, and yield legend entries."""
    from matplotlib.lines import Line2D

    free = scene.with_target | (scene.status == "usable")
    entry = {"marker": "o", "markerfacecolor": "none", "linestyle": "none"}
    usual = IDLE if color else PATROL  # a blue edge would tint what is filled
    for rows, edge, label in ((free, usual, "patrol area"), (~free, IDLE, "patrol area, no target")):
        if not rows.any():
            continue
        style = {"facecolors": "none", "edgecolors": edge, "linewidths": 0.3 if color else 0.5, "zorder": 1}
        style |= kwargs
        add_circles(ax, scene.centers[rows], scene.outer[rows], **style)
        if scene.inner[rows].any():
            add_circles(ax, scene.centers[rows], scene.inner[rows], **{**style, "linestyles": ":"})
        yield Line2D([], [], color=edge, label=label, **entry)


def _draw_obstacles(ax, scene):
    from matplotlib.lines import Line2D

    if len(scene.obstacles):
        add_circles(ax, scene.obstacles[:, :2], scene.obstacles[:, 2], facecolors=OBSTACLE, zorder=2)
        yield Line2D([], [], color=OBSTACLE, marker="o", linestyle="none", label="obstacle")


def _draw_arms(ax, scene, kwargs):
    """Draw both arms of each positioner and the space around the one that can collide, and yield legend entries."""
    from matplotlib.collections import LineCollection, PolyCollection
    from matplotlib.colors import to_rgba
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    present, target = np.isfinite(scene.tips).all(axis=1), scene.with_target
    groups = (
        (present & ~target & ~scene.colliding, IDLE, "arm, no target", 3, {"linewidths": 1.0, "linestyles": "--"}),
        (present & target & ~scene.colliding, ARM, "arm", 4, {"linewidths": 1.0, "capstyle": "round"}),
        (present & scene.colliding, COLLISION, "arm in collision", 5, {"linewidths": 2.2, "capstyle": "round"}),
    )
    for rows, color, label, zorder, style in groups:
        if not rows.any():
            continue
        central = np.stack([scene.centers[rows], scene.elbows[rows]], axis=1)
        ax.add_collection(LineCollection(central, colors=color, linewidths=0.4, alpha=0.5, zorder=zorder))
        arms = np.stack([scene.elbows[rows], scene.tips[rows]], axis=1)
        ax.add_collection(LineCollection(arms, colors=color, zorder=zorder, **{**style, **kwargs}))
        shade = {"facecolors": to_rgba(color, 0.2), "edgecolors": "none"}
        if color is COLLISION:
            shade |= {"edgecolors": color, "linewidths": 0.8, "hatch": HATCH}
        ax.add_collection(PolyCollection(capsules(scene.bodies[rows], scene.half), zorder=zorder - 0.5, **shade))
        add_circles(ax, scene.tips[rows], 0.06 * scene.outer[rows], facecolors=color, zorder=zorder)
        if color is COLLISION:
            yield Patch(facecolor=to_rgba(color, 0.2), edgecolor=color, hatch=HATCH, label=label)
        else:
            yield Line2D([], [], color=color, linestyle=style.get("linestyles", "-"), label=label)


def _draw_marks(ax, scene):
    """Mark positioners that are out of the ordinary, and yield legend entries."""
    for status, (marker, label) in MARKS.items():
        points = scene.centers[scene.status == status]
        if len(points):
            style = {"facecolors": OUTLINE} if marker == "x" else {"facecolors": "none", "edgecolors": OUTLINE}
            yield ax.scatter(*points.T, s=16, marker=marker, linewidths=1.0, zorder=6, label=label, **style)


def capsules(bodies, radius):
    """Outlines of all points within ``radius`` of each segment, shape (n, 18, 2)."""
    a, b = bodies[:, None, :2], bodies[:, None, 2:]
    along = np.arctan2(*(bodies[:, 2:] - bodies[:, :2]).T[::-1])
    angle = along[:, None] + np.linspace(-np.pi / 2, np.pi / 2, 9)
    arc = radius * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    return np.concatenate([b + arc, a - arc], axis=1)
