"""The table of the state of all targets."""

import numpy as np
from astropy.table import QTable

from rfpsurvey.catalog import Catalog
from rfpsurvey.survey._history._catalogs import is_science, kinds_of
from rfpsurvey.survey._history._replay import Replay
from rfpsurvey.survey._history._rule import LAST
from rfpsurvey.tile import describe

STATE = {
    "target_id": "identifier of the target",
    "requested": "number of requested visits",
    "observed": "number of successful visits",
    "failed": "number of failed visits",
    "left": "number of remaining visits",
    "kind": "kind of the target: science, standard or sky",
    "priority": "priority that the rule determines",
    "last": "result of the last visit",
    "last_tile": "tile of the last visit",
    "last_date": "date of the last visit",
}


def state_table(state) -> QTable:
    """Return the table of a `SurveyState`; see `SurveyState.table`."""
    own, n = state.replayed, len(state.observed)
    catalog = state.catalog if isinstance(state.catalog, Catalog) else None
    ids = state.catalog.parts.column("id") if catalog is None else catalog.id
    table = QTable({"target_id": ids}, copy=False)
    counts = is_science(state.catalog)
    for name in ("requested", "observed", "failed", "left"):
        table[name] = np.where(counts, getattr(state, name), np.uint8(0))
    kind = kinds_of(state.catalog)
    if kind is not None:
        table["kind"] = kind
    if catalog is not None and catalog.priority is not None:
        table["priority"] = catalog.priority
    table["last"] = np.array(LAST)[last_results(own)]
    for name, values in (
        ("last_tile", [one.tile for one in own.attempts]),
        ("last_date", [one.date for one in own.attempts]),
    ):
        table[name] = np.array([*values, ""])[own.last] if n else np.array([], dtype=str)
    table.meta["events"] = state.record
    return describe(table, STATE)


def last_results(own: Replay) -> np.ndarray:
    """Return the result of the last visit of each target as an index of ``LAST``."""
    return np.where(own.last < 0, 0, np.where(own.is_good, LAST.index("good"), LAST.index("bad")))
