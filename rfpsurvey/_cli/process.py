"""The process of a command: its standard streams, the signals that end it, and its exit code.

The module imports little, because an interrupt before the function ``main`` gives a traceback.
"""

import atexit
import os
import signal
import sys

# Signals that end a command (SIGHUP: the terminal is closed), with words for the message.
SIGNALS = {"SIGINT": "interrupted", "SIGTERM": "terminated", "SIGHUP": "terminated"}
# Time in seconds for which a command may end its work after a signal. Then, the process ends at once.
PATIENCE = 5.0

_received: list[int] = []
_kept: list[str] = []


def main() -> None:
    """Run the command that the user typed, and end the process with the exit code of the command.

    A signal raises KeyboardInterrupt in the command, so that the command stores finished results and removes its
    temporary files. The process then ends without waiting for threads, because some threads, such as those of HiGHS,
    cannot be stopped and would abort the process.
    """
    numbers = [getattr(signal, name) for name in SIGNALS if hasattr(signal, name)]
    handlers, hook = {number: signal.getsignal(number) for number in numbers}, sys.unraisablehook
    try:
        _prepare()
        from rfpsurvey._cli.application import run

        code = run()
    finally:
        if _received:  # even if a function of another package caught the KeyboardInterrupt
            _end()
        for number, handler in handlers.items():
            signal.signal(number, handler)
        sys.unraisablehook = hook
    atexit.unregister(_ignore_signals)
    atexit.register(_ignore_signals, code)
    sys.exit(code)


def _ignore_signals(code: int) -> None:
    """Let a signal end the process with the exit code of the command, because the output is complete."""
    _on_signals(lambda *_: os._exit(code))


def tell_if_interrupted(sentence: str) -> None:
    """Add a sentence to the message that is printed after a signal; the sentence states which results are stored."""
    _kept[:] = [sentence]


def set_up_worker() -> None:
    """Let a worker process ignore Ctrl-C, which ends the main process, and end with the main process."""
    from rfpsurvey._common.executors import end_with_parent
    from rfpsurvey._common.temporary import remove_all

    end_with_parent()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, lambda *_: (remove_all(), os._exit(128 + signal.SIGTERM)))


def _prepare() -> None:
    """Open closed standard streams, and catch signals."""
    for name in ("stdin", "stdout", "stderr"):
        if getattr(sys, name) is None:
            # Without this, a file of data could become the standard stream. Standard output is opened only for reading,
            # so that the lost text is an error.
            number = os.open(os.devnull, os.O_WRONLY if name == "stderr" else os.O_RDONLY)
            stream = os.fdopen(number, "r" if name == "stdin" else "w", closefd=False)
            setattr(sys, name, stream)
            setattr(sys, f"__{name}__", stream)
    sys.unraisablehook = _end_if_lost
    _on_signals(_interrupt)


def _on_signals(handler) -> None:
    """Set the handler of all signals that are not ignored; nohup, for example, ignores SIGHUP."""
    for name in SIGNALS:
        number = getattr(signal, name, None)  # Windows has no SIGHUP
        if number is not None and signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, handler)


def _interrupt(number: int, _) -> None:
    """Raise KeyboardInterrupt, and end the process later if this takes too long; end it now at the second signal."""
    if _received:
        _end()
    _received.append(number)
    if hasattr(signal, "setitimer"):
        signal.signal(signal.SIGALRM, lambda *_: _end())
        signal.setitimer(signal.ITIMER_REAL, PATIENCE)
    raise KeyboardInterrupt


def _end_if_lost(report) -> None:
    """End the process if Python ignores a KeyboardInterrupt, for example in a method ``__del__``."""
    if _received and isinstance(report.exc_value, KeyboardInterrupt):
        _end()
    sys.__unraisablehook__(report)


def _end() -> None:
    """End the worker processes, remove temporary files, print a message, and end the process."""
    code = 128 + _received[0]
    _on_signals(signal.SIG_IGN)
    if hasattr(signal, "setitimer"):
        signal.signal(signal.SIGALRM, lambda *_: os._exit(code))
        signal.setitimer(signal.ITIMER_REAL, PATIENCE)
    if "multiprocessing" in sys.modules:
        _end_workers()
    from contextlib import suppress

    from rfpsurvey._common.temporary import remove_all

    message = "; ".join([f"rfpsurvey: {SIGNALS[signal.Signals(_received[0]).name]}", *_kept]) + "\n"
    for step in (sys.stdout.flush, sys.stderr.flush, remove_all, lambda: os.write(2, message.encode())):
        with suppress(OSError, ValueError, RuntimeError):  # a stream can be closed or in use
            step()
    os._exit(code)


def _end_workers() -> None:
    import threading
    from multiprocessing import active_children

    threading.excepthook = lambda *_: None  # a thread of the executor fails if it sees the end of a worker
    workers = active_children()
    for worker in workers:
        worker.terminate()
    for worker in workers:
        worker.join(1.0)
        worker.kill()
        worker.join(1.0)
