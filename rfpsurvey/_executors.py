"""Run function calls on executors, such as process pools; worker processes end when their parent process ends."""

import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Executor, Future
from contextlib import contextmanager
from functools import cache, partial

from rfpsurvey._progress import Progress
from rfpsurvey.errors import InputTypeError, short


def map_in_order(executor: Executor | None, function: Callable, *arguments: Iterable) -> Iterator:
    """Yield the results of function calls, in the order of the arguments.

    If ``executor`` is None, the calls run in the present thread.
    """
    if not isinstance(executor, Executor | None):
        raise InputTypeError(f"executor must be a concurrent.futures.Executor, got {short(executor)}")
    if executor is None:
        return map(function, *arguments)
    return executor.map(_for_workers(executor, function), *arguments)


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
    return executor.submit(_for_workers(executor, function), *arguments)


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
    os._exit(1)


def _in_worker(function, *arguments):
    """Call a function in a worker process; the first call makes the process end when the parent process ends."""
    end_with_parent()
    return function(*arguments)


def _for_workers(executor, function):
    """Return the function to submit to an executor; for a process pool, `_in_worker` calls it."""
    from concurrent.futures import ProcessPoolExecutor

    return partial(_in_worker, function) if isinstance(executor, ProcessPoolExecutor) else function
