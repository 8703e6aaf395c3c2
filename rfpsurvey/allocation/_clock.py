"""The time that is left for a search."""

from threading import Event
from time import perf_counter

__all__ = ["OutOfTimeError", "left", "share", "stop"]

stop = Event()
"""Set it to end all searches early; they then return the best plans found so far."""


class OutOfTimeError(Exception):
    """The deadline passed before a step was complete."""


def left(deadline: float) -> float:
    """Return the number of seconds until a time of `time.perf_counter`; 0 if it has passed or a stop was requested."""
    return 0.0 if stop.is_set() else max(deadline - perf_counter(), 0.0)


def share(deadline: float, fraction: float) -> float:
    """Return the time at which a fraction of the remaining time will have passed."""
    return perf_counter() + fraction * left(deadline)
