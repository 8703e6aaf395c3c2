"""The embedded default in fresh processes, without and with a cache of compiled kernels."""

from cold_start import plan_seconds


def test_the_embedded_default_starts_fast(tmp_path):
    """Under 20 s with all kernels to be compiled, under 3 s with a cache: the least of several."""
    cold, *warm = plan_seconds(str(tmp_path), 3)
    assert cold < 20
    assert min(warm) < 3
