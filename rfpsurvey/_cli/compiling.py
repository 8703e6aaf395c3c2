"""The message that a command prints when numba begins to compile functions; the list of commands needs no numba."""

import sys

from numba.core import event


class _Announcement(event.Listener):
    """Event handler that prints one line when numba compiles the first function that is not in the cache of numba."""

    def __init__(self):
        self._told = False

    def on_start(self, event: event.Event) -> None:
        if not self._told:
            self._told = True
            print(
                "rfpsurvey: compiling functions for this machine; this happens only once and takes a few seconds",
                file=sys.stderr,
            )

    def on_end(self, event: event.Event) -> None:
        pass


def announce_compilation() -> None:
    """Prepare a message that is printed when numba compiles a function, but only if standard error is a terminal."""
    if sys.stderr.isatty():
        event.register("numba:compile", _Announcement())
