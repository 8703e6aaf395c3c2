"""The search for a joint plan that finishes as many targets as possible.

A target is *finished* if it receives all its remaining visits, on any tiles; this is a value of 1 of this number of
visits (`Steps`), and targets can also have other values. Local moves complete targets, as for cadences with a single
epoch. Integer programs for patches of the sky, or for all tiles, then improve the plan. There, further variables state
which number of visits each target reaches. The program for all tiles also gives an upper bound.
"""

from concurrent.futures import Executor
from dataclasses import replace
from functools import cached_property
from time import time

import numpy as np
from scipy.sparse import block_array, csr_array

from rfpsurvey._assignment.clock import now
from rfpsurvey._assignment.weighted import WeightedProblem, solve_weighted
from rfpsurvey._common.executors import map_in_order
from rfpsurvey._kernels import paths as path_kernels
from rfpsurvey._survey.joint.exposures import colliding, without_collisions
from rfpsurvey._survey.joint.network import Network, Patches, divide
from rfpsurvey._survey.joint.programs import EqualTiles, solve_balanced
from rfpsurvey._survey.joint.search import FOR_PRICES, MOST_EDGES
from rfpsurvey._survey.joint.values import class_weights, steps_of
from rfpsurvey._survey.joint.windows import PASSES, WHOLE, WindowSearch, dates_of

# Number of candidates of a patch, in units of the option ``patch_size``; number of candidates up to which one program
# contains all tiles; and weight of all visits, in units of a finished target of the last class.
SIZE, MOST_OF_ALL, OF_VISITS = 4, 40_000, 0.4
# Largest number of nodes of a program of a patch; the same times the number of candidates, for a program of all tiles;
# and largest number of candidates of a program of all tiles with a part of the candidates.
NODES, EFFORT, MOST_AMONG = 100, 2e6, 10_000
# Relative rounding error of a bound of values that are not whole numbers.
ROUNDING = 1e-6
# Fraction of the remaining time for the programs of all tiles; largest gap with which they are solved before patches.
FOR_ALL, LITTLE = 0.8, 0.005


