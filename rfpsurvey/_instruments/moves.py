"""The motion of arms between folded poses and their targets, and the turning of folded arms, in numbers."""

from itertools import product

import numpy as np

from rfpsurvey._common.units import to_radian
from rfpsurvey._instruments.focal_plane import FocalPlane
from rfpsurvey._kernels import arms, motion

MUCH = 0.1
"""An arm folds to the other side if the joint limits stop it so early that the cosine of phi is larger by this."""
N_BINS = 3600
"""Number of directions of a folded arm that are tested; between them, the arm is known not to come too close."""
BIN = 2 * np.pi / N_BINS
N_WAYS = 24
"""Number of directions from which one is chosen for each folded arm without a target."""
MOST = 4
"""Largest number of candidates of a positioner that are considered when the directions of idle arms are chosen."""


def find_moves(columns, owner, fiber, theta, phi, *, moving: np.ndarray | bool = True) -> motion.Moves:
    """Return the motion of arms from given angles, in the convention of the kernels, to the folded pose.

    ``owner`` and ``fiber`` are the rows of the positioners and the indices of the fiber types. Arms for which
    ``moving`` is false remain at the given angles.
    """
    geometry, outline = columns.geometry_of(owner, fiber), columns.plane.positioner.outline
    offset, inner, length, reach = sizes_of(columns, owner, fiber, geometry)
    turn = np.where(moving, to_fold(columns, owner, fiber, phi, offset), 0.0)
    x, y = geometry.cx + geometry.l1 * np.cos(theta), geometry.cy + geometry.l1 * np.sin(theta)
    angle = theta + phi + offset
    circle, sector = np.empty((3, len(owner))), np.empty((4, len(owner)))
    # the sector of an outline is a full circle, because the parts on the central arm are outside the eccentric sector
    motion.enclose(x, y, angle, turn if outline is None else np.full(len(owner), 2 * np.pi), reach, circle, sector)
    if outline is not None:
        circle = _around_both(circle, geometry, outline.reach[1])
    return motion.Moves(x, y, angle, turn, inner, length, reach, circle, sector)


def sizes_of(columns, owner, fiber, geometry) -> tuple[np.ndarray, ...]:
    """Return sizes of the eccentric arms of positioners with fibers.

    These are the angle from the fiber to the axis of the arm, the begin and the end of the segment that can collide
    (mm from the elbow), and the largest distance of the arm from the elbow (mm).
    """
    n, outline, has_axis = len(owner), columns.plane.positioner.outline, columns.model == arms.CAPSULE
    offset = np.arctan2(*columns.angles_of(owner, fiber)[::-1]) if has_axis else np.zeros(n)
    length = np.full(n, columns.length) if has_axis else geometry.l2.copy()
    inner = length.copy() if columns.model == arms.FIBER_TIP else np.zeros(n)
    return offset, inner, length, length.copy() if outline is None else np.full(n, outline.reach[0])


def to_fold(columns, owner, fiber, phi, offset):
    """Return the angle by which phi changes from its value at the target until the arm is folded.

    The folded arm lies over the central arm, or as close to it as the joint limits allow. ``phi`` is between -pi and
    pi, and ``offset`` is the angle from the fiber to the axis of the arm.
    """
    side = np.where(np.signbit(phi), -1.0, 1.0)
    turn = side * np.pi - (phi + offset)
    low, high, _ = phi_limits(columns, owner, fiber)
    if np.isinf(low).all():
        return turn
    joint = joint_phi(columns, owner, fiber, phi)
    direct, reverse = (np.clip(joint + way, low, high) - joint for way in (turn, turn - 2 * np.pi * side))
    return np.where(np.cos(phi + offset + reverse) < np.cos(phi + offset + direct) - MUCH, reverse, direct)


def limits_of(columns, owner, k, name):
    if columns.joints is not None:
        return columns.joints.limits[2 * k, owner], columns.joints.limits[2 * k + 1, owner]
    given = getattr(columns.plane.positioner, name)
    low, high = (-np.inf, np.inf) if given is None else to_radian(given, name)
    return np.full(len(owner), low), np.full(len(owner), high)


def _within_theta(columns, owner, theta):
    """Return whether joint angles theta, in the convention of the kernels, are within the joint limits."""
    low, high = limits_of(columns, owner, 0, "theta_range")
    zero = 0.0 if columns.joints is None else columns.joints.zeros(owner, columns.first_index[owner])[0]
    with np.errstate(invalid="ignore"):
        # a rounding error at the lower limit must not add a full rotation
        return np.isinf(low) | (np.mod(theta - zero - low + 1e-9, 2 * np.pi) - 1e-9 <= high - low + 1e-9)


