"""Patrol areas, obstacles and arms, drawn to scale."""

from collections.abc import Iterator

import numpy as np
from matplotlib.collections import LineCollection, PathCollection, PolyCollection
from matplotlib.colors import to_rgba
from matplotlib.patches import Patch
from matplotlib.path import Path
from scipy.spatial import ConvexHull

from rfpsurvey.plot._axes import add_circles, legend_line
from rfpsurvey.plot._scene import Scene
from rfpsurvey.plot._style import ARM, COLLISION, HATCH, IDLE, OBSTACLE, OPEN_CIRCLE, OUTLINE, PATROL

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