class FinishedSearch(WindowSearch):
    """A plan of all tiles that finishes targets, and upper bounds.

    Parameters
    ----------
    network : Network
        The candidates of all tiles, or of chosen targets.
    plans : tuple of ndarray
        Candidates of all positioners; the search starts with the best plan that keeps all limits of the first one.
    request : Request
        The request of the survey.
    directions : ndarray
        Unit vectors of the centers of all positioners.
    shares : Shares or None
        The categories of all targets in the order of slots.
    exposures : Exposures or None
        All targets, if the network contains only chosen ones.
    """

    def __init__(self, network: Network, plans: tuple, request, directions: np.ndarray, shares, exposures=None):
        self.network, self._directions, self._exposures, self.bound_of_smallest = network, directions, exposures, np.inf
        self.shares, self._all_shares = None if shares is None else shares.on(network.slot), shares
        category = request.source.by_slot("category")
        self.worth = steps_of(network, request.joint.objective, request.builder, category)
        self.has_moves = request.joint.objective == "finished"
        self._weights = class_weights(network.n_classes, len(network.slot))
        self.columns = FinishedSearch.columns if self.has_moves else ("value", "bound_value")
        # arms at targets that are not listed are idle, and can then collide with others
        first = plans[0] if exposures is None else without_collisions(network, plans[0])
        super().__init__(network, self._without_surplus(first), request)
        self._is_proven = np.zeros(len(self.levels), dtype=bool)
        for plan in plans[1:]:
            plan = without_collisions(network, plan)
            keeps = (network.sums(plan) <= self.limits + path_kernels.TOLERANCE).all()
            if keeps and self._value(plan) > self._value(self.chosen):
                self._use(plan)

    def _make_dates(self):
        wanted, n_tiles = self._wanted, len(self.request.tiling)
        numbers = np.unique(np.append(wanted, 0))
        # a cadence for each number of visits: one epoch without a window; the last one, without epochs, is for 0 visits
        epochs = [np.array([[-1.0], [-1.0], [n], [np.inf]]) for n in numbers[1:]] + [np.empty((4, 0))]
        of_slot, real = np.full(len(self.request.builder.left), -1), wanted > 0
        of_slot[self.network.slot[real]] = np.searchsorted(numbers, wanted[real]) - 1
        return dates_of(self.network, epochs, of_slot, np.zeros(n_tiles), np.zeros(n_tiles), 1.0)

    def _counts_of_targets(self):
        return self._counts_of(self.chosen)

    def _counts_of(self, chosen: np.ndarray) -> np.ndarray:
        """Return the value of each target, and its visits outside of fixed tiles that the value requires."""
        reached = self.worth.reached(self._made(chosen))
        value = self.worth.base + self.worth.value_of(reached)
        counts = np.column_stack([value, np.maximum(self.worth.number_of(reached) - self._fixed, 0)])
        return counts.astype(np.int64) if self.has_moves else counts

    def _made(self, chosen: np.ndarray) -> np.ndarray:
        """Return the number of visits of each target."""
        counted = chosen[self.network.rank[chosen] < self.network.n_classes]
        return np.bincount(self.network.target[counted], minlength=len(self.network.slot))

    @cached_property
    def _fixed(self) -> np.ndarray:
        """Number of visits of each target on fixed tiles."""
        return self._made(self.network.start[:-1][np.diff(self.network.start) == 1])

    @property
    def _wanted(self) -> np.ndarray:
        """Number of visits that each target requires in addition to those of fixed tiles."""
        network = self.network
        return np.where(network.rank_of_target < network.n_classes, np.maximum(network.visits - self._fixed, 0), 0)

    def _by_level(self, value: np.ndarray) -> np.ndarray:
        """Return the sum of a value of each target for each level."""
        by_class = np.bincount(self.network.rank_of_target, value, self.network.n_classes + 1)
        return np.cumsum(by_class[: self.network.n_classes])[self.levels]

    def _without_limits(self, per_visit, per_whole):
        before = per_visit * self._fixed + per_whole * self.worth.value_of(self.worth.reached(self._fixed))
        if self._exposures is not None:  # a target has at least one visit
            return self._by_level(before) + [self._exposures.bound_of_visits(level) for level in self.levels]
        network, n_tiles = self.network, len(self.request.tiling)
        positioner, target = network.pairs
        tile = np.repeat(np.arange(n_tiles), np.diff(network.first))[positioner]
        places = np.unique(target.astype(np.int64) * n_tiles + tile)
        number = np.bincount(places // n_tiles, minlength=len(network.slot))
        if per_visit:
            return self._by_level(before + np.minimum(number, self._wanted))
        return self._by_level(self.worth.base + self.worth.value_of(self.worth.reached(self._fixed + number)))

    @property
    def _may_end(self) -> bool:
        return self.shares is None or self.iteration > 0

    def _bound_level(self, k: int) -> None:
        """Compute the bounds of the numbers of finished targets and of visits of a level."""
        limit = (1 + k) / len(self.levels) * FOR_PRICES
        if self.has_moves and not self._together.has_equal:  # programs of equal tiles give smaller bounds
            n = int(self._by_level(self.worth.value_of(self.worth.reached(self._fixed)))[k])
            self.bounds_complete[k] = n + self._bound(k, *WHOLE, int(self.counts[k, 0]) - n, self._minima(), limit)
        self.bounds[k] = self.bounds_of_all[k] = self.network.matching(int(self.levels[k]), MOST_EDGES)

    def _improve(self, passes: int) -> None:
        """Try to finish each target that is not finished, a number of times."""
        if not self.has_moves:
            return
        before = self.chosen.copy()
        super()._improve(passes)
        if self._value(self.chosen) < self._value(before):  # moves do not consider shares
            self._use(before)

    def iterate(self, executor: Executor | None) -> None:
        """Run one iteration: moves, and integer programs for patches, or one for each level with a gap."""
        if self.shares is None or self.iteration == 0:
            self._improve(PASSES)
        is_small = len(self.network.target) <= MOST_OF_ALL
        if self.iteration == 0:
            self._bound_together()
        if self._exposures is not None:
            pass  # a plan of chosen targets is improved only by moves
        elif self.shares is not None:
            self._balance(is_small)
        elif (self.gaps > self.options.gap).any():
            if not is_small or (self.gaps > LITTLE).any():
                self._solve_patches(executor)
            if is_small:
                self._solve_all()
        self.iteration += 1
        self._record()

    @property
    def _is_open(self) -> np.ndarray:
        """Whether each level has a gap that is larger than rounding errors."""
        rounding = 0.0 if self.worth.is_whole else ROUNDING
        return self.counts[:, 0] < self.bounds_complete * (1.0 - rounding)

    def _lower(self, k: int, bound: float) -> None:
        """Use a bound of the values of a level, without the values before all tiles, if it is smaller."""
        bound += self._by_level(self.worth.base)[k]
        self.bounds_complete[k] = min(self.bounds_complete[k], np.floor(bound) if self.worth.is_whole else bound)

    def _solve_all(self) -> None:
        """Find the best plan, and an upper bound for each level with a gap, by integer programs for all tiles."""
        network, patches = self.network, Patches(self.network, np.zeros(len(self.network.start) - 1, dtype=np.int64))
        gains = {k: (np.arange(network.n_classes) <= level).astype(float) for k, level in enumerate(self.levels)}
        if network.n_classes > 1:  # first the plan that is best in the order of the classes
            gains = {-1: self._weights, **gains}
        for k, weights in gains.items():
            is_open = self._is_open & ~self._is_proven
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
                self._lower(k, bound)
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
            problem = self._program(patches, k, self._weights, time() + seconds, nodes)
            outside = self._counts_of_targets()[:, 0] > 0
            outside[problem[2]] = False
            given = problem[2], self.shares, self.shares.count(outside), rounds, now() + seconds * (rounds + 1)
            chosen, bound = solve_balanced(problem[1], *given)
            self._take(patches.members[k], problem, chosen)
            if is_small and self._is_complete:
                self.bound_of_smallest = min(self.bound_of_smallest, bound)

    @cached_property
    def _together(self) -> EqualTiles:
        return EqualTiles(self.network, self.worth)

    def _bound_together(self) -> None:
        """Find smaller upper bounds by programs in which equal tiles are one tile, and plans from their solutions."""
        network, shares, exposures = self.network, self._all_shares, self._exposures
        if not self._is_complete and exposures is None:
            return
        programs = {k: (np.arange(network.n_classes) <= level) * 1.0 for k, level in enumerate(self.levels)}
        if shares is not None or (network.n_classes > 1 and exposures is None):
            programs = {-1: self._weights, **programs}
        for k, weights in programs.items():
            if self.out_of_time() or not (self._is_open[k] if k >= 0 else shares is not None or self._is_open.any()):
                continue
            part = FOR_ALL if exposures is not None or self._together.has_equal else FOR_PRICES
            end = now() + part * min(self._limit - self.seconds, 1e9) / (1 if k >= 0 else 2)
            given = None if k >= 0 or shares is None else self.shares if exposures is None else shares
            bound, is_used = (exposures or self._together).solve(weights, end, given)
            if k >= 0:
                self._lower(k, bound)
            elif shares is not None:
                self.bound_of_smallest = min(self.bound_of_smallest, bound)
            if is_used is not None and (k < 0 or len(programs) == 1):
                self._solve_among(is_used, weights)

    def _solve_among(self, is_used: np.ndarray, weights: np.ndarray) -> None:
        """Improve the plan by programs for all tiles with a part of the candidates, those that equal tiles use."""
        network, whole = self.network, np.zeros(len(self.network.start) - 1, dtype=np.int64)
        is_used = is_used | (network.rank >= network.n_classes)
        for _ in range(2):
            some = replace(network, usable=network.usable & is_used)
            if np.count_nonzero(some.usable) > MOST_AMONG:
                break
            deadline = time() + FOR_ALL * min(self._limit - self.seconds, 1e9)
            nodes = int(EFFORT / max(np.count_nonzero(some.usable), 1))
            problem = self._program(Patches(some, whole), 0, weights, deadline, nodes, of_visits=0.0)
            self._take(np.arange(len(whole)), problem, solve_weighted(problem[1])[0])
            if not self._is_open.any():
                break
            # then also all candidates of the positioners that reach targets that are still not finished
            lost = np.zeros(len(network.slot) + 1, dtype=bool)
            lost[network.target[is_used]] = True
            lost[:-1] &= self._counts_of_targets()[:, 1] == 0
            near = np.zeros(len(whole), dtype=bool)
            near[network.positioner[lost[network.target] & (network.rank < network.n_classes)]] = True
            is_used = is_used | near[network.positioner]

    def _solve_patches(self, executor) -> None:
        """Improve the plan by integer programs for patches; those that share no set are solved at the same time."""
        patches = self._patches()
        for group in patches.colors():
            if self.out_of_time():
                break
            deadline = time() + self._limit - self.seconds
            problems = [self._program(patches, k, self._weights, deadline, NODES) for k in group]
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

    def _program(self, patches, k, weights, deadline, nodes, of_visits=OF_VISITS):
        """Return the candidates of a patch, the program that finishes targets by its visits, and these targets."""
        network, n_classes = self.network, self.network.n_classes
        load = network.columns @ np.bincount(self.chosen, minlength=len(network.target)).astype(float)
        limits = np.append(network.most, self.limits)
        rows, problem = patches.within(k, self.chosen, load, limits, np.zeros(len(network.target)), deadline, 0.5)
        target = np.where(network.rank[rows] < n_classes, network.target[rows], -1)
        inside = self.chosen[patches.members[k]]
        there, n_slots = self._made(inside), len(network.slot)
        outside = self._made(self.chosen) - there
        able = outside + np.bincount(target[target >= 0], minlength=n_slots)
        steps, before = self.worth, self.worth.value_of(self.worth.reached(outside))
        open_steps = np.flatnonzero((steps.number > outside[steps.target]) & (steps.number <= able[steps.target]))
        of_step = steps.target[open_steps]
        goals, goal = np.unique(of_step, return_inverse=True)
        goal = goal.reshape(-1)
        m, n, q = len(goals), len(rows), len(open_steps)
        # further candidates for each target: one for each step that it can reach, and one for no further step
        column = np.arange(q) + goal
        needed = (steps.number[open_steps] - outside[of_step]).astype(float)
        link = csr_array((needed, (goal, column)), shape=(m, q + m))
        place = np.full(n_slots + 1, -1)
        place[goals] = np.arange(m)
        some = np.flatnonzero(place[target] >= 0)
        visits = csr_array((np.full(len(some), -1.0), (place[target[some]], some)), shape=(m, n))
        sets = block_array([[problem.sets, None], [visits, link]], format="csr")
        gain = np.zeros(q + m)
        gain[column] = weights[network.rank_of_target[of_step]] * (steps.value[open_steps] - before[of_step])
        unit = self.worth.smallest_gain * min(weights[weights > 0].min(initial=1.0), 1.0)
        tie = of_visits * unit / max(len(problem.start) - 1, 1)
        of_visit = tie * weights[np.minimum(network.rank[rows], n_classes - 1)] / weights.max()
        weight = np.append(np.where(target >= 0, of_visit, 0.0), gain)
        number = np.bincount(goal, minlength=m)
        ends = np.cumsum(number + 1)
        start = np.append(problem.start, n + ends)
        reached = np.bincount(goal[steps.number[open_steps] <= (outside + there)[of_step]], minlength=m)
        first = np.append(problem.first, n + ends - 1 - number + np.where(reached > 0, reached - 1, number))
        gap = 0.5 * (tie or 0.5 * unit) / max(float(np.maximum.reduceat(weight, start[:-1]).sum()), 1e-12)
        most = np.append(problem.most, np.zeros(m))
        return rows, WeightedProblem(start, weight, sets, most, first, nodes, gap, deadline), goals

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
        network, value = self.network, self._counts_of(chosen)[:, 0]
        values = tuple(np.round(np.bincount(network.rank_of_target, value, network.n_classes + 1), 9)[:-1])
        if self.shares is None:
            return values
        number = self.shares.count(value)
        return *np.sort(np.round(self.shares.fractions(number), 9)), *values

    def _without_surplus(self, chosen: np.ndarray) -> np.ndarray:
        """Return a plan without visits that bring no value, except visits that meet requirements."""
        network, made = self.network, self._made(chosen)
        surplus = np.append(made - self.worth.number_of(self.worth.reached(made)), 0)
        meets = (network.rules < 0).sum(axis=0) > 0 if len(network.rule_most) else np.zeros(len(network.target), bool)
        can_change = (network.rank[chosen] < network.n_classes) & (np.diff(network.start) > 1) & ~meets[chosen]
        rows = np.flatnonzero(can_change & (surplus[network.target[chosen]] > 0))
        rows = rows[np.argsort(network.target[chosen[rows]], kind="stable")]
        target = network.target[chosen[rows]]
        rows = rows[np.arange(len(rows)) - np.searchsorted(target, target) < surplus[target]]
        result = chosen.copy()
        result[rows] = network.start[rows + 1] - 1
        while True:  # visits remain where the idle arm would collide with others
            kept = rows[colliding(network, result)[rows]]
            if len(kept) == 0:
                return result
            result[kept] = chosen[kept]
            rows = np.setdiff1d(rows, kept)

    @property
    def record(self) -> dict:
        """The finished targets of each category for the summary, if there are shares."""
        if self.shares is None:
            return {}
        return self.shares.record(self._counts_of_targets()[:, 0], self.bound_of_smallest)

    def _use(self, chosen) -> None:
        """Replace the plan."""
        super()._use(self._without_surplus(chosen))

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
        self._done = np.column_stack([self._counts_of_targets()[:, 0], visits])
        self._record()
