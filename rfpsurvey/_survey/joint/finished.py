"""The search for a joint plan that finishes as many targets as possible.

A target is *finished* if it receives all its remaining visits, on any tiles. Local moves complete targets, as for
cadences with a single epoch. Integer programs for patches of the sky, or for all tiles, then improve the plan. There,
a further variable of each target is 1 if the target is finished, and is at most its number of visits divided by the
number that it requires. The program for all tiles also gives an upper bound.
"""

from concurrent.futures import Executor
from functools import cached_property
from time import time

import numpy as np
from scipy.sparse import csr_array, hstack, vstack

from rfpsurvey._assignment.clock import now
from rfpsurvey._assignment.solver import maximize, with_errors
from rfpsurvey._assignment.weighted import WeightedProblem, solve_weighted
from rfpsurvey._common.executors import map_in_order
from rfpsurvey._kernels import paths as path_kernels
from rfpsurvey._survey.joint.network import Network, Patches, divide
from rfpsurvey._survey.joint.search import FOR_PRICES, MOST_EDGES
from rfpsurvey._survey.joint.shares import UNITS, Shares, solve_balanced
from rfpsurvey._survey.joint.windows import PASSES, WHOLE, WindowSearch, dates_of

# Number of candidates of a patch, in units of the option ``patch_size``; number of candidates up to which one program
# contains all tiles; and weight of all visits, in units of a finished target of the last class.
SIZE, MOST_OF_ALL, OF_VISITS = 4, 40_000, 0.4
# Largest number of nodes of a program of a patch; the same times the number of candidates, for a program of all tiles;
# and largest ratio of the weights of two classes.
NODES, EFFORT, STEEPEST = 100, 2e6, 1e4
# Fraction of the remaining time for the programs of all tiles.
FOR_ALL = 0.8


