"""The motion of candidates, if a constraint requires that arms unfold without collisions."""

import numpy as np

from rfpsurvey import collision
from rfpsurvey._kernels.motion import Moves
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
        self.problem, self.same_speed = problem, problem.options.motion_law == "same_speed"
        columns, parked = problem.focal_plane.arrays, problem.parked_obstacles
        self._idle = collision.idle_moves(columns, parked)
        self._turning = collision.Turning(columns, self._idle)
        if not collision.stays_folded(columns, parked).any():
            return
        indptr, target, r2 = problem.pairs.by_positioner
        owner = np.repeat(np.arange(len(problem.focal_plane)), np.diff(indptr))
        target = target[np.lexsort((r2, owner))]  # the directions must not depend on the order of the targets
        side = columns.sides(problem.xy[target], owner, problem.fiber_of(owner, target))
        moves = self.moves(owner, target, side)
        self._idle = collision.turn_idle_arms(columns, self._idle, self._turning, indptr, moves, self.same_speed)

    def moves(self, owner: np.ndarray, target: np.ndarray, side: np.ndarray, idle: np.ndarray | None = None) -> Moves:
        """Return the motion of each candidate; ``idle`` contains the indices of the idle arms of all positioners."""
        points, real = np.full((len(owner), 2), np.nan), np.ones(len(owner), dtype=bool)
        if idle is not None:
            real[idle] = False
        points[real] = self.problem.xy[target[real]]
        columns, fiber = self.problem.focal_plane.arrays, self.problem.fiber_of(owner, target)
        moves = collision.solve_moves(columns, owner, fiber, points, side)
        return moves if idle is None else collision.joined(moves, idle, self._idle, np.arange(len(idle)))

    def obstacle_hits(self, owner: np.ndarray, moves: Moves) -> np.ndarray:
        """Return the pairs (arm, obstacle) that collide while arms unfold; ``owner`` is the positioner of each arm."""
        plane = self.problem.focal_plane
        test = collision.obstacle_tests(plane.arrays.obstacle_pairs, owner)
        return test[collision.unfolding_obstacles(plane, moves, owner, test)]

    def turns(self, owner: np.ndarray, moves: Moves) -> np.ndarray:
        """Return whether each folded arm can turn to its direction; the positioners ``owner`` are sorted."""
        center = self.problem.focal_plane.arrays.xy[owner]
        return self._turning.allows(owner, np.arctan2(moves.y - center[:, 1], moves.x - center[:, 0]))

    def allowed(self, owner: np.ndarray, target: np.ndarray, side: np.ndarray) -> np.ndarray:
        """Return whether the arm of each candidate can turn and unfold without a collision with obstacles.

        The candidates must be sorted by positioner; idle arms are allowed.
        """
        plane = self.problem.focal_plane
        near, allowed = np.zeros(len(plane), dtype=bool), np.ones(len(owner), dtype=bool)
        near[plane.arrays.obstacle_pairs[:, 0]] = near[self._turning.examined] = True
        rows = np.flatnonzero(near[owner] & (target >= 0))
        if len(rows):
            moves = self.moves(owner[rows], target[rows], side[rows])
            allowed[rows] = self.turns(owner[rows], moves)
            allowed[rows[self.obstacle_hits(owner[rows], moves)[:, 0]]] = False
        return allowed

    def reachable(self, reach: Reach) -> Reach:
        """Return the pairs (positioner, target) for which at least one pose is `allowed`."""
        columns, n = self.problem.focal_plane.arrays, len(reach.owner)
        order = np.argsort(reach.owner, kind="stable")
        owner, target = reach.owner[order], reach.target[order]
        fiber, points = self.problem.fiber_of(owner, target), self.problem.xy[target]
        if columns.plane.positioner.handedness == "both":
            free = np.zeros(n, dtype=bool)
            for side in (1.0, -1.0):
                allowed = self.allowed(owner, target, np.full(n, side))
                free |= allowed & columns.poses_allowed(owner, points, side, fiber)
        else:
            free = self.allowed(owner, target, columns.sides(points, owner, fiber))
        keep = np.empty(n, dtype=bool)
        keep[order] = free
        return reach if keep.all() else reach.where(keep)
