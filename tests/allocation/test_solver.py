"""Threads of HiGHS that the search abandons at the time limit."""

import subprocess
import sys

import pytest

# The program is dense, so that its presolve takes longer than the time limit. The last object delays the end of Python
# until the thread of HiGHS ends.
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
constraints = matrix, np.full(rows, -np.inf), np.ones(rows)
deadline = time.perf_counter() + 0.2
x, bound = _solver.maximize(constraints, np.ones(n), np.ones(n), deadline, integral=True, gap=0.0, presolve=True)
assert x is None and bound == np.inf and len(_solver._abandoned) == 1

class Delay:
    wait = staticmethod(time.sleep)
    def __del__(self):
        Delay.wait(4)

{end}
delay = Delay()
"""


@pytest.mark.parametrize("end", ["", pytest.param("atexit._clear()", marks=pytest.mark.exhaustive)])
def test_the_process_ends_normally_after_a_search_was_abandoned(end):
    """Regression: the process was aborted, because the thread of HiGHS returned to Python after Python had ended."""
    done = subprocess.run([sys.executable, "-c", SCRIPT.replace("{end}", end)], capture_output=True, text=True)
    assert (done.returncode == 0) is (end == ""), done.stderr
