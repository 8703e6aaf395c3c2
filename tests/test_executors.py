"""Worker processes end when the process that started them ends."""

import os
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from threading import Event

import pytest

import rfpsurvey
from rfpsurvey._executors import map_in_order, released, submit

SECONDS = 5.0

# import the package without its __init__, whose imports every new process would repeat
SCRIPT = """
import os, sys, time, types
sys.modules.setdefault("rfpsurvey", types.ModuleType("rfpsurvey")).__path__ = [PACKAGE]
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from rfpsurvey._executors import map_in_order

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
from rfpsurvey.inputs._groups import WorkerKeys
from rfpsurvey._cli._surveys import workers

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
    path = tmp_path / "script.py"
    script = script.replace("PACKAGE", repr(os.path.dirname(rfpsurvey.__file__)))
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
