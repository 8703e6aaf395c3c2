"""Draw the positioners of large focal planes as dots, because arms would be too short to be visible."""

from collections.abc import Iterator

import numpy as np

from rfpsurvey.plot._axes import add_circles, diamond_size, legend_line, points_per_unit, spacing_of
from rfpsurvey.plot._scene import Scene
from rfpsurvey.plot._style import ARM, COLLISION, FADED, FAINT

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
