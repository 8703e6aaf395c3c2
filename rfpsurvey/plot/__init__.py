"""Plots of focal planes, tiles, tilings and surveys, and plots that compare designs, instruments or methods.

The functions return axes or figures without showing them. matplotlib is imported when the first plot is drawn.
"""

from rfpsurvey.plot._classes import COLORINGS
from rfpsurvey.plot._comparisons import draw_instruments, plot_allocators, plot_instruments
from rfpsurvey.plot._designs import plot_designs, plot_probability, plot_residuals
from rfpsurvey.plot._focal_plane import plot_focal_plane, plot_targets
from rfpsurvey.plot._focal_plane_maps import plot_collision_map, plot_coverage
from rfpsurvey.plot._quality import draw_survey, plot_quality
from rfpsurvey.plot._sky import draw_tiling, plot_tiling
from rfpsurvey.plot._speed_accuracy import plot_probability_accuracy, plot_speed_accuracy
from rfpsurvey.plot._survey import plot_completeness, plot_selection, plot_survey_status

__all__ = [
    "COLORINGS",
    "draw_instruments",
    "draw_survey",
    "draw_tiling",
    "plot_allocators",
    "plot_collision_map",
    "plot_completeness",
    "plot_coverage",
    "plot_designs",
    "plot_focal_plane",
    "plot_instruments",
    "plot_probability",
    "plot_probability_accuracy",
    "plot_quality",
    "plot_residuals",
    "plot_selection",
    "plot_speed_accuracy",
    "plot_survey_status",
    "plot_targets",
    "plot_tiling",
]
