"""Given plans from which allocators start: allocations, and tiles whose targets are found in a new catalog."""

import numpy as np
import scipy  # its subpackages are imported on first use

from rfpsurvey.allocation._answer import AllocationAnswer
from rfpsurvey.errors import InputError, warn

TOLERANCE_MM = 1e-6
"""Largest distance of a target from its position in the plan of a tile."""


def is_plan(start: object) -> bool:
    """Return whether ``start`` is a plan, and not the name of an allocator."""
    return hasattr(start, "target_of_positioner") or hasattr(start, "table")


LOST = -2
"""Target of a positioner whose target in a given plan is not in the problem, or not available to the positioner."""


def from_tile(table, problem, ids: np.ndarray | None) -> AllocationAnswer:
    """Return the plan of a tile for a problem; the target of a positioner can be ``LOST``.

    Targets are found by their identifiers ``ids``, or by their positions if there are none; sky positions that were
    added are always found by their positions.
    """
    plane, n = problem.focal_plane, len(problem.focal_plane)
    columns = ("id", "status", "target_id", "tip_x", "tip_y", "elbow_x", "elbow_y")
    lacking = [name for name in columns if name not in table.colnames]
    if lacking or len(table) != n or not np.array_equal(np.asarray(table["id"]).astype(str), plane.id.astype(str)):
        raise InputError("start must be a tile with the same positioners, got a tile with other positioners")
    tip, elbow = (
        np.column_stack([table[f"{part}_{axis}"].to_value("mm") for axis in "xy"]) for part in ("tip", "elbow")
    )
    had = (np.asarray(table["status"]) == "assigned") & np.isfinite(tip).all(axis=1)
    owner, target_of = np.flatnonzero(had), np.where(had, LOST, -1)
    target = _at(problem.xy, tip[owner])
    if ids is not None:
        order = np.argsort(ids.astype(str), kind="stable")
        names, wanted = ids.astype(str)[order], np.asarray(table["target_id"]).astype(str)[owner]
        place = np.minimum(np.searchsorted(names, wanted), max(len(names) - 1, 0))
        same = names[place] == wanted if len(names) else np.zeros(len(owner), dtype=bool)
        target = np.where(same, order[place] if len(names) else -1, np.where(target >= len(ids), target, -1))
    pairs = problem.pairs
    can = (target >= 0) & np.isin(target * n + owner, pairs.target * n + pairs.owner) & plane.arrays.usable[owner]
    target_of[owner[can]] = target[can]
    if owner.size and not can.any() and len(problem.xy):
        warn("no fiber of the tile in start has a target that it can keep; the tile has other targets or another field")
    (ax, ay), (bx, by) = (elbow - plane.arrays.xy).T, (tip - elbow).T
    return AllocationAnswer(target_of, np.where(ax * by - ay * bx < 0, "left", "right"))


def _at(xy: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return the row of the target at each point; -1 if there is none."""
    rows, known = np.full(len(points), -1), np.flatnonzero(np.isfinite(xy).all(axis=1))
    if len(points) and len(known):
        apart, place = scipy.spatial.cKDTree(xy[known]).query(points)
        rows = np.where(apart <= TOLERANCE_MM, known[place], -1)
    return rows


def changes_of(before: np.ndarray, owner: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Return the cost of each pair of a positioner and a target: 0 if the pair is in the given plan, otherwise 1 or 2.

    ``before`` is the target of each positioner in the given plan. For all plans with the same number of targets, the
    sum of the costs is the number of changed fibers plus the same constant.
    """
    return np.where(before[owner] == target, 0.0, np.where(before[owner] == -1, 2.0, 1.0))


def from_allocation(start, problem, n_given: int, in_reach: np.ndarray, order: np.ndarray | None) -> AllocationAnswer:
    """Return the plan of an allocation of the same targets; ``order`` is the catalog row of each target."""
    rows = slice(None) if order is None else order
    plane, points = problem.focal_plane, problem.xy[:n_given]
    same = (len(start.target_of_positioner), start.n_given) == (len(plane), n_given)
    same = same and np.array_equal(start.in_reach[rows], in_reach)
    same = same and np.array_equal(start.xy_mm[:n_given][rows], points, equal_nan=True)
    if same:
        owner = np.flatnonzero((start.target_of_positioner >= 0) & plane.arrays.usable)
        columns = plane.arrays.using(plane.arrays.index_of(start.fiber_type))
        r = np.hypot(*(start.tips_mm[owner] - columns.xy[owner]).T)
        slack, (inner, outer) = columns.reach_slack, columns.edges
        same = not ((r > outer[owner] + slack) | (r < inner[owner] - slack)).any()
        side = np.where(start.handedness[owner] == "left", -1.0, 1.0)
        tips = start.tips_mm[owner]
        same = same and (columns.poses_free or columns.poses_allowed(owner, tips, side).all())
    if not same:
        raise InputError("start must be an allocation of the same targets to the same focal plane")
    target_of = np.where(start.target_of_positioner < start.n_given, start.target_of_positioner, -1)
    if order is not None:
        target_of = np.append(np.argsort(order), -1)[target_of]
    return AllocationAnswer(target_of, start.handedness)


def with_changes(problem, answer: AllocationAnswer, before: np.ndarray) -> AllocationAnswer:
    """Return an answer with the number of positioners that have another target than in the given plan, or none."""
    after = answer.target_of_positioner
    counted = problem.focal_plane.arrays.usable | (before != -1)
    return answer._replace(meta={**(answer.meta or {}), "n_changed": int(((before != after) & counted).sum())})
