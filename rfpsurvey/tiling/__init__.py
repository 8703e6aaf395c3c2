"""Where the tiles of a survey go."""

from rfpsurvey.tiling._tiling import Tiling, as_tiling

__all__ = ["Tiling", "as_tiling"]
