"""The search for a joint plan of dated tiles, whose targets have cadences.

A *place* is a pair of a target and a tile that can observe it. A *sequence* is a list of places of a target that
completes its first epochs. The plan changes by moves that remove a few targets and add them again
(``_kernels/windows``). Visits of the first plan that complete no epoch remain until a move removes them. In the upper
bounds, prices replace the limits that a positioner has one target and that arms do not collide (subgradient
optimization); each target then has its own best sequence.
"""

from copy import deepcopy
from itertools import product

import numpy as np

from rfpsurvey._assignment.clock import now
from rfpsurvey._kernels import windows as kernels
from rfpsurvey._kernels.paths import TOLERANCE
from rfpsurvey._survey.bookkeeping import Bookkeeping
from rfpsurvey._survey.cadences import NIGHT
from rfpsurvey._survey.joint.network import Network, Patches, Paths
from rfpsurvey._survey.joint.programs import SequenceProgram, all_sequences
from rfpsurvey._survey.joint.search import FOR_PRICES, JointSearch, Step
from rfpsurvey._survey.joint.values import starts_of

# Largest number of candidates, and of sequences, up to which one program contains all tiles.
MOST_OF_ALL = 10_000
# Number of times that an iteration considers each target that is not complete.
PASSES = 20
# Number of adjustments of the prices for each bound. The step is halved if the bound does not decrease LATE times.
N_STEPS, LATE = 150, 8
# Values of a visit and of a complete cadence in the bounds of the numbers of complete cadences and of visits.
WHOLE, VISIT = (0.0, 1.0), (1.0, 0.0)
# Absolute and relative rounding error of a bound.
ROUNDING = 1e-6, 1e-9


