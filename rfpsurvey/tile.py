"""Plan a single tile from a catalog, or find the collisions in assignments that another program planned."""

from rfpsurvey._field.plan_tile import plan_tile
from rfpsurvey._field.score import score_tile
from rfpsurvey._field.tile import Tile

__all__ = ["Tile", "plan_tile", "score_tile"]
