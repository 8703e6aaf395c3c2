"""Placement of the tiles of a survey."""

from rfpsurvey._survey.tiling.centers import Centers, Fibers
from rfpsurvey._survey.tiling.place import METHODS, place_tiles
from rfpsurvey._survey.tiling.tiling import Tiling

__all__ = ["METHODS", "Centers", "Fibers", "Tiling", "place_tiles"]