class FinishedSearch(WindowSearch):
    """A plan of all tiles that finishes targets, and upper bounds; the parameters are those of `Search`."""

    def __init__(self, network: Network, chosen: np.ndarray, request, directions: np.ndarray):
        self._directions, self.bound_of_smallest = directions, np.inf
        category = request.source.by_slot("category")
        is_finished = (request.builder.wanted > 0) & (request.builder.left == 0)
        self.shares = Shares.of(request.joint.share, category, network, is_finished) if request.joint.share else None
        super().__init__(network, chosen, request)
        self._is_proven = np.zeros(len(self.levels), dtype=bool)

    def _make_dates(self):
        wanted, n_tiles = _wanted(self.network), len(self.request.tiling)
        numbers = np.unique(np.append(wanted, 0))
        # a cadence for each number of visits: one epoch without a window; the last one, without epochs, is for 0 visits
        epochs = [np.array([[-1.0], [-1.0], [n], [np.inf]]) for n in numbers[1:]] + [np.empty((4, 0))]
        of_slot, real = np.full(len(self.request.builder.left), -1), wanted > 0
        of_slot[self.network.slot[real]] = np.searchsorted(numbers, wanted[real]) - 1
        return dates_of(self.network, epochs, of_slot, np.zeros(n_tiles), np.zeros(n_tiles), 1.0)

    def _counts_of_targets(self):
        return _finished(self.network, self.chosen)

    @cached_property
    def _n_fixed(self) -> np.ndarray:
        """Number of targets of each level that fixed tiles finish."""
        network = self.network
        done = (network.rank_of_target < network.n_classes) & (network.visits > 0) & (_wanted(network) == 0)
        return np.cumsum(np.bincount(network.rank_of_target[done], minlength=network.n_classes))[self.levels]

    def _without_limits(self, per_visit, per_whole):
        return super()._without_limits(per_visit, per_whole) + per_whole * self._n_fixed

    @property
    def _may_end(self) -> bool:
        return self.shares is None or self.iteration > 0

    def _bound_level(self, k: int) -> None:
        """Compute the bounds of the numbers of finished targets and of visits of a level."""
        limit = (1 + k) / len(self.levels) * FOR_PRICES
        n = int(self._n_fixed[k])
        self.bounds_complete[k] = n + self._bound(k, *WHOLE, int(self.counts[k, 0]) - n, self._minima(), limit)
        self.bounds[k] = self.bounds_of_all[k] = self.network.matching(int(self.levels[k]), MOST_EDGES)

    def iterate(self, executor: Executor | None) -> None:
        """Run one iteration: moves, and integer programs for patches, or one for each level with a gap."""
        if self.shares is None or self.iteration == 0:
            before = self.chosen.copy()
            self._improve(PASSES)
            if self._value(self.chosen) < self._value(before):  # moves do not consider shares
                self._use(before)
        is_small = len(self.network.target) <= MOST_OF_ALL
        if self.iteration == 0:
            self._bound_together()
        if self.shares is not None:
            self._balance(is_small)
        elif (self.gaps > self.options.gap).any():
            self._solve_patches(executor)
            if is_small:
                self._solve_all()
        self.iteration += 1
        self._record()

    def _solve_all(self) -> None:
        """Find the best plan, and an upper bound for each level with a gap, by integer programs for all tiles."""
        network, patches = self.network, Patches(self.network, np.zeros(len(self.network.start) - 1, dtype=np.int64))
        gains = {k: (np.arange(network.n_classes) <= level).astype(float) for k, level in enumerate(self.levels)}
        if network.n_classes > 1:  # first the plan that is best in the order of the classes
            gains = {-1: self._class_weights(), **gains}
        for k, weights in gains.items():
            is_open = (self.counts[:, 0] < self.bounds_complete) & ~self._is_proven
            if not (is_open.any() if k < 0 else is_open[k]) or self.out_of_time():
                continue
            n_open = 1 if k < 0 else int(is_open[k:].sum())
            deadline = time() + FOR_ALL / n_open * min(self._limit - self.seconds, 1e9)
            problem = self._program(patches, 0, weights, deadline, int(EFFORT / len(network.target)))
            chosen, bound = solve_weighted(problem[1])
            self._take(patches.members[0], problem, chosen)
            if k < 0:
                continue
            if self._is_complete and np.isfinite(bound):
                self.bounds_complete[k] = min(self.bounds_complete[k], np.floor(bound))
            self._is_proven[k] = True  # further iterations use only moves

    def _balance(self, is_small: bool) -> None:
        """Increase the smallest finished fractions of the categories, by a program for all tiles or for patches."""
        network = self.network
        if is_small and self.iteration > 0:
            return
        whole = np.zeros(len(network.start) - 1, dtype=np.int64)
        patches, rounds = (Patches(network, whole), len(self.shares.names)) if is_small else (self._patches(), 1)
        for k in range(patches.n):
            if self.out_of_time():
                break
            seconds = min(self._limit - self.seconds, 1e9) * (FOR_ALL / (rounds + 1) if is_small else 1.0)
            nodes = int(EFFORT / len(network.target)) if is_small else NODES
            problem = self._program(patches, k, self._class_weights(), time() + seconds, nodes)
            outside = _finished(network, self.chosen)[:, 0] > 0
            outside[problem[2]] = False
            given = problem[2], self.shares, self.shares.count(outside), rounds, now() + seconds * (rounds + 1)
            chosen, bound = solve_balanced(problem[1], *given)
            self._take(patches.members[k], problem, chosen)
            if is_small and self._is_complete:
                self.bound_of_smallest = min(self.bound_of_smallest, bound)

    def _bound_together(self) -> None:
        """Find a smaller upper bound for each level with a gap, by a program in which equal tiles are one tile."""
        network = self.network
        if not self._is_complete:
            return
        together = _EqualTiles(network)
        if self.shares is not None and not self.out_of_time():
            end = now() + FOR_ALL * min(self._limit - self.seconds, 1e9) / 2
            bound = together.bound(network.n_classes - 1, end, self.shares)
            self.bound_of_smallest = min(self.bound_of_smallest, bound)
        for k in np.flatnonzero(self.counts[:, 0] < self.bounds_complete):
            if not self.out_of_time():
                bound = together.bound(self.levels[k], now() + FOR_ALL * min(self._limit - self.seconds, 1e9))
                self.bounds_complete[k] = min(self.bounds_complete[k], np.floor(bound))

    def _solve_patches(self, executor) -> None:
        """Improve the plan by integer programs for patches; those that share no set are solved at the same time."""
        patches = self._patches()
        for group in patches.colors():
            if self.out_of_time():
                break
            deadline = time() + self._limit - self.seconds
            problems = [self._program(patches, k, self._class_weights(), deadline, NODES) for k in group]
            results = map_in_order(executor, solve_weighted, [problem for _, problem, _ in problems])
            for k, problem, (chosen, _) in zip(group, problems, results, strict=True):
                self._take(patches.members[k], problem, chosen)

    @property
    def _is_complete(self) -> bool:
        """Whether programs of all tiles contain all candidates of all plans, so that they give bounds."""
        return bool(self.network.usable.all() and not self.network.free.any())

    def _patches(self) -> Patches:
        """Divide the positioners into patches, which differ in each iteration."""
        rng = np.random.default_rng([self.request.seed, self.iteration, 3])
        return Patches(self.network, divide(self.network, self._directions, SIZE * self.options.patch_size, rng))

    def _class_weights(self) -> np.ndarray:
        """Return the weight of a finished target of each class: higher priorities take precedence."""
        n = self.network.n_classes
        ratio = min(float(len(self.network.slot)), STEEPEST ** (1.0 / max(n - 1, 1)))
        return ratio ** np.arange(n - 1, -1, -1.0)

    def _program(self, patches, k, weights, deadline, nodes):
        """Return the candidates of a patch, the program that finishes targets by its visits, and these targets."""
        network, n_classes = self.network, self.network.n_classes
        load = network.columns @ np.bincount(self.chosen, minlength=len(network.target)).astype(float)
        limits = np.append(network.most, self.limits)
        rows, problem = patches.within(k, self.chosen, load, limits, np.zeros(len(network.target)), deadline, 0.5)
        target = np.where(network.rank[rows] < n_classes, network.target[rows], -1)
        inside = self.chosen[patches.members[k]]
        counted = network.rank[self.chosen] < n_classes
        made = np.bincount(network.target[self.chosen[counted]], minlength=len(network.slot))
        mine = network.target[inside[network.rank[inside] < n_classes]]
        needed = network.visits - made + np.bincount(mine, minlength=len(network.slot))
        number = np.bincount(target[target >= 0], minlength=len(network.slot))
        goals = np.flatnonzero((network.rank_of_target < n_classes) & (needed > 0) & (number >= needed))
        m, n = len(goals), len(rows)
        # two further candidates for each target: it is finished, or it is not
        link = csr_array((needed[goals].astype(float), (np.arange(m), np.arange(0, 2 * m, 2))), shape=(m, 2 * m))
        place = np.full(len(network.slot) + 1, -1)
        place[goals] = np.arange(m)
        some = np.flatnonzero(place[target] >= 0)
        visits = csr_array((np.full(len(some), -1.0), (place[target[some]], some)), shape=(m, n))
        sets = vstack([hstack([problem.sets, csr_array((problem.sets.shape[0], 2 * m))]), hstack([visits, link])])
        gain = np.column_stack([weights[network.rank_of_target[goals]], np.zeros(m)]).ravel()
        tie = OF_VISITS * min(weights[weights > 0].min(initial=1.0), 1.0) / max(len(problem.start) - 1, 1)
        weight = np.append(
            np.where(target >= 0, tie * weights[np.minimum(network.rank[rows], n_classes - 1)] / weights.max(), 0.0),
            gain,
        )
        start = np.append(problem.start, n + 2 * np.arange(1, m + 1))
        now = target[problem.first]
        done = np.bincount(now[now >= 0], minlength=len(network.slot))[goals] >= needed[goals]
        first = np.append(problem.first, n + 2 * np.arange(m) + ~done)
        gap = 0.5 * tie / max(float(np.maximum.reduceat(weight, start[:-1]).sum()), 1.0)
        most = np.append(problem.most, np.zeros(m))
        return rows, WeightedProblem(start, weight, csr_array(sets), most, first, nodes, gap, deadline), goals

    def _take(self, members, problem, chosen) -> None:
        """Use the result of a program if the plan that it gives finishes at least as many targets, class by class."""
        if chosen is None:
            return
        new = self.chosen.copy()
        new[members] = problem[0][chosen[: len(members)]]
        network = self.network
        load = network.columns @ np.bincount(new, minlength=len(network.target)).astype(float)
        keeps = (load <= np.append(network.most, self.limits) + path_kernels.TOLERANCE).all()
        if keeps and self._value(new) >= self._value(self.chosen):
            self._use(new)

    def _value(self, chosen) -> tuple:
        """Return the values of a plan in the order of their importance."""
        values = tuple(_by_class(self.network, chosen))
        if self.shares is None:
            return values
        number = self.shares.count(_finished(self.network, chosen)[:, 0])
        return *np.sort(np.round(self.shares.fractions(number), 9)), *values

    @property
    def record(self) -> dict:
        """The finished targets of each category for the summary, if there are shares."""
        if self.shares is None:
            return {}
        return self.shares.record(_finished(self.network, self.chosen)[:, 0], self.bound_of_smallest)

    def _use(self, chosen) -> None:
        """Replace the plan."""
        super()._use(_without_unfinished(self.network, chosen))

    def add_visits(self) -> None:
        """Add visits of targets that are not finished, along paths that keep the visits of all other targets."""
        network, links = self.network, self._links
        target = network.target[self.chosen]
        left = network.visits - np.bincount(target[target >= 0], minlength=len(network.slot))
        rng = np.random.default_rng([self.request.seed, self.iteration, 4])
        for level in range(network.n_classes):
            order = rng.permutation(np.flatnonzero((network.rank_of_target == level) & (left > 0)))
            for depth in (4, 16, 64):
                path_kernels.find_paths(order, level, False, depth, links, self.chosen, self._load, left)
        visits = np.where(network.rank_of_target < network.n_classes, network.visits - left, 0)
        self._done = np.column_stack([_finished(network, self.chosen)[:, 0], visits])
        self._record()


