"""A small plan in new processes, without and with a cache of compiled kernels."""

import subprocess
import sys

import pytest

from cold_start import BASE, plan_seconds, processor_time, seconds

COMPILED = """
import sys
from numba.core import event
compiled = []
class Listener(event.Listener):
    def on_start(self, found):
        compiled.append(found)
    def on_end(self, found):
        pass
event.register("numba:compile", Listener())
from rfpsurvey._cli import main
sys.argv = ["rfpsurvey", "plan"]
try:
    main()
finally:
    print("compiled", len(compiled))
"""


def compiled(folder, monkeypatch):
    """Return how many functions numba compiles for the embedded default."""
    for name, value in {"NUMBA_CACHE_DIR": str(folder), "RFPSURVEY_CACHE": "1"}.items():
        monkeypatch.setenv(name, value)
    done = subprocess.run([sys.executable, "-c", COMPILED], capture_output=True, text=True, check=True)
    return int(done.stdout.split()[-1])


@pytest.mark.exhaustive
def test_only_the_first_start_compiles(tmp_path, monkeypatch):
    """The first plan compiles few functions; later plans compile none, and take little longer than the imports.

    Counts and ratios depend less on other processes than times.
    """
    assert 20 < compiled(tmp_path, monkeypatch) <= 70
    assert compiled(tmp_path, monkeypatch) == 0
    imports = min(seconds([sys.executable, "-c", BASE], processor_time) for _ in range(3))
    assert min(plan_seconds(str(tmp_path), 2, processor_time)) < 3 * imports
