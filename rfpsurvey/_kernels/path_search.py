"""Search of paths in the joint space of a few arms, and the proof that there is no path for two arms.

A configuration of m arms is a point with the coordinates theta and phi of each arm. All other arms are at rest. The
search grows two trees of configurations, one from the initial poses and one from folded poses, toward random
configurations and toward each other (RRT-Connect, Kuffner and LaValle 2000). All motions are tested at all times.

The proof divides each angle into cells. If two arms can move from their initial poses to their folded poses without
coming closer than the minimum separation D, then they can also move from the center of a cell to the center of a
neighboring cell, and so on, and are never closer in these centers than D minus the largest distance of a point of an
arm from its position in the center of the cell. If the cells that can be reached in this way do not contain the folded
poses, there is no path.
"""

import math

import numpy as np

from rfpsurvey._kernels.collisions import obstacle_distance
from rfpsurvey._kernels.jit import kernel
from rfpsurvey._kernels.path_steps import blocked_by, distance_at_rest, locate

OPEN, LOCKED, UNKNOWN = 0, 1, 2


@kernel
def is_free(bodies, limits, around, state, members, here, there, gaps):
    """Return whether the members can move from the configuration ``here`` to ``there`` at constant rates."""
    theta, psi, rate, psi_rate, _ = state
    for k in range(members.size):
        i = members[k]
        theta[i], psi[i] = here[2 * k], here[2 * k] + here[2 * k + 1]
        rate[i] = there[2 * k] - here[2 * k]
        psi_rate[i] = rate[i] + there[2 * k + 1] - here[2 * k + 1]
    for i in members:  # noqa: SIM110 (numba does not compile a generator here)
        if blocked_by(bodies, limits, around, state, i, rate[i], psi_rate[i], gaps) != -1:
            return False
    return True


@kernel
def nearest_node(nodes, n, point):
    """Return the row of the node whose largest difference of an angle is smallest, and this difference."""
    best, nearest = math.inf, 0
    for k in range(n):
        far = 0.0
        for c in range(point.size):
            far = max(far, abs(nodes[k, c] - point[c]))
        if far < best:
            best, nearest = far, k
    return nearest, best


@kernel
def search(bodies, limits, around, theta, psi, members, reach, n_nodes, rng):
    """Return the configurations of a path to folded poses, shape (k, 2 m); no row if no path was found.

    Between two nodes, no angle changes by more than ``reach``. ``theta`` and ``psi`` are the poses of all arms.
    """
    m = members.size
    size = 2 * m
    gaps = np.full(np.max(np.diff(around.start)), -np.inf)  # no distances are known before the motions are tested
    state = theta.copy(), psi.copy(), np.zeros(theta.size), np.zeros(theta.size), np.zeros(theta.size, np.bool_)
    low, high, goal = np.empty(size), np.empty(size), np.empty(size)
    nodes, parent, count = np.empty((2, n_nodes, size)), np.full((2, n_nodes), -1), np.zeros(2, np.int64)
    for k in range(m):
        i = members[k]
        state[4][i] = True
        low[2 * k], high[2 * k] = around.theta_low[i], around.theta_high[i]
        low[2 * k + 1], high[2 * k + 1] = around.phi_low[i], around.phi_high[i]
        nodes[0, 0, 2 * k], nodes[0, 0, 2 * k + 1] = theta[i], psi[i] - theta[i]
    count[0] = 1
    for attempt in range(64):
        for k in range(m):
            angle = nodes[0, 0, 2 * k] if attempt == 0 else low[2 * k] + rng.random() * (high[2 * k] - low[2 * k])
            goal[2 * k], goal[2 * k + 1] = angle, around.fold[members[k]]
        if is_free(bodies, limits, around, state, members, goal, goal, gaps):
            nodes[1, count[1]] = goal
            count[1] += 1
    path = np.empty((0, size))
    if count[1] == 0:
        return path
    point, new = np.empty(size), np.empty(size)
    tree, met = 0, False
    for _ in range(2 * n_nodes):  # in dense planes, most random points extend no tree
        if met or count.max() >= n_nodes - 1:
            break
        for c in range(size):
            # some coordinates are at their limits, because narrow passages often are
            point[c] = low[c] + min(max(1.1 * rng.random() - 0.05, 0.0), 1.0) * (high[c] - low[c])
        # the tree grows one step toward the random point, and the other tree then grows toward the new node
        for turn in range(2):
            side = tree if turn == 0 else 1 - tree
            k, far = nearest_node(nodes[side], count[side], point)
            grown, size_of_step = False, reach
            while count[side] < n_nodes - 1:
                part = min(1.0, size_of_step / far) if far > 0.0 else 1.0
                for c in range(size):
                    new[c] = nodes[side, k, c] + part * (point[c] - nodes[side, k, c])
                if not is_free(bodies, limits, around, state, members, nodes[side, k], new, gaps):
                    # in narrow passages, only short steps are possible
                    size_of_step *= 0.25
                    if grown or size_of_step < 0.03 * reach:
                        break
                    continue
                nodes[side, count[side]], parent[side, count[side]] = new, k
                k = count[side]
                count[side] += 1
                far -= part * far
                grown = True
                met = turn == 1 and part == 1.0
                if turn == 0 or met:
                    break
            if not grown:
                break
            point[:] = nodes[side, k]
        tree = 1 - tree
    if not met:
        return path
    # the last nodes of both trees are equal
    lengths = np.zeros(2, np.int64)
    for side in range(2):
        k = count[side] - 1
        while k >= 0:
            lengths[side] += 1
            k = parent[side, k]
    path = np.empty((lengths.sum() - 1, size))
    k, row = count[0] - 1, lengths[0] - 1
    while k >= 0:
        path[row] = nodes[0, k]
        k, row = parent[0, k], row - 1
    k, row = parent[1, count[1] - 1], lengths[0]
    while k >= 0:
        path[row] = nodes[1, k]
        k, row = parent[1, k], row + 1
    # nodes between two nodes with a direct motion are removed
    for _ in range(20 * len(path)):
        if len(path) < 3:
            break
        first = int(rng.random() * (len(path) - 2))
        last = first + 2 + int(rng.random() * (len(path) - first - 2))
        if is_free(bodies, limits, around, state, members, path[first], path[last], gaps):
            path = np.concatenate((path[: first + 1], path[last:]))
    return path


