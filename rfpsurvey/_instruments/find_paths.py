"""Plan paths of all arms between a plan and the folded poses, and prove that no arms collide on them."""

import astropy.units as u
import numpy as np

from rfpsurvey._common.units import to_scalar, to_seed
from rfpsurvey._instruments.arms import Arms, check_arms, check_plane, place_arms
from rfpsurvey._instruments.focal_plane import FocalPlane
from rfpsurvey._instruments.joint_motion import JointMotion
from rfpsurvey._instruments.path_arms import PathArms, arms_of
from rfpsurvey._instruments.paths import Paths, near_obstacles, near_pairs
from rfpsurvey._kernels import joint_motion, path_search, path_steps
from rfpsurvey._kernels.motion import TOLERANCE
from rfpsurvey.errors import InputTypeError, check_keywords, check_switch

STAGES = ((1.0, 2.0, 0.3, True), (0.5, 2.0, 0.3, True), (0.25, 2.0, 0.3, False), (0.25, 4.0, 1.0, False))
"""Attempts to fold the arms that remain: step (in units of the given step), range (mm) and noise of the cost, and
whether the margin is kept."""
CROWDED = (*STAGES, *((1.0, 2.0, 1.0, False), (1.0, 4.0, 2.0, False), (0.5, 2.0, 0.3, False), STAGES[2]) * 3)
"""Attempts for planes in which folded arms touch each other unless they all point in one direction."""
WEIGHT = 0.02
"""Cost of an angle from this direction; that of the same angle from the folded pose is 1."""
PATIENCE = np.deg2rad([40.0, 80.0])
"""An attempt ends if the arms fold no further while an arm could turn by this angle; the second is for `CROWDED`."""
PRESSED = np.deg2rad(20.0)
"""Angle by which an arm turns while it gives way to a neighbor that it blocked."""
MOST = np.deg2rad(1440.0)
"""Angle by which an arm can turn during an attempt."""
ASSUMED_SPEED = np.deg2rad(10.0)
"""Angular speed (rad / s) of joints for which no speed is known."""
NOT_FOUND = "no path was found"
SAME = 1e-6
"""Largest difference (rad) of phi from that of the folded arm, for arms that have arrived."""
GROUP = 4
"""Largest number of arms whose joint space is searched."""
CELL = np.deg2rad(1.0)
"""Size of the cells with which it is proven that an arm has no path."""
PAIR_CELL, MOST_STATES = np.deg2rad(2.0), 20_000_000
"""Size of the cells with which it is proven that two arms have no paths, and largest number of examined states."""
REACH, N_NODES = np.deg2rad(10.0), (6_000, 1_000)
"""Largest change of an angle between two nodes of a search, and largest number of nodes (second: `CROWDED`)."""
TOLERANCES = np.deg2rad([16.0, 8.0, 4.0, 2.0, 1.0, 0.5])
"""Largest changes of angles by which paths are simplified; the first that is possible is used."""


