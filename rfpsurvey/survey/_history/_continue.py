"""Continue a survey from its state: observed tiles keep their plans, and the others are planned."""

import hashlib
import json

import numpy as np

from rfpsurvey.survey._bookkeeping import Bookkeeping
from rfpsurvey.survey._flags import DONE, flags_of
from rfpsurvey.survey._history._events import DONE as OBSERVED
from rfpsurvey.survey._work import reach_of

STATES = ("planned", "done", "partly", "dropped")


def begin(request, bookkeeping: Bookkeeping) -> None:
    """Mark the targets in the fields and in reach of the observed tiles.

    The marks of a tile are stored with the state, so that they are computed only once. Targets with successful visits
    are omitted, because their outcome does not depend on the marks.
    """
    own, source = request.state.replayed, request.source
    about = json.dumps([request.instrument.provenance["digest"], request.parameters], default=str, sort_keys=True)
    own.mark_for(hashlib.sha256(about.encode()).hexdigest())
    unseen = (own.made == 0).astype(np.uint8)
    added = unseen.copy()
    added[: own.n_searched] = 0
    for attempts, searched in ((own.attempts[: own.n_flagged], added), (own.attempts[own.n_flagged :], unseen)):
        left = source.to_slots(searched)
        for event in attempts if searched.any() else ():
            if event.state == OBSERVED:
                job = request.job(event.row, left)
                reach = reach_of(job)
                own.flags[job.field.row] |= flags_of(reach.pairs.covered, reach.excluded)
    own.n_flagged, own.n_searched = len(own.attempts), len(unseen)
    bookkeeping.flags |= source.to_slots(own.flags)
    bookkeeping.flags[source.to_slots(own.made) > 0] |= DONE


def state_columns(request) -> dict[str, np.ndarray]:
    """Return the columns of the table of tiles that state what was observed."""
    state, n = request.state, len(request.tiling)
    names, dates, failed = np.full(n, "planned", dtype="U8"), np.full(n, "", dtype="U10"), np.zeros(n, dtype=np.int64)
    for row, event in {**state.closed, **state.begun}.items():
        names[row] = "dropped" if event is None else event.state
        dates[row] = "" if event is None else event.date
        failed[row] = 0 if event is None else state.replayed.n_failed.get(row, 0)
    return {"state": names, "date": dates, "n_failed": failed}
