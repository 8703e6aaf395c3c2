"""Reachable pairs of targets and positioners."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from rfpsurvey._kernels import reach

__all__ = ["Reach"]


@dataclass(frozen=True, eq=False)
class Reach:
    """Reachable pairs, a row of positioners for each target (CSR)."""

    indptr: np.ndarray
    owner: np.ndarray
    """Positioner of each pair, ascending within a target."""
    r2: np.ndarray
    """Squared distance of target and center, mm^2."""
    n_positioners: int

    @property
    def target(self) -> np.ndarray:
        """Target of each pair."""
        return np.repeat(np.arange(len(self.indptr) - 1), np.diff(self.indptr))

    @property
    def n_reachable(self) -> int:
        """Number of targets that any positioner reaches."""
        return int(np.count_nonzero(np.diff(self.indptr)))

    def where(self, keep: np.ndarray) -> "Reach":
        """Return the pairs marked in ``keep``."""
        indptr = np.concatenate([[0], np.cumsum(keep)])[self.indptr]
        return Reach(indptr, self.owner[keep], self.r2[keep], self.n_positioners)

    @cached_property
    def by_positioner(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The same pairs as rows of targets, ascending: indptr, target, r2."""
        indptr = np.empty(self.n_positioners + 1, dtype=np.int64)
        target, source = np.empty_like(self.owner), np.empty_like(self.owner)
        reach.transpose(self.indptr, self.owner, self.n_positioners, indptr, target, source)
        return indptr, target, self.r2[source]
