"""Disks around positioners, colored by group, such as the spectrograph."""

from collections.abc import Iterator

import numpy as np
from matplotlib.patches import Patch

from rfpsurvey.errors import InputError
from rfpsurvey.plot._axes import add_circles, spacing_of
from rfpsurvey.plot._scene import Scene
from rfpsurvey.plot._style import GROUP_COLORS

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
