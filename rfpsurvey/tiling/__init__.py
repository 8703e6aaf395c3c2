"""Placement of the tiles of a survey."""

from rfpsurvey.tiling._centers import Centers
from rfpsurvey.tiling._columns import warn_of_programs, warn_of_targets
from rfpsurvey.tiling._conditions import FieldsOfTiles, conditions_of_tiles, places_of_tiles, times_of_tiles, when_of
from rfpsurvey.tiling._methods import METHODS
from rfpsurvey.tiling._place import place_tiles
from rfpsurvey.tiling._serve import Fibers
from rfpsurvey.tiling._tiling import Tiling, as_tiling

__all__ = [
    "METHODS",
    "Centers",
    "Fibers",
    "FieldsOfTiles",
    "Tiling",
    "as_tiling",
    "conditions_of_tiles",
    "place_tiles",
    "places_of_tiles",
    "times_of_tiles",
    "warn_of_programs",
    "warn_of_targets",
    "when_of",
]