@check_keywords
def find_paths(
    focal_plane: FocalPlane,
    arms: object,
    *,
    motion: JointMotion | None = None,
    step: u.Quantity = 4 * u.deg,
    margin: u.Quantity = 0.05 * u.mm,
    rng: int | np.random.Generator | None = 1,
    examine: bool = False,
) -> Paths:
    """Plan paths on which all arms fold without collisions; the reversed paths lead from the folded poses to the plan.

    All arms move at the same time, in short steps. In each step, an arm moves toward its folded pose; if it would come
    too close to another arm, it waits or gives way, and the arms in its way also give way. For arms that remain, paths
    of groups of up to four arms are searched in the space of their joint angles. Folded arms finally turn to the home
    pose of the instrument. If folded arms can touch each other while they turn, the goal is one direction of all arms
    in which they do not. The paths are then simplified to few break points, and are proven (`Paths`).

    Arms without a target move out of the way of other arms, and broken arms are obstacles. Where joint limits are not
    known, theta turns by at most 180 deg from the home pose, and phi does not pass the extended pose.

    Parameters
    ----------
    focal_plane : FocalPlane
        The n positioners.
    arms : Arms, Allocation or Quantity, shape (n, 2)
        The poses of the plan, as in `~rfpsurvey.find_collisions`; no arms may collide in these poses.
    motion : JointMotion, optional
        Ranges of joints that have no limits in ``focal_plane``, and speeds; by default, the ranges are unlimited.
        Without a speed, the times refer to 10 deg / s.
    step : Quantity, optional
        Largest change of a joint angle in a step, from 0.01 deg to 90 deg.
    margin : Quantity, optional
        Length that is added to the minimum separation while paths are planned, where the poses of the plan permit it.
    rng : int, Generator or None, optional
        Seed or generator of random numbers, on which the motions of arms that give way depend.
    examine : bool, optional
        Whether to examine, for each group without a path, whether the two arms that are nearest to each other have a
        path without the other arms, or are certainly interlocked. This can take a minute per group.

    Returns
    -------
    Paths
        The proven paths. Arms that do not arrive are listed in its attribute ``groups``.

    Raises
    ------
    InputError
        If arms with targets collide in the poses of the plan, if the poses belong to another focal plane, or if
        ``step`` or ``margin`` is not a valid value.

    See Also
    --------
    find_motion : Test a simple motion that needs no planned paths.

    References
    ----------
    Kuffner and LaValle (2000), "RRT-Connect: An efficient approach to single-query path planning" (the search for
    groups of arms); Sayres and coauthors (2021), AJ 161, 92 (a planner in short steps for SDSS-V).

    Examples
    --------
    >>> import astropy.units as u
    >>> import rfpsurvey as rs
    >>> robot = rs.Positioner(8 * u.mm, 17 * u.mm, 2 * u.mm)
    >>> plane = rs.FocalPlane([[0, 0], [25, 0]] * u.mm, robot)
    >>> targets = [[16, -12], [14, 12]] * u.mm
    >>> rs.collision.find_motion(plane, targets).n_planner
    2
    >>> rs.collision.find_paths(plane, targets)
    <Paths: 2 of 2 arms with a target arrive in 22.2 s, smallest distance 4.111 mm>
    """
    check_plane(focal_plane)
    h = np.deg2rad(to_scalar(step, u.deg, "step", low=0.01, high=90, closed=True))
    gap = to_scalar(margin, u.mm, "margin", low=0, closed=True)
    seed = to_seed(rng)
    if hasattr(arms, "place_arms"):
        arms = arms.place_arms(focal_plane)
    posed = arms if isinstance(arms, Arms) else place_arms(focal_plane, arms)
    check_arms(focal_plane, posed)
    columns = focal_plane.arrays.using(posed.fiber)
    motion = JointMotion() if motion is None else motion
    if not isinstance(motion, JointMotion):
        raise InputTypeError(f"motion must be a JointMotion, got {type(motion).__name__}")
    prepared = arms_of(columns, posed, motion, gap)
    planner = _Planner(columns, prepared, h, np.random.default_rng(seed))
    planner.fold_all()
    planner.search_groups(check_switch(examine, "examine"))
    planner.turn_home()
    knots = planner.knots()
    joint_motion.simplify(knots, prepared.bodies, columns.limits, prepared.around, TOLERANCES)
    rows = np.concatenate([np.arange(*ends) for ends in zip(knots.start, knots.stop, strict=True)])
    owner = np.repeat(np.arange(len(knots.start)), knots.stop - knots.start)
    start = np.append(0, np.cumsum(knots.stop - knots.start))
    theta = knots.theta[rows]
    phi = knots.psi[rows] - theta - prepared.phi_zero[owner]
    theta = theta - prepared.theta_zero[owner]
    absent = np.isnan(prepared.bodies.x)[owner]
    theta[absent] = phi[absent] = np.nan
    speeds = [v for v in (motion.theta_speed, motion.phi_speed) if v is not None]
    rate = min((v.to_value(u.rad / u.s) for v in speeds), default=ASSUMED_SPEED)
    meta = {
        "seed": seed,
        "step_deg": float(np.rad2deg(h)),
        "speed_deg_s": float(np.rad2deg(rate)),
        "speed_is_assumed": not speeds,
        "margin_mm": gap,
    }
    angles = (np.rad2deg(v) << u.deg for v in (theta, phi))
    arrives = prepared.around.free & (planner.remaining <= SAME)
    time = knots.time[rows] * (h / rate) << u.s
    groups = (
        *(([str(i)], "an arm without a target collides in all poses") for i in columns.plane.id[prepared.enclosed]),
        *(([str(i)], "the pose is beyond the range of a joint") for i in columns.plane.id[prepared.beyond]),
        *planner.groups,
    )
    return Paths(focal_plane, start, time, *angles, arrives, posed.assigned, columns.fiber_index, groups, meta)


