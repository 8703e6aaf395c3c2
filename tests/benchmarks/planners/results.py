"""The table of results: one row for each scene and program, which `merge` replaces or adds."""

from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from astropy.table import Table

COLUMNS = {
    "scene": str,
    "program": str,
    "version": str,
    "science": int,
    "by_class": str,
    "standard": int,
    "sky": int,
    "missing": int,
    "colliding": int,
    "science_without_idle": int,
    "doubles": int,
    "wrong": int,
    "seconds": float,
    "gap": str,
    "limit": float,
    "machine": str,
    "date": str,
}
"""Columns, and their types. ``README.rst`` describes them."""


def machine() -> str:
    """Return the processor of this machine."""
    names = [line for line in Path("/proc/cpuinfo").read_text().splitlines() if line.startswith("model name")]
    return f"{names[0].partition(':')[2].strip().replace('(R)', '')}, {len(names)} cores"


def today() -> str:
    """Return the date."""
    return datetime.now(UTC).date().isoformat()


def read(path: Path) -> Table:
    """Return a table of results, without rows if the file does not exist."""
    if not path.exists():
        return Table(names=list(COLUMNS), dtype=[object if one is str else one for one in COLUMNS.values()])
    table = Table.read(path, format="ascii.ecsv")
    for name, kind in COLUMNS.items():
        if kind is str:  # empty text is read as a missing value
            table[name] = np.ma.filled(np.ma.asarray(table[name]), "").astype(str)
    return table


def merge(old: Table, rows: list[dict], order: list[str]) -> Table:
    """Return the rows of a table, of which the new rows replace those of the same scene and program.

    Rows are sorted by the order of the scenes; rows of a scene keep their order, and new programs follow.
    """
    every = {(str(row["scene"]), str(row["program"])): dict(zip(old.colnames, row, strict=True)) for row in old}
    every |= {(row["scene"], row["program"]): row for row in rows}
    place = {name: k for k, name in enumerate(order)}
    kept = sorted(every.values(), key=lambda row: place.get(str(row["scene"]), len(place)))
    columns = {name: [kind(row[name]) for row in kept] for name, kind in COLUMNS.items()}
    return Table(columns, dtype=list(COLUMNS.values()))


def write(table: Table, path: Path) -> None:
    """Write a table of results; times have three significant digits."""
    rounded = table.copy()
    rounded["seconds"] = [float(f"{one:.3g}") for one in table["seconds"]]
    rounded.write(path, format="ascii.ecsv", overwrite=True)
