"""The motion of candidates, if a constraint requires that arms unfold without collisions."""

import numpy as np

from rfpsurvey._kernels.motion import Moves
from rfpsurvey.collision import Folded, Turning, idle_moves, joined, solve_moves, unfolding_obstacles
from rfpsurvey.focal_plane import Reach


class Motion:
    """The motion of the arms of a problem, from their folded poses to their targets.

    Parameters
    ----------
    problem : AllocationProblem
        The allocation problem.
    """

    def __init__(self, problem):
        self._problem, self.same_speed = problem, problem.options.motion_law == "same_speed"
        columns, parked = problem.focal_plane.arrays, problem.parked_obstacles
        self._turning = Turning(columns, Folded.of(columns), idle_moves(columns, parked))
        self._idle = idle_moves(columns, parked, self._turning)

    def moves(self, own: np.ndarray, target: np.ndarray, side: np.ndarray, idle: np.ndarray | None = None) -> Moves:
        """Return the motion of each candidate; ``idle`` contains the indices of the idle arms of all positioners."""
        problem, points = self._problem, np.full((len(own), 2), np.nan)
        real = np.ones(len(own), dtype=bool)
        if idle is not None:
            real[idle] = False
        points[real] = problem.xy[target[real]]
        found = solve_moves(problem.focal_plane.arrays, own, problem.fiber_of(own, target), points, side)
        return found if idle is None else joined(found, idle, self._idle)

    def allowed(self, own: np.ndarray, target: np.ndarray, side: np.ndarray) -> np.ndarray:
        """Return whether the arm of each candidate can turn and unfold without a collision with obstacles.

        The candidates must be sorted by positioner; idle arms are allowed.
        """
        problem, columns = self._problem, self._problem.focal_plane.arrays
        pairs, n = columns.obstacle_pairs, len(problem.focal_plane)
        near = np.zeros(n, dtype=bool)
        near[pairs[:, 0]] = near[list(self._turning.examined)] = True
        rows = np.flatnonzero(near[own] & (target >= 0))
        allowed = np.ones(len(own), dtype=bool)
        if len(rows) == 0:
            return allowed
        who, moves = own[rows], self.moves(own[rows], target[rows], side[rows])
        first = np.searchsorted(pairs[:, 0], np.arange(n + 1))
        size = first[who + 1] - first[who]
        index = np.repeat(np.arange(len(rows)), size)
        offset = np.arange(len(index)) - np.repeat(np.cumsum(size) - size, size)
        test = np.column_stack([index, pairs[np.repeat(first[who], size) + offset, 1]])
        hit = unfolding_obstacles(problem.focal_plane, moves, who, test)
        allowed[rows[test[hit, 0]]] = False
        theta = np.arctan2(moves.y - columns.xy[who, 1], moves.x - columns.xy[who, 0])
        allowed[rows] &= self._turning.allows(who, theta)
        return allowed

    def reachable(self, reach: Reach) -> Reach:
        """Return the pairs (positioner, target) for which at least one pose is `allowed`."""
        problem, columns = self._problem, self._problem.focal_plane.arrays
        order = np.argsort(reach.owner, kind="stable")
        own, target = reach.owner[order], reach.target[order]
        fiber, points = problem.fiber_of(own, target), problem.xy[target]
        if columns.plane.positioner.handedness == "both":
            free = np.zeros(len(own), dtype=bool)
            for side in (1.0, -1.0):
                free |= self.allowed(own, target, np.full(len(own), side)) & columns.poses_allowed(
                    own, points, side, fiber
                )
        else:
            free = self.allowed(own, target, columns.sides(points, own, fiber))
        keep = np.empty(len(own), dtype=bool)
        keep[order] = free
        return reach if keep.all() else reach.where(keep)
