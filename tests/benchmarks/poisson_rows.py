"""Compute rows of the page on the claims of the paper: the Poisson point process and Poisson-distributed coordinates.

The standard error of every design is 2e-4 instead of 1e-4. ``python tests/benchmarks/poisson_rows.py`` takes 14 minutes
on one core. With the path of a table ``poisson.ecsv`` of ``python docs/reproduction poisson``, it prints the rows of
that table.
"""

import sys
from pathlib import Path

import numpy as np
from astropy.table import QTable

sys.path.insert(0, str(Path(__file__).parents[2] / "docs"))
from reproduction._designs import Settings
from reproduction._poisson import PLACES, _of_reading, poisson


def main(path=None):
    table = QTable.read(path) if path else poisson(Settings(error=2e-4), discs={})[0]["poisson"]
    for name in [name for name in PLACES if name in table.colnames]:
        claim, part = _of_reading(name, table), table[:-1][np.isfinite(table[name][:-1])]
        away = np.asarray(part["uniform"] - part[name])
        pitch, ratio = (np.corrcoef(away, np.asarray(part[c]))[0, 1] for c in ("pitch", "ratio"))
        print(f"{name}: {claim.ours}: {claim.verdict}")
        print(
            f"  {100 * away.mean():.2f} percentage points; correlation with pitch {pitch:.2f}, with ratio {ratio:.2f}"
        )


if __name__ == "__main__":
    main(*sys.argv[1:])