@kernel
def mark_open(bodies, limits, around, i, low, size, slack, segments, cells, is_open):
    """Mark the cells of arm i in whose centers it is not closer than the required distances minus ``slack``.

    Obstacles and arms that cannot move are considered. The center of cell (k, m) has theta = low[0] + k size and
    psi - theta = low[1] + m size; its segment is written to column k n + m of ``cells``, for n angles of phi. The last
    column of ``segments``, which contains all arms, is overwritten.
    """
    last = segments.shape[1] - 1
    for k in range(is_open.shape[0]):
        for m in range(is_open.shape[1]):
            theta = low[0] + k * size
            locate(bodies, theta, theta + low[1] + m * size, i, segments, last)
            cells[:, k * is_open.shape[1] + m] = segments[:, last]
            ends = segments[0, last], segments[1, last], segments[2, last], segments[3, last]
            free = True
            for n in range(around.o_start[i], around.o_start[i + 1]):
                j = around.o_near[n]
                radius = around.obstacles[j, 2] if j < around.obstacles.shape[0] else 0.0
                free &= obstacle_distance(limits, around.obstacles, i, *ends, j) - radius >= around.required - slack
            for n in range(around.start[i], around.start[i + 1]):
                j = around.near[n]
                if not around.free[j]:
                    distance = distance_at_rest(segments, limits, last, i, j, j, limits.separation)
                    free &= not distance < limits.separation - slack  # true for NaN
            is_open[k, m] = free


@kernel
def reaches_fold(is_open, cyclic, k, m, fold):
    """Return whether the open cells that are connected with the cell (k, m) contain a cell (any, fold).

    If ``cyclic`` is true, the first and the last direction theta are neighbors.
    """
    n_theta, n_phi = is_open.shape
    seen = ~is_open
    stack = np.empty((n_theta * n_phi + 1, 2), np.int64)
    stack[0, 0], stack[0, 1] = k, m
    seen[k, m] = True
    used = 1
    while used > 0:
        used -= 1
        k, m = stack[used, 0], stack[used, 1]
        if m == fold:
            return True
        for u, v in ((k - 1, m), (k + 1, m), (k, m - 1), (k, m + 1)):
            u = u % n_theta if cyclic else u
            if 0 <= u < n_theta and 0 <= v < n_phi and not seen[u, v]:
                seen[u, v] = True
                stack[used, 0], stack[used, 1] = u, v
                used += 1
    return False


@kernel
def reach_fold_together(cells, limits, i, j, open_i, open_j, cyclic, first, folds, separation, most):
    """Return OPEN if two arms can reach folded poses between the centers of cells, LOCKED if not, or UNKNOWN.

    ``cells`` contains the segments of all cells of arm i, then those of arm j. ``cyclic`` states for each
    arm whether the first and the last direction theta are neighbors. ``first`` is the number of the cell of each arm in
    these lists, and ``folds`` are the numbers of the angles phi of folded arms. The result is UNKNOWN if
    more than ``most`` pairs of cells remain to be examined at the same time.
    """
    n, n_phi, other_phi = open_j.size, open_i.shape[1], open_j.shape[1]
    start = open_i.size
    seen = np.zeros(start * n // 64 + 1, np.uint64)
    stack = np.empty(most, np.int64)
    state = first[0] * n + first[1]
    seen[state >> 6] |= np.uint64(1) << np.uint64(state & 63)
    stack[0], used = state, 1
    while used > 0:
        used -= 1
        a, b = stack[used] // n, stack[used] % n
        if a % n_phi == folds[0] and b % other_phi == folds[1]:
            return OPEN
        for move in range(8):
            # motions toward the fold are on top of the stack, so that they are examined first
            arm, joint, way = move % 2, move // 4, 2 * (move // 2 % 2) - 1
            is_open, cell, wide = (open_i, a, n_phi) if arm == 0 else (open_j, b, other_phi)
            theta, phi = cell // wide, cell % wide
            if joint == 0:
                theta = (theta + way) % is_open.shape[0] if cyclic[arm] else theta + way
            else:
                phi += way if folds[arm] >= phi else -way
            if theta < 0 or theta >= is_open.shape[0] or phi < 0 or phi >= wide or not is_open[theta, phi]:
                continue
            cell = theta * wide + phi
            p, q = (cell, b) if arm == 0 else (a, cell)
            state = p * n + q
            bit = np.uint64(1) << np.uint64(state & 63)
            if seen[state >> 6] & bit:
                continue
            seen[state >> 6] |= bit
            if distance_at_rest(cells, limits, p, i, start + q, j, separation) < separation:
                continue
            if used + 1 >= most:
                return UNKNOWN
            stack[used] = state
            used += 1
    return LOCKED
