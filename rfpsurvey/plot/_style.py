"""Colors and markers of plots. Important differences are shown by color and by a marker, a hatch or a line style."""

import numpy as np
from matplotlib import colormaps
from matplotlib.colors import ListedColormap

# the palette of Okabe and Ito, whose colors color-blind people can distinguish
PATROL, ARM, IDLE, COLLISION, OBSTACLE = "#56B4E9", "#0072B2", "#8A8A8A", "#D55E00", "#444444"
SERIES = ("#D55E00", "#0072B2", "#E69F00", "#009E73", "#CC79A7", "#56B4E9", "#000000", "#F0E442")
GROUP_COLORS = (
    *SERIES[:6],
    "#555555",
    "#F0E442",
    "#F2B58A",
    "#5E3C99",
    "#8C5A00",
    "#8FD9C0",
    "#8E3B6B",
    "#B9E1F7",
    "#C4C4C4",
    "#8A8300",
    "#8B1A1A",
    "#9DB7E8",
    "#FFD9A0",
    "#004D38",
    "#F3D0E4",
    "#1D3F6E",
    "#000000",
    "#C8D96F",
)
"""Fill colors of groups: the palette, then lighter or darker versions of its colors."""
FADED, FAINT = "#A8A8A8", "#8A8A8A26"
"""Color of positioners without a target, and color of the disks behind dots: a translucent gray, faint on any page."""
OUTLINE = "#222222"
MARKERS = "osD^vP*X"
OPEN_CIRCLE = {"marker": "o", "markerfacecolor": "none", "linestyle": "none"}
"""Style of legend entries that show a circle without a fill."""
HATCH = "//////"
"""Hatch of arms, disks and bars that show collisions or fibers lost to collisions."""
LEVELS = ("#FFFFFF", "#C9DFF0", "#93C0E0", "#5A9DCC", "#2474B6", "#0C4A8C", "#06234F")
"""Colors for points that 0, 1, 2, ... positioners reach. The lightness differs, so that prints in gray are legible."""
SEQUENTIAL, DIVERGING, PROBABILITY_COLORS = "viridis", "RdBu_r", "YlOrBr"


def light_scale():
    """Return the sequential color map without its darkest third, in which dark edges would not be visible."""
    return ListedColormap(colormaps[SEQUENTIAL](np.linspace(0.35, 1, 256)))