class _Planner:
    """The poses of all arms while their paths are planned; times are numbers of steps of ``step`` rad."""

    def __init__(self, columns, prepared: PathArms, step: float, rng: np.random.Generator):
        self.columns, self.prepared, self.step, self.rng = columns, prepared, step, rng
        self.theta, self.psi = prepared.theta.copy(), prepared.psi.copy()
        self.time, self.parts, self.groups = 0.0, [], []
        around, limits = prepared.around, columns.limits
        self.closer = around._replace(  # without the margin, but with enough distance for the proof
            separation=np.minimum(around.separation, limits.separation + 2 * TOLERANCE),
            clearance=np.minimum(around.clearance, around.required + 2 * TOLERANCE),
        )
        self._add(np.arange(len(self.theta)), 0.0)

    @property
    def remaining(self) -> np.ndarray:
        """Angle phi from each arm to its folded pose; 0 for arms that do not move."""
        around = self.prepared.around
        return np.where(around.free, np.abs(around.fold - (self.psi - self.theta)), 0.0)

    def _add(self, rows, time):
        """Add knots with the present poses of the positioners ``rows``."""
        self.parts.append((rows, np.broadcast_to(time, len(rows)), self.theta[rows], self.psi[rows]))

    def _left(self) -> tuple[int, int]:
        """Return how many arms are not folded, and how many do not point in the direction of a crowded plane."""
        around, crowded = self.prepared.around, self.prepared.crowded
        turned = around.free & (np.abs(around.home - self.theta) > SAME) & crowded
        return int((self.remaining > SAME).sum()), int(turned.sum())

    def fold_all(self):
        """Fold all arms in short steps; each attempt begins with the poses at the end of the attempt before."""
        prepared, limits = self.prepared, self.columns.limits
        crowded = int(prepared.crowded)
        best = self._left(), len(self.parts), self.time, self.theta.copy(), self.psi.copy()
        for factor, wide, noise, with_margin in CROWDED if crowded else STAGES:
            around = prepared.around if with_margin else self.closer
            before = self.theta.copy(), self.psi.copy(), self._left()
            # the arms that are farthest from their folded poses decide first
            order = np.argsort(-self.remaining, kind="stable")
            h = self.step * factor
            counts = (int(np.ceil(angle / h)) for angle in (MOST, PATIENCE[crowded], PRESSED))
            costs = wide, noise, crowded * WEIGHT
            owner, when, where, n = path_steps.walk(
                prepared.bodies, limits, around, self.theta, self.psi, order, h, *counts, *costs, self.rng
            )
            left = self._left()
            if left == before[2] and not crowded:  # an attempt that folds no arm only takes time
                self.theta, self.psi = before[:2]
                continue
            self.parts.append((owner, self.time + factor * when, *where))
            self.time += factor * n
            if left < best[0]:
                best = left, len(self.parts), self.time, self.theta.copy(), self.psi.copy()
            if left == (0, 0):
                break
        _, n, self.time, self.theta, self.psi = best
        del self.parts[n:]

    def search_groups(self, examine: bool):
        """Search paths of small groups for the arms that are not folded; distant groups move at the same time."""
        prepared, around, n_nodes = self.prepared, self.closer, N_NODES[self.prepared.crowded]
        busy = np.full(len(self.theta), self.time)
        for i in np.flatnonzero(self.remaining > SAME):
            if self.remaining[i] <= SAME:
                continue
            if self._is_locked(i):
                self.groups.append(([str(self.columns.plane.id[i])], "locked by obstacles and joint limits"))
                continue
            row = around.near[around.start[i] : around.start[i + 1]]
            row = row[around.free[row]]
            members = np.append(i, row[np.argsort(self._distances(i, row), kind="stable")])
            for size in range(min(2, len(members)), min(GROUP, len(members)) + 1):
                group = members[:size]
                path = path_search.search(
                    prepared.bodies, self.columns.limits, around, self.theta, self.psi, group, REACH, n_nodes, self.rng
                )
                if len(path):
                    break
            if len(path) == 0:
                reason = self._examine(members[:2]) if examine and len(members) > 1 else NOT_FOUND
                self.groups.append(([str(self.columns.plane.id[k]) for k in members[:2]], reason))
                continue
            touched = np.unique(np.concatenate([around.near[around.start[k] : around.start[k + 1]] for k in group]))
            touched = np.append(touched, group)
            begin = busy[touched].max()
            times = begin + np.append(0.0, np.cumsum(np.abs(np.diff(path, axis=0)).max(axis=1) / self.step))
            for pose, time in zip(path, times, strict=True):
                self.theta[group], self.psi[group] = pose[::2], pose[::2] + pose[1::2]
                self._add(group, time)
            busy[touched] = times[-1]
        self.time = busy.max()

    def _is_locked(self, i) -> bool:
        """Return whether arm i certainly has no path to its folded pose, even if all arms that can move are removed."""
        is_open, _, _, (k, m), fold = self._cells_of(i, CELL)
        return not path_search.reaches_fold(is_open, self.prepared.turns_freely[i], k, m, fold)

    def _examine(self, pair) -> str:
        """Return what is certain about the paths of two arms if all other arms that can move are removed."""
        bodies, others = self.prepared.bodies, self.prepared.around.free.copy()
        others[pair] = False
        alone = bodies._replace(x=np.where(others, np.nan, bodies.x))
        poses = self.closer, self.theta, self.psi, pair
        if len(path_search.search(alone, self.columns.limits, *poses, REACH, N_NODES[0], self.rng)):
            return "the two arms have a path without the other arms"
        return "the two arms are interlocked" if self._are_interlocked(*pair) else NOT_FOUND

    def _are_interlocked(self, i, j) -> bool:
        """Return whether the arms i and j certainly have no paths, even if all other arms that can move are removed."""
        limits = self.columns.limits
        is_open, cells, slack, begin, folds = zip(*(self._cells_of(k, PAIR_CELL) for k in (i, j)), strict=True)
        separation = limits.separation - sum(slack)
        cyclic = tuple(self.prepared.turns_freely[[i, j]].tolist())
        first = tuple(k * flags.shape[1] + m for (k, m), flags in zip(begin, is_open, strict=True))
        return (
            separation > 0.0
            and path_search.reach_fold_together(
                np.hstack(cells), limits, i, j, *is_open, cyclic, first, folds, separation, MOST_STATES
            )
            == path_search.LOCKED
        )

    def _cells_of(self, i, size):
        """Return flags of open cells of arm i, all cells, the slack of distances, and the cells of pose and fold."""
        prepared, limits = self.prepared, self.columns.limits
        around, bodies = prepared.around, prepared.bodies
        low = around.theta_low[i], around.phi_low[i]
        ends = (around.theta_high[i], low[0]), (around.phi_high[i], low[1])
        is_open = np.empty([int(np.ceil((high - start) / size - 1e-9)) + 1 for high, start in ends], dtype=bool)
        # no point of the arm is farther from its position in the center of the cell
        slack = 0.5 * size * max(bodies.l1[i] + 2 * bodies.reach[i], bodies.central)
        segments, cells = np.empty((4, len(self.theta) + 1)), np.empty((4, is_open.size))
        path_steps.locate_all(bodies, prepared.theta, prepared.psi, segments)
        path_search.mark_open(bodies, limits, around, i, low, size, slack, segments, cells, is_open)
        angles = self.theta[i] - low[0], self.psi[i] - self.theta[i] - low[1], around.fold[i] - low[1]
        k, m, fold = (round(float(angle / size)) for angle in angles)
        return is_open, cells, slack, (k, m), fold

    def _distances(self, i, rows):
        segments, limits = np.empty((4, len(self.theta) + 1)), self.columns.limits
        path_steps.locate_all(self.prepared.bodies, self.theta, self.psi, segments)
        return [path_steps.distance_at_rest(segments, limits, i, i, j, j, np.inf) for j in rows]

    def turn_home(self):
        """Turn the folded arms to the home pose, unless they would collide with arms that do not turn."""
        prepared, n = self.prepared, len(self.theta)
        turn = np.where(prepared.around.free & (self.remaining <= SAME), prepared.around.home - self.theta, 0.0)
        while turn.any():
            rows = np.arange(0, 2 * n, 2)
            ends = (np.column_stack([angle, angle + turn]).ravel() for angle in (self.theta, self.psi))
            knots = joint_motion.Knots(rows, rows + 2, np.tile([0.0, 1.0], n), *ends)
            hits = near_obstacles(knots, prepared.bodies, self.columns)
            blocked = np.append(near_pairs(knots, prepared.bodies, self.columns), self.columns.obstacle_pairs[hits, 0])
            blocked = blocked[turn[blocked] != 0.0]
            if len(blocked) == 0:
                break
            turn[blocked] = 0.0
        self._add(np.arange(n), self.time)
        self.theta, self.psi = self.theta + turn, self.psi + turn
        self.time += max(np.abs(turn).max(initial=0.0) / self.step, 1.0 if self.time == 0.0 else 0.0)
        self._add(np.arange(n), self.time)

    def knots(self) -> joint_motion.Knots:
        """Return the knots of all paths, of which no two of one path have the same time."""
        owner, time, theta, psi = (np.concatenate(column) for column in zip(*self.parts, strict=True))
        order = np.lexsort((time, owner))
        owner, time, theta, psi = owner[order], time[order], theta[order], psi[order]
        keep = np.append((np.diff(owner) != 0) | (np.diff(time) > 1e-9), True)
        owner = owner[keep]
        start = np.searchsorted(owner, np.arange(len(self.theta) + 1))
        return joint_motion.Knots(start[:-1].copy(), start[1:].copy(), time[keep], theta[keep], psi[keep])
