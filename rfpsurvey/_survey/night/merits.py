"""Merits of tiles: numbers that state how much the observation of a tile is worth, with a table of methods."""

import numpy as np
from astropy.table import QTable

from rfpsurvey._common.descriptions import Method, table_of
from rfpsurvey._common.plugins import Plugin, find_function
from rfpsurvey.errors import InputError

GROUP = "rfpsurvey.merits"
"""Group of the entry points of merits."""
STEP = 10.0


def visits(tiles: QTable) -> np.ndarray:
    """Return the number of visits that are planned for each tile."""
    return np.asarray(tiles["n_visits"], dtype=float)


def classes(tiles: QTable) -> np.ndarray:
    """Return the planned visits, of which each one is worth ten visits to targets of the next priority."""
    by_class = np.asarray(tiles["n_by_class"], dtype=float)
    return by_class @ STEP ** -np.arange(by_class.shape[1])


MERITS = table_of(
    Method("visits", visits, summary="planned visits of the tile"),
    Method("classes", classes, summary="planned visits, each worth ten visits of the next priority"),
)
"""Merits of the tiles of surveys, by name."""


def merit_of(merit: object, tiles: QTable) -> np.ndarray:
    """Return the merit of each tile, after a check; ``merit`` is a name or a function of the table of tiles."""
    function = MERITS[merit].function if isinstance(merit, str) and merit in MERITS else merit
    plugin = find_function(GROUP, function, MERITS, "merit") if not isinstance(function, Plugin) else function
    with plugin.answering():
        values = np.asarray(plugin.value(tiles.copy()), dtype=float)
        if values.shape != (len(tiles),) or not (np.isfinite(values) & (values >= 0)).all():
            raise InputError(f"it must return {len(tiles)} finite numbers of at least 0, one for each tile")
    return values