def fold_of(columns, owner, fiber, phi, turn):
    """Return the joint angle phi at which each arm is folded; 0 if phi has no limits."""
    low, _, _ = phi_limits(columns, owner, fiber)
    return np.where(np.isinf(low), 0.0, joint_phi(columns, owner, fiber, phi) + turn)


def joint_phi(columns, owner, fiber, phi):
    """Return the joint angle phi for phi in the convention of the kernels; within the limits, if there are limits."""
    low, _, zero = phi_limits(columns, owner, fiber)
    with np.errstate(invalid="ignore"):
        # a rounding error at the lower limit must not add a full rotation
        joint = low + np.mod(phi - zero - low + 1e-12, 2 * np.pi) - 1e-12
    return np.where(np.isinf(low), phi - zero, joint)


def phi_limits(columns, owner, fiber):
    """Return the joint limits of phi, and the value of phi in the convention of the kernels at the joint angle 0."""
    zero = 0.0 if columns.joints is None else columns.joints.zeros(owner, fiber)[1]
    return *limits_of(columns, owner, 1, "phi_range"), zero


def _around_both(circle, geometry, radius):
    """Return circles that contain the given circles and the circles around the centers of the positioners."""
    dx, dy = circle[0] - geometry.cx, circle[1] - geometry.cy
    apart = np.hypot(dx, dy)
    # the smallest circle around two circles, or the larger circle if it contains the other
    size = np.maximum(0.5 * (apart + radius + circle[2]), np.maximum(radius, circle[2]))
    part = np.clip((size - radius) / np.maximum(apart, 1e-300), 0.0, 1.0)
    return np.array([geometry.cx + part * dx, geometry.cy + part * dy, size])


def solve_moves(columns, owner, fiber, points, side) -> motion.Moves:
    """Return the motion of the arms with which positioners reach points (mm); ``side`` is 1 (right) or -1 (left)."""
    theta, phi = np.empty((2, len(owner)))
    arms.solve(points, columns.geometry_of(owner, fiber), side, theta, phi)
    return find_moves(columns, owner, fiber, theta, phi)


def split_phi(columns, phi):
    """Return phi in the range from -pi to pi; the sign of a folded or extended arm is that of the usual handedness."""
    phi = np.mod(phi + np.pi, 2 * np.pi) - np.pi
    usual = -1.0 if columns.plane.positioner.handedness == "left" else 1.0
    straight = np.abs(np.sin(phi)) < 1e-9
    return np.where(straight, usual * np.abs(phi), phi)


def stays_folded(columns, parked_obstacles: bool) -> np.ndarray:
    """Return which positioners remain folded without a target: they are usable, and no obstacles in static tests."""
    first = columns.plane.arrays
    return first.usable & ~first.idle(parked_obstacles).parked & parked_obstacles


def idle_moves(columns, parked_obstacles: bool) -> motion.Moves:
    """Return the motion of the arms without a target, one for each positioner.

    Broken arms do not move. The other arms go to their parked pose if it is an obstacle in static tests; otherwise they
    remain folded, at the theta of the parked pose. If ``parked_obstacles`` is false, they are absent.
    """
    first = columns.plane.arrays
    owner, fiber = np.arange(len(columns.plane)), first.first_index
    home = np.where(first.is_stuck, first.stuck.T, first.home)
    theta, phi = (np.array(v, dtype=float) for v in first.from_joints(*home, owner, fiber))
    stays = stays_folded(columns, parked_obstacles)
    moves = find_moves(first, owner, fiber, theta, split_phi(first, phi), moving=first.usable)
    folded = find_moves(first, owner, fiber, theta, split_phi(first, phi) + moves.turn, moving=False)
    moves = joined(moves, np.flatnonzero(stays), folded, np.flatnonzero(stays))
    gone = first.usable & (not parked_obstacles)
    return moves._replace(x=np.where(gone, np.nan, moves.x))


