"""A message that explains why a first command takes longer."""

import sys

from numba.core import event

__all__ = ["announce_compilation"]


class _Announcement(event.Listener):
    """Prints a line when kernels that are not in the cache are compiled, once per process."""

    def __init__(self):
        self._told = False

    def on_start(self, event: event.Event) -> None:
        if not self._told:
            self._told = True
            print("rfpsurvey: compiling for this machine, once; this takes some seconds", file=sys.stderr)

    def on_end(self, event: event.Event) -> None:
        pass


def announce_compilation() -> None:
    """Print a line before the first compilation, if the output is a terminal."""
    if sys.stderr.isatty():
        event.register("numba:compile", _Announcement())
