"""Independent targets with the same density as the targets in the queues of allocations."""

import numpy as np

from rfpsurvey._kernels import simulate
from rfpsurvey.allocation import Allocation
from rfpsurvey.collision import make_setup, queue_segments
from rfpsurvey.errors import InputError
from rfpsurvey.focal_plane import FocalPlane
from rfpsurvey.probability._simulate import Tally
from rfpsurvey.probability._workspace import make_entries, make_positioners


def as_allocations(density: object, plane: FocalPlane) -> list[Allocation] | None:
    """Return the allocations whose queues define the density; None if ``density`` does not contain allocations."""
    some = [density] if isinstance(density, Allocation) else density
    if not isinstance(some, list | tuple) or not some:
        return None
    for one in some:
        if not isinstance(one, Allocation) or one.queues is None:
            raise InputError(
                f"density must be Allocations with queues, such as those of the allocator 'balanced', got {one!r}"
            )
        if len(one.target_of_positioner) != len(plane):
            raise InputError(
                f"density must be Allocations for the {len(plane)} positioners of the focal plane, got an Allocation "
                f"for {len(one.target_of_positioner)} positioners"
            )
    return list(some)


def pool(plane: FocalPlane, allocations: list[Allocation], *, parked_obstacles: bool) -> Tally:
    """Return the expected numbers of collisions if each positioner draws its target at random from its combined queue.

    The combined queue of a positioner contains the targets of its queues in all ``allocations``.
    """
    parts = [queue_segments(plane, allocation) for allocation in allocations]
    own = np.concatenate([np.repeat(np.arange(len(plane)), np.diff(indptr)) for indptr, _ in parts])
    order = np.argsort(own, kind="stable")
    indptr = np.searchsorted(own[order], np.arange(len(plane) + 1))
    entries = make_entries(len(plane), len(own))
    entries.segments[:, : len(own)] = np.concatenate([segments for _, segments in parts], axis=1)[:, order]
    setup = make_setup(plane.arrays, parked_obstacles)
    sums, times, counted = np.empty((1, 5)), np.zeros(len(plane)), np.zeros(len(plane), dtype=np.int64)
    positioners, pair_probability = make_positioners(plane, setup), np.empty(len(plane.arrays.neighbors))
    simulate.expect_given(
        indptr,
        plane.arrays.neighbors,
        positioners,
        setup,
        entries,
        np.empty(len(plane)),
        pair_probability,
        sums[0],
        times,
        counted,
    )
    return Tally(sums[:, :4], sums[:, 4], times, counted)