class _EqualTiles:
    """A relaxation in which tiles with equal candidates are one tile, whose candidates are used several times.

    The sum of the uses of the candidates of each positioner, and of each clique, is at most the number of tiles.
    """

    def __init__(self, network: Network):
        self.network, first, tiles = network, network.start[network.first], {}
        cliques = network.matrix[: network.n_cliques].tocsc()
        for k in range(len(network.first) - 1):
            part = slice(first[k], first[k + 1])
            starts = network.start[network.first[k] : network.first[k + 1]] - first[k]
            mine = cliques[:, part]
            rows = np.unique(mine.indices, return_inverse=True)[1]
            key = (starts, network.target[part], network.side[part], mine.indptr, rows)
            tiles.setdefault(tuple(values.tobytes() for values in key), []).append(k)
        self.rows = np.concatenate([np.arange(first[same[0]], first[same[0] + 1]) for same in tiles.values()])
        self.times = np.concatenate([np.full(first[k[0] + 1] - first[k[0]], len(k)) for k in tiles.values()])

    def bound(self, level: int, deadline: float, shares: Shares | None = None) -> float:
        """Return an upper bound of the number of finished targets of the classes up to a level.

        With ``shares``, return an upper bound of the smallest finished fraction of the categories.
        """
        network, times = self.network, self.times.astype(float)
        rows = self.rows
        real = network.rank[rows] < network.n_classes
        able = np.bincount(network.target[rows[real]], self.times[real], len(network.slot))
        goals = np.flatnonzero((network.rank_of_target <= level) & (network.visits > 0) & (able >= network.visits))
        place = np.full(len(network.slot) + 1, -1)
        place[goals] = np.arange(len(goals))
        place = np.where(real, place[network.target[rows]], -1)
        keep = place >= 0
        rows, times, place = rows[keep], times[keep], place[keep]
        n, m = len(rows), len(goals)
        owner, number = np.unique(network.positioner[rows], return_inverse=True)
        single = csr_array((np.ones(n), (number, np.arange(n))), shape=(len(owner), n))
        cliques = network.matrix[: network.n_cliques].tocsc()[:, rows].tocsr()
        cliques = cliques[np.flatnonzero(np.diff(cliques.indptr) > 1)]
        limits = np.concatenate([_largest(part, times) for part in (single, cliques)])
        visits = csr_array((np.full(n, -1.0), (place, np.arange(n))), shape=(m, n))
        needed = network.visits[goals].astype(float)
        link = csr_array((needed, (np.arange(m), np.arange(m))), shape=(m, m))
        top = vstack([single, cliques])
        matrix = vstack([hstack([top, csr_array((top.shape[0], m))]), hstack([visits, link])], format="csr")
        high = np.append(limits, np.zeros(m))
        goal, most = np.append(np.zeros(n), np.ones(m)), np.append(times, np.ones(m))
        if shares is not None:
            count = csr_array(
                (np.full(m, -1.0), (shares.group[goals], n + np.arange(m))), shape=(len(shares.size), n + m)
            )
            unit = csr_array((shares.size * shares.weight / UNITS)[:, None])
            matrix = vstack([hstack([matrix, csr_array((len(high), 1))]), hstack([count, unit])], format="csr")
            high = np.append(high, shares.before)
            goal, most = np.append(0.0 * goal, 1.0), np.append(most, UNITS / shares.weight.min())
        program = matrix, np.full(len(high), -np.inf), high
        limits = {"gap": 0.0, "presolve": True, "nodes": int(10 * EFFORT / (n + m + 1))}  # these programs are smaller
        _, bound = maximize(program, goal, most, deadline, integral=True, **limits)
        bound = with_errors(bound, n + m)
        return bound if shares is None else (bound + 1.0) / UNITS


