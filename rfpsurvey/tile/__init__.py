"""Plan a single tile from a catalog, or find the collisions in assignments that another program planned."""

from rfpsurvey.tile._facts import (
    TILE_FACTS,
    model_sentence,
    required_of,
    rules_of_tile,
    tile_facts,
    tile_objectives,
    tile_problems,
    versions,
)
from rfpsurvey.tile._plan import plan_tile, warn_of_costly_rules
from rfpsurvey.tile._recorded import north_of_date
from rfpsurvey.tile._score import score_tile
from rfpsurvey.tile._tile import Tile, collision_shape
