"""The order in which tiles are observed in a night, with a table of methods, on a grid of slots of time."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.sparse import csr_array, vstack

from rfpsurvey._assignment.clock import left, now, share
from rfpsurvey._assignment.solver import maximize, sums_by_group, with_errors
from rfpsurvey._common.descriptions import Method, table_of

GAP = 1e-6
"""Relative difference between an upper limit and the merit of an order up to which the order is an optimum."""
ROUNDING = 1e-9
"""Largest relative rounding error of sums."""
SHARE, MOST_STEPS, FEW = 0.5, 400, 4000
"""Fraction of the time limit, and number of steps, in which prices are found; number of pairs of a first program."""


PARTS, FEW_OF_PART, SECONDS_OF_PART = (4, 6, 8), 400, 1.0
"""Numbers of tiles of the parts that are improved, and pairs and time limit (s) of their programs."""


@dataclass(frozen=True, eq=False)
class NightProblem:
    """Tiles that can be observed in a night, which is divided into slots of equal duration.

    Parameters
    ----------
    length : ndarray of int, shape (n_tiles, n_slots)
        Number of slots that an exposure which begins with a slot and the overhead after it occupy; 0 if the tile cannot
        be observed then. The last overhead may end after the last slot.
    merit : ndarray of float, shape (n_tiles,)
        Merit of each tile, above 0.
    closes : ndarray of float, shape (n_tiles,)
        End of the last window of each tile, which decides between tiles of the same merit.
    """

    length: np.ndarray
    merit: np.ndarray
    closes: np.ndarray

    @cached_property
    def ranked(self) -> np.ndarray:
        """Rows of the tiles: the largest merit is first, and of equal merits the window that closes first."""
        return np.lexsort((self.closes, -self.merit))

    @cached_property
    def most(self) -> int:
        """Upper limit of the number of tiles that any order contains."""
        possible = self.length[self.length > 0]
        return -(-self.length.shape[1] // int(possible.min())) if len(possible) else 0

    @cached_property
    def shortest(self) -> np.ndarray:
        """Smallest number of slots of each tile; a large number if it cannot be observed."""
        return np.where(self.length > 0, self.length, np.iinfo(np.int32).max).min(
            axis=1, initial=np.iinfo(np.int32).max
        )

    @cached_property
    def bound(self) -> float:
        """Upper limit of the merit of any order, in which parts of tiles fill the night and the slots after it."""
        some = np.flatnonzero((self.length > 0).any(axis=1))
        if not len(some):
            return 0.0
        length, shortest = self.length[some], self.shortest[some]
        order = np.argsort(-self.merit[some] / shortest, kind="stable")
        before = np.append(0, np.cumsum(shortest[order])[:-1])
        fraction = np.clip((self.length.shape[1] + length.max() - 1 - before) / shortest[order], 0, 1)
        return float(self.merit[some][order] @ fraction) * (1 + ROUNDING)

    def observable(self, slot: int, end: int | None = None) -> np.ndarray:
        """Return the rows of tiles that can begin with a slot (and end before the slot ``end``), best ones first."""
        length = self.length[self.ranked, slot]
        return self.ranked[(length > 0) & (length <= (np.inf if end is None else end - slot))]


@dataclass(frozen=True, eq=False)
class Order:
    """Tiles in the order of their observation, with the first slot of each, and an upper limit of the sum of merits."""

    tile: np.ndarray
    slot: np.ndarray
    bound: float
    is_optimum: bool = False


def greedy(problem: NightProblem, seconds: float = np.inf) -> Order:
    """Observe, from the beginning of the night on, the observable tile with the largest merit per time.

    The time includes the overhead. Tiles whose exposures are shorter at other times are postponed: the merit per time
    is multiplied by the ratio of the shortest time to the present one. Of equal tiles, the one whose window closes
    first is observed. If no tile can be observed, the method waits for the next slot in which one can.
    """
    chosen, slots, slot, free = [], [], 0, np.ones(len(problem.merit), dtype=bool)
    while slot < problem.length.shape[1]:
        rows = problem.observable(slot)
        rows = rows[free[rows]]
        n = 1
        if len(rows):
            best = rows[np.argmax(problem.merit[rows] * problem.shortest[rows] / problem.length[rows, slot] ** 2)]
            n, free[best] = int(problem.length[best, slot]), False
            chosen.append(best)
            slots.append(slot)
        slot += n
    tile, slots = np.array(chosen, dtype=np.int64), np.array(slots, dtype=np.int64)
    return Order(tile, slots, problem.bound, is_optimum=bool(problem.merit[tile].sum() >= problem.bound * (1 - GAP)))


def postponed(problem: NightProblem, order: Order) -> Order:
    """Return the order with later times of tiles whose exposures are shorter then, as far as the next tile allows."""
    slots, end = order.slot.copy(), np.inf
    for k in range(len(slots) - 1, -1, -1):
        length = problem.length[order.tile[k], slots[k] :]
        possible = (length > 0) & (np.arange(len(length)) + slots[k] + length <= max(end, slots[k] + length[0]))
        slots[k] += np.argmin(np.where(possible, length, np.iinfo(length.dtype).max))
        end = slots[k]
    return replace(order, slot=slots)


def exact(problem: NightProblem, seconds: float = np.inf) -> Order:
    """Maximize the sum of the merits of the observed tiles with an integer program.

    The program has a variable for each tile and each slot with which it can begin, and starts from the order of the
    method ``greedy``. If the time limit ends the search, the best order so far is returned, with an upper limit.
    """
    first = greedy(problem)
    if first.is_optimum:
        return first
    candidates = Candidates(problem, *np.nonzero(not_dominated(problem)))
    deadline = now() + seconds
    order, bound, priced = price(candidates, first, share(deadline, SHARE))
    most = candidates.through(priced)
    if bound > problem.merit[order.tile].sum() * (1 + GAP):
        order = improve(candidates, most, order, share(deadline, SHARE))
    value = problem.merit[order.tile].sum()
    for n in (FEW, len(most)):  # a good order from the most promising pairs, and then the proof
        if bound > value * (1 + GAP):
            rest = np.zeros(len(most), dtype=bool)
            rest[np.argsort(-most, kind="stable")[:n]] = True
            rest &= most > value
            part = Candidates(problem, candidates.tile[rest], candidates.slot[rest])
            limit = bound if rest.sum() < np.sum(most > value) else -np.inf
            order, found = solve(part, order, bound, share(deadline, SHARE) if n == FEW else deadline)
            value = problem.merit[order.tile].sum()
            bound = max(found, limit)
    return Order(order.tile, order.slot, max(bound, value), is_optimum=bool(bound <= value * (1 + 2 * GAP)))


@dataclass(frozen=True, eq=False)
class Candidates:
    """Pairs of a tile and its first slot, sorted by slots, and paths of pairs through the night."""

    problem: NightProblem
    tile: np.ndarray
    slot: np.ndarray

    def __post_init__(self):
        order = np.argsort(self.slot, kind="stable")
        for name in ("tile", "slot"):
            object.__setattr__(self, name, getattr(self, name)[order])

    @cached_property
    def n_slots(self) -> int:
        """Number of slots of the night."""
        return self.problem.length.shape[1]

    @cached_property
    def end(self) -> np.ndarray:
        """Slot after each pair; the end of the night for the last ones."""
        return np.minimum(self.slot + self.problem.length[self.tile, self.slot], self.n_slots)

    @cached_property
    def ranges(self) -> np.ndarray:
        """Index of the first pair of each slot, and the number of pairs."""
        return np.searchsorted(self.slot, np.arange(self.n_slots + 1))

    def after(self, value: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the largest sum of values from each slot on, and the pair with which it begins (-1: wait)."""
        best, pair = np.zeros(self.n_slots + 1), np.full(self.n_slots, -1)
        for s in range(self.n_slots - 1, -1, -1):
            best[s], low, high = best[s + 1], self.ranges[s], self.ranges[s + 1]
            if low < high:
                sums = value[low:high] + best[self.end[low:high]]
                k = sums.argmax()
                if sums[k] > best[s]:
                    best[s], pair[s] = sums[k], low + k
        return best, pair

    def path(self, pair: np.ndarray) -> np.ndarray:
        """Return the pairs of the path that begins with the first slot."""
        slot, pairs = 0, []
        while slot < self.n_slots:
            is_used = pair[slot] >= 0
            pairs += [pair[slot]] if is_used else []
            slot = self.end[pair[slot]] if is_used else slot + 1
        return np.array(pairs, dtype=np.int64)

    def through(self, price: np.ndarray) -> np.ndarray:
        """Return an upper limit of the merit of all orders that contain each pair, for any prices of tiles."""
        value = (self.problem.merit - price)[self.tile]
        best, before = self.after(value)[0], np.zeros(self.n_slots + 1)
        for s in range(self.n_slots):
            low, high = self.ranges[s], self.ranges[s + 1]
            before[s + 1] = max(before[s + 1], before[s])
            np.maximum.at(before, self.end[low:high], before[s] + value[low:high])
        return price.sum() + before[self.slot] + value + best[self.end]


