"""Run function calls on executors, such as process pools, and show the progress of a run.

Worker processes end when their parent process ends. The progress is one line of the standard error stream.
"""

import os
import pickle
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import BrokenExecutor, Executor, Future
from contextlib import contextmanager
from functools import cache, partial
from itertools import islice
from time import monotonic

from rfpsurvey.errors import InputTypeError, check_switch, short

EVERY = 0.1  # shortest time between two updates of the line, in seconds


class Progress:
    """Shows the progress of a run with the rate and the remaining time, or passes the progress to a function.

    The rate includes only new work of this run, because reading the results of an earlier run is much faster.

    Parameters
    ----------
    progress : bool or callable
        With True, a line is shown; with False, nothing is shown. A function is called with the amount of work that is
        done and the total amount of work.
    total : float, optional
        Total amount of work; 1 if the progress is given as a fraction.
    unit : str, optional
        Unit of the work, in the plural; if it is empty, the progress is shown in percent.
    done : float, optional
        Amount of work that an earlier run did.
    """

    def __init__(self, progress: object, total: float = 1, unit: str = "", *, done: float = 0):
        self._tell = progress if callable(progress) else None
        self._shown = self._tell is None and check_switch(progress, "progress")
        self._total, self._unit, self._done = total, unit, done
        self._note = ""
        self._new, self._seconds, self._last, self._line = 0.0, 0.0, monotonic(), None

    def __call__(self, done: float, *, new: bool = True, note: str = "") -> None:
        """Update the amount of work done.

        With ``new=False``, the work that was added since the last call was done by an earlier run. The text ``note``,
        such as the stage of a run, is shown at the end of the line.
        """
        self._note = f", {note}" if note else ""
        now = monotonic()
        if new:
            self._new += done - self._done
            self._seconds += now - self._last
        self._done, self._last = done, now
        if self._tell is not None:
            self._tell(done, self._total)
        elif self._line is not None and (now - self._drawn >= EVERY or done == self._total):
            self._draw()

    def __enter__(self):
        self._last = self._drawn = monotonic()
        if self._shown:
            from rich import console, progress

            bar, text = progress.BarColumn(), progress.TextColumn("{task.description}")
            where = console.Console(stderr=True, force_jupyter=False)
            # The line is updated without a thread, because a process with threads cannot be forked safely.
            self._line = progress.Progress(
                bar, text, console=where, auto_refresh=False, redirect_stdout=False, redirect_stderr=False
            )
            self._task = self._line.add_task("", total=self._total, completed=self._done)
            self._line.start()
        return self

    def __exit__(self, *_):
        if self._line is not None:
            self._draw()
            self._line.stop()
            self._line = None

    def _draw(self):
        self._drawn = self._last
        self._line.update(self._task, completed=self._done, description=self._text(), refresh=True)

    def _text(self):
        rate = self._new / self._seconds if self._seconds > 0 else 0.0
        left = f", {_clock((self._total - self._done) / rate)} left" if rate > 0 else ""
        if not self._unit:
            return f"{self._done / self._total:.0%}{left}{self._note}"
        kept = round(self._done - self._new)
        kept = f" ({kept} of them from an earlier run)" if kept else ""
        return f"{self._done} of {self._total} {self._unit}{kept}, {rate:.1f} {self._unit}/s{left}{self._note}"


def _clock(seconds: float) -> str:
    minutes, seconds = divmod(round(seconds), 60)
    return f"{minutes // 60}:{minutes % 60:02d}:{seconds:02d}"


# Largest number of tiles that are submitted to an executor before the result of the first of these tiles is awaited.
IN_FLIGHT = 256


def map_in_order(executor: Executor | None, function: Callable, *arguments: Iterable) -> Iterator:
    """Yield the results of function calls, in the order of the arguments.

    If ``executor`` is None, the calls run in the present thread.
    """
    if not isinstance(executor, Executor | None):
        raise InputTypeError(f"executor must be a concurrent.futures.Executor, got {short(executor)}")
    if executor is None:
        return map(function, *arguments)
    if _is_process_pool(executor):
        return executor.map(partial(_in_worker, _packed(function)), *(map(_packed, each) for each in arguments))
    return executor.map(function, *arguments)


def map_with_progress(
    executor: Executor | None, progress: bool | Callable, unit: str, function: Callable, *arguments: Sequence
) -> list:
    """Return the results of function calls, in the order of the arguments, and show the progress of the calls."""
    results = []
    with Progress(progress, len(arguments[0]), unit) as line:
        for result in map_in_order(executor, function, *arguments):
            results.append(result)
            line(len(results))
    return results


