"""Colors and markers."""

__all__ = ["ARM", "COLLISION", "IDLE", "MARKERS", "OBSTACLE", "PATROL", "SERIES"]

# the palette of Okabe and Ito, which color-blind people can tell apart, with a plain red for collisions
PATROL, ARM, IDLE, COLLISION, OBSTACLE = "#56B4E9", "#0072B2", "#9A9A9A", "#D00000", "#444444"
SERIES = ("#D00000", "#0072B2", "#E69F00", "#009E73", "#CC79A7", "#56B4E9", "#000000", "#F0E442")
MARKERS = "osD^vP*X"