def price(candidates: Candidates, first: Order, deadline: float) -> tuple[Order, float, np.ndarray]:
    """Return the best order found, an upper limit of the merit of any order, and the prices of tiles that prove it.

    If each observation of a tile costs a price, and each tile receives its price once, then the best path, which may
    contain a tile several times, has at least the merit of any order. Steps along the subgradient minimize this limit.
    """
    problem, price, bound = candidates.problem, np.zeros(len(candidates.problem.merit)), np.inf
    best, value, factor, kept = first, problem.merit[first.tile].sum(), 1.0, price
    for _ in range(MOST_STEPS):
        sums, pair = candidates.after((problem.merit - price)[candidates.tile])
        path = candidates.path(pair)
        limit = sums[0] + price.sum()
        factor = factor if limit < bound else factor * 0.97
        bound, kept = (limit, price) if limit < bound else (bound, kept)
        tile, where = np.unique(candidates.tile[path], return_index=True)
        if problem.merit[tile].sum() > value:
            where = np.sort(where)
            best = Order(candidates.tile[path][where], candidates.slot[path][where], np.inf)
            value = problem.merit[tile].sum()
        step = 1.0 - np.bincount(candidates.tile[path], minlength=len(price))
        step[(price <= 0) & (step > 0)] = 0
        if bound <= value * (1 + GAP) or not step.any() or left(deadline) == 0:
            break
        price = np.maximum(price - factor * (limit - value) / (step @ step) * step, 0)
    return best, min(bound * (1 + ROUNDING), problem.bound), kept


