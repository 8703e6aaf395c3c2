"""The motion of candidates, if a constraint requires that arms unfold without collisions."""

import numpy as np

from rfpsurvey._kernels.motion import Moves
from rfpsurvey.collision import (
    Folded,
    Turning,
    idle_moves,
    joined,
    obstacle_tests,
    solve_moves,
    stays_folded,
    turn_idle_arms,
    unfolding_obstacles,
)
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
        if not stays_folded(columns, parked).any():
            return
        indptr, target, r2 = problem.pairs.by_positioner
        own = np.repeat(np.arange(len(problem.focal_plane)), np.diff(indptr))
        target = target[np.lexsort((r2, own))]  # the directions must not depend on the order of the targets
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

    def obstacle_hits(self, problem, own: np.ndarray, moves: Moves) -> np.ndarray:
        """Return the pairs (arm, obstacle) that collide while arms unfold; ``own`` is the positioner of each arm."""
        test = obstacle_tests(problem.focal_plane.arrays.obstacle_pairs, own)
        return test[unfolding_obstacles(problem.focal_plane, moves, own, test)]

    def turns(self, problem, own: np.ndarray, moves: Moves) -> np.ndarray:
        """Return whether each folded arm can turn to its direction; ``own``, the positioner of each arm, is sorted."""
        center = problem.focal_plane.arrays.xy[own]
        return self._turning.allows(own, np.arctan2(moves.y - center[:, 1], moves.x - center[:, 0]))

    def allowed(self, problem, own: np.ndarray, target: np.ndarray, side: np.ndarray) -> np.ndarray:
        """Return whether the arm of each candidate can turn and unfold without a collision with obstacles.

        The candidates must be sorted by positioner; idle arms are allowed.
        """
        near, allowed = np.zeros(len(problem.focal_plane), dtype=bool), np.ones(len(own), dtype=bool)
        near[problem.focal_plane.arrays.obstacle_pairs[:, 0]] = near[self._turning.examined] = True
        rows = np.flatnonzero(near[own] & (target >= 0))
        if len(rows):
            moves = self.moves(problem, own[rows], target[rows], side[rows])
            allowed[rows] = self.turns(problem, own[rows], moves)
            allowed[rows[self.obstacle_hits(problem, own[rows], moves)[:, 0]]] = False
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
