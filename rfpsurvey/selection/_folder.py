"""The folder that stores the state of an unfinished computation of selection probabilities, and then its result."""

from time import monotonic

import numpy as np

from rfpsurvey._folder import RequestFolder
from rfpsurvey._io import written
from rfpsurvey.constraints import with_present_texts
from rfpsurvey.errors import InputError
from rfpsurvey.selection._state import State

EVERY = 60.0
"""Minimum time between two checkpoints of a block, in seconds."""
NAME = "selection.fits"
"""Name of the file with the result."""
BLOCK, STATE = "block-{:04d}", "state-{:04d}"
"""Names of the files of a finished block, and of the state of an unfinished block."""


class SelectionFolder(RequestFolder):
    """The folder of a computation of selection probabilities, which is locked during the computation.

    A block is a group of realizations that are planned together. Finished blocks, and the state of the unfinished
    block, are stored in NumPy files with checksums. These files are removed when the result is written.
    """

    request_name = "selection.json"
    work, parts, again = "computation of selection probabilities", "realizations", "its tiles are planned again"

    def _compare(self, before: dict, now: dict):
        super()._compare(with_present_texts(before, now), now)

    def _open(self):
        super()._open()
        self._last = monotonic()

    def save(self, name: str, **arrays: np.ndarray) -> None:
        """Write arrays to a file; if writing fails, no incomplete file remains."""
        with self.writing(f"{name}.npz") as temporary:
            np.savez(temporary, **arrays)

    def save_state(self, number: int, state: State) -> None:
        """Write the state of an unfinished block, if the last checkpoint is at least ``EVERY`` seconds old."""
        if monotonic() - self._last >= EVERY:
            self.save(STATE.format(number), left=state.left, counts=state.counts, n_rounds=np.array(state.n_rounds))
            self._last = monotonic()

    def load_state(self, number: int, state: State, n_rounds: int) -> None:
        """Restore ``state`` from the file of an unfinished block of ``n_rounds`` rounds, if there is such a file."""
        left, counts = ("u1", state.left.shape), ("i8", state.counts.shape)
        stored = self.load(STATE.format(number), left=left, counts=counts, n_rounds=("i8", ()))
        if stored is not None:
            done = int(stored["n_rounds"])
            if not 0 <= done < n_rounds:
                raise InputError(
                    f"{self.path} is damaged: block {number} must have at most {n_rounds} rounds, got {done}"
                )
            state.restore(stored["left"], stored["counts"], done)

    def save_block(self, number: int, mask: np.ndarray, counts: np.ndarray) -> None:
        """Write the masks of all targets and the counts of a finished block, and remove its state."""
        self.save(BLOCK.format(number), mask=mask, counts=counts)
        with written(self.path):
            (self.path / f"{STATE.format(number)}.npz").unlink(missing_ok=True)

    def load_block(self, number: int, n_targets: int, n: int) -> tuple[np.ndarray, np.ndarray] | None:
        """Return the masks of all targets and the counts of a block of n realizations; None if it is not finished."""
        stored = self.load(BLOCK.format(number), mask=("u4", (n_targets,)), counts=("i8", (n, 3)))
        return None if stored is None else (stored["mask"], stored["counts"])

    def finish(self) -> None:
        """Remove the files that are required only to continue an unfinished computation, and their checksums."""
        with written(self.path):
            for path in self.path.glob("*.npz"):
                path.unlink()
        self._known = {NAME: self._known[NAME]}
        super().finish()