def submit(executor: Executor, function: Callable, *arguments: object) -> Future:
    """Submit a function call to an executor, and return the future of its result."""
    if _is_process_pool(executor):
        return executor.submit(_in_worker, _packed(function), *map(_packed, arguments))
    return executor.submit(function, *arguments)


def in_order(
    executor: Executor | None, function: Callable, jobs: Iterable, most: int = IN_FLIGHT, together: int = 1
) -> Iterator:
    """Yield the job of each tile, its result, and whether this run computed the result.

    ``jobs`` yields the job, the argument of ``function``, and the result if it is already known; a job is created when
    it is submitted. With an executor, each task consists of ``together`` jobs, and at most ``most`` tiles, rounded up
    to whole tasks, are submitted before the result of the first task is awaited.
    """
    waiting, jobs, together = deque(), iter(jobs), 1 if executor is None else together
    try:
        while part := list(islice(jobs, together)):
            calls = [(job.tile, argument) for job, argument, known in part if known is None]
            with _telling_remedy():
                is_task = executor is not None and calls
                results = submit(executor, _call, function, calls) if is_task else _call(function, calls)
            waiting.append((part, results))
            if executor is None or len(waiting) * together >= most:
                yield from _take(waiting)
        while waiting:
            yield from _take(waiting)
    finally:
        for _, results in waiting:
            if not isinstance(results, list):
                results.cancel()


def _take(waiting: deque) -> Iterator:
    """Wait for the task that was submitted first, and yield each of its jobs, as `in_order` does."""
    part, results = waiting.popleft()
    with _telling_remedy():
        new = iter(results if isinstance(results, list) else results.result())
    for job, _, known in part:
        yield job, next(new) if known is None else known, known is None


def _call(function: Callable, calls: list) -> list:
    """Call a function for each of several tiles; errors name the tile. Each call is a tile and an argument."""
    results = []
    for tile, argument in calls:
        try:
            results.append(function(argument))
        except Exception as error:
            error.add_note(f"while tile {tile} was planned")
            raise
    return results


@contextmanager
def _telling_remedy():
    """Add a remedy to the message if a worker process ended abruptly."""
    try:
        yield
    except BrokenExecutor as error:
        text = (
            "a worker process died; the files of finished tiles remain: continue the survey with resume=True (--resume)"
        )
        raise BrokenExecutor(text) from error


def is_local(executor: Executor | None) -> bool:
    """Return whether an executor runs function calls in other threads or processes of this machine."""
    from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor

    return isinstance(executor, ProcessPoolExecutor | ThreadPoolExecutor)


@contextmanager
def released(executor: Executor) -> Iterator[Executor]:
    """Shut down an executor at the end of the context; after an interrupt, do not wait for calls that still run."""
    interrupted = False
    try:
        yield executor
    except KeyboardInterrupt:
        interrupted = True
        raise
    finally:
        executor.shutdown(wait=not interrupted, cancel_futures=True)


@cache
def end_with_parent() -> None:
    """Make this process end within a second after its parent process ends, even if the parent is killed.

    Otherwise, workers of a `concurrent.futures.ProcessPoolExecutor` would wait for work forever after their parent
    process has ended.
    """
    from multiprocessing import parent_process
    from threading import Thread

    parent = parent_process()
    if parent is not None:
        Thread(target=_end_after, args=(parent,), daemon=True, name="rfpsurvey-end-with-parent").start()


def _end_after(parent) -> None:
    parent.join()
    os._exit(1)  # without waiting for other threads of this process


def _packed(value: object) -> bytes:
    """Return a value as bytes, in which read-only arrays remain read-only.

    Numba would otherwise compile in each worker process the kernels that this process has already compiled, because
    read-only arrays have another type than other arrays. Process pools use an older protocol of pickle, by which all
    arrays can be written.
    """
    return pickle.dumps(value, 5)


def _in_worker(function: bytes, *arguments: bytes):
    """Call a function in a worker process; the first call makes the process end when the parent process ends."""
    end_with_parent()
    return pickle.loads(function)(*map(pickle.loads, arguments))


def _is_process_pool(executor: Executor) -> bool:
    from concurrent.futures import ProcessPoolExecutor

    return isinstance(executor, ProcessPoolExecutor)
