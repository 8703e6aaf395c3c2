"""Functions that determine the time left for a search, and that let a user end a search."""

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from math import inf
from threading import Event, current_thread, local, main_thread
from time import perf_counter

from numba.core import event

stop = Event()
"""Event that is set to end all searches early; the searches then return the best plans found so far."""
_active = Event()


class _Allowance(local):
    """The number of programs that the search of this thread may still solve."""

    programs = inf


_allowance = _Allowance()


class OutOfTimeError(Exception):
    """The deadline passed, or the number of collisions became too large, before a step of the search was complete."""


class _Compilation(event.Listener):
    """Measures the time during which numba compiles functions; it does not count against a time limit."""

    def __init__(self):
        self.seconds, self._begin, self._depth = 0.0, 0.0, 0

    def on_start(self, event: event.Event) -> None:
        if self._depth == 0:
            self._begin = perf_counter()
        self._depth += 1

    def on_end(self, event: event.Event) -> None:
        self._depth -= 1
        if self._depth == 0:
            self.seconds += perf_counter() - self._begin


_compilation = _Compilation()
event.register("numba:compile", _compilation)


def now() -> float:
    """Return the time in seconds on a clock that stops while numba compiles functions; deadlines refer to it."""
    return perf_counter() - _compilation.seconds


def left(deadline: float) -> float:
    """Return the number of seconds until a deadline; 0 if no programs are left, or if a stop was requested.

    Steps without a deadline do not end if no programs are left.
    """
    return 0.0 if _allowance.programs <= 0 and deadline < inf else seconds_until(deadline)


def seconds_until(deadline: float) -> float:
    """Return the number of seconds until a deadline, also if no programs are left; 0 if a stop was requested."""
    return 0.0 if stop.is_set() else max(deadline - now(), 0.0)


def count_program() -> None:
    """Count a program that is solved."""
    _allowance.programs -= 1


def share(deadline: float, fraction: float) -> float:
    """Return the time at which a given fraction of the time until the deadline will have passed."""
    return now() + fraction * left(deadline)


@contextmanager
def searching(programs: float) -> Iterator[None]:
    """Return a context manager for the part of a search that an interrupt (Ctrl-C) or a number of programs may end."""
    before = _allowance.programs
    _allowance.programs = programs
    _active.set()
    try:
        yield
    finally:
        _allowance.programs = before
        _active.clear()


@contextmanager
def end_on_interrupt() -> Iterator[Event]:
    """Let the first interrupt (Ctrl-C) during a search end the search, so that the best plan found so far is returned.

    All other interrupts raise KeyboardInterrupt as usual. In threads other than the main thread, the function has no
    effect.

    Yields
    ------
    Event
        Event that is set when an interrupt ends a search early.

    Examples
    --------
    >>> import astropy.units as u
    >>> import rfpsurvey as rs
    >>> robot = rs.Positioner(8.25 * u.mm, 8.25 * u.mm, 2.25 * u.mm)
    >>> plane = rs.FocalPlane([[0, 0], [25.6, 0]] * u.mm, robot)
    >>> with rs.allocation.end_on_interrupt() as interrupted:
    ...     plan = rs.allocate(plane, [[12, 0], [14, 0]] * u.mm, allocator="optimal")
    >>> interrupted.is_set()
    False
    """

    def handle(*signal_and_frame):
        if stop.is_set() or not _active.is_set():
            before(*signal_and_frame)
        stop.set()

    # only the main thread receives interrupts; a process in the background can ignore them
    if current_thread() is not main_thread() or not callable(signal.getsignal(signal.SIGINT)):
        yield Event()
        return
    before = signal.signal(signal.SIGINT, handle)
    try:
        yield stop
    finally:
        signal.signal(signal.SIGINT, before)
        stop.clear()
