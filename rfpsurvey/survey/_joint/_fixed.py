"""Tiles that were already observed; their plans are taken from another survey."""

from typing import NamedTuple

import numpy as np

from rfpsurvey.allocation import TileCandidates
from rfpsurvey.errors import InputError, refusal
from rfpsurvey.survey._survey import Survey

__all__ = ["FixedTile", "candidates_of", "fixed_tiles"]


class FixedTile(NamedTuple):
    """The plan of a tile that was already observed."""

    slot: np.ndarray
    """Slot of the target of each positioner (see `Bookkeeping`); -1 if the positioner has no target."""
    side: np.ndarray
    """Handedness of each positioner: +1 is right, -1 is left."""
    counted: np.ndarray
    """Whether the visit of each positioner counts as an observation."""


def fixed_tiles(request) -> dict[int, FixedTile]:
    """Return the plans of the tiles that the option ``fixed`` contains, as a dict from the row of a tile to its plan.

    Raises
    ------
    InputError
        If the fixed survey has another instrument or other targets, if it contains none of the tiles of the tiling, if
        it contains more visits of a target than requested, or if its positioners have the handedness ``both``.
    """
    given = request.joint.fixed
    if given is None:
        return {}
    survey = given if isinstance(given, Survey) else Survey.read(given)
    plane = request.instrument.focal_plane
    digest = survey.provenance["instrument"].get("digest")
    if digest != request.instrument.provenance["digest"]:
        name = request.instrument.name
        raise InputError(f"fixed must be a survey with the instrument {name!r}, got a survey with another instrument")
    if plane.positioner.handedness == "both":
        raise InputError(
            "fixed needs positioners of one handedness, because a survey does not record to which side an arm bends"
        )
    side = -1 if plane.positioner.handedness == "left" else 1
    slot_of_row = np.argsort(request.source.to_slots(np.arange(len(request.source))), kind="stable")
    ids, left = request.source.ids(), request.open_state().left.astype(np.int64)
    row_of = {name: k for k, name in enumerate(plane.id.tolist())}
    known = {str(name) for name in np.asarray(survey.tiles["tile"]).tolist()}
    found = {}
    for tile, name in enumerate(np.asarray(request.tiling.table["tile"]).tolist()):
        if str(name) not in known:
            continue
        visits = survey.visits(name)
        row, observed = np.asarray(visits["target_row"]), np.asarray(visits["observed"]).astype(bool)
        same = (row >= 0) & (row < len(ids))
        if not same.all() or (ids[row].astype(str) != np.asarray(visits["target_id"]).astype(str)).any():
            raise InputError(f"fixed must be a survey of the targets of this catalog, got other targets in tile {name}")
        own = np.array([row_of[one] for one in np.asarray(visits["positioner"]).tolist()], dtype=np.int64)
        slot, counted = np.full(len(plane), -1), np.zeros(len(plane), dtype=bool)
        slot[own], counted[own] = slot_of_row[row], observed
        left[slot[counted]] -= 1
        if (left[slot[own]] < 0).any() or (request.open_state().left[slot[own]] == 0).any():
            worst = slot[own][np.argmin(left[slot[own]])]
            row = int(np.flatnonzero(slot_of_row == worst)[0])
            raise InputError(
                f"fixed must not have more visits of a target than requested, got too many visits of target {ids[row]}"
            )
        found[tile] = FixedTile(slot, np.full(len(plane), side, dtype=np.int8), counted)
    if not found:
        raise refusal("fixed must be a survey with at least one tile of the tiling", given)
    return found


def candidates_of(fixed: FixedTile, slots: np.ndarray) -> TileCandidates:
    """Return the candidates of a fixed tile, one for each positioner.

    ``slots`` lists the slots of all targets in the field of the tile. Visits that do not count as observations
    are omitted.
    """
    n = len(fixed.slot)
    order = np.argsort(slots, kind="stable")
    target = np.full(n, -1, dtype=np.int32)
    own = np.flatnonzero(fixed.counted)
    target[own] = order[np.searchsorted(slots[order], fixed.slot[own])]
    empty = np.empty(0, dtype=np.int32)
    pairs = own.astype(np.int32), target[own]
    return TileCandidates(
        np.arange(n + 1), target, fixed.side, np.zeros(1, dtype=np.int64), empty, np.zeros(n, dtype=bool), pairs
    )
