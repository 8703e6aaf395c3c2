"""Candidates, which are the possible targets and elbows of each positioner, and pairs of candidates that collide."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy  # its subpackages are imported on first use

from rfpsurvey._assignment.before_and_after import Preselection, place_segments, preselect, replaceable
from rfpsurvey._assignment.clock import OutOfTimeError, left, now
from rfpsurvey._assignment.distribution import Spread, members
from rfpsurvey._assignment.problem import AllocationProblem
from rfpsurvey._instruments.collision_methods import arms_closer_exactly
from rfpsurvey._instruments.find_collisions import obstacle_tests, touching
from rfpsurvey._kernels import conflicts, motion
from rfpsurvey._kernels import conflicts as reduce
from rfpsurvey._kernels.collisions import halve

ROOM = 1 << 18
# Number of tests of two candidates for a collision before the clock is read again.
BATCH = 10_000_000
# Ratio of the times of tests of moving and of resting arms.
SLOWER = 20
# Number of comparisons of candidates before the clock is read again, while candidates are removed.
COMPARED = 10_000_000
# Largest number of candidates in place of a maximum.
UNLIMITED = np.iinfo(np.int64).max


@dataclass(frozen=True, eq=False)
class Candidates:
    """Candidates and their collisions; the last candidate of each positioner is its idle arm."""

    problem: AllocationProblem
    options: conflicts.Options
    side: np.ndarray  # elbow of each candidate: +1 is right, -1 is left
    pairs: np.ndarray  # pairs of candidates that collide, shape (2, m)
    held: np.ndarray  # whether each candidate counts toward each group of requirements, shape (n_groups, n)
    preselection: Preselection  # reachable pairs that the candidates are made from; some may be omitted
    idle_pairs: np.ndarray | None = None  # positioners whose idle arms collide, shape (2, m); None if unknown

    def __len__(self):
        return len(self.side)

    def where(self, keep: np.ndarray) -> "Candidates":
        """Return the candidates for which ``keep`` is true."""
        o, new = self.options, np.cumsum(keep) - 1
        start = np.concatenate([[0], np.cumsum(keep)])[o.start]
        pairs = _pairs_where(self.pairs, keep, new)
        columns = start, o.owner[keep], o.target[keep], self.side[keep], o.cost[keep], pairs
        candidates = _assemble(self.problem, self.preselection, *columns)
        if "segments" in self.__dict__:
            # with the memory layout of self.segments[:, keep], numba would compile kernels again
            candidates.__dict__["segments"] = np.compress(keep, self.segments, axis=1)
        return candidates

    def for_problem(self, problem: AllocationProblem) -> "Candidates":
        """Return the candidates for a problem in which only the roles of the targets differ."""
        o = self.options
        return _assemble(problem, self.preselection, o.start, o.owner, o.target, self.side, o.cost, self.pairs)

    @cached_property
    def spreads(self) -> list[Spread]:
        """The candidates that each rule on the distribution of fibers concerns."""
        o, problem = self.options, self.problem
        return [
            Spread(rule, *(members(problem, rule, what, o.owner, o.target) for what in ("science", rule.what)))
            for rule in problem.distributions
        ]

    @cached_property
    def limits(self) -> np.ndarray:
        """Smallest and largest number of candidates of each group of ``held`` that a plan may use, shape (2, n_groups).

        The largest number is a large number if there is no maximum.
        """
        limits = [(g.requirement.minimum, g.requirement.maximum) for g in self.problem.groups]
        limits = [(low, UNLIMITED if high is None else high) for low, high in limits]
        return np.ascontiguousarray(np.array(limits, dtype=np.int64).reshape(-1, 2).T)

    @cached_property
    def counted(self) -> np.ndarray:
        """Whether each candidate counts toward a minimum."""
        return self.held[self.limits[0] > 0].any(axis=0)

    @cached_property
    def held_sparse(self) -> "scipy.sparse.csr_array":
        """The array ``held`` as a sparse matrix of numbers; each candidate counts toward few of many requirements."""
        return scipy.sparse.csr_array(self.held, dtype=np.int64)

    @cached_property
    def segments(self) -> np.ndarray:
        """Segments that represent the arms in tests for collisions, shape (4, n)."""
        o = self.options
        return place_segments(self.problem, o.owner, o.target, self.side, o.start[1:] - 1)

    @cached_property
    def moves(self) -> "tuple[motion.Moves, bool] | None":
        """Motion of the arms, and whether they unfold with the same speed; None if no constraint requires it."""
        o, moving = self.options, self.problem.motion
        if moving is None:
            return None
        return moving.moves(o.owner, o.target, self.side, o.start[1:] - 1), moving.same_speed

    def with_collisions(self, seconds: float = np.inf, most_pairs: float = np.inf) -> "Candidates":
        """Return the candidates with their collisions; the parameters are those of `find_candidates`."""
        o, is_idle = self.options, np.zeros(len(self), dtype=bool)
        is_idle[o.start[1:] - 1] = True
        pairs = find_conflicts(self.problem.focal_plane, o.start, self.segments, seconds, most_pairs, self.moves)
        pairs = np.hstack([pairs, avoided_rows(self.problem, 2, o.owner, o.target, self.side)])
        # A plan may contain collisions of two idle arms, and of an idle arm with an obstacle.
        both_idle = is_idle[pairs[0]] & is_idle[pairs[1]]
        idle_pairs, pairs = o.owner[pairs[:, both_idle]], np.ascontiguousarray(pairs[:, ~both_idle])
        options = o._replace(**_adjacency(len(self), pairs))
        return replace(self, options=options, pairs=pairs, idle_pairs=idle_pairs)

    def relaxed(self) -> "Candidates":
        """Return a copy without some of the collisions, so that its best plan gives an upper bound for all plans.

        The preselection omits some candidates. The copy contains no collisions of the candidates that can replace these
        omitted candidates (`replaceable`). The bound is therefore also valid for plans that use omitted candidates.
        """
        o, plane = self.options, self.problem.focal_plane
        n_elbows = 2 if plane.positioner.handedness == "both" else 1
        free = replaceable(self.preselection, o.owner, o.target, o.rank, plane.arrays.n_sharing, n_elbows)
        pairs = _pairs_where(self.pairs, ~free, np.arange(len(free)))
        return replace(self, options=o._replace(**_adjacency(len(self), pairs)), pairs=pairs, idle_pairs=None)


def find_candidates(
    problem: AllocationProblem,
    *,
    collide: bool = True,
    squared_cost: bool = False,
    keep_target: np.ndarray | None = None,
    seconds: float = np.inf,
    most_pairs: float = np.inf,
) -> Candidates:
    """Return the candidates of a problem: all candidates, or only the candidates that `preselect` keeps.

    If ``collide`` is false, collisions are ignored, and each pair of a target and a positioner has only one elbow.
    ``keep_target`` contains one target (or -1) for each positioner; this target is always kept. If finding the
    collisions would take more than ``seconds``, or if there are more than ``most_pairs`` collisions, `OutOfTimeError`
    is raised. If ``most_pairs`` is 0, the collisions of two arms are not found.
    """
    preselection = preselect(problem, collide=collide, keep_target=keep_target)
    start, owner, target, side, r2 = list_candidates(problem, preselection.reach, both_elbows=collide)
    cost = r2 if squared_cost else np.zeros(len(owner))
    candidates = _assemble(problem, preselection, start, owner, target, side, cost, np.empty((2, 0), dtype=np.int64))
    if not collide:
        return candidates
    keep = np.ones(len(owner), dtype=bool)
    keep[obstacle_hits(problem.focal_plane, start, candidates.segments)[:, 0]] = False
    if problem.motion is not None:
        keep &= problem.motion.allowed(owner, target, side)
    keep[avoided_rows(problem, 1, owner, target, side)] = False
    keep[start[1:] - 1] = True
    candidates = candidates if keep.all() else candidates.where(keep)
    return candidates.with_collisions(seconds, most_pairs) if most_pairs else candidates


def avoided_rows(problem, size, owner, target, side):
    """Return the candidates of each avoided combination of ``size`` assignments, shape (size, k)."""
    some = [combination for combination in problem.avoided if len(combination) == size]
    row_of = {}
    for i in {i for combination in some for i, _, _ in combination}:
        rows = slice(*np.searchsorted(owner, [i, i + 1]))  # the candidates are sorted by positioner
        row_of |= {(i, *key): rows.start + k for k, key in enumerate(zip(target[rows], side[rows], strict=True))}
    listed = [[row_of.get(assignment, -1) for assignment in combination] for combination in some]
    listed = [rows for rows in listed if min(rows) >= 0]
    return np.array(listed, dtype=np.int64).reshape(-1, size).T


def _pairs_where(pairs, keep, new):
    """Return the pairs whose two candidates are kept, with the new indices of the candidates."""
    return np.ascontiguousarray(new[pairs[:, keep[pairs[0]] & keep[pairs[1]]]])


def _assemble(problem, preselection, start, owner, target, side, cost, pairs):
    """Return `Candidates` with the given columns and the data that are derived from these columns."""
    rank = problem.rank_of(target)
    place = problem.spectrograph_of(owner, target) if problem.groups else None
    near = [members(problem, rule, rule.what, owner, target) for rule in problem.distributions]
    held = np.array([g.holds(target, place, owner) for g in problem.groups], dtype=bool).reshape(-1, len(owner))
    key, as_good = _keys(problem, target, held, near)
    pairs = np.ascontiguousarray(pairs)  # for another memory layout, numba would compile the kernel again
    by_target, adjacency = _by_target(target, len(problem.xy)), _adjacency(len(owner), pairs)
    options = conflicts.Options(start, owner, target, rank, cost, key, as_good, *by_target, **adjacency)
    return Candidates(problem, options, side, pairs, held, preselection)


def _adjacency(n, pairs):
    """Return the collisions of each of n candidates as compressed rows, for `Options`."""
    indptr, excluded = np.empty(n + 1, dtype=np.int64), np.empty(2 * pairs.shape[1], dtype=np.int64)
    conflicts.adjacency(pairs[0], pairs[1], indptr, excluded)
    return {"indptr": indptr, "excluded": excluded}


def list_candidates(problem, reach, both_elbows):
    """Return ``start`` and the positioner, target, elbow and squared distance of all candidates, including idle arms.

    There is one candidate for each target in reach and each possible elbow position.
    """
    plane = problem.focal_plane
    indptr, target, r2 = reach.by_positioner
    owner = np.repeat(np.arange(len(plane)), np.diff(indptr))
    fiber = problem.fiber_of(owner, target)
    side = plane.arrays.sides(problem.xy[target], owner, fiber)
    if both_elbows and plane.positioner.handedness == "both":
        allowed = {s: plane.arrays.poses_allowed(owner, problem.xy[target], s, fiber) for s in (1.0, -1.0)}
        columns = [(owner[ok], target[ok], np.full(ok.sum(), s), r2[ok]) for s, ok in allowed.items()]
        owner, target, side, r2 = (np.concatenate(parts) for parts in zip(*columns, strict=True))
    n = len(plane)
    watched = np.full(n, -1) if problem.watched is None else problem.watched
    columns = (owner, np.arange(n)), (target, watched), (side, plane.arrays.sides(plane.arrays.xy)), (r2, np.zeros(n))
    owner, target, side, r2 = (np.concatenate(parts) for parts in columns)
    order = np.argsort(owner, kind="stable")  # the idle arm of each positioner is its last candidate
    start = np.concatenate([[0], np.cumsum(np.bincount(owner, minlength=n))])
    return start, owner[order], target[order], side[order], r2[order]


def obstacle_hits(plane, start, segments):
    """Return the pairs (candidate, obstacle) that collide, shape (k, 2)."""
    owner = np.repeat(np.arange(len(plane)), np.diff(start))
    return touching(plane, segments, obstacle_tests(plane.arrays.obstacle_pairs, owner), owner)[0]


def find_conflicts(plane, start, segments, seconds=np.inf, most_pairs=np.inf, moves=None):
    """Return pairs of candidates that collide, shape (2, m); borderline pairs are tested in exact arithmetic.

    If ``moves`` contains the motion of the arms, the pairs are those that collide while the arms unfold.
    """
    columns, pairs = plane.arrays, plane.arrays.neighbors
    halves = np.empty_like(segments)
    halve(segments, halves)
    size = np.diff(start)
    work = size[pairs[:, 0]] * size[pairs[:, 1]]
    room = int(max(ROOM, work.max(initial=0)))
    first, second = np.empty(room, dtype=np.int64), np.empty(room, dtype=np.int64)
    borderline = np.empty(room, dtype=bool)
    owner = np.repeat(np.arange(len(size)), size)
    outlined = columns.limits.outline.start.size > 1
    work = np.cumsum(work)
    batch = BATCH if moves is None else BATCH // SLOWER
    p, parts, total, begin = 0, [], 0, now()
    while p < len(pairs):
        part = pairs[: int(np.searchsorted(work, (work[p - 1] if p else 0) + batch)) + 1]
        if moves is not None:
            n, p = motion.list_meeting(part, p, start, *moves, columns.limits, first, second)
            borderline[:n] = False
        else:
            n, p = conflicts.list_conflicts(
                part, p, columns.geometry, start, segments, halves, columns.limits, first, second, borderline
            )
        if outlined and moves is None:
            n = conflicts.keep_outlined(n, owner, segments, columns.limits, first, second, borderline)
        part = np.array([first[:n], second[:n]])
        edge = np.flatnonzero(borderline[:n])
        if len(edge):
            rows = [(*part[:, k], *owner[part[:, k]]) for k in edge]
            close = [arms_closer_exactly(columns, segments, *four) for four in rows]
            part = np.delete(part, edge[~np.array(close)], axis=1)
        parts.append(part)
        total += part.shape[1]
        # the work of all pairs, divided by the work that is done, predicts the total time
        if (now() - begin) * (work[-1] / max(work[p - 1], 1)) > seconds or total > most_pairs:
            raise OutOfTimeError
    return np.concatenate(parts, axis=1) if parts else np.empty((2, 0), dtype=np.int64)


def _keys(problem, target, held, near):
    """Return the key of each candidate, and a matrix that states which keys are at least as good as other keys.

    Candidates that count toward the same requirements, and are neighbors for the same rules (``near``), have the same
    key, which is a whole number. Key a is at least as good as key b if a counts toward every minimum and is a neighbor
    for every rule for which b does, and b counts toward every maximum toward which a counts.
    """
    low = [g.requirement.minimum > 0 for g in problem.groups]
    high = [g.requirement.maximum is not None for g in problem.groups]
    required = np.zeros((0, len(target)), dtype=bool)
    if problem.any_required:
        required = np.append(problem.is_required, False)[target][None]
    does = np.concatenate([held[np.flatnonzero(low)], required, *(near_rule[None] for near_rule in near)])
    spends = held[np.flatnonzero(high)]
    if len(does) + len(spends) == 0:
        return np.zeros(len(target), dtype=np.int64), np.ones((1, 1), dtype=bool)
    first, key = _distinct(np.concatenate([does, spends]))
    does, spends = does[:, first].astype(np.float32), spends[:, first].astype(np.float32)
    # a product of matrices counts the conditions that key a does not meet, without an array of all conditions and pairs
    return key, ((1 - does).T @ does + spends.T @ (1 - spends)) == 0


def _distinct(flags):
    """Return the index of one column of each kind, and the kind of each column, for an array of booleans."""
    packed = np.zeros((flags.shape[1], -(-len(flags) // 64) * 8), dtype=np.uint8)
    packed[:, : -(-len(flags) // 8)] = np.packbits(flags, axis=0).T
    kind = np.zeros(flags.shape[1], dtype=np.int64)
    for word in packed.view(np.int64).T:
        values, place = np.unique(word, return_inverse=True)
        first, kind = np.unique(kind * len(values) + place.reshape(-1), return_index=True, return_inverse=True)[1:]
    return first, kind.reshape(-1)


def _by_target(target, n):
    """Return the candidates of each target as compressed rows (CSR): the offsets of the rows, and the candidates."""
    rows = np.flatnonzero(target >= 0)
    rows = rows[np.argsort(target[rows].astype(np.min_scalar_type(n)), kind="stable")]  # fast for numbers of 16 bits
    return np.concatenate([[0], np.cumsum(np.bincount(target[rows], minlength=n))]), rows


def reduced(options: conflicts.Options, deadline: float = np.inf) -> np.ndarray:
    """Mark the candidates that remain after removing candidates that an optimal plan does not need.

    Parameters
    ----------
    options : Options
        All candidates.
    deadline : float, optional
        Value of `now` at which the removal stops.

    Returns
    -------
    ndarray of bool, shape (n_candidates,)
        Whether each candidate remains.
    """
    n, size = len(options.start) - 1, len(options.owner)
    alive, queue, waiting = np.ones(size, dtype=bool), np.arange(n), np.ones(n, dtype=bool)
    ends, mark, removed = np.array([0, n]), np.full(size, -1), np.empty(size, dtype=np.int64)
    while ends[0] < ends[1] and left(deadline) > 0:
        reduce.reduce_some(options, alive, queue, waiting, ends, mark, removed, COMPARED)
    return alive


# Largest numbers between two readings of the clock: cliques, members of cliques, and comparisons of candidates.
N_CLIQUES, N_MEMBERS, WORK = 4096, 200_000, 50_000_000


def cover(options: conflicts.Options, rows: np.ndarray, edges: np.ndarray, deadline: float = np.inf):
    """Return maximal cliques, which are sets of candidates; a plan without collisions uses at most one of each set.

    If two of the candidates ``rows`` collide, or have the same target but different positioners, at least one clique
    contains both candidates.

    Parameters
    ----------
    options : Options
        All candidates.
    rows : ndarray of int, shape (n,)
        Indices of the candidates from which the cliques are formed.
    edges : ndarray of int, shape (2, m)
        Collisions between candidates of ``rows``.
    deadline : float, optional
        Value of `now` at which `OutOfTimeError` is raised.

    Returns
    -------
    indptr, column : ndarray of int
        The cliques as compressed rows: clique ``k`` is ``column[indptr[k]:indptr[k + 1]]``. Each clique is sorted.
    """
    n = len(options.owner)
    edges_and_rivals = np.concatenate([edges, _twins(options, rows)], axis=1)
    indptr, excluded = _adjacency(n, edges_and_rivals).values()
    covered, room = np.zeros(len(excluded), dtype=bool), np.empty(n + N_MEMBERS, dtype=np.int64)
    first, sizes, columns = 0, [np.zeros(1, dtype=np.int64)], []
    while first < n:
        if left(deadline) == 0:
            raise OutOfTimeError
        some = np.zeros(N_CLIQUES + 1, dtype=np.int64)
        first, k = conflicts.grow_cliques(options.owner, indptr, excluded, first, covered, some, room, WORK)
        sizes.append(np.diff(some[: k + 1]))
        columns.append(room[: some[k]].copy())
    return np.cumsum(np.concatenate(sizes)), np.concatenate(columns)


def _twins(options, rows):
    """Return the pairs of candidates that have the same target but different positioners."""
    rows = rows[np.argsort(options.target[rows], kind="stable")]
    rows = rows[options.target[rows] >= 0]
    parts, step = [np.empty((2, 0), dtype=np.int64)], 1
    while True:
        pair = np.array([rows[:-step], rows[step:]])
        same = options.target[pair[0]] == options.target[pair[1]]
        if not same.any():
            return np.concatenate(parts, axis=1)
        apart = options.owner[pair[0]] != options.owner[pair[1]]
        parts.append(pair[:, same & apart])
        step += 1
