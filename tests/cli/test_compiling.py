"""The line that tells why a first command takes longer."""

import numba
import pytest
from numba.core import event

from rfpsurvey._cli import _compiling


@pytest.fixture
def listener(monkeypatch):
    """Register nothing for good: what is registered is removed after the test."""
    found = []
    register = event.register

    def remember(kind, listener):
        found.append((kind, listener))
        register(kind, listener)

    monkeypatch.setattr(event, "register", remember)
    yield found
    for kind, one in found:
        event.unregister(kind, one)


@pytest.mark.parametrize("watched", [True, False])
def test_it_is_printed_once_if_a_person_watches(monkeypatch, capsys, listener, watched):
    monkeypatch.setattr(_compiling.sys.stderr, "isatty", lambda: watched, raising=False)
    _compiling.announce_compilation()
    if numba.config.DISABLE_JIT:
        pytest.skip("nothing is compiled")
    for _ in range(2):
        assert numba.njit(lambda x: x + 1)(1) == 2
    assert capsys.readouterr().err.count("compiling") == int(watched)
