"""Results in the order of the calls, and worker processes, which end when the process that started them ends."""

import os
import signal
import subprocess
import sys
import time
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import nullcontext, suppress
from operator import attrgetter
from threading import Event
from typing import NamedTuple

import numpy as np
import pytest

import rfpsurvey
from rfpsurvey._common.executors import in_order, map_in_order, released, submit

SECONDS = 5.0

# import the package without its __init__, whose imports every new process would repeat
SCRIPT = """
import os, sys, time, types
sys.modules.setdefault("rfpsurvey", types.ModuleType("rfpsurvey")).__path__ = [PACKAGE]
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from rfpsurvey._common.executors import map_in_order

def work(seconds):
    time.sleep(seconds)
    return os.getpid()

if __name__ == "__main__":
    with ProcessPoolExecutor(2, get_context(sys.argv[1])) as pool:
        print(*set(map_in_order(pool, work, [0.5, 0.5])), flush=True)
        list(map_in_order(pool, work, [float(sys.argv[2])] * 2))
"""

COMMAND = """
import os, sys, time
from rfpsurvey._survey.key_groups import WorkerKeys
from rfpsurvey._cli.results import workers

if __name__ == "__main__":
    with workers(WorkerKeys(2, processes=True)) as pool:
        print(*{pool.submit(os.getpid).result() for _ in range(8)}, flush=True)
        time.sleep(600)
"""


def is_alive(pid):
    """Return whether a process runs. A process that has ended is listed until its status is read."""
    try:
        with open(f"/proc/{pid}/stat") as file:
            return file.read().rpartition(")")[2].split()[0] not in "ZX"
    except FileNotFoundError:
        return False


@pytest.mark.skipif(not os.path.isdir("/proc/self"), reason="needs /proc to look at processes")
@pytest.mark.parametrize(
    ("script", "arguments"),
    [(SCRIPT, ["spawn", "0.01"]), (SCRIPT, ["fork", "600"]), (COMMAND, [])],
    ids=["idle workers", "busy workers", "workers of the command"],
)
def test_workers_end_when_their_parent_is_killed(tmp_path, script, arguments):
    """Regression: each worker waited for work forever, with 215 MB of memory."""
    path, script = tmp_path / "script.py", script.replace("PACKAGE", repr(os.path.dirname(rfpsurvey.__file__)))
    path.write_text(script if arguments[-1:] != ["0.01"] else script + "        time.sleep(600)\n")
    parent = subprocess.Popen([sys.executable, "-W", "ignore", path, *arguments], stdout=subprocess.PIPE, text=True)
    try:
        workers = [int(word) for word in parent.stdout.readline().split()]
        assert workers
        assert all(map(is_alive, workers))
    finally:
        parent.send_signal(signal.SIGKILL)
        parent.wait()
        parent.stdout.close()
    begin = time.monotonic()
    while any(map(is_alive, workers)) and time.monotonic() - begin < SECONDS:
        time.sleep(0.05)
    left = [pid for pid in workers if is_alive(pid)]
    for pid in left:
        os.kill(pid, signal.SIGKILL)
    assert not left


def test_results_come_in_the_order_of_the_arguments():
    numbers = list(range(20))
    with ThreadPoolExecutor(3) as pool:
        for executor in (None, pool):
            assert list(map_in_order(executor, pow, numbers, [2] * 20)) == [n * n for n in numbers]
        assert submit(pool, pow, 2, 3).result() == 8


def test_an_interrupt_does_not_wait_for_calls_that_still_run():
    end, begun = Event(), Event()

    def call():
        begun.set()
        end.wait(60)

    with suppress(KeyboardInterrupt), released(ThreadPoolExecutor(1)) as executor:
        running, waiting = (executor.submit(call) for _ in range(2))
        begun.wait(60)
        raise KeyboardInterrupt
    assert running.running()
    assert waiting.cancelled()
    end.set()
    with released(ThreadPoolExecutor(1)) as executor:
        done = executor.submit(sum, [1, 2])
    assert done.result(0) == 3


def test_read_only_arrays_are_read_only_in_processes():
    """Regression: numba compiled kernels again in each process, because all arrays there could be written."""
    locked = np.arange(3.0)
    locked.flags.writeable = False
    with ProcessPoolExecutor(1) as pool:
        found = list(map_in_order(pool, attrgetter("flags.writeable"), [np.arange(3.0), locked]))
        one = submit(pool, attrgetter("flags.writeable"), locked).result()
    assert (found, one) == ([True, False], False)


class Named(NamedTuple):
    """A job, of which only the name of the tile is needed."""

    tile: int


def jobs(known=()):
    return ((Named(k), k, -k if k in known else None) for k in range(20))


@pytest.mark.parametrize("together", [1, 3, 8, 50])
@pytest.mark.parametrize("pool", [None, 1, 3])
def test_the_results_are_in_order(together, pool):
    known = {0, 4, 5, 6, 19}
    with nullcontext() if pool is None else ThreadPoolExecutor(pool) as executor:
        found = list(in_order(executor, lambda k: 2 * k, jobs(known), 7, together))
    assert found == [(Named(k), -k if k in known else 2 * k, k not in known) for k in range(20)]


@pytest.mark.parametrize("together", [1, 4])
def test_an_error_names_its_tile_and_later_tasks_are_cancelled(together):
    begun = []

    def work(k):
        begun.append(k)
        return 1 // (k - 5)

    with ThreadPoolExecutor(1) as executor, pytest.raises(ZeroDivisionError) as error:
        for _ in in_order(executor, work, jobs(), 8, together):
            pass
    assert error.value.__notes__ == ["while tile 5 was planned"]
    assert 5 in begun
    assert len(begun) < 20


def test_few_jobs_are_made_before_the_first_result_is_awaited():
    made = []

    def count():
        for job in jobs():
            made.append(job)
            yield job

    with ThreadPoolExecutor(1) as executor:
        next(in_order(executor, abs, count(), 8, 4))
        assert len(made) == 8