def _largest(matrix, values):
    """Return the largest value of the columns of each row of a matrix."""
    return np.maximum.reduceat(values[matrix.indices], matrix.indptr[:-1]) if matrix.shape[0] else np.zeros(0)


def _wanted(network: Network) -> np.ndarray:
    """Return the number of visits that each target requires in addition to those of fixed tiles."""
    fixed = network.start[:-1][np.diff(network.start) == 1]
    counted = fixed[network.rank[fixed] < network.n_classes]
    made = np.bincount(network.target[counted], minlength=len(network.slot))
    return np.where(network.rank_of_target < network.n_classes, np.maximum(network.visits - made, 0), 0)


def _finished(network: Network, chosen: np.ndarray) -> np.ndarray:
    """Return whether each target is finished by a plan, and its visits outside of fixed tiles if it is."""
    counted = chosen[network.rank[chosen] < network.n_classes]
    made = np.bincount(network.target[counted], minlength=len(network.slot))
    done = (made >= network.visits) & (network.visits > 0) & (network.rank_of_target < network.n_classes)
    return np.column_stack([done, np.where(done, _wanted(network), 0)]).astype(np.int64)


def _by_class(network: Network, chosen: np.ndarray) -> np.ndarray:
    """Return the number of finished targets of each class."""
    done = _finished(network, chosen)[:, 0]
    return np.bincount(network.rank_of_target, done, network.n_classes + 1)[: network.n_classes]


def _without_unfinished(network: Network, chosen: np.ndarray) -> np.ndarray:
    """Return a plan without the visits of targets that it does not finish, except visits that meet requirements."""
    done = np.append(_finished(network, chosen)[:, 0], 1)[network.target[chosen]] > 0
    meets = (network.rules < 0).sum(axis=0) > 0 if len(network.rule_most) else np.zeros(len(network.target), bool)
    is_useless = (network.rank[chosen] < network.n_classes) & ~done & (np.diff(network.start) > 1) & ~meets[chosen]
    return np.where(is_useless, network.start[1:] - 1, chosen)
