"""Measure the times of new processes: the import of the package, and a small plan with and without cached kernels.

Run ``python tests/benchmarks/cold_start.py``. It prints medians of five runs; the run without a cache is done once.
"""

import os
import statistics
import subprocess
import sys
import tempfile
import time

BASE = "import astropy.coordinates, astropy.table, numba, scipy.spatial"
PLAN = [sys.executable, "-m", "rfpsurvey", "plan"]


def processor_time():
    """Return the processor time of all child processes so far."""
    times = os.times()
    return times.children_user + times.children_system


def seconds(command, clock=time.perf_counter, **environment):
    """Return the wall time of a process, or its time on another clock."""
    start = clock()
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL, env={**os.environ, **environment})
    return clock() - start


def plan_seconds(folder, repeats, clock=time.perf_counter, options=()):
    """Return the times of a small plan: the first is without a cache, and all others are with a cache."""
    settings = {"NUMBA_CACHE_DIR": folder, "NUMBA_BOUNDSCHECK": "0", "RFPSURVEY_CACHE": "1"}
    return [seconds([*PLAN, *options], clock, **settings) for _ in range(repeats + 1)]


if __name__ == "__main__":
    imports = {"dependencies": BASE, "rfpsurvey": "import rfpsurvey"}
    times = {name: [] for name in imports}
    for _ in range(5):
        for name, statement in imports.items():
            times[name].append(seconds([sys.executable, "-c", statement]))
    with tempfile.TemporaryDirectory() as folder:
        cold, *warm = plan_seconds(folder, 5)
    times |= {"plan, cold": [cold], "plan, warm": warm}
    with tempfile.TemporaryDirectory() as folder:
        cold, *warm = plan_seconds(folder, 5, options=["--allocator", "optimal"])
    times |= {"optimal, cold": [cold], "optimal, warm": warm}
    for name, values in times.items():
        print(f"{name:<14}{statistics.median(values):8.3f} s")
