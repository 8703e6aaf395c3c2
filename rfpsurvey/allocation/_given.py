"""Given plans from which allocators start: allocations, and tiles whose targets are found by their positions."""

import numpy as np
import scipy  # its subpackages are imported on first use

from rfpsurvey.allocation._answer import AllocationAnswer
from rfpsurvey.errors import InputError

TOLERANCE_MM = 1e-6
"""Largest distance of a target from its position in the plan of a tile."""


def is_plan(start: object) -> bool:
    """Return whether ``start`` is a plan, and not the name of an allocator."""
    return hasattr(start, "target_of_positioner") or hasattr(start, "table")


def from_tile(table, problem) -> AllocationAnswer:
    """Return the plan of a tile for a problem; positioners whose targets are not in the problem have none."""
    plane, n = problem.focal_plane, len(problem.focal_plane)
    lacking = [name for name in ("id", "status", "tip_x", "tip_y", "elbow_x", "elbow_y") if name not in table.colnames]
    if lacking or len(table) != n or not np.array_equal(np.asarray(table["id"]).astype(str), plane.id.astype(str)):
        raise InputError("start must be a tile with the same positioners, got a tile with other positioners")
    tip, elbow = (
        np.column_stack([table[f"{part}_{axis}"].to_value("mm") for axis in "xy"]) for part in ("tip", "elbow")
    )
    own = np.flatnonzero((np.asarray(table["status"]) == "assigned") & np.isfinite(tip).all(axis=1))
    target_of, known = np.full(n, -1), np.flatnonzero(np.isfinite(problem.xy).all(axis=1))
    if len(own) and len(known):
        apart, place = scipy.spatial.cKDTree(problem.xy[known]).query(tip[own])
        own, target = own[apart <= TOLERANCE_MM], known[place[apart <= TOLERANCE_MM]]
        pairs = problem.pairs
        can = np.isin(target * n + own, pairs.target * n + pairs.owner)
        target_of[own[can]] = target[can]
    (ax, ay), (bx, by) = (elbow - plane.arrays.xy).T, (tip - elbow).T
    return AllocationAnswer(target_of, np.where(ax * by - ay * bx < 0, "left", "right"))


def from_allocation(start, problem, n_given: int, in_reach: np.ndarray, order: np.ndarray | None) -> AllocationAnswer:
    """Return the plan of an allocation of the same targets; ``order`` is the catalog row of each target."""
    rows = slice(None) if order is None else order
    plane, points = problem.focal_plane, problem.xy[:n_given]
    same = (len(start.target_of_positioner), start.n_given) == (len(plane), n_given)
    same = same and np.array_equal(start.in_reach[rows], in_reach)
    same = same and np.array_equal(start.xy_mm[:n_given][rows], points, equal_nan=True)
    if same:
        own = np.flatnonzero((start.target_of_positioner >= 0) & plane.arrays.usable)
        columns = plane.arrays.using(plane.arrays.index_of(start.fiber_type))
        r = np.hypot(*(start.tips_mm[own] - columns.xy[own]).T)
        slack, (inner, outer) = columns.reach_slack, columns.edges
        same = not ((r > outer[own] + slack) | (r < inner[own] - slack)).any()
        side = np.where(start.handedness[own] == "left", -1.0, 1.0)
        tips = start.tips_mm[own]
        same = same and (columns.poses_free or columns.poses_allowed(own, tips, side).all())
    if not same:
        raise InputError("start must be an allocation of the same targets to the same focal plane")
    target_of = np.where(start.target_of_positioner < start.n_given, start.target_of_positioner, -1)
    if order is not None:
        target_of = np.append(np.argsort(order), -1)[target_of]
    return AllocationAnswer(target_of, start.handedness)


def with_changes(problem, answer: AllocationAnswer) -> AllocationAnswer:
    """Return an answer with the number of positioners that have another target than in the given plan, or none."""
    n = int((problem.start().target_of_positioner != answer.target_of_positioner).sum())
    return answer._replace(meta={**(answer.meta or {}), "n_changed": n})
