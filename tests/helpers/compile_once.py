"""Test processes that run at the same time compile each kernel once."""

from contextlib import suppress
from pathlib import Path

from filelock import FileLock, Timeout

from rfpsurvey._kernels.jit import _Cache

PATIENCE = 120
"""Time in seconds after which a process compiles a kernel itself, for example because the other process has failed."""


def compile_once(folder: Path) -> None:
    """Let this process wait while another process compiles a kernel that it needs, and then read the compiled code.

    ``folder`` is for the locks of all kernels, and is the same for all processes.
    """

    def load(cache, signature, context):
        found = cache._opened.load_overload(signature, context)
        if found is None:
            name = f"{cache._function.__module__}.{cache._function.__qualname__}.lock"
            lock = cache.__dict__.setdefault("_lock", FileLock(folder / name))
            with suppress(Timeout):
                lock.acquire(PATIENCE, poll_interval=0.02)
                found = cache._opened.load_overload(signature, context)
            if found is not None:
                lock.release()
        return found

    def save(cache, signature, compiled):
        try:
            cache._opened.save_overload(signature, compiled)
        finally:
            cache._lock.release()

    _Cache.load_overload, _Cache.save_overload = load, save
