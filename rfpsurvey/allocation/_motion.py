"""The motion of candidates, if a constraint requires that arms unfold without collisions."""

import numpy as np

from rfpsurvey._kernels.motion import Moves
from rfpsurvey.collision import Folded, Turning, idle_moves, joined, solve_moves, turn_idle_arms, unfolding_obstacles
from rfpsurvey.focal_plane import Reach


class Motion:
    """The motion of the arms of a problem, from their folded poses to their targets.

    Folded arms without a target have the directions in which they collide with the fewest candidates.

    Parameters
    ----------
    problem : AllocationProblem
        The allocation problem.
    """

    def __init__(self, problem):
        self.same_speed = problem.options.motion_law == "same_speed"
        columns, parked = problem.focal_plane.arrays, problem.parked_obstacles
        self._idle = idle_moves(columns, parked)
        self._turning = Turning(columns, Folded.of(columns), self._idle)
        if not parked:
            return
        indptr, target, _ = problem.pairs.by_positioner
        own = np.repeat(np.arange(len(problem.focal_plane)), np.diff(indptr))
        side = columns.sides(problem.xy[target], own, problem.fiber_of(own, target))
        moves = self.moves(problem, own, target, side)
        self._idle = turn_idle_arms(columns, self._idle, self._turning, indptr, moves, self.same_speed)

    def moves(
        self, problem, own: np.ndarray, target: np.ndarray, side: np.ndarray, idle: np.ndarray | None = None
    ) -> Moves:
        """Return the motion of each candidate; ``idle`` contains the indices of the idle arms of all positioners."""
        points, real = np.full((len(own), 2), np.nan), np.ones(len(own), dtype=bool)
        if idle is not None:
            real[idle] = False
        points[real] = problem.xy[target[real]]
        found = solve_moves(problem.focal_plane.arrays, own, problem.fiber_of(own, target), points, side)
        return found if idle is None else joined(found, idle, self._idle, np.arange(len(idle)))

    def allowed(self, problem, own: np.ndarray, target: np.ndarray, side: np.ndarray) -> np.ndarray:
        """Return whether the arm of each candidate can turn and unfold without a collision with obstacles.

        The candidates must be sorted by positioner; idle arms are allowed.
        """
        columns = problem.focal_plane.arrays
        pairs, n = columns.obstacle_pairs, len(problem.focal_plane)
        near = np.zeros(n, dtype=bool)
        near[pairs[:, 0]] = near[list(self._turning.examined)] = True
        rows = np.flatnonzero(near[own] & (target >= 0))
        allowed = np.ones(len(own), dtype=bool)
        if len(rows) == 0:
            return allowed
        who, moves = own[rows], self.moves(problem, own[rows], target[rows], side[rows])
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

    def reachable(self, problem, reach: Reach) -> Reach:
        """Return the pairs (positioner, target) for which at least one pose is `allowed`."""
        columns = problem.focal_plane.arrays
        order = np.argsort(reach.owner, kind="stable")
        own, target = reach.owner[order], reach.target[order]
        fiber, points = problem.fiber_of(own, target), problem.xy[target]
        if columns.plane.positioner.handedness == "both":
            free = np.zeros(len(own), dtype=bool)
            for side in (1.0, -1.0):
                free |= self.allowed(problem, own, target, np.full(len(own), side)) & columns.poses_allowed(
                    own, points, side, fiber
                )
        else:
            free = self.allowed(problem, own, target, columns.sides(points, own, fiber))
        keep = np.empty(len(own), dtype=bool)
        keep[order] = free
        return reach if keep.all() else reach.where(keep)
