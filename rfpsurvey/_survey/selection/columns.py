"""The columns and the summary of selection probabilities."""

import numpy as np

from rfpsurvey._common.descriptions import Column, Fact, table_of
from rfpsurvey._field.table import TARGET_ID

TARGETS = table_of(
    TARGET_ID,
    Column("requested", "number of requested visits"),
    Column("n_tiles", "number of tiles in which at least one positioner reaches the target"),
    Column("BITWEIGHTS", "bit r is 1 if realization r observed the target"),
    Column("n_observed", "number of realizations that observed the target"),
    Column("probability", "n_observed divided by the number of realizations"),
    Column("probability_error", "standard error of the column probability"),
    Column("weight", "inverse probability (n_realizations+1)/(n_observed+1)"),
    Column("weight_error", "standard error of the column weight"),
    Column("unreachable", "whether no positioner reaches the target in any tile"),
    Column("never_observed", "whether no realization observed the target"),
)
OF_CADENCES = table_of(
    Column("n_with_visits", "element k is the number of realizations in which k visits of the target count"),
    Column("n_complete", "number of realizations that complete the cadence of the target"),
    Column("probability_complete", "n_complete divided by the number of realizations"),
)
"""Further columns of surveys with cadences."""
STORED = dict.fromkeys(("n_tiles", "n_observed", "n_with_visits", "n_complete"), np.int32)
STORED |= dict.fromkeys(("probability", "probability_error", "weight", "weight_error"), np.float32)
STORED["probability_complete"] = np.float32
"""Data types of columns in tables and files."""
SELECTION_FACTS = (
    Fact("n_realizations", "realizations", zero=True),
    Fact("n_tiles", "tiles", zero=True),
    Fact("n_targets", "targets with requested visits", zero=True),
    Fact("n_unreachable", "targets in reach of no tile", zero=True),
    Fact("n_never_observed", "targets never observed", zero=True),
    Fact("n_sometimes_observed", "targets sometimes observed", zero=True),
    Fact("n_always_observed", "targets always observed", zero=True),
    Fact("mean_probability", "mean selection probability", zero=True),
    Fact("mean_probability_complete", "mean completion probability", zero=True),
    Fact("n_assigned", "assigned fibers, all realizations", zero=True),
    Fact("n_lost", "lost to collisions", "n_assigned", zero=True),
    Fact("n_observed", "visits observed, all realizations", zero=True),
)
"""The numbers of the summary of selection probabilities that are shown."""
