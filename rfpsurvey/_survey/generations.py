"""Generations of the plan of a survey: each plan of the rest is made beside the present plan, and then replaces it.

The files of a new plan are written to the folder ``next``. When the plan is complete, this folder is renamed to
``ready``, and its files replace those of the former plan. If this is interrupted, the next command completes it.
Therefore, the folder always contains one whole plan. Plans of tiles that were replaced are kept for late reports.
"""

import csv
import hashlib
import os
import re
import tomllib
from io import StringIO
from pathlib import Path
from typing import NamedTuple

from rfpsurvey._common.folder import INDEX, LOCK, WAIT, checksums_in, locked
from rfpsurvey._common.io import write_bytes
from rfpsurvey._common.read_documents import content_of, is_present
from rfpsurvey._common.temporary import remove
from rfpsurvey.errors import InputError

NEXT, READY = "next", "ready"
EVENTS, KEPT = "events", "events/plans"
"""Folders of recorded events, and of copies of plans that were replaced."""
PLANS, GENERATIONS = f"{EVENTS}/plans.csv", f"{EVENTS}/generations.csv"
"""Files with the plans of each tile, and with all generations."""
MOST_FILE = 2**28
PLAN_LINE = re.compile(r"(tiles/\d+/\d+\.fits),([0-9a-f]{64}),(\d{1,9})")
FORMER_LINE = re.compile(r"tiles/\d+/\d+\.fits,[0-9a-f]{64},(|\d{4}-\d\d-\d\d)")
"""Line of version 0.3, which stated the date of the former plan of each tile."""
DATE = re.compile(r"|\d{4}-\d\d-\d\d")


class Generation(NamedTuple):
    """A plan of all tiles that had not been observed."""

    number: int
    date: str
    """Day on which this plan replaced the plan before it; empty for the first plan."""
    n_files: int
    """Number of files of events with which it was made."""
    edits: str = ""
    """Keys of the plan file that were changed for this plan, with their former and new values."""


def read_generations(folder: Path) -> list[Generation]:
    """Return the generations of the plan of a survey; an empty list for surveys that were planned only once."""
    if not is_present(folder / GENERATIONS):
        return []
    try:
        text = content_of(folder / GENERATIONS, most=MOST_FILE).decode("utf-8", "replace")
        rows = csv.reader(StringIO(text))
        generations = [Generation(int(row[0]), row[1], int(row[2]), row[3]) for row in rows]
        numbers = [generation.number for generation in generations]
        is_whole = text.endswith("\n") and bool(numbers) and numbers == sorted({*numbers})
        if not (is_whole and all(DATE.fullmatch(generation.date) for generation in generations)):
            raise ValueError
    except (IndexError, ValueError, csv.Error):
        raise InputError(
            f"{folder / GENERATIONS} is damaged (it must have a line for each generation); restore it, or remove it"
        ) from None
    return generations


def generations_of(folder: Path, request: dict) -> list[Generation]:
    """Return all generations of the plan of a survey with a given request; the last one is that of the present plan."""
    generations, number = read_generations(folder), request.get("generation", 1)
    if not generations or generations[-1].number != number:  # planned once, or by an earlier version
        n_files = request.get("events", {}).get("n_files", 0)
        generations.append(Generation(number, request.get("planned", ""), n_files))
    return generations


def read_plans(folder: Path) -> dict[str, list[tuple[str, int]]]:
    """Return, for the file of each tile, the checksums of its plans, with the generations that introduced them."""
    if not is_present(folder / PLANS):
        return {}
    text = content_of(folder / PLANS, most=MOST_FILE).decode("ascii", "replace")
    plans: dict[str, list[tuple[str, int]]] = {}
    for line in text.splitlines():
        if match := PLAN_LINE.fullmatch(line):
            plans.setdefault(match[1], []).append((match[2], int(match[3])))
        elif not FORMER_LINE.fullmatch(line):
            plans.clear()
            break
    if not text.endswith("\n") or not (plans or FORMER_LINE.fullmatch(text.partition("\n")[0])):
        raise InputError(f"{folder / PLANS} is damaged (it must have a line for each plan); restore it, or remove it")
    return plans


