"""Sky positions for fibers: positions in gaps between the targets, and the positions that stuck fibers observe."""

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from rfpsurvey._kernels import gaps
from rfpsurvey.allocation._problem import AllocationProblem
from rfpsurvey.focal_plane import Reach

# Number of points that are tested for each positioner, and largest number of blank points that are kept for each
# positioner.
N_TRIALS, N_KEPT = 64, 4


class Sky(NamedTuple):
    """Sky positions, each for one positioner and one fiber type."""

    owner: np.ndarray
    points: np.ndarray
    wanted: np.ndarray
    stuck: np.ndarray  # whether the position is observed by a stuck fiber


def find_sky(plane, points: np.ndarray, separation: float, fiber_types: list[str]) -> Sky:
    """Return sky positions at least ``separation`` (mm) from all points, for each fiber type ("" means any type)."""
    x, y = np.ascontiguousarray(points.T)
    grid = _bin(plane, x, y, separation)
    cx, cy = plane.arrays.xy.T.copy()
    # A van der Corput sequence: for every k, the first k points are spread evenly.
    k = np.arange(N_TRIALS)
    fraction = (sum((k >> b & 1) / (2 << b) for b in range(6)) + 0.5 / N_TRIALS).astype(float)
    parts, taken = [], np.zeros(len(plane), dtype=bool)
    for name in fiber_types:
        able = np.array([name == "" or name in row.split("+") for row in plane.fiber_type.tolist()])
        owner = np.flatnonzero(able & plane.arrays.usable)
        room = len(owner) * N_KEPT
        out = np.empty(room, dtype=np.int64), np.empty(room), np.empty(room)
        fiber = None if name == "" else np.full(len(plane), plane.fiber_types.index(name))
        columns = plane.arrays.using(fiber)
        n = gaps.find_gaps(owner, cx, cy, *columns.edges, fraction, N_KEPT, separation, x, y, grid, *out)
        owner, px, py = (column[:n] for column in out)
        spots = np.column_stack([px, py])
        keep = ~columns.is_hidden(spots)
        if not columns.poses_free:
            keep &= columns.poses_allowed(owner, spots, columns.sides(spots, owner))
        owner, spots = owner[keep], spots[keep]
        # A stuck fiber observes one position, which is known only for its first fiber type. If it is also broken, it
        # observes nothing.
        seeing = plane.arrays.is_stuck & ~plane.disabled & ~taken
        fixed = np.flatnonzero(seeing & ((name == "") | (plane.arrays.first_type == name)))
        seen = plane.arrays.idle(False).segments[2:, fixed].T
        clear = np.array([gaps.is_clear(*p, separation, x, y, *grid) for p in seen], dtype=bool)
        taken[fixed[clear]] = True
        for rows, points_of, stuck in ((owner, spots, False), (fixed[clear], seen[clear], True)):
            parts.append((rows, points_of, np.full(len(rows), name), np.full(len(rows), stuck)))
    return Sky(*(np.concatenate(column) for column in zip(*parts, strict=True)))


def with_sky(
    problem: AllocationProblem, separation: float, avoided: np.ndarray, excludes: Callable | None = None
) -> AllocationProblem:
    """Return the problem; if a requirement or rule counts sky positions, add sky positions between the targets.

    The added positions are at least ``separation`` (mm) from all targets and from the points ``avoided``. The function
    ``excludes`` returns which positions must not be added, from the positions (mm) and the fiber types.
    """
    fibers = list(dict.fromkeys(need.fiber_type for need in problem.options.needs if need.what == "sky"))
    if not fibers:
        return problem
    plane, n = problem.focal_plane, len(problem.xy)
    sky = find_sky(plane, np.vstack([problem.xy, avoided]), separation, fibers)
    if excludes is not None:
        allowed = ~excludes(sky.points, None if plane.fiber_types == ("",) else sky.wanted)
        sky = Sky(*(column[allowed] for column in sky))
    owner, points, wanted, stuck = sky
    k, usable = len(owner), ~stuck
    added = {"xy": points, "rank": np.full(k, len(problem.classes)), "kind": np.full(k, "sky", dtype="U8")}
    if problem.category.strides != (0,):
        # The category of the positions is "sky" only if targets have this category; otherwise, only the kind is "sky".
        added["category"] = np.full(k, "sky" if np.any(problem.category == "sky") else "")
    if problem.any_required:
        added["is_required"] = np.zeros(k, dtype=bool)
    if problem.subpriority is not None:
        added["subpriority"] = np.full(k, problem.subpriority.min(initial=0.0))
    if plane.fiber_types != ("",):  # any fiber can observe a position without a type: the first one of its positioner
        added["fiber_type"] = np.where(wanted == "", plane.arrays.first_type[owner], wanted)
    columns = dict.fromkeys(("category", "is_required", "fiber_type"))
    columns |= {name: np.concatenate([getattr(problem, name), values]) for name, values in added.items()}
    reach, r2 = problem.pairs, ((points - plane.arrays.xy[owner]) ** 2).sum(axis=1)
    pairs = Reach(
        np.concatenate([reach.indptr, reach.indptr[-1] + np.cumsum(usable)]),
        np.concatenate([reach.owner, owner[usable]]),
        np.concatenate([reach.r2, r2[usable]]),
        len(plane),
    )
    watched = np.full(len(plane), -1)
    watched[owner[stuck]] = n + np.flatnonzero(stuck)
    return replace(problem, pairs=pairs, watched=watched if stuck.any() else None, **columns)


def _bin(plane, x, y, separation):
    """Sort targets into grid cells; return the grid as (x0, y0, size, nx, ny, start, order)."""
    margin = plane.arrays.largest_radius[:, None] + separation
    low, high = (plane.arrays.xy - margin).min(axis=0), (plane.arrays.xy + margin).max(axis=0)
    size = max(separation, float(np.sqrt(np.prod(high - low) / max(len(x), 1))), float((high - low).max()) / 4096)
    nx, ny = (int(n) for n in (high - low) // size + 1)
    start, order = np.zeros(nx * ny + 1, dtype=np.int64), np.empty(len(x), dtype=np.int64)
    grid = float(low[0]), float(low[1]), size, nx, ny, start, order
    gaps.bin_points(x, y, *grid)
    return grid
