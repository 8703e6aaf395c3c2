"""The search for a joint plan: prices, integer programs for patches of the sky, and upper bounds.

A *level* is a priority class together with all classes of higher priority. A *set* contains candidates that exclude
each other, or all candidates with the same target; a plan may use only a limited number of candidates of each set. The
*price* of a set is the Lagrange multiplier of this constraint in the upper bound.
"""

from concurrent.futures import Executor
from functools import partial
from time import perf_counter, time
from typing import ClassVar, NamedTuple

import numpy as np
from astropy.table import QTable

from rfpsurvey._assignment.weighted import RowPrices, solve_weighted
from rfpsurvey._common.executors import map_in_order
from rfpsurvey._kernels.paths import TOLERANCE
from rfpsurvey._survey.joint.fixed import JointOptions
from rfpsurvey._survey.joint.network import PRECISION, Network, Patches, Paths, divide
from rfpsurvey.errors import InputError

# Stages of the computation of prices: width of the smooth maximum (see `RowPrices.improve`), and number of sweeps.
SWEEPS = ((0.2, 20), (0.1, 20), (0.05, 30), (0.02, 30), (0.01, 30), (0.005, 30))
# Fraction of the time limit that is available for computing the prices before the first iteration.
FOR_PRICES = 0.15
# Goals after the visits: number of divisions into patches for each goal, weight of a goal relative to the preceding
# goal, error of the sum of the goals, and fraction of the time limit that remains for them.
N_LAST, LESS, PRECISION_OF_GOALS, FOR_GOALS = 2, 0.1, 0.01, 0.15
# Largest number of levels for which bounds are computed.
MOST_LEVELS = 8
# Largest number of reachable pairs for which the matching that ignores collisions is computed.
MOST_EDGES = 4_000_000
# Upper limit of the sum of all terms that decide between plans of equal value, as a fraction of the weight of the
# lowest priority class.
TIE = 0.4
# Largest ratio of the weights of the highest and the lowest priority class.
STEEPEST = 1e6
# The size of the patches grows by the factor GROWTH after an iteration that closes less than the fraction LITTLE of the
# gap of every level. The largest size is LARGEST times the initial size.
GROWTH, LITTLE, LARGEST = 1.5, 0.05, 10.0


def levels_of(n_classes: int) -> np.ndarray:
    """Return the lowest priority class of each level, in ascending order of the numbers of classes."""
    return np.unique(np.linspace(0, n_classes - 1, min(n_classes, MOST_LEVELS)).astype(int))


def _damaged(expected: str, n: int) -> InputError:
    """Return the error that the stored state of a search has a wrong number of values."""
    return InputError(
        f"the stored state of the search for a joint plan is damaged: it must have {expected}, got {n}; start again in "
        "another folder"
    )


class Step(NamedTuple):
    """The state after an iteration."""

    iteration: int
    seconds: float
    """Duration of the search until the end of the iteration; NaN if an earlier run made this iteration."""
    visits: np.ndarray
    """Number of visits of each level."""
    bound: np.ndarray
    complete: np.ndarray | None = None
    bound_complete: np.ndarray | None = None
    """Number of complete cadences of each level, and its bound; None without cadences."""


class JointSearch:
    """A plan of all tiles, and upper bounds of its numbers of visits, which the iterations of a search improve.

    ``chosen`` is the candidate of each positioner in the first plan.
    """

    def __init__(self, network: Network, chosen: np.ndarray, options: JointOptions):
        self.network, self.chosen, self.options = network, chosen.astype(np.int64), options
        # Every plan meets the requirements of each tile at least as well as the first plan. The bounds apply to all
        # plans that do so, except `bounds_of_all`.
        self.limits = np.maximum(network.rule_most, network.sums(chosen))
        self.levels = levels_of(network.n_classes)
        self.bounds = np.full(len(self.levels), np.inf)
        self.bounds_of_all = self.bounds.copy()
        self.iteration, self.spent, self._reserved, self._begin = 0, 0.0, 0.0, perf_counter()
        self.steps: list[Step] = []
        self.complete_before = np.zeros(len(self.levels), dtype=np.int64)
        """Number of targets of each level that need no further visits."""

    record: ClassVar[dict] = {}
    """Further entries of the summary."""
    columns: ClassVar[tuple[str, str]] = "n_complete", "bound_complete"
    """Names of the numbers of complete targets, and of their bounds, in the table of iterations."""

    @property
    def seconds(self) -> float:
        """Duration of the search in seconds; if the time is limited, earlier runs of this search are included."""
        return self.spent + perf_counter() - self._begin

    @property
    def is_over(self) -> bool:
        """Whether no further iteration is required or allowed."""
        small = bool((self.gaps <= self.options.gap).all() and self._may_end)
        return small or self.iteration >= self.options.iterations or self.out_of_time()

    @property
    def _limit(self) -> float:
        """Part of the time limit (seconds) that is not reserved for the goals after the visits."""
        return self.options.seconds * (1.0 - self._reserved)

    def out_of_time(self, fraction: float | None = None) -> bool:
        """Return whether a fraction of the time limit has passed.

        By default, this is the time limit without the time that is reserved for the goals.
        """
        return self.seconds >= (self._limit if fraction is None else fraction * self.options.seconds)


