"""The improvement of a plan of all tiles by augmenting paths.

Along an augmenting path, the first positioner moves to a target that requires a visit. Each further positioner, of any
tile, moves to the target that the positioner before it has left.
"""

from collections.abc import Callable

import numpy as np

from rfpsurvey._kernels import paths as kernels
from rfpsurvey.survey._joint._network import Network

# Depths, that is, largest numbers of positioners in a path. The search uses these depths one after the other, because
# short paths are found much faster.
DEPTHS = (4, 16, 64, 256)
# Largest number of times that the search considers all targets of a priority class for each depth.
PASSES = 20


class Paths:
    """The candidates of a network in the order in which the search for augmenting paths requires them."""

    def __init__(self, network: Network):
        self.network = network
        target = np.where(network.rank < network.n_classes, network.target, -1)
        real = np.flatnonzero((target >= 0) & network.usable)
        candidate = real[np.argsort(target[real], kind="stable")]
        number = np.bincount(target[real], minlength=len(network.slot))
        cliques, rules = network.matrix[: network.n_cliques].tocsc(), network.rules.tocsc()
        indices = [network.positioner, target, network.rank, np.concatenate([[0], np.cumsum(number)]), candidate]
        indices += [cliques.indptr, cliques.indices, rules.indptr, rules.indices]
        room = np.zeros(len(network.rule_most))
        self.links = kernels.Links(*(index.astype(np.int64) for index in indices), rules.data.astype(float), room)

    def improve(
        self, chosen: np.ndarray, rng: np.random.Generator, is_over: Callable[[], bool], limits: np.ndarray
    ) -> np.ndarray:
        """Return a plan with at least as many visits as ``chosen``; visits to higher priorities take precedence.

        Parameters
        ----------
        chosen : ndarray of int, shape (n_positioners,)
            Candidate of each positioner in the given plan.
        rng : numpy.random.Generator
            Generator of the random order in which the search considers the targets.
        is_over : callable
            Function that returns True when the time limit has passed.
        limits : ndarray of float, shape (n_rules,)
            Largest sum of each rule.

        Returns
        -------
        ndarray of int, shape (n_positioners,)
            Candidate of each positioner in the improved plan.
        """
        network, chosen = self.network, chosen.astype(np.int64)
        self.links.room[:] = limits - network.sums(chosen)
        used = np.bincount(chosen, minlength=len(network.target))
        load = (network.matrix[: network.n_cliques] @ used).astype(np.int64)
        target = network.target[chosen]
        left = network.visits - np.bincount(target[target >= 0], minlength=len(network.slot))
        for depth in DEPTHS:
            for level in range(network.n_classes):
                mine = np.flatnonzero(network.rank_of_target == level)
                for replaces in (False, True) if level + 1 < network.n_classes else (False,):
                    gained, number = 1, 0
                    while gained and number < PASSES and not is_over():
                        order = rng.permutation(mine[left[mine] > 0])
                        gained = kernels.find_paths(order, level, replaces, depth, self.links, chosen, load, left)
                        number += 1
        return chosen
