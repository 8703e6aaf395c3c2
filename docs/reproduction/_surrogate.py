"""Make the file ``rfpsurvey/probability/surrogate.npz``."""

from concurrent.futures import Executor
from pathlib import Path

import numpy as np

from rfpsurvey._common.executors import map_with_progress
from rfpsurvey._common.io import writing_to
from rfpsurvey._common.units import to_generator
from rfpsurvey._studies.surrogate import AXES, interior_probability

__all__ = ["make_surrogate"]

N_POINTS = 1024


def make_surrogate(
    path: Path | str, *, rng: int = 0, executor: Executor | None = None, progress: bool = False, overwrite: bool = False
) -> None:
    """Compute the collision probabilities of the grid of designs, and write them to a file."""
    grid = np.stack(np.meshgrid(*AXES.values(), indexing="ij"), axis=-1)
    shapes = [tuple(s) for s in grid.reshape(-1, 3).tolist()]
    sources, numbers = to_generator(rng).spawn(len(shapes)), [N_POINTS] * len(shapes)
    found = map_with_progress(executor, progress, "designs", interior_probability, shapes, numbers, sources)
    values = [value for value, _ in found]
    with writing_to(path, (".npz",), overwrite=overwrite) as temporary, open(temporary, "wb") as file:
        np.savez_compressed(file, risk=np.array(values, dtype=np.float32).reshape(grid.shape[:-1]))