def add_generation(
    home: Path, ready: Path, before: list[Generation], now: Generation, used: set[tuple], *, is_observed: bool
) -> None:
    """Write the files that describe all generations to a folder with the files of a new plan.

    Plans of the present generation that the new plan replaces are kept if ``is_observed`` is true, or if the names of
    their files and their checksums are in ``used``.
    """
    plans, former, new = read_plans(home), checksums_in(home), checksums_in(ready)
    for checksums, generation in ((former, before[-1]), (new, now)):
        for name in (name for name in checksums if name.startswith("tiles/")):
            of_tile, checksum = plans.setdefault(name, []), checksums[name]
            if not of_tile or of_tile[-1][0] != checksum:
                of_tile.append((checksum, generation.number))
            is_kept = new.get(name) == checksum or is_observed or (name, checksum) in used
            if of_tile[-1][1] == before[-1].number and not is_kept:
                of_tile.pop()
    for name, checksum in sorted(used):  # the index, which can be damaged, does not determine which plans are kept
        if checksum not in dict(plans.setdefault(name, [])):
            plans[name].insert(0, (checksum, 0))
    lines = [f"{name},{checksum},{number}\n" for name in sorted(plans) for checksum, number in plans[name]]
    edits, rows = changed_keys(home / "plan.toml", ready / "plan.toml"), StringIO()
    csv.writer(rows, lineterminator="\n").writerows([*before, now._replace(edits=edits)])
    (ready / EVENTS).mkdir(exist_ok=True)
    for name, text in ((PLANS, "".join(lines)), (GENERATIONS, rows.getvalue())):
        write_bytes(ready / name, text.encode(), sync=True)


def changed_keys(before: Path, after: Path) -> str:
    """Return the keys of two plan files that have other values, with both values."""
    try:
        earlier, later = (dict(_flat(tomllib.loads(path.read_text()))) for path in (before, after))
    except (OSError, ValueError):  # there was no plan file
        return ""
    names = [name for name in sorted({*earlier, *later}) if earlier.get(name) != later.get(name)]
    return "; ".join(f"{name}: {earlier.get(name, 'not given')} -> {later.get(name, 'not given')}" for name in names)


def _flat(table: dict, prefix: str = ""):
    """Yield the keys and values of nested tables."""
    for name, value in table.items():
        if isinstance(value, dict):
            yield from _flat(value, f"{prefix}{name}.")
        elif name != "output":
            yield prefix + name, value


def settle(folder: Path) -> None:
    """Complete the replacement of a plan, if a process was interrupted during it."""
    if is_present(folder / READY):
        with locked(folder, folder / LOCK, wait=WAIT):
            replace_plan(folder)


def replace_plan(folder: Path) -> None:
    """Replace the present plan of a survey, whose folder is locked, by the plan in its folder ``ready``, if any.

    Each step can be repeated; the request is replaced last.
    """
    ready = folder / READY
    if is_present(ready / "survey.json"):
        plans = read_plans(ready) or read_plans(folder)
        kept = {checksum for of_tile in plans.values() for checksum, _ in of_tile}
        present = checksums_in(folder)
        new = checksums_in(ready) or present
        for name in {*present, *plans}:
            if (name in new and not is_present(ready / name)) or not is_present(folder / name):
                continue  # the plan does not change, or was replaced before the interruption
            checksum = hashlib.sha256((folder / name).read_bytes()).hexdigest()
            if checksum in kept and checksum != new.get(name):
                (folder / KEPT).mkdir(parents=True, exist_ok=True)
                os.replace(folder / name, folder / KEPT / f"{checksum}.fits")
            elif name not in new:
                (folder / name).unlink()
        paths = [path for path in ready.rglob("*") if path.is_file() and path.name != LOCK]
        # the request is replaced last, so that all steps can be repeated until then
        for path in sorted(paths, key=lambda path: (path.name == "survey.json", path.name == INDEX, path)):
            (folder / path.relative_to(ready)).parent.mkdir(parents=True, exist_ok=True)
            os.replace(path, folder / path.relative_to(ready))
    if is_present(folder / "plan.toml") and is_present(folder / "inputs"):
        text = (folder / "plan.toml").read_text()
        for path in (folder / "inputs").iterdir():
            if path.name not in text:
                remove(path)
    remove(ready)
