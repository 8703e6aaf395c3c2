"""Tables of the comparison of planners (docs/related.rst), from results of tests/benchmarks/planners/compare.py."""

import csv
from pathlib import Path

import numpy as np
from astropy.table import Table

RESULTS = Path(__file__).parent.parent / "tests" / "benchmarks" / "planners" / "results.ecsv"
SHOWN = ("repair", "optimal", "joint", "fiberassign", "netflow", "robostrategy", "CP-SAT, kaiju", "CP-SAT", "recorded")
SUBPRIORITIES = ("repair random", "optimal random", "fiberassign", "fiberassign equal")
HEADS = {
    "scene": "scene",
    "planner": "planner",
    "science": "science, by class",
    "science_without_idle": "idle arms ignored",
    "standard": "standards",
    "sky": "sky",
    "missing": "missing",
    "seconds": "time (s)",
}
RULES = ("standard", "sky", "missing")
TABLES = {
    "desi": {"desi_1": "5000 targets", "desi_2": "10,000 targets", "desi_5": "25,000 targets"},
    "desi_rules": {"desi_1_rules": "5000 targets", "desi_2_rules": "10,000 targets"},
    "subpriorities": {"desi_1": "5000 targets", "desi_2": "10,000 targets", "desi_5": "25,000 targets"}
    | {"desi_1_rules": "5000, requirements", "desi_2_rules": "10,000, requirements"},
    "tiles": {"desi_tiles": "four tiles"},
    "pfs": {"pfs_3600": "3600 targets", "pfs_9600": "9600 targets"},
    "pfs_rules": {"pfs_rules": "3600 targets"},
    "sdss": {"field_a": "field_a", "sdss_dark": "sdss_dark"},
    "others": {name: name for name in ("stuck", "lamost_2", "moons_crowded", "must_2", "hub")},
}
"""Scenes of each table, and their names on the page."""


def read() -> dict[tuple[str, str], dict]:
    """Return the rows of the results by scene and program."""
    table = Table.read(RESULTS, format="ascii.ecsv")
    return {(str(row["scene"]), str(row["program"])): dict(zip(table.colnames, row, strict=True)) for row in table}


def number(value: int) -> str:
    """Return a number as text; numbers of more than four digits have a comma."""
    return f"{value:,}" if value > 9999 else str(value)


def cells(row: dict) -> dict[str, str]:
    """Return the text of each column for a row of the results."""
    colliding = f" ({row['colliding']})" if row["colliding"] else ""
    by_class = ", ".join(str(row["by_class"]).split())
    time = "" if np.isnan(row["seconds"]) else f"{row['seconds']:#.2g}".rstrip(".")
    gap = "" if row["gap"] is np.ma.masked else str(row["gap"])
    return {
        "planner": str(row["program"]),
        "science": f"{number(row['science'])}: {by_class}{colliding}",
        "science_without_idle": number(row["science_without_idle"]),
        **{name: str(row[name]) for name in RULES},
        "seconds": time + (f", gap {gap}" if gap not in ("0", "") else ""),
    }


def table_of(name: str) -> list[list[str]]:
    """Return the rows of a table of the page, the head first."""
    every, rows = read(), []
    for scene, title in TABLES[name].items():
        programs = SUBPRIORITIES if name == "subpriorities" else SHOWN
        some = [every[scene, program] for program in programs if (scene, program) in every]
        rows += [{"scene": title if k == 0 else "", **cells(row)} for k, row in enumerate(some)]
    left_out = () if name.endswith("rules") or name == "sdss" else RULES
    if all(row["science"].split(":")[0] == row["science_without_idle"] for row in rows):
        left_out += ("science_without_idle",)
    columns = [column for column in HEADS if column not in left_out]
    return [[HEADS[column] for column in columns], *([row[column] for column in columns] for row in rows)]


def write_tables(folder: Path) -> None:
    """Write the tables of the page to a folder."""
    for name in TABLES:
        with (folder / f"planners_{name}.csv").open("w", newline="", encoding="utf-8") as file:
            csv.writer(file).writerows(table_of(name))
