"""Place tiles by network flow (Blanton et al. 2003, AJ 125, 2276, Section 4).

Targets are combined into small cells, and a minimum-cost flow assigns the cells to tiles. If a cell lies outside its
tile, the cost of the assignment increases with the distance of the cell from the edge of the tile. Each tile then moves
to the center that minimizes the cost of the cells assigned to it.
"""

import numpy as np

from rfpsurvey._sky import shapes as _healpix
from rfpsurvey._sky.arrays import SkyIndex
from rfpsurvey._survey.tiling.cover import lattice
from rfpsurvey._survey.tiling.greedy import climb
from rfpsurvey._survey.tiling.problem import TilingProblem, TilingState, visit_all

# Lengths as fractions of the radius of a tile. The flow can assign targets outside a tile to this tile, up to the
# distance OUTSIDE from its edge. CELL is the size of the cells.
OUTSIDE = 0.2
CELL = 0.15
# The cost of a visit is almost 0 inside the field, and increases from 1 to 3 beyond its edge. UNASSIGNED is the
# cost of a requested visit that is not made.
INSIDE_COST, EDGE_COST, STEEP, UNASSIGNED = 0.01, 1.0, 2.0, 10.0
MOST_ROUNDS = 20
GAIN = 2e-3


def network_flow(problem: TilingProblem) -> TilingState:
    """Place tiles together by network flow: a given number, or the smallest number that reaches a given completeness.

    By default, the number of tiles is that of a hexagonal lattice that covers the targets.
    """
    if problem.completeness is not None:
        return _fewest(problem)
    n = len(_lattice(problem, 2.0, np.sqrt(3) * problem.radius)) if problem.n_tiles is None else problem.n_tiles
    return _attempt(problem, n)