class WindowSearch(JointSearch):
    """A plan of all tiles that observes targets in their windows, and upper bounds.

    ``before`` is the state after the visits that were already made, and those of fixed tiles.
    """

    def __init__(self, network: Network, chosen: np.ndarray, request, before: Bookkeeping | None = None):
        super().__init__(network, chosen, request.joint)
        self.request, self._before, self._links = request, before, Paths(network).links
        self._dates, place_of, self._time_of = self._make_dates()
        self._place_of = place_of
        self._work, self._picked = _work_for(self._dates)
        n_places = len(self._dates.p_tile)
        self._cost, self._candidate = np.empty(n_places), np.empty(n_places, np.int64)
        self._used = np.full(n_places, -1)
        self._use(self.chosen)
        self.bounds_complete = self.bounds.copy()

    def _make_dates(self) -> tuple[kernels.Dates, np.ndarray, np.ndarray]:
        """Return the result of `dates_of`."""
        request, network, windows = self.request, self.network, self._before.windows
        cadences, row = request.cadences
        given = cadences.epochs, request.source.to_slots(row), request.visit_days, request.brightness, NIGHT
        dates, *others = dates_of(network, *given)
        slot = np.where(network.rank_of_target < network.n_classes, network.slot, -1)
        past = dict(zip(("skipped", "made", "begun", "previous"), windows.past(), strict=True))
        fresh = {name: getattr(dates, name) for name in past}
        past = {name: np.where(slot >= 0, values[slot], fresh[name]) for name, values in past.items()}
        return dates._replace(**past), *others

    @property
    def counts(self) -> np.ndarray:
        """Numbers of complete cadences and of visits of each level in the present plan, shape (n_levels, 2)."""
        return np.cumsum(self._by_class, axis=0)[self.levels]

    @property
    def _by_class(self) -> np.ndarray:
        by_class = np.zeros((self.network.n_classes + 1, 2), dtype=self._done.dtype)
        np.add.at(by_class, self.network.rank_of_target, self._done)
        return by_class[:-1]

    @property
    def visits(self) -> np.ndarray:
        """Number of visits of each level."""
        return self.counts[:, 1]

    def _counts_of_targets(self) -> np.ndarray:
        """Return whether the first plan completes each target, and its number of visits in new epochs."""
        network, windows = self.network, deepcopy(self._before.windows)
        before = windows.counts()
        slots = np.append(network.slot, -1)[network.target[self.chosen]]
        # positioners of fixed tiles have a single candidate
        counted = (network.rank[self.chosen] < network.n_classes) & (np.diff(network.start) > 1)
        for tile in np.argsort(self.request.visit_days, kind="stable").tolist():
            part = slice(network.first[tile], network.first[tile + 1])
            slot = slots[part][counted[part]]
            windows.enter(slot[windows.state(slot, tile)[0]], tile)
        counts = np.concatenate([windows.counts() - before, np.zeros((1, 2), dtype=np.int64)])
        return counts[np.where(network.rank_of_target < network.n_classes, network.slot, -1)]

    def _use(self, chosen: np.ndarray) -> None:
        """Replace the plan."""
        network, self.chosen = self.network, chosen
        used = np.bincount(chosen, minlength=len(network.target))
        self._load = (network.matrix[: network.n_cliques] @ used).astype(np.int64)
        self._links.room[:] = self.limits - network.sums(chosen)
        self._used[:] = -1
        mine = chosen[self._place_of[chosen] >= 0]
        self._used[self._place_of[mine]] = mine
        self._done = self._counts_of_targets()

    def begin(self) -> None:
        """Improve the first plan, and compute the bounds."""
        self.bounds_complete, self.bounds = (self._without_limits(*values) for values in (WHOLE, VISIT))
        self.bounds_of_all = self.bounds.copy()
        self._record()
        self._improve(1)
        for k in range(len(self.levels)) if not self.network.free.any() else ():
            self._bound_level(k)
        self._record()

    def iterate(self, _executor: object) -> None:
        """Run one iteration, which considers each target that is not complete several times.

        In small surveys, integer programs of all sequences then find the best plan.
        """
        self._improve(PASSES)
        if self.iteration == 0:
            self._solve_all()
        self.iteration += 1
        self._record()

    @property
    def gaps(self) -> np.ndarray:
        """Relative difference between the number of complete cadences of each level and its upper bound."""
        n = self.counts[:, 0]
        most = np.maximum(self.bounds_complete, n)
        return np.where(most > 0, 1.0 - n / np.where(most > 0, most, 1.0), 0.0)

    @property
    def _may_end(self) -> bool:
        """Whether the search can end when the gaps are small: no further visits are possible."""
        return bool((self.visits >= self.bounds).all())

    def _record(self) -> None:
        counts = self.counts
        bounds = self.bounds.copy(), self.bounds_complete.copy()
        self.steps.append(Step(self.iteration, self.seconds, counts[:, 1], bounds[0], counts[:, 0], bounds[1]))

    def _improve(self, passes: int) -> None:
        """Try to complete each target that is not complete, a number of times."""
        rng = np.random.default_rng([self.request.seed, self.iteration, passes])
        totals = np.diff(self._dates.e_indptr)[self._dates.cadence] - self._dates.skipped
        real = (self.network.rank_of_target < self.network.n_classes) & (totals > 0)
        gain = np.zeros((self.network.n_classes + 1, 2), dtype=np.int64)
        for _ in range(passes):
            if self.out_of_time():
                break
            order = rng.permutation(np.flatnonzero(real & (self._done[:, 0] == 0)))
            rolls = rng.integers(0, 1 << 30, (len(order), kernels.MOST_REMOVED + 4))
            state = self.chosen, self._load, self._used, self._done
            work = self._cost, self._candidate, self._work, self._picked
            kernels.move(order, rolls, self._links, self._dates, *state, *work, gain)

    def _solve_all(self) -> None:
        """Find the best plan and the bounds by integer programs of all sequences, unless there are too many."""
        network, n_classes = self.network, self.network.n_classes
        is_best = (self.counts == np.column_stack([self.bounds_complete, self.bounds])).all()
        if is_best or len(network.target) > MOST_OF_ALL or self._needs_other_visits():
            return
        sequences = all_sequences(self._dates, MOST_OF_ALL)
        if sequences is None or self.out_of_time():
            return
        patches = Patches(network, np.zeros(len(network.start) - 1, dtype=np.int64))
        load = network.columns @ np.bincount(self.chosen, minlength=len(network.target)).astype(float)
        limits, deadline = np.append(network.most, self.limits), now() + min(self._limit - self.seconds, 1e9)
        rows, problem = patches.within(0, self.chosen, load, limits, np.zeros(len(network.target)), deadline, 0.5)
        target, visits, whole, uses = sequences
        rank, per = network.rank_of_target[target], (whole, visits)
        program = SequenceProgram(problem, self._place_of[rows], target, uses)
        has_all = network.usable.all() and not network.free.any()
        for k, j in reversed([*product(range(len(self.levels)), range(2))]):
            bounds, is_first = (self.bounds_complete, self.bounds)[j], (k, j) == (0, 0)
            if is_first or (has_all and self.counts[k, j] < bounds[k]):
                bound = np.floor(program.maximize(per[j] * (rank <= self.levels[k])))
                bounds[k] = min(bounds[k], bound) if has_all else bounds[k]
        for level, value in product(range(n_classes), per):
            if (level, value is per[0]) != (0, True):  # the last program found the largest number of the first goal
                program.maximize(value * (rank == level))
            if program.chosen is None:
                return
            program.keep(value * (rank == level))
        before, after = self.chosen, self.chosen.copy()
        after[patches.members[0]] = rows[program.chosen]
        number = self._by_class.ravel().tolist()
        self._use(after)
        if self._by_class.ravel().tolist() < number or (self._links.room < -TOLERANCE).any():
            self._use(before)

    def _needs_other_visits(self) -> bool:
        """Return whether visits that complete no epoch, which are not in the program, can meet a requirement.

        Targets that also have another role can meet requirements in this role, without a visit.
        """
        network, n = self.network, len(self.request.builder.left)
        for row in range(len(network.rule_most)):
            part = network.rules[[row]]
            members = part.indices[part.data < 0]
            slot, is_science = network.slot[network.target[members]], network.rank[members] < network.n_classes
            if not np.isin(slot[is_science], slot[~is_science] - n).all():
                return True
        return False

    def _bound_level(self, k: int) -> None:
        """Compute the bounds of the numbers of complete cadences and of visits of a level."""
        whole, visits = self.counts[k].tolist()
        rules = self._minima()
        limit = (1 + 2 * k) / (2 * len(self.levels)) * FOR_PRICES
        self.bounds_complete[k] = self._bound(k, *WHOLE, whole, rules, limit)
        self.bounds[k] = self._bound(k, *VISIT, visits, rules, limit + FOR_PRICES / (2 * len(self.levels)))
        self.bounds_of_all[k] = self._bound(k, *VISIT, visits, [], FOR_PRICES) if rules else self.bounds[k]

    def _minima(self) -> list:
        """Return the candidates, their cliques and the smallest number of requirements on sky fibers and standards.

        The requirements share no candidates.
        """
        network, taken, minima = self.network, np.zeros(len(self.network.target), dtype=bool), []
        cliques = network.matrix[: network.n_cliques].tocsc()
        for row in np.flatnonzero(network.is_count & (self.limits < 0)).tolist():
            part = network.rules[[row]]
            members = part.indices[part.data < 0]
            is_sky = (network.rank[members] >= network.n_classes).all()  # the prices of science fibers count elsewhere
            if len(members) and is_sky and not taken[members].any():
                taken[members] = True
                members = np.sort(members)
                minima.append((members, cliques[:, members], int(-self.limits[row])))
        return minima

    def _without_limits(self, per_visit: float, per_whole: float) -> np.ndarray:
        """Return the largest sum of the values of the targets of each level if tiles observe all targets in reach.

        The parameters are those of `_bound`.
        """
        network, n_tiles = self.network, len(self._dates.day)
        positioner, target = network.pairs
        tile = np.repeat(self._time_of, np.diff(network.first))[positioner]
        places = np.unique(target.astype(np.int64) * n_tiles + tile)
        dates = self._dates._replace(p_indptr=starts_of(places // n_tiles, len(network.slot)), p_tile=places % n_tiles)
        work, picked = _work_for(dates)
        by_class, cost = np.zeros(network.n_classes + 1), np.zeros(len(places))
        for t in np.flatnonzero(np.diff(dates.p_indptr)).tolist():
            value = kernels.best_sequence(t, cost, per_visit, per_whole, dates, work, picked)[0]
            by_class[network.rank_of_target[t]] += value
        return np.cumsum(by_class)[self.levels]

    def _bound(self, level: int, per_visit: float, per_whole: float, value: int, rules: list, limit: float) -> float:
        """Return an upper bound of the sum of the values of all targets of a level, by adjusting prices.

        Parameters
        ----------
        level : int
            Index of the level.
        per_visit, per_whole : float
            Value of a visit and of a complete cadence.
        value : int
            Value of the present plan.
        rules : list
            Candidates, cliques and smallest number of each requirement (`_minima`).
        limit : float
            Fraction of the time limit after which the adjustment ends.
        """
        network, links, n = self.network, self._links, self.network.n_cliques
        active = (network.rank_of_target <= self.levels[level]).astype(float)
        price, arm_price = np.zeros(n), np.zeros(len(network.start) - 1)
        best, step, late = np.inf, 1.0, 0
        given = per_visit * active, per_whole * active, links, self._dates, self._work, self._picked, self._cost
        for _ in range(N_STEPS):
            usage, arm_usage = np.zeros(n), np.zeros(len(arm_price))
            total = kernels.use_prices(price, arm_price, *given, usage, arm_usage) + price.sum() + arm_price.sum()
            for members, cliques, number in rules:
                # every plan uses at least this number of these candidates, and pays at least the cheapest ones
                costs = arm_price[network.positioner[members]] + cliques.T @ price
                order = np.argsort(costs, kind="stable")
                order = order[np.sort(np.unique(network.positioner[members][order], return_index=True)[1])][:number]
                total -= costs[order].sum()
                arm_usage[network.positioner[members][order]] += 1.0
                usage += cliques[:, order].sum(axis=1)
            late = 0 if total < best else late + 1
            best = min(best, total)
            if late >= LATE:
                step, late = step / 2, 0
            if best < value + 1 or self.out_of_time(limit):
                break
            more, arm_more = usage - 1.0, arm_usage - 1.0
            # prices are not negative, so that a price of 0 cannot decrease
            more[(price == 0) & (more < 0)] = arm_more[(arm_price == 0) & (arm_more < 0)] = 0.0
            norm = more @ more + arm_more @ arm_more
            if norm == 0:
                break
            # Polyak's step: the value of the present plan stands for the unknown smallest bound
            size = step * (total - value) / norm
            price, arm_price = np.maximum(price + size * more, 0.0), np.maximum(arm_price + size * arm_more, 0.0)
        return float(np.floor(best + ROUNDING[0] + ROUNDING[1] * (abs(best) + price.sum() + arm_price.sum())))


def dates_of(
    network: Network, epochs: list, cadence_of_slot: np.ndarray, days: np.ndarray, brightness: np.ndarray, night: float
) -> tuple[kernels.Dates, np.ndarray, np.ndarray]:
    """Return the cadences and times for the kernels, the place of each candidate, and the time rank of each tile.

    The place is -1 for candidates without a place. ``epochs`` contains the epochs of each cadence, and ``night`` is the
    largest time between the exposures of an epoch.
    """
    in_time = np.argsort(days, kind="stable")
    time_of = np.empty_like(in_time)
    time_of[in_time] = np.arange(len(in_time))
    n_tiles, n_targets = len(in_time), len(network.slot)
    low, high, n_exp, limit = np.concatenate(epochs, axis=1)
    # positioners of fixed tiles have a single candidate
    can_change = (np.diff(network.start) > 1)[network.positioner]
    real = np.flatnonzero((network.rank < network.n_classes) & can_change)
    tile = np.repeat(time_of, np.diff(network.first))[network.positioner[real]]
    key = network.target[real].astype(np.int64) * n_tiles + tile
    order = np.argsort(key, kind="stable")
    places, place = np.unique(key, return_inverse=True)
    place_of = np.full(len(network.target), -1)
    place_of[real] = place
    # standards, sky positions, and copies of targets that are used only in these roles have no cadence
    counted = network.rank_of_target < network.n_classes
    cadence = np.full(n_targets, -1)
    cadence[counted] = cadence_of_slot[network.slot[counted]]
    cliques = network.matrix[: network.n_cliques]
    first_epoch = np.cumsum([0, *(epochs_of_cadence.shape[1] for epochs_of_cadence in epochs)])
    of_epochs = first_epoch, low, high, n_exp.astype(np.int64), limit
    of_places = starts_of(places // n_tiles, n_targets), places % n_tiles, starts_of(place, len(places)), real[order]
    of_cliques = cliques.indptr.astype(np.int64), cliques.indices.astype(np.int64)
    of_network = network.usable, network.start[1:] - 1, network.rank_of_target.astype(np.int64)
    of_tiles = days[in_time], brightness[in_time], night
    cadence = np.where(cadence < 0, len(epochs) - 1, cadence)
    past = np.zeros((2, n_targets), dtype=np.int64), np.full((2, n_targets), np.nan)
    dates = kernels.Dates(cadence, *of_epochs, *of_places, *of_cliques, *of_network, *of_tiles, *past[0], *past[1])
    return dates, place_of, time_of


def _work_for(dates: kernels.Dates) -> tuple[kernels.Work, np.ndarray]:
    """Return the arrays that `best_sequence` uses."""
    m = int(np.diff(dates.p_indptr).max(initial=1))
    shape = int(np.diff(dates.e_indptr).max(initial=1)), m, m
    work = kernels.Work(np.empty(shape), np.empty(shape, dtype=np.int64), np.empty(m, dtype=bool))
    return work, np.empty(m, dtype=bool)
