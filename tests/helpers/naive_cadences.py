"""A few cadences, and a second implementation of their windows."""

import numpy as np
from astropy.table import Table

NAMES = ["once", "twice", "pairs", "thrice", "dark"]
TABLE = Table(
    {
        "cadence": NAMES,
        "delta_min": ["0", "0 3", "0 2", "0 1 5", "0 -1"],
        "delta_max": ["0", "0 6", "0 30", "0 4 9", "0 -1"],
        "n_exp": ["1", "1 1", "2 2", "1 2 1", "1 1"],
        "skybrightness": ["1", "1 1", "1 1", "1 0.5 1", "0.35 0.35"],
    }
)


class Naive:
    """The exposures of one target, in the order of time."""

    def __init__(self, name):
        row = TABLE[NAMES.index(name)] if name else None
        columns = ("delta_min", "delta_max", "n_exp", "skybrightness")
        values = [[float(x) for x in row[one].split()] for one in columns] if name else [[-1], [-1], [1], [9]]
        self.epochs, self.starts, self.now = list(zip(*values, strict=True)), [], []

    def allows(self, day, brightness):
        """Return whether the target may be observed, and when its window closes."""
        if self.now and day - self.now[0] > 0.5:
            self.now = []
        if len(self.starts) == len(self.epochs):
            return False, np.inf
        low, high, _, limit = self.epochs[len(self.starts)]
        closes, fits = np.inf, True
        if self.now:
            closes = self.now[0] + 0.5
        elif self.starts:
            since = day - self.starts[-1]
            fits = (low < 0 or since >= low) and (high < 0 or since <= high)
            closes = self.starts[-1] + high if high >= 0 else np.inf
        return fits and brightness <= limit, closes

    def observe(self, day):
        self.now.append(day)
        if len(self.now) == self.epochs[len(self.starts)][2]:
            self.starts.append(self.now[0])
            self.now = []

    def is_released(self, day):
        self.allows(day, 0)
        if self.now or not self.starts or len(self.starts) == len(self.epochs):
            return False
        high = self.epochs[len(self.starts)][1]
        return high >= 0 and day - self.starts[-1] > high
