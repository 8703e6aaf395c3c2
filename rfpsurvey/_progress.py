"""Show the progress of a run on one line of the standard error stream."""

from time import monotonic

from rfpsurvey.errors import check_switch

EVERY = 0.1  # shortest time between two updates of the line, in seconds


class Progress:
    """Shows the progress of a run with the rate and the remaining time, or passes the progress to a function.

    The rate includes only new work of this run, because reading the results of an earlier run is much faster.

    Parameters
    ----------
    progress : bool or callable
        With True, a line is shown; with False, nothing is shown. A function is called with the amount of work that is
        done and the total amount of work.
    total : float, optional
        Total amount of work; 1 if the progress is given as a fraction.
    unit : str, optional
        Unit of the work, in the plural; if it is empty, the progress is shown in percent.
    done : float, optional
        Amount of work that an earlier run did.
    """

    def __init__(self, progress: object, total: float = 1, unit: str = "", *, done: float = 0):
        self._tell = progress if callable(progress) else None
        self._shown = self._tell is None and check_switch(progress, "progress")
        self._total, self._unit, self._done = total, unit, done
        self._note = ""
        self._new, self._seconds, self._last, self._line = 0.0, 0.0, monotonic(), None

    def __call__(self, done: float, *, new: bool = True, note: str = "") -> None:
        """Update the amount of work done.

        With ``new=False``, the work that was added since the last call was done by an earlier run. The text ``note``,
        such as the stage of a run, is shown at the end of the line.
        """
        self._note = f", {note}" if note else ""
        now = monotonic()
        if new:
            self._new += done - self._done
            self._seconds += now - self._last
        self._done, self._last = done, now
        if self._tell is not None:
            self._tell(done, self._total)
        elif self._line is not None and (now - self._drawn >= EVERY or done == self._total):
            self._draw()

    def __enter__(self):
        self._last = self._drawn = monotonic()
        if self._shown:
            from rich import console, progress

            bar, text = progress.BarColumn(), progress.TextColumn("{task.description}")
            where = console.Console(stderr=True, force_jupyter=False)
            # The line is updated without a thread, because a process with threads cannot be forked safely.
            self._line = progress.Progress(
                bar, text, console=where, auto_refresh=False, redirect_stdout=False, redirect_stderr=False
            )
            self._task = self._line.add_task("", total=self._total, completed=self._done)
            self._line.start()
        return self

    def __exit__(self, *_):
        if self._line is not None:
            self._draw()
            self._line.stop()
            self._line = None

    def _draw(self):
        self._drawn = self._last
        self._line.update(self._task, completed=self._done, description=self._text(), refresh=True)

    def _text(self):
        rate = self._new / self._seconds if self._seconds > 0 else 0.0
        left = f", {_clock((self._total - self._done) / rate)} left" if rate > 0 else ""
        if not self._unit:
            return f"{self._done / self._total:.0%}{left}{self._note}"
        kept = round(self._done - self._new)
        kept = f" ({kept} of them from an earlier run)" if kept else ""
        return f"{self._done} of {self._total} {self._unit}{kept}, {rate:.1f} {self._unit}/s{left}{self._note}"


def _clock(seconds: float) -> str:
    minutes, seconds = divmod(round(seconds), 60)
    return f"{minutes // 60}:{minutes % 60:02d}:{seconds:02d}"
