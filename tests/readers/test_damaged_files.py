"""Damaged files of every format are read with all rows, or are refused with a sentence."""

import numpy as np
import pytest

from damaged_files import FINE, damage, outcome
from valid_files import samples
from valid_inputs import inputs

N_EACH = 10


@pytest.fixture(scope="module")
def valid(tmp_path_factory):
    folder = tmp_path_factory.mktemp("valid")
    return samples(folder) + inputs(folder)


def test_valid_files_are_read(valid):
    for sample in valid:
        assert outcome(sample, sample.path) == ("read", ""), sample.path.name


@pytest.mark.few(1)
@pytest.mark.parametrize("seed", range(N_EACH))
def test_damaged_files_are_refused_or_read_whole(valid, tmp_path, seed):
    """``python tests/benchmarks/fuzz_readers.py`` tests more files, each in a separate process."""
    for number, sample in enumerate(valid):
        folder = tmp_path / str(number)
        folder.mkdir()
        path, done = damage(np.random.default_rng([99, seed, number]), sample, folder)
        what, text = outcome(sample, path)
        assert what in FINE, f"{sample.path.name} ({done}): {what}: {text}"
