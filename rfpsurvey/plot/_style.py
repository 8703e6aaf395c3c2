"""Colors and markers: every difference that matters shows without color, too, by a marker, a hatch or a line."""

__all__ = [
    "ARM", "COLLISION", "DIVERGING", "HATCH", "IDLE", "LEVELS", "MARKERS", "OBSTACLE", "OUTLINE", "PATROL", "RISK",
    "SEQUENTIAL", "SERIES",
]  # fmt: skip

# the palette of Okabe and Ito, which color-blind people can tell apart
PATROL, ARM, IDLE, COLLISION, OBSTACLE = "#56B4E9", "#0072B2", "#8A8A8A", "#D55E00", "#444444"
SERIES = ("#D55E00", "#0072B2", "#E69F00", "#009E73", "#CC79A7", "#56B4E9", "#000000", "#F0E442")
OUTLINE = "#222222"
MARKERS = "osD^vP*X"
HATCH = "//////"
"""On everything that collides or is lost to collisions."""
LEVELS = ("#FFFFFF", "#C9DFF0", "#93C0E0", "#5A9DCC", "#2474B6", "#0C4A8C", "#06234F")
"""Counts 0, 1, 2, ...: steps of lightness, which print in gray as well."""
SEQUENTIAL, DIVERGING, RISK = "viridis", "RdBu_r", "YlOrBr"
