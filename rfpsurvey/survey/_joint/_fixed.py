"""Tiles that were already observed; their plans are taken from another survey."""

from typing import NamedTuple

import numpy as np
from astropy.coordinates import SkyCoord
from astropy.table import QTable

from rfpsurvey._roles import has_role
from rfpsurvey._units import to_vectors
from rfpsurvey.allocation import TileCandidates, no_rules
from rfpsurvey.catalog import SkyIndex, to_time
from rfpsurvey.errors import InputError, short
from rfpsurvey.focal_plane import FocalPlane
from rfpsurvey.pipeline import FieldBuilder, FieldTargets, project_field
from rfpsurvey.survey._survey import Survey
from rfpsurvey.survey._work import projection_of
from rfpsurvey.tiling import Tiling, places_of_tiles, when_of

# Options that determine where the arms of a tile are, and whether a visit counts.
SAME = ("epoch", "lost_in_collision", "keep_out", "constraints", "conditions")
# Largest difference (degrees) between the centers, position angles and targets of two equal tiles: about 1 mas.
TOLERANCE = 3e-7


class TilePlan(NamedTuple):
    """The plan of a tile."""

    slot: np.ndarray
    """Slot of the target of each positioner (see `Bookkeeping`); -1 if the positioner has no target.

    The number of all slots is added for a science target that the tile observes only in its other roles (see
    `FieldBuilder`), without using one of its visits. The slot of the blank sky position with the index k is -2 - k.
    These positions do not depend on which targets have remaining visits.
    """
    side: np.ndarray
    """Handedness of each positioner: +1 is right, -1 is left."""
    counted: np.ndarray | None = None
    """Whether the visit of each positioner of an observed tile counts as an observation; None for other tiles."""
    blank_mm: np.ndarray | None = None
    """Position of the blank sky that each positioner of an observed tile observes, in mm; NaN if it observes none."""

    def spent(self, builder: FieldBuilder) -> np.ndarray:
        """Return the slots of the targets of which an observed tile uses a visit."""
        return builder.spending(self.slot[self.counted & (self.slot < len(builder.left))])


def fixed_tiles(request) -> dict[int, TilePlan]:
    """Return the plans that do not change, as a dict from the row of a tile to its plan.

    These are the plans of the tiles that the option ``fixed`` contains. In a survey with recorded events, tiles that
    were partly observed keep their plans, and observed and dropped tiles observe no further targets.

    Raises
    ------
    InputError
        If the fixed survey has another instrument, other targets, another epoch, or other observing conditions, if it
        contains a tile that is not in the tiling, if it contains more visits of a target than requested, or if its
        positioners have the handedness ``both``.
    """
    given = request.joint.fixed
    if request.state is not None:
        if given is not None:
            raise InputError(
                "fixed must not be given for a survey with recorded events, which keeps its observed tiles"
            )
        return _recorded_tiles(request)
    if given is None:
        return {}
    survey = given if isinstance(given, Survey) else Survey.read(given)
    plane = request.instrument.focal_plane
    _check_request(request, survey)
    left = request.builder.left.astype(np.int64)
    requested, every = left > 0, np.ones(len(left), dtype=np.uint8)
    plans = {}
    names = np.asarray(survey.tiles["tile"]).tolist()
    for name, tile, visits in zip(names, _counterparts(request.tiling, survey.tiles), survey, strict=True):
        visits, blank = (visits[(np.asarray(visits["target_row"]) >= 0) == is_target] for is_target in (True, False))
        job = request.job(tile, every)
        field = job.field
        index = _targets_of(visits, field)
        if index is None:
            raise InputError(
                f"fixed must be a survey of the targets of this catalog, got other targets or positions in tile {name}"
            )
        slot = with_roles(request.builder, field.slot[index], visits)
        plan = _plan_of(plane, visits["positioner"], slot, visits["observed"])
        left[plan.spent(request.builder)] -= 1
        bad = np.flatnonzero((left[field.slot[index]] < 0) | ~requested[field.slot[index]])
        if len(bad):
            raise InputError(
                "fixed must not have more visits of a target than requested, got too many visits of target "
                f"{field.targets.id[index[bad[0]]]}"
            )
        blank_mm = np.full((len(plane), 2), np.nan)
        if len(blank):
            types = np.asarray(blank["fiber_type"]).astype(str) if "fiber_type" in blank.colnames else None
            vectors = to_vectors(SkyCoord(blank["ra"], blank["dec"]))
            places = project_field(request.instrument, projection_of(job), vectors, types)[0]
            blank_mm[_rows_of(plane, blank["positioner"])] = places
        plans[tile] = plan._replace(blank_mm=blank_mm)
    return plans


