"""One tile end to end: planned from a catalog, or scored as another planner assigned it."""

from rfpsurvey.tile._field import north_of_date
from rfpsurvey.tile._model import model_sentence
from rfpsurvey.tile._plan import plan_tile
from rfpsurvey.tile._score import score_tile
from rfpsurvey.tile._tile import Tile, versions

__all__ = ["Tile", "model_sentence", "north_of_date", "plan_tile", "score_tile", "versions"]