def turn_idle_arms(columns, idle: motion.Moves, turning: "Turning", start, moves: motion.Moves, same_speed: bool):
    """Return the motion of arms without a target, in which folded arms turn out of the way of candidates.

    Each arm that remains folded turns to the direction, of ``N_WAYS`` directions, with the fewest collisions; of equal
    directions, the first after that of the parked pose. Candidate k of positioner i in ``moves`` has an index from
    ``start[i]`` to ``start[i + 1] - 1``.
    """
    first, n = columns.plane.arrays, len(columns.plane)
    stays = np.flatnonzero(stays_folded(columns, True))
    if len(stays) == 0:
        return idle
    size = np.diff(start)
    step = np.maximum(-(-size // MOST), 1)  # rounded up, so that every step-th candidate is at most MOST candidates
    offset = np.arange(start[-1]) - np.repeat(start[:-1], size)
    some = np.flatnonzero(offset % np.repeat(step, size) == 0)
    start = np.searchsorted(some, start)
    theta = np.arctan2(idle.y - first.xy[:, 1], idle.x - first.xy[:, 0])
    ways = (theta[:, None] + np.arange(N_WAYS) * (2 * np.pi / N_WAYS)).ravel()
    phi = np.repeat(idle.angle - theta, N_WAYS)
    if first.model == arms.CAPSULE:
        phi -= np.repeat(np.arctan2(*first.angles[::-1]), N_WAYS)
    owner = np.repeat(np.arange(n), N_WAYS)
    folded = find_moves(first, owner, first.first_index[owner], ways, phi, moving=False)
    folded = folded._replace(x=np.where(np.isin(owner, stays), folded.x, np.nan))
    all_moves = motion.Moves(*(np.concatenate([a[..., some], b], axis=-1) for a, b in zip(moves, folded, strict=True)))
    counts = np.empty((n, N_WAYS), dtype=np.int64)
    motion.count_meeting(first.neighbors, start, all_moves, same_speed, first.limits, counts)
    allowed = turning.allows(owner, ways) & _within_theta(first, owner, ways)
    counts[~allowed.reshape(n, N_WAYS)] = np.iinfo(np.int64).max
    best = counts.argmin(axis=1)
    return joined(idle, stays, folded, stays * N_WAYS + best[stays])


def joined(moves: motion.Moves, rows: np.ndarray, source: motion.Moves, source_rows: np.ndarray) -> motion.Moves:
    """Return a copy of ``moves``, in which arms ``rows`` have the motion of the arms ``source_rows`` of ``source``."""
    columns = [value.copy() for value in moves]
    for column, source_column in zip(columns, source, strict=True):
        column[..., rows] = source_column[..., source_rows]
    return motion.Moves(*columns)


def unfolding_pairs(plane: FocalPlane, moves: motion.Moves, same_speed: bool) -> np.ndarray:
    """Return the pairs of positioners whose arms collide while they unfold, sorted; one motion per positioner."""
    pairs = plane.arrays.neighbors
    first, second = np.empty((2, max(len(pairs), 1)), dtype=np.int64)
    start = np.arange(len(plane) + 1)
    n, _ = motion.list_meeting(pairs, 0, start, moves, same_speed, plane.arrays.limits, first, second)
    return np.column_stack([first[:n], second[:n]])


def unfolding_obstacles(plane: FocalPlane, moves: motion.Moves, owner: np.ndarray, pairs: np.ndarray) -> np.ndarray:
    """Return which pairs (arm, obstacle) collide while the arm unfolds; ``owner`` is the positioner of each arm."""
    out, columns = np.zeros(len(pairs), dtype=bool), plane.arrays
    if len(pairs):
        motion.obstacles_meeting(moves, owner, columns.limits, pairs, columns.obstacles, columns.clearance, out)
    return out


class Folded:
    """The sizes of folded arms: distances (mm) from the center to the farthest points of the arms while they turn.

    All fibers and each handedness that plans may use are considered. ``poses`` contains, for each handedness and fiber
    type, the fiber index and phi of folded arms, in the convention of the kernels.
    """

    def __init__(self, columns):
        plane, n = columns.plane, len(columns.plane)
        owner, outline = np.arange(n), plane.positioner.outline
        sides = {"right": (1.0,), "left": (-1.0,), "both": (1.0, -1.0)}[plane.positioner.handedness]
        kinds = [columns.first_index] if columns.fibers is None else range(len(plane.fiber_types))
        self.columns, self.eccentric, self.central, self.poses = columns, np.zeros(n), np.zeros(n), []
        if outline is not None and len(outline.parts) > outline.n_eccentric:
            self.central += outline.reach[1]
        for side, kind in product(sides, kinds):
            fiber = np.broadcast_to(kind, n)
            # any pose of this handedness leads to the same fold; the arm is at a right angle here
            start = np.full(n, side * np.pi / 2)
            low, high, zero = phi_limits(columns, owner, fiber)
            start = zero + np.where(np.isinf(low), start - zero, np.clip(start - zero, low, high))
            start = split_phi(columns, start)
            moves = find_moves(columns, owner, fiber, np.zeros(n), start)
            self.eccentric = np.maximum(self.eccentric, extent(columns, moves.angle + moves.turn, moves.length))
            self.poses.append((fiber, start + moves.turn))

    @property
    def touching(self) -> np.ndarray:
        """Pairs of usable positioners whose folded arms can touch each other when they turn, shape (k, 2)."""
        return touching(self.columns, self.eccentric, self.central)


def touching(columns, eccentric, central) -> np.ndarray:
    """Return the pairs of usable positioners whose arms of given sizes can touch each other when they turn."""
    pairs = columns.neighbors[columns.usable[columns.neighbors].all(axis=1)]
    (a, b), (p, q) = eccentric[pairs].T, central[pairs].T
    apart = np.hypot(*(columns.xy[pairs[:, 0]] - columns.xy[pairs[:, 1]]).T)
    size = np.maximum(a + b, np.maximum(a + q if q.any() else 0.0, b + p if p.any() else 0.0))
    return pairs[size + columns.separation + motion.TOLERANCE > apart]


def extent(columns, angle, length):
    """Return the largest distance of the eccentric arms from the centers, for arms at an angle to the central arm."""
    outline, x = columns.plane.positioner.outline, columns.central_arm
    if outline is None:
        size = np.hypot(x + length * np.cos(angle), length * np.sin(angle))
        return size if columns.model == arms.FIBER_TIP else np.maximum(size, x)
    c, s = np.cos(angle), np.sin(angle)
    return np.max(
        [
            np.hypot(x + c * vx - s * vy, s * vx + c * vy) + radius
            for vertices, radius in outline.parts[: outline.n_eccentric]
            for vx, vy in vertices
        ],
        axis=0,
    )


class Turning:
    """The directions to which the folded arms can turn beside broken arms and obstacles.

    Only positioners that are near to broken arms or obstacles are examined. The directions in which the folded arm of
    such a positioner certainly collides with none of them form arcs of joint angles; within an arc, the arm can turn in
    the direction that remains in the arc. The arc of the parked pose (or the longest arc, if the parked arm collides)
    is the *usual* arc.
    """

    def __init__(self, columns, broken: motion.Moves):
        first, self.folded = columns.plane.arrays, Folded(columns)
        self._lines, self._usual = {}, {}
        home = first.from_joints(*first.home, np.arange(len(first.usable)), first.first_index)[0]
        for i, (neighbors, obstacles) in _near(first, self.folded, broken).items():
            free = np.ones(N_BINS, dtype=bool)
            for fiber, phi in self.folded.poses:
                free &= _free_bins(first, i, fiber, phi, self.folded.eccentric[i], broken, neighbors, obstacles)
            self._lines[i] = _line(first, i, free)
            size = np.bincount(self._lines[i][1], minlength=2)
            size[0] = 0  # directions that are not free
            known = self.labels(i, home[i : i + 1])[:, 0]
            known = known if known.any() else np.arange(len(size))
            self._usual[i] = known[size[known].argmax()]

    @property
    def examined(self) -> list[int]:
        """The examined positioners, sorted."""
        return sorted(self._lines)

    def labels(self, i: int, theta: np.ndarray) -> np.ndarray:
        """Return the arcs (from 1; 0 for none) that contain directions of positioner i, shape (2, n).

        There are two rows because the joint range can contain a direction twice.
        """
        origin, label = self._lines[i]
        angle = np.nan_to_num(theta - origin)  # arms that are ignored have no direction
        k = np.minimum((np.mod(angle, 2 * np.pi) / BIN).astype(np.int64), N_BINS - 1)
        padded = np.append(label, np.zeros(2 * N_BINS, dtype=np.int64))
        return np.array([padded[k], padded[k + N_BINS]])

    def allows(self, owner: np.ndarray, theta: np.ndarray, before: np.ndarray | None = None) -> np.ndarray:
        """Return whether folded arms can turn to the directions ``theta``, in the convention of the kernels.

        They turn from the directions ``before`` or, by default, from anywhere in the usual arc. ``owner`` must be
        sorted.
        """
        allowed = np.ones(len(owner), dtype=bool)
        for i in self._lines:
            rows = slice(*np.searchsorted(owner, [i, i + 1]))
            labels = self.labels(i, theta[rows])
            if before is None:
                allowed[rows] = ((labels == self._usual[i]) & (labels > 0)).any(axis=0)
            else:
                old = self.labels(i, before[rows])
                allowed[rows] = ((labels[:, None] == old[None]) & (labels[:, None] > 0)).any(axis=(0, 1))
        return allowed


def _near(columns, folded, broken):
    """Return the broken positioners and the obstacles that the folded arm of each usable positioner can touch."""
    near: dict = {}
    pairs = columns.neighbors[columns.usable[columns.neighbors].sum(axis=1) == 1]
    theta = np.arctan2(broken.y - columns.xy[:, 1], broken.x - columns.xy[:, 0])
    with np.errstate(invalid="ignore"):
        size = np.maximum(extent(columns, broken.angle - theta, broken.length), folded.central)
    reach = np.maximum(folded.eccentric, folded.central)
    for a, b in pairs.tolist():
        i, j = (a, b) if columns.usable[a] else (b, a)
        apart = np.hypot(*(columns.xy[i] - columns.xy[j]))
        if apart <= reach[i] + size[j] + columns.separation + motion.TOLERANCE:
            near.setdefault(i, ([], []))[0].append(j)
    for i, j in columns.obstacle_pairs.tolist():
        if not columns.usable[i]:
            continue
        n = len(columns.obstacles)
        points = columns.obstacles[j : j + 1, :2] if j < n else columns.obstacle_polygons[j - n]
        radius = columns.obstacles[j, 2] if j < n else np.hypot(*np.ptp(points, axis=0))
        apart = np.hypot(*(points - columns.xy[i]).T).min() - radius
        if apart <= reach[i] + columns.clearance + motion.TOLERANCE:
            near.setdefault(i, ([], []))[1].append(j)
    return near


def _segments_of(moves):
    """Return the segments of arms at the begin of their motion, shape (4, n)."""
    c, s = np.cos(moves.angle), np.sin(moves.angle)
    near = [moves.x + moves.inner * c, moves.y + moves.inner * s]
    return np.array([*near, moves.x + moves.length * c, moves.y + moves.length * s])


def _free_bins(columns, i, fiber, phi, size, broken, neighbors, obstacles):
    """Return the ranges of directions in which a folded arm is certainly clear of broken arms and obstacles."""
    theta = (np.arange(N_BINS) + 0.5) * BIN
    owner = np.full(N_BINS, i)
    moves = find_moves(columns, owner, np.full(N_BINS, fiber[i]), theta, np.full(N_BINS, phi[i]), moving=False)
    segments, fixed = _segments_of(moves), _segments_of(broken)
    outline = columns.plane.positioner.outline
    # from the center of a range to its ends, no point of the arm moves farther than this arc
    slack = 0.5 * BIN * max(size, 0.0 if outline is None else outline.reach[1]) + motion.TOLERANCE
    gaps = np.full(N_BINS, np.inf)
    for j in neighbors:
        tested = np.ascontiguousarray(np.hstack([segments, fixed[:, [j]]]))
        gap = np.empty(N_BINS)
        motion.gaps_to_one(tested, N_BINS, i, j, 2 * slack, columns.limits, gap)
        gaps = np.minimum(gaps, gap - columns.separation)
    for j in obstacles:
        gap = np.empty(N_BINS)
        motion.gaps_to_obstacle(segments, i, j, columns.limits, columns.obstacles, gap)
        gaps = np.minimum(gaps, gap - columns.clearance)
    return gaps > slack


def _line(columns, i, free):
    """Return the direction at which the joint range of theta begins, and the arc of each bin from there (0: none)."""
    low, high = (float(v[0]) for v in limits_of(columns, np.array([i]), 0, "theta_range"))
    if np.isfinite(low):
        zero = 0.0 if columns.joints is None else columns.joints.zeros(i, columns.first_index[i])[0]
        first, last = int(np.floor((low + zero) / BIN)), int(np.ceil((high + zero) / BIN))
    else:  # the line begins at a direction that is not free, or anywhere
        first = int(np.argmin(free))
        last = first + N_BINS
    # a joint range contains a direction at most twice
    line = free[np.arange(first, min(last, first + 2 * N_BINS)) % N_BINS]
    begins = line & ~np.append(False, line[:-1])
    return first * BIN, np.where(line, np.cumsum(begins), 0)
