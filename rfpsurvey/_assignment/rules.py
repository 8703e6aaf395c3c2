"""Rules that assign targets in a given order, in one plan or in each realization, and random subpriorities."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from rfpsurvey._assignment.answer import AllocationAnswer
from rfpsurvey._assignment.problem import AllocationProblem, with_watched
from rfpsurvey._common.units import rows_of, to_plain
from rfpsurvey._instruments.reach import Reach
from rfpsurvey._kernels import allocation as kernels
from rfpsurvey._kernels import batch as hashing
from rfpsurvey.errors import INCONVERTIBLE, InputError, InputTypeError, listed, short

# Seed of the hash by which ``optimal`` breaks ties.
TIE_SEED = 0
# Positions that agree in this length (mm) have the same hash.
SAME_POSITION_MM = 1e-6


def id_numbers(ids: np.ndarray) -> np.ndarray:
    """Return one number per identifier; the random subpriorities of targets are computed from these numbers.

    Parameters
    ----------
    ids : ndarray of int or str, shape (n,)
        Identifiers. An integer and the text of this integer have the same number.

    Returns
    -------
    ndarray of uint64, shape (n,)
        The number of each identifier.
    """
    ids = np.asarray(ids)
    if ids.dtype.kind in "iu":
        return ids.astype(np.int64 if ids.dtype.kind == "i" else np.uint64).view(np.uint64)
    texts = ids.astype(str)
    texts = np.ascontiguousarray(texts, dtype=texts.dtype.newbyteorder("="))
    out = np.empty(len(texts), dtype=np.uint64)
    length = texts.dtype.itemsize // 4
    hashing.numbers_of_texts(texts.view(np.uint32).reshape(len(texts), length), out)
    return out


def subpriorities(ids: np.ndarray, seed: int) -> np.ndarray:
    """Return reproducible random subpriorities of targets, which depend only on their identifiers and a seed.

    Parameters
    ----------
    ids : array_like of int or str, shape (n,)
        Identifiers. An integer and the text of this integer have the same subpriority.
    seed : int
        Seed, 0 to 2^63 - 1.

    Returns
    -------
    ndarray of float, shape (n,)
        Subpriorities, which are uniformly distributed in [0, 1). The subpriorities are the same on all computers.

    Raises
    ------
    InputError
        If the identifiers are neither integers nor text, or if the seed is not an integer in the allowed range.

    Notes
    -----
    If an identifier is an integer or the text of an integer, its number is this integer. Otherwise, its number is the
    hash FNV-1a of the text. The number and the seed are combined by the output function of the generator
    SplitMix64 (Steele, Lea & Flood 2014, doi:10.1145/2660193.2660195).

    Examples
    --------
    >>> import rfpsurvey as rs
    >>> rs.allocation.subpriorities([7, 8], seed=1).round(4).tolist()
    [0.4652, 0.1724]
    """
    ids = to_plain(ids, "ids")
    if ids.ndim != 1 or ids.dtype.kind not in "iuUS":
        raise InputError(f"ids must be integers or text, shape (n,), got {ids.dtype.name} of shape {ids.shape}")
    if ids.dtype.kind == "S":
        ids = np.char.decode(ids, "utf-8")
    return subpriorities_of(id_numbers(ids), check_seed(seed))


def check_seed(seed: object) -> int:
    """Convert a seed of subpriorities to an integer."""
    if isinstance(seed, bool | np.bool_) or not isinstance(seed, int | np.integer):
        raise InputTypeError(f"the seed of subpriorities must be an integer, got {short(seed)}")
    if not 0 <= seed < 2**63:
        raise InputError(f"the seed of subpriorities must be from 0 to 2^63 - 1, got {short(seed)}")
    return int(seed)


def subpriorities_of(numbers: np.ndarray, seed: int) -> np.ndarray:
    """Return the subpriorities of the targets with given `id_numbers`; the seed is not checked."""
    mixed = hashing.split_mix(numbers ^ hashing.split_mix(np.array([seed], dtype=np.uint64)))
    return (mixed >> np.uint64(11)) * hashing.UNIT


FEWEST_FIRST = "fewest remaining visits"
"""Value of the option ``subpriority`` of surveys in which targets with few remaining visits come first."""


def to_subpriorities(given: int | str, ids: np.ndarray, extra: dict | None) -> np.ndarray:
    """Return the subpriorities of the targets of a field.

    Parameters
    ----------
    given : int or str
        Seed, or the name of a column of the catalog.
    ids : ndarray of int or str, shape (n,)
        Identifiers of the targets.
    extra : dict or None
        Additional columns of the catalog: a dictionary of column names to values.

    Returns
    -------
    ndarray of float, shape (n,)
        Subpriority of each target.

    Raises
    ------
    InputError
        If there is no such column, or if it does not contain one finite number per target.
    """
    if not isinstance(given, str):
        return subpriorities_of(id_numbers(ids), given)
    if given == FEWEST_FIRST:
        raise InputError(f"the subpriority {FEWEST_FIRST!r} can be used only for tiles of a survey")
    if given not in (extra or {}):
        raise InputError(
            f"subpriority must be a seed or the name of an additional column that was read from the catalog by keep= "
            f"or --set catalog.keep=NAME, got {given!r}; additional columns: {listed(extra or ())}"
        )
    return check_values(extra[given], len(ids), f"the subpriorities (column {given!r})")


def check_values(values: object, n: int, what: str) -> np.ndarray:
    """Convert subpriorities to numbers; raise an error unless each target has a finite number."""
    plain = to_plain(values, what, "numbers")
    try:
        numbers = plain.astype(float)
    except INCONVERTIBLE as error:
        raise InputError(f"{what} must be numbers: {error}") from None
    return check_one_each(numbers, n, what)


def check_one_each(values: np.ndarray, n: int, what: str) -> np.ndarray:
    """Return numbers or texts unchanged; raise an error unless each target has a finite number or a text."""
    if values.shape != (n,):
        raise InputError(f"{what} must have one value per target, shape ({n},), got {values.shape}")
    if values.dtype.kind != "U" and (lacking := ~np.isfinite(values)).any():
        raise InputError(f"{what} must be a finite number for every target, but {rows_of(lacking)} have none")
    return values


def service_order(values: np.ndarray, ids: np.ndarray) -> np.ndarray:
    """Return the rows of targets in order of decreasing subpriority; ties are decided by `id_numbers`.

    Parameters
    ----------
    values : ndarray of float, shape (n,)
        Subpriorities.
    ids : ndarray of int or str, shape (n,)
        Identifiers.

    Returns
    -------
    ndarray of int, shape (n,)
        Rows of the targets; the target with the largest subpriority is first.
    """
    order = np.argsort(-values)
    if (np.diff(values[order]) == 0).any():
        order = np.lexsort((id_numbers(ids), -values))
    return order


def tie_order(xy_mm: np.ndarray, ids: np.ndarray | None = None) -> np.ndarray:
    """Return the rows of targets in an order that does not depend on the order of the catalog.

    The targets are sorted by a hash of their identifiers or, if there are no identifiers, of their positions.

    Parameters
    ----------
    xy_mm : ndarray of float, shape (n, 2)
        Positions on the focal plane, mm.
    ids : ndarray of int or str, shape (n,), optional
        Identifiers.

    Returns
    -------
    ndarray of int, shape (n,)
        Rows of the targets.
    """
    if ids is not None:
        return service_order(subpriorities_of(id_numbers(ids), TIE_SEED), ids)
    whole = np.rint(np.nan_to_num(xy_mm) / SAME_POSITION_MM).astype(np.int64)
    x, y = np.ascontiguousarray(whole.T).view(np.uint64)
    return service_order(subpriorities_of(subpriorities_of(x, TIE_SEED).view(np.uint64) ^ y, TIE_SEED), y)


@dataclass(frozen=True, eq=False)
class RuleProblem:
    """The pairs of a positioner and a target that a rule may assign; all realizations of a tile share these data."""

    pairs: Reach
    rank: np.ndarray  # class of each target; class 0 is the most important
    number: np.ndarray  # integer that represents the identifier of each target
    n_sharing: np.ndarray  # upper limit of the number of other positioners that reach a target of each positioner
    by_distance: bool = False  # whether targets of a class are assigned in the order of their distances

    @classmethod
    def of(cls, pairs: Reach, rank, science, is_required, number, n_sharing, *, by_distance=False) -> "RuleProblem":
        """Return the problem of science targets and required targets; required targets are the most important class.

        ``is_required`` is None if no target is required.
        """
        if is_required is not None:
            rank, science = np.where(is_required, 0, rank + 1), science | is_required
        pairs = pairs if science.all() else pairs.where(science[pairs.target])
        return cls(pairs, rank, number, n_sharing, by_distance)

    @cached_property
    def closest(self) -> np.ndarray:
        """Indices of the pairs of each target, sorted by distance."""
        return kernels.sort_by_distance(self.pairs.indptr, self.pairs.r2)

    @cached_property
    def start(self) -> np.ndarray:
        """Index at which the list of the first targets of each positioner begins, followed by the length of all lists.

        If k other positioners share targets with a positioner, they can observe at most k of its targets. One of the
        first k + 1 targets of the positioner is therefore always available, and its further targets are omitted.
        """
        in_reach = np.bincount(self.pairs.owner, minlength=self.pairs.n_positioners)
        return np.concatenate([[0], np.cumsum(np.minimum(in_reach, self.n_sharing + 1))])

    def first_targets(self, start: np.ndarray, subpriority: np.ndarray, is_open: np.ndarray) -> tuple:
        """Return lists of the first open targets of each positioner, in the order of the rule.

        The list of positioner i begins at the index ``start[i]`` and has at most ``start[i + 1] - start[i]`` targets.
        The result contains the length of each list, the targets, their squared distances, and the number of open
        targets in reach of each positioner.
        """
        order, pairs = (self.rank, subpriority, self.number, self.by_distance, is_open), self.pairs
        return kernels.list_best(pairs.indptr, pairs.owner, pairs.r2, *order, start)


def balanced(problem: RuleProblem, subpriority: np.ndarray, is_open: np.ndarray, rng) -> AllocationAnswer:
    """Add the targets that are open, in order of subpriority, to queues, and draw one target from each queue."""
    pairs, targets = problem.pairs, np.flatnonzero(is_open)
    targets = targets[service_order(subpriority[targets], problem.number[targets])]
    count, place = np.empty(pairs.n_positioners, np.int64), np.empty((1, pairs.n_positioners), np.int64)
    owner_of, indptr = np.empty(len(is_open), dtype=np.int64), np.empty(len(count) + 1, dtype=np.int64)
    kernels.balanced(pairs.indptr, pairs.owner, pairs.r2, targets, count, owner_of)
    queue = np.empty(int(count.sum()), dtype=np.int64)
    kernels.fill_queues(owner_of, targets, count, indptr, queue)
    kernels.draw_places(indptr, rng.random((1, len(count))), place)
    return AllocationAnswer(np.where(place[0] >= 0, np.append(queue, -1)[place[0]], -1), queues=(indptr, queue))


def nearest(problem: RuleProblem, subpriority: np.ndarray, is_open: np.ndarray, rng) -> AllocationAnswer:
    """Assign each open target, in the order of the rule, to its closest free positioner."""
    pairs, order = problem.pairs, (problem.rank, subpriority, problem.number, problem.by_distance, is_open)
    given = pairs.n_positioners, pairs.indptr, pairs.owner, pairs.r2, problem.closest
    return AllocationAnswer(kernels.nearest(*given, *order))


def lamost_rule(problem: RuleProblem, subpriority: np.ndarray, is_open: np.ndarray, rng) -> AllocationAnswer:
    """Let each free positioner nominate its first open target, class by class, until there are no nominations."""
    *lists, in_reach = problem.first_targets(problem.start, subpriority, is_open)
    given = problem.start, *lists, problem.rank, problem.pairs.indptr, problem.pairs.owner, in_reach
    return AllocationAnswer(kernels.nominate(*given))


def plan_balanced(problem: AllocationProblem) -> AllocationAnswer:
    """Distribute targets to queues of nearly equal length, and draw one target from each queue.

    Each science target, in catalog order, is added to the shortest queue among the positioners that reach it; ties are
    decided by the distance, then by the row of the positioner. One target of each queue is drawn uniformly and
    observed. Priorities and requirements are ignored.
    """
    return _by_rule(problem, balanced, by_priority=False)


def plan_nearest(problem: AllocationProblem) -> AllocationAnswer:
    """Assign the targets of one class after the other; in each class, assign the closest pairs first.

    If subpriorities are given, assign each target of a class, in order of subpriority, to the closest free positioner.
    Requirements are ignored.
    """
    return _by_rule(problem, nearest)


def plan_lamost_rule(problem: AllocationProblem) -> AllocationAnswer:
    """Assign the targets of one class after the other; in each round, every free positioner nominates one target.

    In each class, every free positioner nominates its nearest unassigned target, until no nominations are possible. If
    several positioners nominate a target, the target is assigned to the positioner with the fewest unassigned targets
    (of any class) in reach; ties are decided by the distance, then by the row of the positioner. The requirements are
    then met one after the other: first by idle positioners, then by positioners that give up the least important
    targets.
    """
    answer = _by_rule(problem, lamost_rule)
    _fill_quotas(problem, answer.target_of_positioner)
    return answer


def _by_rule(problem, rule, *, by_priority=True):
    """Return the plan of a rule; the rows of the targets are already in order of subpriority."""
    n, n_sharing = len(problem.rank), problem.focal_plane.arrays.n_sharing
    is_required = problem.is_required if by_priority and problem.any_required else None
    rank, number = problem.rank if by_priority else np.zeros(n, np.int64), np.zeros(n, np.uint64)
    given = problem.pairs, rank, problem.science, is_required, number, n_sharing
    by_distance = problem.subpriority is None
    answer = rule(RuleProblem.of(*given, by_distance=by_distance), np.zeros(n), np.ones(n, np.bool_), problem.rng)
    return answer._replace(target_of_positioner=with_watched(problem, answer.target_of_positioner))


def _fill_quotas(problem, target_of):
    """Change a plan in place such that it meets the requirements as far as possible.

    The function uses idle positioners first, then the positioners of the least important targets.
    """
    plane, reach = problem.focal_plane, problem.pairs
    used, owner_of = np.flatnonzero(target_of >= 0), np.full(len(problem.rank), -1)
    owner_of[target_of[used]] = used
    locked = ~plane.arrays.usable
    locked[used] |= problem.is_required[target_of[used]]
    for requirement in problem.requirements:
        groups = [group for group in problem.groups if group.requirement is requirement and requirement.minimum > 0]
        if not groups:
            continue
        by_fiber, counting = plane.spectrograph.ndim > 1 and requirement.per == "spectrograph", None
        for group in groups:
            if group.targets is not counting:
                counting, rows = group.targets, reach.where(group.holds_target(reach.target, reach.owner))
            part = rows
            if by_fiber:
                part = rows.where(problem.spectrograph_of(rows.owner, rows.target) == group.spectrograph)
            indptr, target, r2 = part.by_positioner
            inside = np.diff(indptr) > 0
            if not by_fiber and group.spectrograph is not None:
                inside &= plane.spectrograph == group.spectrograph
            if group.fibers is not None:
                inside &= group.fibers
            used = np.flatnonzero(target_of >= 0)
            counted = used[group.holds(target_of[used], problem.spectrograph_of(used, target_of[used]), used)]
            locked[counted] = True
            rank = problem.rank_of(target_of)
            able = np.flatnonzero(~locked & inside)
            order = able[np.argsort(-rank[able], kind="stable")]
            need = requirement.minimum - len(counted)
            kernels.fill_quota(order, need, indptr, target, r2, group.targets, locked, target_of, owner_of)