def improve(candidates: Candidates, most: np.ndarray, order: Order, deadline: float) -> Order:
    """Replace parts of an order by better ones, which programs for single parts of the night find.

    ``most`` is the upper limit of the merit of all orders that contain each pair. A program contains the most promising
    pairs that fit into the time of some successive tiles, without the tiles of the rest of the night.
    """
    merit, length = candidates.problem.merit, candidates.problem.length[candidates.tile, candidates.slot]
    for n in PARTS:
        k = 0
        while k < max(1, len(order.tile) - n // 2) and left(deadline) > 0:
            inside = np.zeros(len(order.tile), dtype=bool)
            inside[k : k + n] = True
            first = order.slot[k] if k else 0
            last = order.slot[k + n] if k + n < len(order.tile) else np.inf
            fits = (candidates.slot >= first) & (candidates.slot + length <= last)
            rows = np.flatnonzero(fits & ~np.isin(candidates.tile, order.tile[~inside]))
            rows = rows[np.argsort(-most[rows], kind="stable")[:FEW_OF_PART]]
            part = Order(order.tile[inside], order.slot[inside], np.inf)
            own = Candidates(candidates.problem, candidates.tile[rows], candidates.slot[rows])
            found, _ = solve(own, part, np.inf, min(deadline, now() + SECONDS_OF_PART))
            if merit[found.tile].sum() > merit[part.tile].sum() * (1 + GAP):
                tile, slot = np.append(order.tile[~inside], found.tile), np.append(order.slot[~inside], found.slot)
                order = Order(tile[np.argsort(slot)], np.sort(slot), np.inf)
            k += n // 2
    return order


def solve(candidates: Candidates, first: Order, bound: float, deadline: float) -> tuple[Order, float]:
    """Return an order of the candidates with the largest merit, found by an integer program, and an upper limit."""
    problem, tile, slot = candidates.problem, candidates.tile, candidates.slot
    value = problem.merit[first.tile].sum()
    if len(tile) == 0:
        return first, value
    length, n, scale = candidates.end - slot, len(tile), problem.merit[tile].max()
    variable = np.repeat(np.arange(n), length)
    occupied = np.arange(len(variable)) + np.repeat(slot - np.cumsum(length) + length, length)
    slots = csr_array((np.ones(len(variable)), (occupied, variable)), shape=(candidates.n_slots, n))
    rows = vstack([sums_by_group(tile, len(problem.merit)), slots], format="csr")
    rows = rows[np.diff(rows.indptr) > 1]  # other rows limit at most one variable, which is at most 1
    limits = rows, np.full(rows.shape[0], -np.inf), np.ones(rows.shape[0])
    x, limit = maximize(limits, problem.merit[tile] / scale, np.ones(n), deadline, integral=True, gap=GAP)
    if x is not None and problem.merit[tile] @ x > value:
        used = np.flatnonzero(x > 0.5)
        first = Order(tile[used], slot[used], np.inf)
    # orders with other pairs have at most the given merit
    return first, min(max(scale * with_errors(limit, 0), value), bound)


def not_dominated(problem: NightProblem) -> np.ndarray:
    """Return which pairs of a tile and its first slot an optimum may need.

    If at least `NightProblem.most` other tiles of no smaller rank can begin with the slot and occupy no more slots, an
    order that contains the pair does not contain one of them, and this tile can take its place.
    """
    needed = np.zeros(problem.length.shape, dtype=bool)
    for slot in range(problem.length.shape[1]):
        rows = problem.observable(slot)
        length = problem.length[rows, slot]
        for n in np.unique(length):
            first = np.flatnonzero(length <= n)[: problem.most]
            needed[rows[first[length[first] == n]], slot] = True
    return needed


@dataclass(frozen=True)
class OrderMethod(Method):
    """A method that finds the order of the tiles of a night; the function takes a `NightProblem` and a time limit."""


METHODS = table_of(
    OrderMethod("greedy", greedy, summary="at each time, the observable tile with the largest merit per time"),
    OrderMethod("exact", exact, ("time_limit",), "the largest sum of merits, with its upper limit"),
)
"""Methods that find the order of the tiles of a night, by name."""
