"""How far the placing of tiles has come, on one line."""

import sys
from collections.abc import Callable
from time import monotonic

__all__ = ["Progress"]

EVERY = 0.5  # seconds


class Progress:
    """Tell a function the number of tiles and the completeness, or write both to standard error."""

    def __init__(self, progress: bool | Callable):
        self._tell = progress if callable(progress) else None
        self._shown, self._last, self._text = bool(progress) and self._tell is None, -EVERY, ""

    def __call__(self, n_tiles: int, completeness: float) -> None:
        """Tell what is there after a tile."""
        if self._tell is not None:
            self._tell(n_tiles, completeness)
        elif self._shown:
            self._text = f"{n_tiles} tile{'' if n_tiles == 1 else 's'}, completeness {completeness:.4f}"
            if monotonic() - self._last >= EVERY:
                self._last = monotonic()
                print(f"\r{self._text:<40}", end="", file=sys.stderr, flush=True)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        if self._text:  # the last state, also where it is too early for another one
            print(f"\r{self._text:<40}", file=sys.stderr, flush=True)
