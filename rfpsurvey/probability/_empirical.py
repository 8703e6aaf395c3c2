"""Independent targets with the same density as the targets in the queues of allocations."""

import numpy as np

from rfpsurvey._kernels import simulate
from rfpsurvey.allocation import Allocation
from rfpsurvey.collision import make_setup, queue_segments
from rfpsurvey.errors import InputError
from rfpsurvey.focal_plane import FocalPlane
from rfpsurvey.probability._simulate import CollisionSums
from rfpsurvey.probability._workspace import make_entries, make_expected, make_positioners


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


def pool(plane: FocalPlane, allocations: list[Allocation], *, parked_obstacles: bool) -> CollisionSums:
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
    sums, pairs = np.empty((1, 5)), plane.arrays.neighbors
    expected = make_expected(len(plane), len(pairs))
    simulate.expect_given(indptr, pairs, make_positioners(plane, setup), setup, entries, expected, sums[0])
    return CollisionSums(sums[:, :4], sums[:, 4], expected.times, expected.counted)
