"""Simulation of allocated targets: collisions in single configurations, or means over all targets of the queues."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from rfpsurvey._assignment.allocate import TargetColumns, assign
from rfpsurvey._assignment.allocation import Allocation
from rfpsurvey._assignment.options import AllocationOptions
from rfpsurvey._instruments.count_collisions import count_poses, count_tips, draw_poses, make_setup, queue_segments
from rfpsurvey._instruments.focal_plane import FocalPlane
from rfpsurvey._kernels import arms, batch, queues, simulate
from rfpsurvey._studies.targets import Source
from rfpsurvey.errors import InputError


def make_positioners(plane: FocalPlane, setup: batch.CollisionSetup) -> simulate.Positioners:
    """Return the data that determine which targets each positioner reaches, and which poses its arms have.

    Kernels that draw targets assume that joint limits do not restrict the patrol areas.
    """
    idle = setup.idle.copy()
    arms.shape(idle, setup.model, setup.length, setup.cosine, setup.sine)
    side = plane.arrays.sides(np.full((len(plane), 2), np.nan))
    columns = (plane.arrays.annuli, plane.arrays.offers)
    return simulate.Positioners(plane.arrays.geometry, side, *columns, plane.arrays.grid, idle)


def make_realization(plane: FocalPlane, number: int, cells: int) -> simulate.Realization:
    """Return the arrays to which kernels write one realization of at most ``number`` targets.

    ``cells`` is the number of cells of the grid that `scatter_apart` uses.
    """
    n, pairs = len(plane), number * int(np.diff(plane.arrays.grid[5]).max())

    def integers(size):
        return np.empty(size, dtype=np.int64)

    return simulate.Realization(
        x=np.empty(number),
        y=np.empty(number),
        accepts=np.full(number, -1),
        targets=np.arange(number),
        indptr=integers(number + 1),
        owner=integers(pairs),
        r2=np.empty(pairs),
        code=integers(pairs),
        owner_of=integers(number),
        length=integers(n),
        queues=integers(n + 1),
        queue=integers(number),
        cells=np.empty((2, cells)),
    )


def make_entries(n: int, number: int) -> queues.Entries:
    """Return arrays for the queues of n positioners with ``number`` targets in total; each target has the weight 1."""
    size = number + n
    return queues.Entries(
        start=np.empty(n, dtype=np.int64),
        stop=np.empty(n, dtype=np.int64),
        segments=np.empty((4, size)),
        halves=np.empty((4, size)),
        weight=np.ones(size),
        total=np.empty(n),
        free=np.empty(size),
        hit=np.zeros(size),
        ahead=np.empty(size),
    )


def make_expected(n: int, n_pairs: int) -> queues.Expected:
    """Return arrays for the probabilities of n positioners and of their pairs; the values of realizations are 0."""
    return queues.Expected(np.empty(n), np.empty(n_pairs), np.zeros(n), np.zeros(n, dtype=np.int64))


QUEUEING = "balanced"
"""The allocator whose queues define the estimand, unless the user chooses another one; kernels simulate this one."""


@dataclass(frozen=True)
class CollisionSums:
    """Numbers of collisions in each realization, and numbers of collisions of each positioner in all realizations."""

    colliding: np.ndarray
    """Four columns with numbers of positioners: counted and colliding; counted; assigned and colliding; assigned.

    There is a row for each realization.
    """
    pairs: np.ndarray
    times: np.ndarray
    counted: np.ndarray

    def rates(self, column: int = 0) -> np.ndarray:
        """Return the collision rate of the counted (for ``column=2``, assigned) positioners in each realization.

        Realizations without counted (or assigned) positioners are omitted.
        """
        return self._ratio(self.colliding[:, column], self.colliding[:, column + 1])

    def mean(self, column: int = 0) -> float:
        """Return the mean of `rates`; NaN if no realization has counted (or assigned) positioners."""
        rates = self.rates(column)
        return float(rates.mean()) if len(rates) else np.nan

    def first(self, n: int) -> "CollisionSums":
        """Return a copy whose rates are those of the first ``n`` realizations.

        The numbers of each positioner remain those of all realizations.
        """
        return replace(self, colliding=self.colliding[:n], pairs=self.pairs[:n])

    @property
    def pair_rates(self) -> np.ndarray:
        """Number of colliding pairs divided by the number of counted positioners, for each realization."""
        return self._ratio(self.pairs, self.colliding[:, 1])

    @property
    def trials(self) -> int:
        """Number of counted positioners, summed over all realizations."""
        return int(self.colliding[:, 1].sum())

    @property
    def per_positioner(self) -> np.ndarray:
        """Collision rate of each positioner in the realizations in which it is counted; NaN if it is never counted."""
        return np.where(self.counted > 0, self.times / np.maximum(self.counted, 1), np.nan)

    @classmethod
    def of(cls, sums: np.ndarray, expected: queues.Expected) -> "CollisionSums":
        """Return the expected numbers that a kernel has computed."""
        return cls(sums[:, :4], sums[:, 4], expected.times, expected.counted)

    @staticmethod
    def _ratio(part, whole):
        return part[whole > 0] / whole[whole > 0]


def merge(parts: list[CollisionSums]) -> CollisionSums:
    """Return one `CollisionSums` that contains the realizations of all ``parts``."""
    rows = (np.concatenate([getattr(p, name) for p in parts]) for name in ("colliding", "pairs"))
    return CollisionSums(*rows, sum(p.times for p in parts), sum(p.counted for p in parts))


def expect_queues(plane: FocalPlane, setup, positioners, given: tuple, expected, sums: np.ndarray) -> None:
    """Write the expected numbers of collisions to ``sums``; ``given`` is a result of `queue_segments`."""
    indptr, segments = given
    entries = make_entries(len(plane), segments.shape[1])
    entries.segments[:, : segments.shape[1]] = segments
    simulate.expect_given(indptr, plane.arrays.neighbors, positioners, setup, entries, expected, sums)


@dataclass(frozen=True, eq=False)
class Simulation:
    """A simulation that draws targets, allocates them, and finds collisions."""

    plane: FocalPlane
    source: Source
    options: AllocationOptions
    most_entries: int | None = None
    """Maximum number of targets that `expect` uses from each queue; None means all targets."""

    @property
    def compiled(self) -> bool:
        """Whether compiled kernels run the whole simulation."""
        return self.source.compiled and self.options.allocator == QUEUEING and self.plane.arrays.poses_free

    def draw(self, size: int, rng: np.random.Generator) -> CollisionSums:
        """Draw realizations, and return the numbers of collisions in one configuration of each realization."""
        n, plane, setup = len(self.plane), self.plane, self._setup
        if self.compiled:
            numbers, tips = self.source.numbers(size, rng), np.empty((size, n, 2))
            realization = make_realization(plane, int(numbers.max()), self.source.grid_cells)
            simulate.draw_tips(rng, numbers, self.source.sky, self._positioners, realization, tips)
            counts, hits, _ = count_tips(plane.arrays, setup, tips, self._positioners.side[None])
            counted = np.count_nonzero((tips[:, :, 0] < np.inf) | setup.parked, axis=0)
        else:
            counts = np.empty((size, batch.N_COUNTS), dtype=np.int64)
            hits, counted = np.zeros((2, n), dtype=np.int64)
            for row in range(size):
                indptr, segments = self._queue_segments(rng)
                chosen = draw_poses(indptr, rng, 1)
                given = chosen, segments, self._positioners.idle, hits[None]
                counts[row : row + 1] = count_poses(plane, setup, *given)
                counted += (chosen[0] >= 0) | setup.parked
        columns = [batch.COLLIDING, batch.COUNTED, batch.COLLIDING_ASSIGNED, batch.ASSIGNED]
        return CollisionSums(
            counts[:, columns].astype(float), counts[:, batch.PAIRS].astype(float), hits.astype(float), counted
        )

    def expect(self, size: int, rng: np.random.Generator) -> CollisionSums:
        """Draw realizations, and return collision counts, averaged over all configurations that the queues allow."""
        n = len(self.plane)
        sums, pairs = np.empty((size, 5)), self.plane.arrays.neighbors
        expected = make_expected(n, len(pairs))
        if self.compiled:
            numbers = self.source.numbers(size, rng)
            most = int(numbers.max())
            realization, entries = make_realization(self.plane, most, self.source.grid_cells), make_entries(n, most)
            given = numbers, self._most, self.source.sky, self._positioners, realization, pairs, self._setup
            simulate.queue_and_expect(rng, *given, entries, expected, sums)
        else:
            for sums_of_realization in sums:
                given = self._queue_segments(rng, thin=True)
                expect_queues(self.plane, self._setup, self._positioners, given, expected, sums_of_realization)
        return CollisionSums.of(sums, expected)

    @property
    def _most(self):
        return np.iinfo(np.int64).max if self.most_entries is None else self.most_entries

    def _queue_segments(self, rng, *, thin=False):
        """Return the queues of one realization, and, for each target of a queue, the arm segment that can collide."""
        given = self.source.kind == "given"
        allocation = self._given if given else self.realize(rng)
        if thin and self.most_entries is not None:
            indptr, queue = (a.copy() for a in allocation.queues)
            simulate.thin(rng, self._most, indptr, queue)
            allocation = replace(allocation, queues=(indptr, queue[: indptr[-1]]))
        elif given:
            return self._given_segments
        return queue_segments(self.plane, allocation)

    @cached_property
    def _given(self):
        return self.realize(np.random.default_rng(0))

    @cached_property
    def _given_segments(self):
        return queue_segments(self.plane, self._given)

    def realize(self, rng: np.random.Generator) -> Allocation:
        """Draw targets, and return their allocation, which always has queues.

        If the allocator makes no queues, each assigned target becomes a queue of length 1.
        """
        columns = TargetColumns(priority=self.source.priority, fiber_type=self.source.types)
        allocation = assign(self.plane, self.source.draw(rng), columns, self.options, rng)
        if allocation.queues is not None:
            return allocation
        target = allocation.target_of_positioner  # without queues, the queue of a positioner is its target
        one_each = np.concatenate([[0], np.cumsum(target >= 0)]), target[target >= 0]
        return replace(allocation, queues=one_each)

    @cached_property
    def _setup(self):
        return make_setup(self.plane.arrays, self.options.parked_obstacles)

    @cached_property
    def _positioners(self):
        return make_positioners(self.plane, self._setup)


def as_allocations(density: object, plane: FocalPlane) -> list[Allocation] | None:
    """Return the allocations whose queues define the density; None if ``density`` does not contain allocations."""
    some = [density] if isinstance(density, Allocation) else density
    if not isinstance(some, list | tuple) or not some:
        return None
    for plan in some:
        if not isinstance(plan, Allocation) or plan.queues is None:
            raise InputError(
                f"density must be Allocations with queues, such as those of the allocator 'balanced', got {plan!r}"
            )
        if len(plan.target_of_positioner) != len(plane):
            raise InputError(
                f"density must be Allocations for the {len(plane)} positioners of the focal plane, got an Allocation "
                f"for {len(plan.target_of_positioner)} positioners"
            )
    return list(some)


def pool(plane: FocalPlane, allocations: list[Allocation], *, parked_obstacles: bool) -> CollisionSums:
    """Return the expected numbers of collisions if each positioner draws its target at random from its combined queue.

    The combined queue of a positioner contains the targets of its queues in all ``allocations``.
    """
    parts = [queue_segments(plane, allocation) for allocation in allocations]
    positioner = np.concatenate([np.repeat(np.arange(len(plane)), np.diff(indptr)) for indptr, _ in parts])
    order = np.argsort(positioner, kind="stable")
    indptr = np.searchsorted(positioner[order], np.arange(len(plane) + 1))
    segments = np.concatenate([segments for _, segments in parts], axis=1)[:, order]
    setup = make_setup(plane.arrays, parked_obstacles)
    sums, expected = np.empty((1, 5)), make_expected(len(plane), len(plane.arrays.neighbors))
    expect_queues(plane, setup, make_positioners(plane, setup), (indptr, segments), expected, sums[0])
    return CollisionSums.of(sums, expected)
