"""How far a run has come, on one line."""

import sys
from time import monotonic

__all__ = ["Ticker"]

EVERY = 0.5  # seconds


class Ticker:
    """Tells a function how much is done, or writes it to standard error with the rate and the remaining time."""

    def __init__(self, progress: object, total: int):
        self._tell = progress if callable(progress) else None
        self._shown, self._open = bool(progress) and self._tell is None, False
        self._total, self._begin, self._last, self._new = total, monotonic(), 0.0, 0

    def step(self, done: int, *, new: bool) -> None:
        """Say that ``done`` tiles are there; those that are read from an earlier run do not count for the rate."""
        self._new += new
        if self._tell is not None:
            self._tell(done, self._total)
        now = monotonic()
        if self._shown and (now - self._last >= EVERY or done == self._total):
            self._last = now
            self._write(done, now)

    def _write(self, done, now):
        rate = self._new / max(now - self._begin, 1e-9)
        left = (self._total - done) / rate if rate else 0.0
        kept = f" ({done - self._new} of them were there)" if done > self._new else ""
        text = f"{done} of {self._total} tiles{kept}, {rate:.1f} tiles/s, {_clock(left)} left"
        self._open = done < self._total
        print(f"\r{text:<70}", end="" if self._open else "\n", file=sys.stderr, flush=True)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        if self._open:  # work ended in the midst of the line
            print(file=sys.stderr, flush=True)


def _clock(seconds: float) -> str:
    minutes, seconds = divmod(round(seconds), 60)
    return f"{minutes // 60}:{minutes % 60:02d}:{seconds:02d}"