def _recorded_tiles(request) -> dict[int, TilePlan]:
    """Return the plans of the tiles that were observed, partly observed or dropped."""
    plane, state = request.instrument.focal_plane, request.state
    if state.begun and plane.positioner.handedness == "both":
        raise InputError(
            "a joint plan of a survey with partly observed tiles needs positioners of one handedness, because a survey "
            "does not record to which side an arm bends"
        )
    every, left = np.ones(len(request.builder.left), dtype=np.uint8), request.builder.left.copy()
    plans = {row: _plan_of(plane, [], [], []) for row in state.closed}
    for tile, event in state.begun.items():
        visits = state.events.visits(event)[0]
        visits = visits[visits["target_row"] >= 0]
        field = request.job(tile, every).field
        base = field.slot[np.searchsorted(field.row, visits["target_row"])]
        slot = with_roles(request.builder, base, visits)
        counted = visits["observed"].astype(bool) & ((left[base] > 0) | (slot != base))
        plans[tile] = _plan_of(plane, visits["positioner"], slot, counted)
        left[plans[tile].spent(request.builder)] -= 1
    return plans


def _plan_of(plane: FocalPlane, positioner, slot, counted) -> TilePlan:
    """Return the plan of an observed tile; the parameters have an element for each visit."""
    rows, side = _rows_of(plane, positioner), -1 if plane.positioner.handedness == "left" else 1
    plan = TilePlan(np.full(len(plane), -1), np.full(len(plane), side, np.int8), np.zeros(len(plane), dtype=bool))
    plan.slot[rows], plan.counted[rows] = slot, counted
    return plan


def _rows_of(plane: FocalPlane, positioner) -> np.ndarray:
    """Return the rows of the positioners with the given identifiers."""
    row_of = {name: k for k, name in enumerate(plane.id.tolist())}
    return np.array([row_of[name] for name in np.asarray(positioner).tolist()], dtype=np.int64)


def with_roles(builder: FieldBuilder, slot: np.ndarray, visits) -> np.ndarray:
    """Return slots, with the number of all slots added for targets that are visited only in other roles.

    ``visits`` is a table of visits, or the columns of targets (`FieldTargets`), with an element for each slot.
    """
    if builder.lasting is None:
        return slot
    kind = visits.columns.kind if isinstance(visits, FieldTargets) else np.asarray(visits["kind"]).astype(str)
    return np.where(builder.lasting[slot] & ~has_role(kind, "science"), slot + len(builder.left), slot)


def _check_request(request, survey: Survey) -> None:
    """Raise an error if the instrument or an option of the fixed survey does not allow the plans of its tiles."""
    if survey.provenance["instrument"].get("digest") != request.instrument.provenance["digest"]:
        name = request.instrument.name
        raise InputError(f"fixed must be a survey with the instrument {name!r}, got a survey with another instrument")
    if request.instrument.focal_plane.positioner.handedness == "both":
        raise InputError(
            "fixed needs positioners of one handedness, because a survey does not record to which side an arm bends"
        )
    now, before = request.provenance["parameters"], survey.provenance["parameters"]
    for name in SAME:
        values = [parameters.get(name) for parameters in (now, before)]
        if name == "epoch":
            # positions at the times of the tiles are compared with the positions of the visits
            if request.years is not None or " to " in str(values[1]):
                continue
            values = [value if value is None else to_time(value, "epoch").jyear for value in values]
        if values[0] != values[1]:
            raise InputError(
                f"fixed must be a survey with the {name} {short(now.get(name))}, got one with the {name} "
                f"{short(before.get(name))}; use the same {name} for both surveys"
            )


