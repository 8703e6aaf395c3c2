"""The content of a plot of a focal plane in mm, and functions that draw it: patrol areas, obstacles, arms, dots."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import astropy.units as u
import numpy as np
from matplotlib.collections import LineCollection, PathCollection, PolyCollection
from matplotlib.colors import to_rgba
from matplotlib.patches import Patch
from matplotlib.path import Path
from scipy.spatial import ConvexHull

from rfpsurvey._field.tile import Tile
from rfpsurvey._instruments.arms import place_arms
from rfpsurvey._instruments.focal_plane import FocalPlane
from rfpsurvey._instruments.instrument import Instrument
from rfpsurvey.errors import InputError, InputTypeError, number_of
from rfpsurvey.plot._axes import (
    ARM,
    COLLISION,
    FADED,
    FAINT,
    GROUP_COLORS,
    HATCH,
    IDLE,
    OBSTACLE,
    OPEN_CIRCLE,
    OUTLINE,
    PATROL,
    add_circles,
    diamond_size,
    legend_line,
    limits_of,
    named_plane,
    points_per_unit,
    spacing_of,
)

GROUPS = ("spectrograph", "fiber_type")


@dataclass(frozen=True, eq=False)
class Scene:
    """Positioners and obstacles of a focal plane, in mm; the coordinates of arms that are not drawn are NaN."""

    title: str
    centers: np.ndarray
    inner: np.ndarray
    outer: np.ndarray
    elbows: np.ndarray
    tips: np.ndarray
    bodies: np.ndarray
    """Segment of each arm that can collide, as a row (x0, y0, x1, y1)."""
    half: float
    """Half the minimum separation of two arms."""
    outline: dict | None
    """Parts of the outline of the ``eccentric`` and of the ``central`` arm, with vertices and radius in mm."""
    status: np.ndarray
    colliding: np.ndarray
    obstacles: np.ndarray
    polygons: list
    """Vertices of the polygons that no arm may touch."""
    groups: dict[str, np.ndarray]

    @property
    def with_target(self) -> np.ndarray:
        """Whether each positioner has a target."""
        return np.isin(self.status, ("assigned", "out_of_reach"))

    @property
    def points(self) -> np.ndarray:
        """Points that the compass should not cover; points on colliding arms occur four times, for a larger weight."""
        arms = np.vstack([self.elbows, self.tips, (self.elbows + self.tips) / 2])
        points = np.vstack([self.centers, arms, *[arms[np.tile(self.colliding, 3)]] * 3])
        return points[np.isfinite(points).all(axis=1)]


def scene_of(thing: Tile | FocalPlane | Instrument | str) -> Scene:
    """Return the scene of a tile, or of positioners without targets."""
    return _of_tile(thing) if isinstance(thing, Tile) else _of_plane(thing)


def _of_tile(tile):
    table, geometry, summary = tile.table, tile.table.meta["geometry"], tile.summary
    centers, elbows, tips, ends = (
        np.column_stack([table[f"{name}x"].to_value(u.mm), table[f"{name}y"].to_value(u.mm)])
        for name in ("", "elbow_", "tip_", "arm_")
    )
    starts = tips if geometry.get("arm_model") == "fiber_tip" else elbows
    counts = f"{summary['n_assigned']} of {summary['n_positioners']} assigned, {summary['n_colliding']} in collision"
    title = f"{tile.provenance['instrument']['name']}: {counts}"
    return Scene(
        title,
        centers,
        *(np.broadcast_to(geometry[f"{e}_radius_mm"], len(table)) for e in ("inner", "outer")),
        elbows,
        tips,
        np.hstack([starts, ends]),
        geometry["min_separation_mm"] / 2,
        geometry.get("outline_mm"),
        np.asarray(table["status"]),
        np.asarray(table["in_collision"]),
        np.array(geometry["obstacles_mm"]).reshape(-1, 3),
        [np.array(polygon) for polygon in geometry.get("obstacle_polygons_mm", [])],
        {name: np.asarray(table[name] if name in table.colnames else np.zeros(len(table), int)) for name in GROUPS},
    )


def _of_plane(thing):
    if not isinstance(thing, Tile | FocalPlane | Instrument | str):
        kind = type(thing).__name__
        raise InputTypeError(
            f"thing must be a Tile, a FocalPlane, an Instrument or the name of an instrument, got {kind}"
        )
    name, plane = named_plane(thing)
    name = f"{name}: " if name else ""
    n, obstacles = len(plane), len(plane.arrays.obstacles) + len(plane.arrays.obstacle_polygons)
    posed = place_arms(plane, np.full((n, 2), np.nan) * u.mm, parked_obstacles=False)
    status = np.where(plane.disabled, "disabled", "usable")
    status[plane.arrays.is_stuck] = "stuck"
    spectrograph = plane.spectrograph if plane.spectrograph.ndim == 1 else plane.spectrograph[:, 0]
    return Scene(
        name + number_of(n, "positioner") + (f", {number_of(obstacles, 'obstacle')}" if obstacles else ""),
        plane.arrays.xy,
        plane.arrays.inner_radius,
        plane.arrays.outer_radius,
        posed.elbow,
        posed.tip,
        posed.segments,
        plane.arrays.separation / 2,
        None if plane.positioner.outline is None else plane.positioner.outline.to_dict(),
        status,
        np.zeros(n, bool),
        plane.arrays.obstacles,
        list(plane.arrays.obstacle_polygons),
        {"spectrograph": spectrograph, "fiber_type": plane.fiber_type},
    )


def visible_part(scene: Scene, ax) -> Scene:
    """Return the part of a scene inside the axes, so that other parts are not drawn and have no legend entries."""
    low, high = limits_of(ax)

    def near(points, margin):
        return ((points > low - margin) & (points < high + margin)).all(axis=1)

    rows = near(scene.centers, 2 * scene.outer.max())  # arms do not extend beyond patrol areas
    columns = ("centers", "inner", "outer", "elbows", "tips", "bodies", "status", "colliding")
    visible = {name: getattr(scene, name)[rows] for name in columns}
    visible["groups"] = {name: values[rows] for name, values in scene.groups.items()}
    seen = near(scene.obstacles[:, :2], scene.obstacles[:, 2:])
    return replace(scene, obstacles=scene.obstacles[seen], **visible)


MARKS = {"disabled": ("x", "disabled"), "stuck": ("s", "stuck"), "out_of_reach": ("^", "target out of reach")}
"""Marker and legend label for each status of a positioner that is marked on the plot."""


def draw_patrol_areas(ax, scene: Scene, kwargs: dict, *, gray: bool, alike: bool) -> Iterator:
    """Draw the inner and outer edge of each patrol area, and yield legend entries.

    If ``gray`` is true, edges are gray and thinner; this option is for plots with filled disks around positioners. If
    ``alike`` is true, positioners with and without a target have the same gray, thin edges; this option is for plots
    with dots of targets.
    """
    gray = gray or alike
    free = scene.with_target | (scene.status == "usable") | alike
    usual = IDLE if gray else PATROL  # a blue edge would change the apparent color of fills
    for rows, edge, label in ((free, usual, "patrol area"), (~free, IDLE, "patrol area, no target")):
        if not rows.any():
            continue
        style = {"facecolors": "none", "edgecolors": edge, "linewidths": 0.3 if gray else 0.5, "zorder": 1}
        style |= kwargs
        add_circles(ax, scene.centers[rows], scene.outer[rows], **style)
        if scene.inner[rows].any():
            add_circles(ax, scene.centers[rows], scene.inner[rows], **{**style, "linestyles": ":"})
        yield legend_line(color=edge, label=label, **OPEN_CIRCLE)


def draw_obstacles(ax, scene: Scene) -> Iterator:
    """Draw the circles and polygons that no arm may touch, and yield a legend entry."""
    if len(scene.obstacles):
        add_circles(ax, scene.obstacles[:, :2], scene.obstacles[:, 2], facecolors=OBSTACLE, zorder=2)
    if scene.polygons:
        ax.add_collection(PolyCollection(scene.polygons, facecolors=OBSTACLE, zorder=2))
    if len(scene.obstacles) or scene.polygons:
        yield legend_line(color=OBSTACLE, marker="o", linestyle="none", label="obstacle")


def draw_arms(ax, scene: Scene, kwargs) -> Iterator:
    """Draw both arms of each positioner and the shade around the segment that can collide, and yield legend entries."""
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
        for shape in _shapes(scene, rows, color):
            shape.set_zorder(zorder - 0.5)
            ax.add_collection(shape)
        add_circles(ax, scene.tips[rows], 0.06 * scene.outer[rows], facecolors=color, zorder=zorder)
        if color is COLLISION:
            yield Patch(facecolor=to_rgba(color, 0.2), edgecolor=color, hatch=HATCH, label=label)
        else:
            yield legend_line(color=color, linestyle=style.get("linestyles", "-"), label=label)


def draw_marks(ax, scene: Scene) -> Iterator:
    """Mark positioners that are disabled or stuck, or that cannot reach their target, and yield legend entries."""
    for status, (marker, label) in MARKS.items():
        points = scene.centers[scene.status == status]
        if len(points):
            style = {"facecolors": OUTLINE} if marker == "x" else {"facecolors": "none", "edgecolors": OUTLINE}
            yield ax.scatter(*points.T, s=16, marker=marker, linewidths=1.0, zorder=6, label=label, **style)


def _shapes(scene: Scene, rows: np.ndarray, color: str) -> Iterator:
    """Yield collections of the shapes that must not touch: capsules, or the outlines of both arms."""
    hatch = {"edgecolors": color, "hatch": HATCH} if color is COLLISION else {"edgecolors": "none"}
    if scene.outline is None:
        shapes = capsules(scene.bodies[rows], scene.half)
        yield PolyCollection(shapes, facecolors=to_rgba(color, 0.2), linewidths=0.8, **hatch)
        return
    elbows = scene.elbows[rows]
    arms = {"eccentric": (elbows, scene.bodies[rows, 2:], 0.25), "central": (scene.centers[rows], elbows, 0.15)}
    for arm, (origins, ends, alpha) in arms.items():
        if scene.outline.get(arm):
            paths = _outlines(scene.outline[arm], scene.half, origins, ends)
            # without edges, because edges between overlapping parts would also be drawn
            yield PathCollection(paths, facecolors=to_rgba(color, alpha), linewidths=0, **hatch)


def _outlines(parts: list[dict], margin: float, origins: np.ndarray, ends: np.ndarray) -> list:
    """Return one path per arm, which contains all parts of its outline; overlaps of parts are filled once."""
    vertices, codes = [], []
    for part in parts:
        points = rounded(np.array(part["vertices"]), part.get("radius", 0.0) + margin)
        vertices += [points, points[:1]]
        codes += [Path.MOVETO, *[Path.LINETO] * (len(points) - 1), Path.CLOSEPOLY]
    x, y = np.concatenate(vertices).T[:, :, None]
    along = ends - origins
    along = along / np.hypot(*along.T)[:, None]
    across = np.column_stack([-along[:, 1], along[:, 0]])
    return [Path(o + x * a + y * b, codes) for o, a, b in zip(origins, along, across, strict=True)]


def rounded(vertices: np.ndarray, radius: float) -> np.ndarray:
    """Return the vertices of a convex polygon enlarged by a radius; its round corners have a point every 7.5 deg."""
    if radius == 0:
        return vertices
    angle = np.arange(48) * np.pi / 24
    circle = radius * np.column_stack([np.cos(angle), np.sin(angle)])
    points = (vertices[:, None] + circle).reshape(-1, 2)
    return points[ConvexHull(points).vertices]


def capsules(bodies: np.ndarray, radius: float) -> np.ndarray:
    """Return points on the outline of a capsule with the given radius around each segment, shape (n, 18, 2)."""
    a, b = bodies[:, None, :2], bodies[:, None, 2:]
    along = np.arctan2(*(bodies[:, 2:] - bodies[:, :2]).T[::-1])
    angle = along[:, None] + np.linspace(-np.pi / 2, np.pi / 2, 9)
    arc = radius * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    return np.concatenate([b + arc, a - arc], axis=1)


PALE = 0.4
"""Opacity of fills below arms or dots, so that arms and dots of the same color remain visible."""


def draw_groups(ax, scene: Scene, color: str | None, *, pale: bool) -> Iterator:
    """Draw a disk around each positioner, colored by group, and write or yield the names of the groups.

    If there are more than two groups, the name of a group is written at the mean center of its positioners, provided
    that the positioner nearest to this point belongs to the group. For all other groups, legend entries are yielded.

    If ``pale`` is true, the fills are pale, so that arms or dots on top of the fills remain visible.
    """
    if color is None:
        return
    values = scene.groups[color]
    names = np.unique(values)
    if len(names) > len(GROUP_COLORS):
        raise InputError(f"{color} must have at most {len(GROUP_COLORS)} values, got {len(names)}")
    radius = 0.5 * spacing_of(scene.centers, scene.outer)
    for k, name in enumerate(names):
        style = {"facecolor": GROUP_COLORS[k], "linewidth": 0, "alpha": PALE if pale else 1.0}
        rows = values == name
        add_circles(ax, scene.centers[rows], radius, zorder=0.9, **style)
        midpoint = scene.centers[rows].mean(axis=0)
        together = len(names) > 2 and rows[np.argmin(np.hypot(*(scene.centers - midpoint).T))]
        if together and ax.viewLim.contains(*midpoint):
            label = ax.text(*midpoint, str(name), ha="center", va="center", weight="bold", zorder=7, clip_on=True)
            label.set_bbox({"facecolor": "white", "alpha": 0.85, "linewidth": 0, "pad": 1.5})
            continue
        yield Patch(label=f"{color.replace('_', ' ')} {name}".strip(), **style)


LARGEST = 2.0  # largest ratio of the size of a diamond to the size of a dot
SHORTEST = 5.0
"""Smallest length of arms that are drawn, in points (1/72 inch)."""


def arms_are_visible(ax, scene: Scene) -> bool:
    """Return whether the axes are large enough to draw arms."""
    present = np.isfinite(scene.bodies).all(axis=1)
    if not present.any():
        length = np.max(scene.outer, initial=0.0) / 2
    else:
        length = np.median(np.hypot(*(scene.tips - scene.elbows)[present].T))
    return length * points_per_unit(ax) >= SHORTEST


def draw_cells(ax, scene: Scene) -> None:
    """Draw a pale disk for each positioner, as a background for dots."""
    add_circles(ax, scene.centers, 0.5 * spacing_of(scene.centers, scene.outer), facecolors=FAINT, zorder=0.8)


def draw_dots(ax, scene: Scene, kwargs: dict) -> Iterator:
    """Draw a dot for each positioner, colored by its state, and yield legend entries.

    The dot of a positioner is at its fiber or, if it has no target, at its center. Positioners in collision are
    diamonds, on top of all other dots; if they are few, the diamonds are larger than the dots.
    """
    spacing = spacing_of(scene.centers, scene.outer)
    draw_cells(ax, scene)
    moving = ~np.isin(scene.status, ("disabled", "stuck"))
    target = scene.with_target
    groups = (
        (moving & ~target & ~scene.colliding, scene.centers, "no target", 2.5, (0.3, 1.2), ("o", FADED, FADED)),
        (target & ~scene.colliding, scene.tips, "fiber on a target", 3, (0.5, 1.8), ("o", ARM, ARM)),
        (scene.colliding, scene.tips, "in collision", 5, (0.5, 1.8), ("D", COLLISION, "black")),
    )
    for rows, points, label, zorder, (part, least), (marker, face, edge) in groups:
        if not rows.any():
            continue
        size = max(part * spacing * points_per_unit(ax), least)
        width = 0.0
        if marker == "D":
            size = diamond_size(size, np.count_nonzero(rows) / len(rows), LARGEST)
            width = min(0.4, 0.1 * size)
            size -= width  # the edge is outside
        style = {"s": size**2, "marker": marker, "facecolor": face, "edgecolor": edge, "linewidths": width}
        ax.scatter(*points[rows].T, label=label, zorder=zorder, **{**style, **kwargs})
        look = {"markersize": max(size, 4), "markerfacecolor": face, "markeredgecolor": edge, "markeredgewidth": width}
        yield legend_line(linestyle="none", marker=marker, label=label, **look)
