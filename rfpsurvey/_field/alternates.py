"""Alternates: targets that a single fiber of a plan can observe in place of its target, if no other arm moves."""

from itertools import count
from typing import NamedTuple

import numpy as np
from astropy.table import QTable

from rfpsurvey._assignment.allocation import find_attempts
from rfpsurvey._assignment.constraints.motion import PATHS
from rfpsurvey._common.descriptions import Column, describe, table_of, with_unit
from rfpsurvey._common.units import from_lonlat, to_lonlat
from rfpsurvey._field.plan import FieldTargets
from rfpsurvey._field.table import OUTCOMES_COLUMNS, TILE_COLUMNS, id_column
from rfpsurvey._instruments.arms import Arms
from rfpsurvey._instruments.focal_plane import FocalPlane
from rfpsurvey._instruments.reach import Reach
from rfpsurvey._sky.arrays import KINDS, has_role
from rfpsurvey.errors import InputError, check_whole

ALTERNATES = table_of(
    Column("tile", "identifier of the tile"),
    Column("positioner", "identifier of the positioner"),
    Column("rank", "rank among the alternates of the positioner, from 1"),
    *(OUTCOMES_COLUMNS[name] for name in ("target_id", "ra", "dec", "x", "y", "kind", "priority")),
    TILE_COLUMNS["fiber_type"],
    Column("handedness", "handedness of the arm at the target"),
    Column("n_left", "remaining visits of the target if all tiles are observed as planned"),
    Column("n_elsewhere", "number of other tiles of the plan that observe the target"),
    Column("planned", "identifier of the planned target of the positioner"),
    Column("separation", "angle between the target and the planned target", "arcsec"),
)


class PlannedField(NamedTuple):
    """A field, the poses of all arms in its plan, and the pairs that are possible alternates."""

    plane: FocalPlane
    arms: Arms
    law: str
    """Law of time by which arms unfold without collisions; empty text if their motion is ignored."""
    parked_obstacles: bool
    targets: FieldTargets
    xy: np.ndarray
    fiber_type: np.ndarray | None
    reach: Reach
    """The pairs of positioners and targets of ``targets`` that no positioner observes."""
    positioner: np.ndarray
    """Row of each positioner that has a target; the identifiers, kinds and directions of these targets follow."""
    planned: np.ndarray
    kind: np.ndarray
    vectors: np.ndarray


def alternates_of_tile(tile, n: int) -> QTable:
    """Return the alternates of a planned tile; see `Tile.alternates`."""
    plan = getattr(tile.field_targets, "plan", None)
    if plan is None:
        raise InputError(
            "alternates need a tile that plan_tile returned, got a tile that was scored or read from a file"
        )
    plane, allocation, law = plan.instrument.focal_plane, plan.allocation, getattr(plan.report.motion, "law", "")
    given, types = allocation.n_given, allocation.target_fiber_type
    xy, types = allocation.xy_mm[:given], None if types is None else types[:given]
    is_possible = allocation.positioner_of_target[:given] < 0
    is_possible &= True if allocation.excluded is None else ~allocation.excluded
    reach = plane.arrays.reach(xy, types)
    reach = reach.where(is_possible[reach.target])
    about = plan.positioner, plan.id, plan.kind, from_lonlat(plan.lon_rad, plan.lat_rad)
    options = law, allocation.parked_obstacles
    return find_alternates(PlannedField(plane, plan.arms, *options, plan.targets, xy, types, reach, *about), n)


