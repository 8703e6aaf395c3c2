"""Threads of HiGHS that the search abandons at the time limit."""

import subprocess
import sys
from threading import Event
from types import SimpleNamespace

import pytest

from rfpsurvey.allocation import _solver

# The program is dense, so that its presolve takes longer than the time limit. A thread that is cancelled before the
# presolve begins ends at once; longer time limits are therefore tried until a thread continues to run. The last object
# delays the end of Python until the thread of HiGHS ends; without the exit handler, this end aborts the process.
SCRIPT = """
import atexit, time
import numpy as np
from scipy.sparse import csr_array
from rfpsurvey.allocation import _solver

n, rows = 1500, 12000
column = np.random.default_rng(0).integers(0, n, 6 * rows)
matrix = csr_array((np.ones(6 * rows), (np.repeat(np.arange(rows), 6), column)), shape=(rows, n))
matrix.data[:] = 1
_solver.GRACE = 0.0
_solver.AT_EXIT = 90.0  # the thread needs longer on a busy machine
constraints = matrix, np.full(rows, -np.inf), np.ones(rows)
for seconds in (0.2, 0.4, 0.6, 0.8, 1.0, 1.5, 2.0):
    _solver._abandoned.clear()
    deadline = time.perf_counter() + seconds
    x, bound = _solver.maximize(constraints, np.ones(n), np.ones(n), deadline, integral=True, gap=0.0, presolve=True)
    assert x is None and bound == np.inf
    time.sleep(0.2)
    if any(thread.is_alive() for thread in _solver._abandoned):
        break
else:
    raise RuntimeError("no thread continued to run after its search was abandoned")

class Delay:
    wait = staticmethod(time.sleep)
    def __del__(self):
        Delay.wait({delay})

{end}
delay = Delay()
"""


def run(end: str, delay: int) -> subprocess.CompletedProcess:
    """Run the script, with the line ``end`` before its end and the given delay (s)."""
    script = SCRIPT.replace("{end}", end).replace("{delay}", str(delay))
    return subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)


def test_the_process_ends_normally_after_a_search_was_abandoned():
    """Regression: the process was aborted, because the thread of HiGHS returned to Python after Python had ended."""
    done = run("", 4)
    assert done.returncode == 0, done.stderr


@pytest.mark.exhaustive
def test_the_process_is_aborted_without_the_exit_handler():
    done = run("atexit._clear()", 60)
    assert done.returncode < 0, done.stderr


def test_an_interrupted_search_waits_for_its_thread_at_the_end_of_the_process(monkeypatch):
    """Regression: the thread of HiGHS was not recorded if an interrupt ended the search, and aborted the process."""

    def interrupt():
        raise KeyboardInterrupt

    end, cancelled = Event(), []
    monkeypatch.setattr(_solver, "_abandoned", [])
    monkeypatch.setattr(_solver, "now", interrupt)
    with pytest.raises(KeyboardInterrupt):
        _solver._run(SimpleNamespace(run=end.wait, cancelSolve=lambda: cancelled.append(True)), 60.0)
    assert [thread.is_alive() for thread in _solver._abandoned] == [True]
    assert cancelled == [True]
    end.set()
