"""Damaged plans of every format are read with all rows, scored and converted, or are refused with a sentence."""

import numpy as np
import pytest

from damaged_files import FINE, damage, outcome
from valid_plans import plan_samples

N_EACH = 3


@pytest.fixture(scope="module")
def valid(tmp_path_factory):
    return plan_samples(tmp_path_factory.mktemp("valid"))


@pytest.mark.exhaustive
def test_valid_plans_are_read_scored_and_converted(valid):
    for sample in valid:
        assert outcome(sample, sample.path) == ("read", ""), sample.path.name


@pytest.mark.few(1)
@pytest.mark.parametrize("seed", range(N_EACH))
def test_damaged_plans_are_refused_or_read_whole(valid, tmp_path, seed):
    """``python tests/benchmarks/fuzz_readers.py`` tests more files, each in a separate process."""
    for number, sample in enumerate(valid):
        folder = tmp_path / str(number)
        folder.mkdir()
        path, done = damage(np.random.default_rng([98, seed, number]), sample, folder)
        what, text = outcome(sample, path)
        assert what in FINE, f"{sample.path.name} ({done}): {what}: {text}"
