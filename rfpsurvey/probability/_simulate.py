"""Simulation of allocated targets: collisions in single configurations, or means over all targets of the queues."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from rfpsurvey._kernels import batch, simulate
from rfpsurvey.allocation import Allocation, AllocationOptions, TargetColumns, assign
from rfpsurvey.collision import make_setup, make_workspace, queue_segments
from rfpsurvey.focal_plane import FocalPlane
from rfpsurvey.probability._targets import Source
from rfpsurvey.probability._workspace import make_entries, make_expected, make_positioners, make_realization

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

    @staticmethod
    def _ratio(part, whole):
        return part[whole > 0] / whole[whole > 0]


def merge(parts: list[CollisionSums]) -> CollisionSums:
    """Return one `CollisionSums` that contains the realizations of all ``parts``."""
    rows = (np.concatenate([getattr(p, name) for p in parts]) for name in ("colliding", "pairs"))
    return CollisionSums(*rows, sum(p.times for p in parts), sum(p.counted for p in parts))


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
        n = len(self.plane)
        counts, counted = np.empty((size, batch.N_COUNTS), dtype=np.int64), np.zeros(n, dtype=np.int64)
        hits, workspace = np.zeros(n, dtype=np.int64), make_workspace(self.plane)
        if self.compiled:
            numbers = self.source.numbers(size, rng)
            realization = make_realization(self.plane, int(numbers.max()), self.source.grid_cells)
            simulate.draw_and_count(
                rng,
                numbers,
                self.source.sky,
                self._positioners,
                realization,
                self._setup,
                workspace,
                counts,
                hits,
                counted,
            )
        else:
            for row in range(size):
                indptr, segments = self._queue_segments(rng)
                counted += (np.diff(indptr) > 0) | self._setup.parked
                uniform, own = rng.random((1, n)), counts[row : row + 1]
                batch.count_draws(uniform, indptr, segments, self._positioners.idle, self._setup, workspace, own, hits)
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
            simulate.queue_and_expect(
                rng,
                numbers,
                self._most,
                self.source.sky,
                self._positioners,
                realization,
                pairs,
                self._setup,
                entries,
                expected,
                sums,
            )
        else:
            for own in sums:
                indptr, segments = self._queue_segments(rng, thin=True)
                entries = make_entries(n, segments.shape[1])
                entries.segments[:, : segments.shape[1]] = segments
                simulate.expect_given(indptr, pairs, self._positioners, self._setup, entries, expected, own)
        return CollisionSums(sums[:, :4], sums[:, 4], expected.times, expected.counted)

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
        target = allocation.target_of_positioner
        one_each = np.concatenate([[0], np.cumsum(target >= 0)]), target[target >= 0]
        return replace(allocation, queues=one_each)

    @cached_property
    def _setup(self):
        return make_setup(self.plane.arrays, self.options.parked_obstacles)

    @cached_property
    def _positioners(self):
        return make_positioners(self.plane, self._setup)
