"""Tables of selection probabilities: the realizations, and a row for each target."""

import numpy as np
from astropy.table import QTable

from rfpsurvey.tile import describe, model_sentence

REALIZATIONS = {
    "realization": "number of the realization, and of its bit in BITWEIGHTS",
    "seed": "seed of the subpriorities and of the random numbers of the realization",
    "n_assigned": "number of usable positioners with a target, summed over all tiles",
    "n_lost": "number of targets lost to collisions, summed over all tiles",
    "n_observed": "number of visits to science targets, without lost targets, summed over all tiles",
}
TARGETS = {
    "target_id": "identifier of the target",
    "requested": "number of requested visits",
    "n_tiles": "number of tiles in which at least one positioner reaches the target",
    "BITWEIGHTS": "bit r is 1 if realization r observed the target",
    "n_observed": "number of realizations that observed the target",
    "probability": "n_observed divided by the number of realizations",
    "probability_error": "standard error of the column probability",
    "weight": "inverse probability (n_realizations+1)/(n_observed+1)",
    "weight_error": "standard error of the column weight",
    "unreachable": "whether no positioner reaches the target in any tile",
    "never_observed": "whether no realization observed the target",
}


def realization_table(request, seeds: list[int], counts: np.ndarray, *, together: bool) -> QTable:
    """Return a table with a row for each realization, and with the provenance in its meta."""
    table = QTable({"realization": np.arange(len(seeds)), "seed": np.array(seeds, dtype=np.int64)})
    for name, column in zip(("n_assigned", "n_lost", "n_observed"), counts.T, strict=True):
        table[name] = column
    n_usable = int(request.instrument.focal_plane.arrays.usable.sum())
    n_tiles = len(request.tiling) - len(request.dropped)
    table.meta = {
        "summary": {
            "n_realizations": len(seeds),
            "n_tiles": n_tiles,
            "n_rounds": len(request.rounds),
            "n_fibers": n_usable * n_tiles,
            **({} if request.moved is None else {"epoch": request.moved}),
            "model": model_sentence(request.instrument, projection="radial" if request.conditions is None else "full"),
        },
        "provenance": request.provenance,
    }
    return describe(table, REALIZATIONS)