class Search(JointSearch):
    """A plan of all tiles, and upper bounds of the number of visits; each iteration can improve the plan or a bound.

    ``chosen`` is the candidate of each positioner in the first plan; ``directions`` are unit vectors of the centers
    of all positioners. ``state`` contains the arrays of the stored state of the search, and ``n_goals`` is the number
    of goals of `finish`.
    """

    def __init__(
        self,
        network: Network,
        chosen: np.ndarray,
        directions: np.ndarray,
        options: JointOptions,
        seed: int,
        state: dict[str, np.ndarray] | None = None,
        n_goals: int = 0,
    ):
        super().__init__(network, chosen, options)
        self.directions, self.seed, self._reserved = directions, seed, FOR_GOALS if n_goals else 0.0
        if state is not None:
            self.limits = state.get("limits", np.empty(0))
        if len(self.limits) != len(network.rule_most):
            raise _damaged(f"{len(network.rule_most)} limits", len(self.limits))
        self._bounded = network.with_requirements(self.limits)
        self.size = float(options.patch_size)
        # The size that the patches must reach before the bound of each level is computed again; an iteration that does
        # not lower the bound increases this size.
        self.next_size = np.zeros(len(self.levels))
        self.prices: list[RowPrices | None] = [None] * len(self.levels)
        """Prices of the sets for each level; None for a level without prices."""
        self._paths = Paths(network)
        if state is not None:
            self._restore(state)

    def _restore(self, state: dict[str, np.ndarray]) -> None:
        """Continue a search from its stored state."""
        n = len(self.levels)
        self.size, iteration, self.spent = state["numbers"].tolist()
        self.iteration, self.next_size, self.bounds = int(iteration), state["next_size"], state["bounds"]
        self.bounds_of_all = state.get("bounds_of_all", self.bounds)
        for row in state["steps"]:
            self.steps.append(Step(int(row[0]), np.nan, row[1 : 1 + n].astype(np.int64), row[1 + n :]))
        for k in range(n):
            if (price := state.get(f"price{k}")) is not None:
                prices = self._prices_of(k)
                if price.shape != prices.price.shape:
                    raise _damaged(f"{len(prices.price)} prices", len(price))
                prices.price = price

    @property
    def visits(self) -> np.ndarray:
        """Number of visits of each level."""
        return np.cumsum(self.network.counts(self.chosen))[self.levels]

    @property
    def gaps(self) -> np.ndarray:
        """Relative difference between the number of visits of each level and its upper bound."""
        return 1.0 - self.visits / np.maximum(np.maximum(self.bounds, self.visits), 1.0)

    @property
    def _may_end(self) -> bool:
        """Whether the search can end when the gaps are small: all bounds are known."""
        return bool(np.isfinite(self.bounds).all())

    def _deadline(self) -> float:
        """Return the value of `time.time` at which the search ends."""
        return time() + self._limit - self.seconds

    def begin(self) -> None:
        """Compute the first bounds from a matching and from prices, and improve the plan along augmenting paths."""
        for k, level in enumerate(self.levels):
            self.bounds[k] = self.network.matching(int(level), MOST_EDGES)
        self._record()
        self._follow_paths()
        self.bounds_of_all = self.bounds.copy()
        for k in range(len(self.levels)):
            if self.bounds[k] > self.visits[k] and not self.out_of_time(FOR_PRICES):
                bound = self._prices_of(k).improve(self._weights(k), SWEEPS, partial(self.out_of_time, FOR_PRICES))
                self.bounds[k] = min(self.bounds[k], np.floor(bound))
        if self._bounded is self.network:
            self.bounds_of_all = self.bounds.copy()
        self._record()

    def iterate(self, executor: Executor | None) -> None:
        """Run one iteration, which can improve the plan and lower the bound of one level."""
        before = self.visits, self.bounds.copy()
        rng = np.random.default_rng([self.seed, self.iteration])
        patches = self._patches(rng)
        self._improve(patches, executor)
        self._follow_paths()
        open_levels = np.flatnonzero(self.bounds > self.visits)
        open_levels = [k for k in open_levels.tolist() if self.size >= self.next_size[k]]
        if open_levels and not self.out_of_time():
            k = open_levels[self.iteration % len(open_levels)]
            self._bound(k, patches, executor)
            if self.bounds[k] == before[1][k]:
                self.next_size[k] = self.size * GROWTH
        self.iteration += 1
        gap = np.maximum(before[1] - before[0], 1.0)
        gained = (self.visits - before[0] + before[1] - self.bounds) / gap
        if (gained < LITTLE).all():
            self.size = min(self.size * GROWTH, self.options.patch_size * LARGEST)
        self._record()

    def _patches(self, rng: np.random.Generator) -> Patches:
        """Divide the positioners into patches of the present size."""
        return Patches(self.network, divide(self.network, self.directions, int(self.size), rng))

    def _follow_paths(self):
        """Improve the plan by augmenting paths."""
        rng = np.random.default_rng([self.seed, self.iteration, 1])
        self.chosen = self._paths.improve(self.chosen, rng, self.out_of_time, self.limits)

    def _record(self):
        self.steps.append(Step(self.iteration, self.seconds, self.visits, self.bounds.copy()))

    def _weights(self, level):
        """Return the weight of each candidate: 1 if its target belongs to a class of the level, otherwise 0."""
        return (self.network.rank <= self.levels[level]).astype(float)

    def _prices_of(self, level) -> RowPrices:
        if self.prices[level] is None:
            network = self._bounded
            self.prices[level] = RowPrices(network.start, network.matrix, network.most, network.free, network.n_least)
        return self.prices[level]

    def _bound(self, level, patches, executor):
        """Lower the bound of a level by solving the patches as integer programs.

        In these programs, prices replace the constraints of the sets that contain candidates of several patches.
        """
        prices, network = self._prices_of(level), self._bounded
        if network.free.any():
            return
        patches = patches if network is self.network else Patches(network, patches.label)
        cross = np.where(patches.crosses, prices.price, 0.0)
        value = self._weights(level) - network.matrix.T @ cross
        deadline = self._deadline()
        problems = [patches.alone(k, value, deadline) for k in range(patches.n)]
        total = float(cross @ network.most) + float(value[patches.only].sum())
        # an allowance for rounding errors, with which the sum remains an upper bound
        total += 1e-9 * (len(network.start) + float(np.abs(cross) @ np.abs(network.most)))
        for _, bound in map_in_order(executor, solve_weighted, problems):
            total += bound
        if np.isfinite(total):
            self.bounds[level] = min(self.bounds[level], np.floor(total))

    def _class_weights(self, most):
        """Return weights of the classes, such that higher priorities take precedence; idle arms have the weight 0.

        Targets whose visits do not count have the weight 0 as well.
        """
        n = self.network.n_classes
        ratio = min(float(most + 1), STEEPEST ** (1.0 / max(n - 1, 1)))
        return np.append(ratio ** np.arange(n - 1, -1, -1.0), [0.0, 0.0])

    def _improve(self, patches, executor):
        """Improve the plan patch by patch, and prefer targets with low prices among plans of equal value."""
        network, price = self.network, self.prices[-1]
        scarce = np.zeros(len(network.target))
        if price is not None:
            n = len(network.most)
            of_targets = np.where(np.arange(n) >= network.n_cliques, price.price[:n], 0.0)
            scarce = network.matrix.T @ of_targets
        value = -scarce / max(scarce.max(initial=0.0), 1e-12)
        unspent = network.rank == network.n_classes
        if unspent.any():  # fibers without science targets observe sky positions and standards rather than nothing
            value = 0.75 * value + 0.25 * unspent
        target = network.target[self.chosen]
        made = np.bincount(target[target >= 0], minlength=len(network.slot))
        unmet = np.append(network.visits > made, False)
        self._replan(patches, executor, value, lambda k: patches.can_gain(k, self.chosen, unmet))

    def finish(self, executor: Executor | None, goals: list[np.ndarray]) -> None:
        """Replace the plan by plans with larger sums of the goals, first goals first, and with at least as many visits.

        Each goal has a value for each candidate, from 0 to 1.
        """
        self._reserved = 0.0
        for n in range(1, len(goals) + 1):
            value = sum(goal * LESS**k for k, goal in enumerate(goals[:n])) / sum(LESS**k for k in range(n))
            for k in range(N_LAST):
                rng = np.random.default_rng([self.seed, n, k, 2])
                self._replan(self._patches(rng), executor, value, lambda _: True, goals[:n])
        self.steps[-1] = self.steps[-1]._replace(visits=self.visits)

    def _replan(self, patches, executor, value, is_useful, goals=()):
        """Improve the plan patch by patch; patches that share no set of candidates are solved at the same time.

        Among plans with the same visits, those with a large sum of the ``value`` of each candidate, from -1 to 1, are
        preferred. ``is_useful`` returns whether a patch is worth the effort. If there are ``goals``, the largest sum is
        found, otherwise only an approximate one.
        """
        network = self.network
        load = network.columns @ np.bincount(self.chosen, minlength=len(network.target)).astype(float)
        limits = np.append(network.most, self.limits)
        by_class = self._class_weights(max((len(patches.members[k]) for k in range(patches.n)), default=1))
        for group in patches.colors():
            if self.out_of_time():
                break
            programs, deadline = [], self._deadline()
            group = [k for k in group if is_useful(k)]
            for k in group:
                tie = TIE / max(len(patches.members[k]), 1)
                weight = by_class[network.rank] + tie * value
                precision = PRECISION_OF_GOALS * tie if goals else PRECISION
                programs.append(patches.within(k, self.chosen, load, limits, weight, deadline, precision))
            results = map_in_order(executor, solve_weighted, [problem for _, problem in programs])
            for k, (rows, _), (chosen, _) in zip(group, programs, results, strict=True):
                if chosen is not None:
                    self._take(patches.members[k], rows[chosen], load, limits, goals)

    def _take(self, members, new, load, limits, goals):
        """Use the new candidates of a patch if the resulting plan is at least as good as before, and keeps all rules.

        Another patch of the same tile, for which a program was solved at the same time, may have used what a rule
        allows. If there are ``goals``, plans of equal value must increase the sum of the first of them that differs.
        """
        network, old = self.network, self.chosen[members]
        counts = [tuple(network.counts(candidates)) for candidates in (old, new)]
        if counts[1] < counts[0] or np.array_equal(new, old):
            return
        goals = goals if counts[1] == counts[0] else ()
        sums = [[goal[plan].sum() for goal in goals] for plan in (old, new)]
        if goals and tuple(sums[1]) <= tuple(sums[0]):
            return
        change = new != old
        before, after = (network.columns[:, candidates[change]] for candidates in (old, new))
        sets, row = np.unique(np.append(before.indices, after.indices), return_inverse=True)
        added = np.bincount(row.reshape(-1), np.append(-before.data, after.data), len(sets))
        if (load[sets] + added > limits[sets] + TOLERANCE).any():
            return
        load[sets] += added
        self.chosen[members] = new


