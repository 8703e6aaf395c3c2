"""The numba decorator that all kernels use, and the settings of its on-disk cache.

Numba identifies an entry of its cache by the modification time and size of the file that defines a kernel. After an
edit of another file with functions that the kernel calls, or an upgrade that changes neither time nor size, numba
would therefore run old code. Here, a digest of the source of all kernels is part of the version of the cache. Numba
compares the version before it reads anything else; this is necessary because the cache of other kernels may refer to
classes that no longer exist.
"""

import hashlib
import os
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numba

__all__ = ["kernel"]


@cache
def _source_digest() -> str:
    here = Path(__file__).parent
    digest = hashlib.sha256()
    for path in sorted([Path(__file__), *(here / "_kernels").glob("*.py")]):
        digest.update(path.name.encode())
        digest.update(path.read_bytes())
    return digest.hexdigest()


def kernel(function: Callable) -> Callable:
    """Compile ``function`` on its first call, to run without the GIL, and keep the machine code on disk.

    No machine code is kept if the environment variable ``RFPSURVEY_CACHE`` is ``0`` or no folder is writable.
    Division by zero gives infinity or NaN, as in NumPy.
    """
    if os.environ.get("RFPSURVEY_CACHE") != "0":
        try:
            dispatcher = numba.njit(nogil=True, error_model="numpy", cache=True)(function)
            if hasattr(dispatcher, "_cache"):  # absent under NUMBA_DISABLE_JIT
                file = dispatcher._cache._cache_file
                file._version = (file._version, _source_digest())
            return dispatcher
        except (RuntimeError, AttributeError):  # no writable folder, or a version of numba with other internals
            pass
    return numba.njit(nogil=True, error_model="numpy")(function)
