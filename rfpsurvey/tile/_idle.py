"""Tables of the positioners without a target."""

from typing import TYPE_CHECKING

import astropy.units as u
import numpy as np
from astropy.table import QTable

from rfpsurvey.allocation import IDLE_REASONS, IdleReasons
from rfpsurvey.tile._columns import describe

if TYPE_CHECKING:
    from rfpsurvey.tile._targets import TargetsOfField

IDLE_COLUMNS = {
    "id": "identifier of the positioner",
    "reason": "reason why the positioner has no target",
    "n_in_reach": "number of targets that the positioner can observe",
    "n_free": "number of targets in reach that no positioner observes",
    "n_possible": "number of free targets at which the arm would not collide",
    "colliding_with": "arms and obstacles with which the arm would collide at free targets",
    "target_id": "identifier of a free target in reach",
    "x": "x coordinate of the target in the focal plane",
    "y": "y coordinate of the target in the focal plane",
    "kind": "kind of the target: science, standard or sky",
    "possible": "whether the arm can observe the target without a collision",
}


def idle_tables(found: IdleReasons, targets: "TargetsOfField", positioner_id: np.ndarray) -> tuple[QTable, QTable]:
    """Return a table of the positioners without a target, and a table of their free targets in reach."""
    # for each positioner and free target, the arms and obstacles that block the arm, in one set for each handedness
    pairs: dict[tuple[int, int], list[set[int]]] = {}
    for own, target, others in zip(found.owner.tolist(), found.target.tolist(), found.blocked_by, strict=True):
        pairs.setdefault((own, target), []).append(set(others))
    blockers: dict[int, set[int]] = {own: set() for own in found.positioner.tolist()}
    n_possible = dict.fromkeys(blockers, 0)
    for (own, _), attempts in pairs.items():
        blockers[own].update(*attempts)
        n_possible[own] += not all(attempts)
    table = QTable({"id": positioner_id[found.positioner]})
    table["reason"] = np.array(IDLE_REASONS)[found.reason]
    table["n_in_reach"], table["n_free"] = found.n_in_reach, found.n_free
    table["n_possible"] = np.array(list(n_possible.values()), dtype=int)
    table["colliding_with"] = _texts(blockers.values(), positioner_id)
    own, target = np.array(list(pairs), dtype=int).reshape(-1, 2).T
    row = targets.given[target]
    free = QTable({"id": positioner_id[own], "target_id": targets.id[row]})
    free["x"], free["y"] = targets.xy_mm[row].T * u.mm
    if "kind" in targets.columns:
        free["kind"] = targets.columns["kind"][row]
    free["possible"] = np.array([not all(attempts) for attempts in pairs.values()], dtype=bool)
    free["colliding_with"] = _texts((set().union(*attempts) for attempts in pairs.values()), positioner_id)
    return describe(table, IDLE_COLUMNS), describe(free, IDLE_COLUMNS)


def _texts(groups, positioner_id) -> np.ndarray:
    """Return the identifiers of positioners and obstacles as text, separated by spaces."""
    names = [" ".join(str(positioner_id[k]) if k >= 0 else f"obstacle-{-1 - k}" for k in sorted(one)) for one in groups]
    return np.array(names, dtype=str)