def table_of(search: JointSearch, names: list[str]) -> QTable:
    """Return a table with a row for each iteration and priority; its meta contains the values of the last iteration."""
    rows = []
    for step in search.steps:
        for k, level in enumerate(search.levels.tolist()):
            visits, bound = int(step.visits[k]), max(float(step.bound[k]), float(step.visits[k]))
            gap = 1.0 - visits / bound if bound else 0.0
            row = step.iteration, names[level], visits, int(bound), gap, round(step.seconds, 2)
            if step.complete is not None:
                kind = float if step.complete.dtype.kind == "f" else int
                complete = step.complete[k], max(step.complete[k], step.bound_complete[k])
                row += tuple(kind(n + search.complete_before[k]) for n in complete)
            rows.append(row)
    columns = ("iteration", "priority", "n_visits", "bound", "gap", "seconds", *search.columns)
    table, levels, n = QTable(rows=rows, names=columns[: len(rows[0])]), [], len(search.levels)
    for k, (before, row) in enumerate(zip(rows[:n], rows[-n:], strict=True)):
        level = {"priority": row[1], "n_visits_before": before[2], "n_visits": row[2], "bound": row[3], "gap": row[4]}
        level |= dict(zip(columns[6:], row[6:], strict=False))
        if len(search.limits):
            level["bound_without_requirements"] = int(max(search.bounds_of_all[k], search.visits[k]))
        levels.append(level)
    gap = max(level["gap"] for level in levels)
    table.meta["summary"] = {"n_iterations": search.iteration, "levels": levels, "gap": gap, **search.record}
    return table
