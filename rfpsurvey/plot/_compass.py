"""The orientation of focal planes on plots, and the compass that shows north and east."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Circle, FancyArrowPatch
from matplotlib.transforms import Affine2D, ScaledTranslation

from rfpsurvey.plot._style import OUTLINE
from rfpsurvey.tile import Tile

ORIENTATIONS = ("sky", "focal plane")
"""Orientations: east to the left as on the sky (x increases to the left), or x increasing to the right."""
LENGTH = 16  # points, length of an arrow
LABEL = 22  # points, distance of the letters N and E from the center of the compass
GROUND = LABEL / 2**0.5 + 5  # points, radius of the white disk below the arrows
MARGIN = 35  # points, distance of the center of the compass from both edges of the axes


def position_angle_of(thing: object) -> float | None:
    """Return the position angle (degrees) at which a focal plane is drawn, or None for a tile with an unknown angle."""
    if isinstance(thing, Tile):
        return thing.provenance["parameters"].get("position_angle_deg")
    return 0.0


def add_compass(ax: Axes, position_angle: float | None, avoid: np.ndarray) -> None:
    """Draw arrows toward north and east in a corner of the axes, and write the position angle.

    The position angle (degrees) is the angle of +y from north toward east; the angle of +x is larger by 90 deg. Nothing
    is drawn if the position angle is None. The compass is drawn in the corner where it hides the fewest of the points
    ``avoid``, shape (n, 2), in mm.
    """
    if position_angle is None:
        return
    across, up = _corner(ax, avoid)
    inward = Affine2D().translate(MARGIN * (1 - 2 * across), MARGIN * (1 - 2 * up)).scale(1 / 72)
    points = inward + ax.figure.dpi_scale_trans + ScaledTranslation(across, up, ax.transAxes)
    # the sign of x is reversed on the screen if x increases to the left
    flip = -1 if ax.xaxis_inverted() else 1
    angle = np.deg2rad(position_angle)
    directions = {"N": (-flip * np.sin(angle), np.cos(angle)), "E": (flip * np.cos(angle), np.sin(angle))}
    toward = np.sum(list(directions.values()), axis=0)
    # the arrows occupy one quarter of a disk around the point where they meet
    ground = {"facecolor": "white", "alpha": 0.85, "linewidth": 0}
    ax.add_artist(Circle(tuple(LABEL / 2 * toward), GROUND, transform=points, zorder=8, **ground))
    style = {"arrowstyle": "-|>", "mutation_scale": 8, "shrinkA": 0, "shrinkB": 0, "color": OUTLINE, "linewidth": 1}
    text = {"ha": "center", "va": "center", "fontsize": "small", "color": OUTLINE, "zorder": 8.5}
    for name, (x, y) in directions.items():
        tip = (LENGTH * x, LENGTH * y)
        ax.add_artist(FancyArrowPatch((0, 0), tip, transform=points, zorder=8.5, gid=f"compass-{name}", **style))
        ax.text(LABEL * x, LABEL * y, name, transform=points, **text)
    label = ax.text(*(-12 * toward), f"PA {round(position_angle, 1):g}\N{DEGREE SIGN}", transform=points, **text)
    label.set(fontsize="x-small", bbox={**ground, "pad": 1})


def _corner(ax, avoid):
    """Return the corner, such as (0, 1), with the fewest points nearby; if there are no points, the upper left one."""
    corners = [(0, 1), (1, 1), (0, 0), (1, 0)]
    if len(avoid) == 0:
        return corners[0]
    size = ax.get_window_extent()
    points = 72 / ax.figure.dpi * np.array([size.width, size.height])  # size of the axes
    places = ax.transAxes.inverted().transform(ax.transData.transform(avoid)) * points

    def hidden(corner):
        center = np.array(corner) * points + MARGIN * (1 - 2 * np.array(corner))
        return int((np.hypot(*(places - center).T) < LABEL + 10).sum())

    return min(corners, key=hidden)
