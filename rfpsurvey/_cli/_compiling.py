"""The message that the first command prints while numba compiles functions."""

import sys

from numba.core import event

__all__ = ["announce_compilation"]


class _Announcement(event.Listener):
    """Handler that prints one line per process when numba compiles a function that is not in its cache."""

    def __init__(self):
        self._told = False

    def on_start(self, event: event.Event) -> None:
        if not self._told:
            self._told = True
            print(
                "rfpsurvey: compiling functions for this machine; this happens only once and takes some seconds",
                file=sys.stderr,
            )

    def on_end(self, event: event.Event) -> None:
        pass


def announce_compilation() -> None:
    """Print a line before the first compilation, if standard error is a terminal."""
    if sys.stderr.isatty():
        event.register("numba:compile", _Announcement())
