"""The numba decorators of all kernels, and the settings of the on-disk cache of compiled kernels.

Numba identifies the cached code of a kernel by the modification time and size of the file that defines the kernel.
Numba would therefore run old code in two cases. First, a function that the kernel calls may be edited in another file.
Second, an upgrade of rfpsurvey may change the code of a file, but neither its modification time nor its size. To
prevent the use of old code, the version of the cache contains a digest of the source of all kernels. Numba checks this
version before it reads the cached code. Numba therefore never reads old code that refers to removed classes.
"""

import hashlib
import os
import secrets
from collections.abc import Callable
from contextlib import contextmanager, suppress
from functools import cache, cached_property
from pathlib import Path

import numba

from rfpsurvey._common.temporary import temporary

# No C code calls a kernel; without a C function of each kernel, numba compiles them in about 5 % less time.
_OPTIONS = {"nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True}


@cache
def _source_digest() -> str:
    digest = hashlib.sha256()
    for path in sorted(Path(__file__).parent.glob("*.py")):
        digest.update(path.name.encode())
        digest.update(path.read_bytes())
    return digest.hexdigest()


def kernel(function: Callable) -> Callable:
    """Compile ``function`` when it is first called, and store the machine code on disk; calls release the GIL.

    No machine code is stored if the environment variable ``RFPSURVEY_CACHE`` is ``0``, or if there is no
    writable folder for the cache. Division by zero gives infinity or NaN, as in NumPy.
    """
    dispatcher = numba.njit(**_OPTIONS)(function)
    if os.environ.get("RFPSURVEY_CACHE") != "0" and hasattr(dispatcher, "_cache"):  # NUMBA_DISABLE_JIT: the function
        dispatcher._cache = _Cache(function)
    return dispatcher


class _Cache:
    """The on-disk cache of a kernel, opened when the kernel is first called: 119 caches are a sixth of the import."""

    def __init__(self, function: Callable):
        self._function = function

    @cached_property
    def _opened(self):
        try:
            from numba.core.caching import FunctionCache, NullCache

            cache = FunctionCache(self._function)
            _make_safe(cache._cache_file)
            return cache
        except (RuntimeError, AttributeError):  # no folder is writable, or this version of numba has other internals
            return NullCache()

    def __getattr__(self, name: str):
        return getattr(self._opened, name)


def _make_safe(file) -> None:
    """Let the cache of a kernel never contain incomplete or old code, even if numba is interrupted."""
    file._version = (file._version, _source_digest())
    file._open_for_write = _open_for_write
    save, save_code = file._save_index, file.save

    def save_if_possible(key, code):
        with suppress(OSError):  # a kernel that cannot be stored, for example on a full disk, is compiled again later
            save_code(key, code)

    def save_index(names):
        # numba writes the new names before the code; a file of old code could then have a new name
        for name in {*names.values()} - {*file._load_index().values()}:
            Path(file._data_path(name)).unlink(missing_ok=True)
        save(names)

    file._save_index, file.save = save_index, save_if_possible


@contextmanager
def _open_for_write(path):
    """Provide a file that is renamed to ``path`` at the end; in contrast to numba, an interrupt leaves no file."""
    with temporary(Path(f"{path}.tmp.{secrets.token_hex(8)}")) as new_path:
        with new_path.open("wb") as file:
            yield file
        os.replace(new_path, path)


def inlined_kernel(function: Callable) -> Callable:
    """Compile ``function`` as a part of each kernel that calls it (inlining).

    If arrays are passed in a named tuple, the call of a short function can take longer than the computation inside the
    function.
    """
    return numba.njit(inline="always", **_OPTIONS)(function)


def inner_kernel(function: Callable) -> Callable:
    """Compile ``function`` for calls by kernels only, which takes less time than for calls from Python."""
    return numba.njit(no_cpython_wrapper=True, **_OPTIONS)(function)