def _counterparts(tiling: Tiling, earlier: QTable) -> list[int]:
    """Return, for each tile of an earlier survey, the row of the tile with the same center and position angle.

    If several tiles have this center and position angle, a tile with the same identifier is preferred.
    """
    before = Tiling(QTable(earlier[("tile", "ra", "dec", "position_angle", "pass")], meta={}))
    names, earlier_names = (np.asarray(some_tiling.table["tile"]).astype(str) for some_tiling in (tiling, before))
    places, earlier_places, index = places_of_tiles(tiling), places_of_tiles(before), SkyIndex(tiling.vectors)
    fits, row_of_earlier, used = [], np.full(len(before), -1), set()
    for vector, place in zip(before.vectors, earlier_places, strict=True):
        near = index.order[index.near(vector, np.deg2rad(TOLERANCE))]
        turn = (places[near, 2] - place[2] + 180) % 360 - 180
        fits.append(near[np.abs(turn) <= TOLERANCE].tolist())
    for by_name in (True, False):  # first the tiles with the same identifier
        for k in np.flatnonzero(row_of_earlier < 0).tolist():
            rows = [row for row in fits[k] if row not in used and (not by_name or names[row] == earlier_names[k])]
            if rows:
                row_of_earlier[k] = rows[0]
                used.add(rows[0])
    missing = np.flatnonzero(row_of_earlier < 0)
    if len(missing):
        k = missing[0]
        same = np.flatnonzero(names == earlier_names[k])
        text = f"fixed must contain only tiles of the tiling, got tile {earlier_names[k]} at {_text(earlier_places[k])}"
        if len(same) and same[0] not in used:
            text += f", but the tile {earlier_names[k]} of the tiling is at {_text(places[same[0]])}"
        else:
            text += "; add this tile to the tiling"
        raise InputError(text + (f"; number of other tiles that are missing: {len(missing) - 1}" * (len(missing) > 1)))
    when = when_of(earlier)
    if when is not None and when in tiling.table.colnames:
        values, earlier_values = np.asarray(tiling.table[when])[row_of_earlier], np.asarray(earlier[when])
        for k in np.flatnonzero(values != earlier_values)[:1].tolist():
            raise InputError(f"fixed must have the {when} of the tiling, got another value for tile {earlier_names[k]}")
    return row_of_earlier.tolist()


def _text(place: np.ndarray) -> str:
    return "{:.6f} {:+.6f} deg, position angle {:.7g} deg".format(*place)


def _targets_of(visits: QTable, field) -> np.ndarray | None:
    """Return, for each visit, the index of its target in the field; None if a target is not there."""
    if not np.isin(visits["target_row"], field.row).all():
        return None
    index = np.searchsorted(field.row, visits["target_row"])
    if (field.targets.id[index].astype(str) != np.asarray(visits["target_id"]).astype(str)).any():
        return None
    vectors = to_vectors(SkyCoord(visits["ra"], visits["dec"]))
    apart = np.linalg.norm(vectors - field.targets.vectors[index], axis=1)
    return index if (apart <= np.deg2rad(TOLERANCE)).all() else None


def candidates_of(fixed: TilePlan, slots: np.ndarray) -> TileCandidates:
    """Return the candidates of a fixed tile, one for each positioner.

    ``slots`` lists the slots of all targets in the field of the tile. Visits that do not count as observations
    are omitted.
    """
    n, order = len(fixed.slot), np.argsort(slots, kind="stable")
    target, counted = np.full(n, -1, dtype=np.int32), np.flatnonzero(fixed.counted)
    target[counted] = order[np.searchsorted(slots[order], fixed.slot[counted])]
    cliques = np.zeros(1, dtype=np.int64), np.empty(0, dtype=np.int32)
    pairs, shortened = (counted.astype(np.int32), target[counted]), np.zeros(n, dtype=bool)
    return TileCandidates(np.arange(n + 1), target, fixed.side, *cliques, shortened, pairs, no_rules(n))