def find_alternates(
    field: PlannedField, n: int, left: np.ndarray | None = None, elsewhere: np.ndarray | None = None
) -> QTable:
    """Return a table of at most ``n`` alternates of each positioner.

    For each target, ``left`` is the number of visits that remain after the plan, and ``elsewhere`` that of other tiles
    that observe it; None for single tiles.
    """
    check_whole(n, "alternates")
    plane, targets, columns = field.plane, field.targets, field.targets.columns
    has_target, planned = np.zeros(len(plane), dtype=bool), np.zeros(len(plane), dtype=field.planned.dtype)
    role, vectors = (
        np.full(len(plane), "science", dtype=np.promote_types("U8", field.kind.dtype)),
        np.full((len(plane), 3), np.nan),
    )
    has_target[field.positioner], planned[field.positioner] = True, field.planned
    role[field.positioner], vectors[field.positioner] = field.kind, field.vectors
    kind = np.full(len(field.xy), "science") if columns.kind is None else columns.kind
    owner, target, side = _free_pairs(field, role, kind)
    tips = np.where(has_target[:, None], field.arms.tip, plane.arrays.xy)
    distance = np.hypot(*(field.xy[target] - tips[owner]).T)
    zeros = np.zeros(len(field.xy))
    priority, subpriority = (zeros if v is None else v for v in (columns.priority, columns.subpriority))
    remaining = np.ones(len(zeros), dtype=int) if left is None else left
    keys = (-side, target, distance, -subpriority[target], -remaining[target], -priority[target])
    order = np.lexsort((*keys, remaining[target] == 0, owner))
    owner, target, side = (values[order] for values in (owner, target, side))
    is_first = np.append(True, (np.diff(owner) != 0) | (np.diff(target) != 0))[: len(owner)]  # one of two elbows
    owner, target, side = (values[is_first] for values in (owner, target, side))
    rank = 1 + np.arange(len(owner)) - np.searchsorted(owner, owner)
    keep = rank <= n
    owner, target, side, rank = (values[keep] for values in (owner, target, side, rank))
    table = QTable({"positioner": plane.id[owner], "rank": rank, "target_id": targets.id[target]})
    lon, lat = to_lonlat(targets.vectors[target])
    table["ra"], table["dec"] = (with_unit(np.rad2deg(angle), "deg") for angle in (lon % (2 * np.pi), lat))
    table["x"], table["y"] = (with_unit(values, "mm") for values in field.xy[target].T)
    for name, values in {
        "kind": columns.kind,
        "priority": columns.priority,
        "n_left": left,
        "n_elsewhere": elsewhere,
    }.items():
        if values is not None:
            table[name] = values[target]
    if field.fiber_type is not None:
        types = field.fiber_type[target]
        table["fiber_type"] = np.where(types == "", plane.arrays.first_type[owner], types)
    if plane.positioner.handedness == "both":
        table["handedness"] = np.where(side > 0, "right", "left")
    table["planned"] = id_column(planned[owner], has_target[owner])
    chord = np.linalg.norm(targets.vectors[target] - vectors[owner], axis=1)
    table["separation"] = with_unit(np.rad2deg(2 * np.arcsin(chord / 2)) * 3600, "arcsec")
    return describe(table, ALTERNATES)


def _free_pairs(field: PlannedField, role: np.ndarray, kind: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the positioners, targets and elbows at which an arm collides with no other arm and no obstacle."""
    plane, reach = field.plane, field.reach
    shared = [has_role(role, name)[reach.owner] & has_role(kind, name)[reach.target] for name in KINDS]
    reach, color = reach.where(np.any(shared, axis=0)), _colors(plane.arrays.neighbors, len(plane))
    law, parts = "" if field.law == PATHS else field.law, []
    # in each step, no two neighbors move, so that arms are compared only with the planned poses of their neighbors
    for number in range(color.max() + 1):
        pairs, options = reach.where(color[reach.owner] == number), {"parked_obstacles": field.parked_obstacles}
        *attempts, blocked_by = find_attempts(plane, field.xy, field.arms, pairs, field.fiber_type, law, **options)
        is_free = np.array([not others for others in blocked_by], dtype=bool)
        parts.append([values[is_free] for values in attempts])
    return tuple(np.concatenate(values) for values in zip(*parts, strict=True))


def _colors(pairs: np.ndarray, n: int) -> np.ndarray:
    """Return a number for each of n positioners; the numbers of the two positioners of each pair differ."""
    color, earlier = np.zeros(n, dtype=int), [[] for _ in range(n)]
    for first, second in np.sort(pairs, axis=1).tolist():
        earlier[second].append(first)
    for row, near in enumerate(earlier):
        used = {*color[near].tolist()}
        color[row] = next(number for number in count() if number not in used)
    return color
