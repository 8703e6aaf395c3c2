"""Pictures. matplotlib is imported when the first one is drawn; nothing is ever shown."""

from rfpsurvey.plot._designs import plot_designs
from rfpsurvey.plot._focal_plane import plot_focal_plane
from rfpsurvey.plot._instruments import draw_instruments, plot_instruments
from rfpsurvey.plot._reproduction import draw_reproduction
from rfpsurvey.plot._sky import draw_survey, plot_completeness, plot_tiling
from rfpsurvey.plot._speed_accuracy import plot_probability_accuracy, plot_speed_accuracy

__all__ = [
    "draw_instruments", "draw_reproduction", "draw_survey", "plot_completeness", "plot_designs", "plot_focal_plane",
    "plot_instruments", "plot_probability_accuracy", "plot_speed_accuracy", "plot_tiling",
]  # fmt: skip