def _fewest(problem: TilingProblem) -> TilingState:
    """Return a state with the smallest number of tiles that reaches the completeness, found by bisection."""
    goal = problem.completeness
    most = problem.n_tiles or 10**6
    n = min(max(int(np.ceil(goal * problem.wanted.sum() / problem.fibers)), 1), most)
    low, reached, best, stuck = 0, None, None, 0
    while reached is None:
        state = _attempt(problem, n)
        if best is None or state.completeness > best.completeness + 1e-9:
            best, stuck = state, 0
        else:
            stuck += 1
        if state.completeness >= goal - 1e-12:
            reached = state
        elif n >= most or stuck >= 6:
            return best
        else:
            foreseen = int(n * min(goal / max(state.completeness, 1e-9), 3))  # completeness in proportion to tiles
            low, n = n, min(max(int(1.25 * n), n + 1, foreseen), most)
    # an attempt may observe all targets before all of its tiles are used
    high = len(reached.rows)
    while high - low > max(1, high // 100):
        middle = (low + high) // 2
        state = _attempt(problem, middle)
        if state.completeness >= goal - 1e-12:
            reached, high = state, min(middle, len(state.rows))
        else:
            low = middle
    return reached


def _attempt(problem: TilingProblem, n: int) -> TilingState:
    """Place ``n`` tiles by network flow, and observe their targets."""
    centers = _relax(problem, _Cells(problem), _uniform(problem, n))
    state = TilingState(problem)
    visit_all(state, _allowed(problem, centers), None)
    return state


def _lattice(problem: TilingProblem, margin: float, pitch: float) -> np.ndarray:
    """Return the centers of a hexagonal lattice with targets, up to ``margin`` radii beyond the circle of targets."""
    center, reach = problem.circle()
    centers = lattice(center, reach + margin * problem.radius, pitch, np.zeros(2))
    centers = problem.where.limits.fit(centers, problem.radius)
    return centers[problem.visits_near(centers) > 0]


def _uniform(problem: TilingProblem, n: int) -> np.ndarray:
    """Return n centers spread evenly over the targets: a hexagonal lattice whose pitch gives n tiles with targets."""
    low, high = 0.0, 3 * (problem.circle()[1] + problem.radius)
    pitch = np.sqrt(3) * problem.radius
    for _ in range(25):
        centers = _lattice(problem, 1.5, pitch)
        if len(centers) == n:
            return centers
        if len(centers) > n:
            low, enough = pitch, centers
        else:
            high = pitch
        if low and high - low < 1e-3 * low:
            break
        # the number of tiles is proportional to 1 / pitch^2
        guess = pitch * np.sqrt(max(len(centers), 0.5) / n)
        pitch = guess if low < guess < high and guess != pitch else (low + high) / 2
    if not low:
        enough = np.vstack([centers, problem.where.limits.move_inside(problem.index.vectors[problem.wanted > 0][:1])])
    keep = np.sort(np.argsort(-problem.visits_near(enough), kind="stable")[:n])
    enough = enough[keep]
    # if there are fewer than n centers with targets, the best centers occur several times
    return enough[np.arange(n) % len(enough)]


class _Cells:
    """Groups of targets that are close together."""

    def __init__(self, problem: TilingProblem):
        rows = np.flatnonzero(problem.wanted > 0)
        nside = _healpix.nside_for(CELL * problem.radius)
        pixels = _healpix.pixels_of(nside, problem.index.vectors[rows])
        _, of, self.count = np.unique(pixels, return_inverse=True, return_counts=True)
        weight = problem.wanted[rows].astype(float)
        self.vectors = np.column_stack([np.bincount(of, weight * problem.index.vectors[rows, k]) for k in range(3)])
        self.vectors /= np.linalg.norm(self.vectors, axis=1)[:, None]
        self.supply = np.bincount(of, weight)
        self.index = SkyIndex(self.vectors)


def _cost(distance: np.ndarray, radius: float) -> np.ndarray:
    """Return the cost of a visit to a target at a given distance from the center of the tile."""
    away = distance / radius
    beyond = EDGE_COST + STEEP * (away - 1) / OUTSIDE
    return np.where(away <= 1, INSIDE_COST * away**2, np.where(away <= 1 + OUTSIDE, beyond, UNASSIGNED))


def _relax(problem: TilingProblem, cells: _Cells, centers: np.ndarray) -> np.ndarray:
    """Alternately compute flows and move the centers until the cost no longer decreases; return the centers."""
    radius, last = problem.radius, np.inf
    for _ in range(MOST_ROUNDS):
        cell, tile, amount, total = _flow(problem, cells, centers)
        if not total < last * (1 - GAIN):
            break
        last = total
        centers = centers.copy()
        left = cells.supply - np.bincount(cell, amount, len(cells.supply))
        order = np.argsort(tile, kind="stable")
        for k, flows in enumerate(np.split(order, np.searchsorted(tile[order], np.arange(1, len(centers))))):
            if len(flows):
                centers[k] = _best_center(centers[k], cells.vectors[cell[flows]], amount[flows], radius)
            elif left.max() > 0.5:  # move a tile without targets to unassigned targets
                gain = cells.index.sum_near(cells.vectors, radius, left[cells.index.order])
                centers[k] = cells.vectors[np.argmax(gain)]
                left[cells.index.order[cells.index.near(centers[k], radius)]] = 0.0
        centers = problem.where.limits.move_inside(centers)
    return centers


def _flow(problem: TilingProblem, cells: _Cells, centers: np.ndarray):
    """Assign cells to tiles at the lowest total cost.

    Return the cell, the tile and the number of visits of each assignment, and the total cost.
    """
    from scipy.optimize import linprog
    from scipy.sparse import csr_array

    reach = min((1 + OUTSIDE) * problem.radius, np.pi)
    lists = [cells.index.order[cells.index.near(center, reach)] for center in centers]
    cell = np.concatenate(lists).astype(np.int64) if lists else np.empty(0, dtype=np.int64)
    tile = np.repeat(np.arange(len(centers)), [len(cells_in_reach) for cells_in_reach in lists])
    chord = np.linalg.norm(cells.vectors[cell] - centers[tile], axis=1)
    cost = _cost(2 * np.arcsin(np.minimum(chord / 2, 1)), problem.radius)
    if len(cell) == 0:
        return cell, tile, np.empty(0), UNASSIGNED * cells.supply.sum()
    # the cost of leaving all targets unassigned is a constant; only the difference from it is minimized
    ones, n = np.ones(len(cell)), np.arange(len(cell))
    limits = csr_array(
        (np.concatenate([ones, ones]), (np.concatenate([cell, len(cells.supply) + tile]), np.concatenate([n, n]))),
        shape=(len(cells.supply) + len(centers), len(cell)),
    )
    capacity = np.concatenate([cells.supply, np.full(len(centers), float(problem.fibers))])
    most = np.column_stack([0 * ones, cells.count[cell]])
    for presolve in (True, False):  # presolve can find programs infeasible that have solutions, as this one always has
        options = {"presolve": presolve}
        solution = linprog(cost - UNASSIGNED, A_ub=limits, b_ub=capacity, bounds=most, method="highs", options=options)
        if solution.status == 0:
            break
    amount = solution.x
    used = amount > 1e-6
    return cell[used], tile[used], amount[used], solution.fun + UNASSIGNED * cells.supply.sum()


def _best_center(center: np.ndarray, vectors: np.ndarray, amount: np.ndarray, radius: float) -> np.ndarray:
    """Return the center that minimizes the cost of the assigned cells, found by steps of decreasing length."""

    def value(places):
        chord = np.linalg.norm(vectors[None] - places[:, None], axis=2)
        return -(_cost(2 * np.arcsin(np.minimum(chord / 2, 1)), radius) @ amount)

    return climb(center, value, 0.1 * radius, 0.01 * radius, gain=1e-9)


def _allowed(problem: TilingProblem, centers: np.ndarray) -> np.ndarray:
    """Return the allowed center that is nearest to each center; by default, all centers are allowed."""
    if problem.where.vectors is None:
        return centers
    from scipy.spatial import cKDTree

    return problem.where.vectors[cKDTree(problem.where.vectors).query(centers)[1]]
