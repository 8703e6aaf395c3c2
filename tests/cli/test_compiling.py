"""The message that explains why the first command takes longer."""

import numba
import pytest
from numba.core import event

from rfpsurvey._cli import _compiling

register = event.register


@pytest.fixture
def registered(monkeypatch):
    """Return the listeners that the command registers, and check that none remains after the test."""
    found = []
    monkeypatch.setattr(_compiling.event, "register", lambda kind, one: (found.append(one), register(kind, one)))
    yield found
    for one in found:
        event.unregister("numba:compile", one)


@pytest.mark.parametrize("watched", [True, False])
def test_it_is_printed_once_if_a_person_watches(monkeypatch, capsys, registered, watched):
    monkeypatch.setattr(_compiling.sys.stderr, "isatty", lambda: watched, raising=False)
    _compiling.announce_compilation()
    assert len(registered) == int(watched)
    monkeypatch.setattr(_compiling.event, "register", register)  # numba registers further listeners
    if numba.config.DISABLE_JIT:
        pytest.skip("nothing is compiled")
    for _ in range(2):
        assert numba.njit(lambda x: x + 1)(1) == 2
    assert capsys.readouterr().err.count("compiling") == int(watched)
