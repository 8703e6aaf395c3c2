"""Assignments, lost targets and visits in many realizations of a tile, which differ only in the order of targets.

All realizations share the reachable pairs of targets and positioners, and the segment of the arm of each pair. A
realization is a row of ``chosen``, which contains the index of the pair that each positioner uses, or -1. Bit r of a
mask stands for realization r of at most 32 realizations.
"""

import numpy as np

from rfpsurvey._jit import kernel

# Largest number of realizations in one call.
MOST = 32


@kernel
def mark_visits(chosen, lost, target, mask, counts):
    """Set bit r of ``mask`` for each target that is visited in realization r, and count assigned and lost targets.

    ``target`` contains the target of each pair. The columns of ``counts`` are the number of positioners with a target,
    and the number of targets lost to collisions.
    """
    mask[:] = 0
    counts[:] = 0
    for r in range(chosen.shape[0]):
        bit = np.uint32(1) << np.uint32(r)
        for i in range(chosen.shape[1]):
            k = chosen[r, i]
            if k >= 0:
                counts[r, 0] += 1
                if lost[r, i]:
                    counts[r, 1] += 1
                else:
                    mask[target[k]] |= bit


@kernel
def record_visits(mask, slot, spends, left, is_open, observed):
    """Subtract the visits of a tile from the remaining visits, and count the visits of each realization.

    ``mask`` contains the visits of the tile; row ``slot[f]`` of ``left`` belongs to target f of the tile. ``spends``
    states whether a visit to a target reduces its remaining visits; visits to all other targets are ignored.
    ``is_open`` marks targets with remaining visits in at least one realization.
    """
    n = left.shape[1]
    for f in range(slot.size):
        s = slot[f]
        if mask[f] != 0 and spends[s]:
            any_left = False
            for r in range(n):
                done = (mask[f] >> np.uint32(r)) & np.uint32(1)
                left[s, r] -= np.uint8(done)
                observed[r] += np.int64(done)
                any_left |= left[s, r] > 0
            is_open[s] = any_left


@kernel
def find_pairs(indptr, owner, target_of_positioner, chosen):
    """Write the index of the pair of each positioner and its target to ``chosen``; -1 for positioners without one."""
    for i in range(chosen.size):
        t = target_of_positioner[i]
        k = indptr[t] if t >= 0 else -1
        while t >= 0 and owner[k] != i:
            k += 1
        chosen[i] = k
