"""A small plan in new processes, without and with a cache of compiled kernels."""

import pytest

from cold_start import plan_seconds, processor_time


@pytest.mark.exhaustive
def test_the_embedded_default_starts_fast(tmp_path):
    """The smallest of several times is below 20 s if all kernels are compiled, and below 3 s with a cache.

    Times are processor times, which depend less on other processes than wall times.
    """
    cold, *warm = plan_seconds(str(tmp_path), 3, processor_time)
    assert cold < 20
    assert min(warm) < 3
