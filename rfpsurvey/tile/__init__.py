"""Plan a single tile from a catalog, or find the collisions in assignments that another program planned."""

from rfpsurvey.tile._build import versions
from rfpsurvey.tile._columns import KEPT_COLUMN, OUTCOMES_COLUMNS, TARGET_COLUMNS, TILE_COLUMNS, describe, with_unit
from rfpsurvey.tile._field import north_of_date
from rfpsurvey.tile._model import collision_shape, model_sentence
from rfpsurvey.tile._plan import plan_tile, warn_of_costly_rules
from rfpsurvey.tile._score import score_tile
from rfpsurvey.tile._tile import Tile

__all__ = [
    "KEPT_COLUMN",
    "OUTCOMES_COLUMNS",
    "TARGET_COLUMNS",
    "TILE_COLUMNS",
    "Tile",
    "collision_shape",
    "describe",
    "model_sentence",
    "north_of_date",
    "plan_tile",
    "score_tile",
    "versions",
    "warn_of_costly_rules",
    "with_unit",
]
