"""Placement of the tiles of a survey."""

from rfpsurvey.tiling._centers import Centers
from rfpsurvey.tiling._conditions import (
    conditions_of_tiles,
    largest_field_rad,
    places_of_tiles,
    times_of_tiles,
    when_of,
    years_of_tiles,
)
from rfpsurvey.tiling._methods import METHODS
from rfpsurvey.tiling._place import place_tiles
from rfpsurvey.tiling._serve import Fibers
from rfpsurvey.tiling._tiling import Tiling, as_tiling
from rfpsurvey.tiling._warnings import warn_of_programs, warn_of_targets

__all__ = [
    "METHODS",
    "Centers",
    "Fibers",
    "Tiling",
    "as_tiling",
    "conditions_of_tiles",
    "largest_field_rad",
    "place_tiles",
    "places_of_tiles",
    "times_of_tiles",
    "warn_of_programs",
    "warn_of_targets",
    "when_of",
    "years_of_tiles",
]
