"""Recognize target tables of surveys by their columns, and read these columns as the surveys define them."""

import re
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from rfpsurvey.errors import warn

# Columns of DESI with numbers of visits. In desitarget, -1 means that no number was set, because the target is only a
# standard star or a sky position, or cannot be observed in the conditions of the file.
COUNTS = ("numobs_init", "numobs_more")

# Bits of DESI_TARGET (desitarget/data/targetmask.yaml). fiberassign assigns no science target, standard star or sky
# position whose bit BAD_SKY, BRIGHT_OBJECT or IN_BRIGHT_OBJECT is set.
SCIENCE = sum(1 << bit for bit in (0, 1, 2, 3, 60, 61, 62))
STANDARD = sum(1 << bit for bit in (33, 34, 35))
SKY = sum(1 << bit for bit in (32, 37))
UNUSABLE = sum(1 << bit for bit in (36, 50, 51))
BITS = re.compile(r"(sv\d_)?desi_target")


class SurveyFormat(NamedTuple):
    """The format of a target table of a survey."""

    name: str
    columns: dict
    """Name of the column with each role; a leading minus reverses the sign of its numbers."""
    bits: str | None = None
    """Name of the column ``DESI_TARGET``, whose bits state the kind of each target."""
    marks: tuple = ()
    """Names of the columns by which the format is recognized, besides the columns with a role."""
    doubt: str = ""
    """Text of a warning, if a column of the format is missing."""


def find_format(names: Iterable[str]) -> SurveyFormat | None:
    """Return the survey format of a table with the given column names; None if the table has no such format."""
    lower = {name.lower(): name for name in reversed(list(names))}
    return _desi(lower) or _sdssv(lower)


def _desi(lower: dict) -> SurveyFormat | None:
    """Return the format of DESI target files (``PRIORITY_INIT``, ``NUMOBS_INIT``) or DESI ledgers (``NUMOBS_MORE``)."""
    bits = next((name for key, name in lower.items() if BITS.fullmatch(key)), None)
    if bits is None and not lower.keys() & {"priority_init", "numobs_init", "numobs_more"}:
        return None
    start, current = ("priority_init", "numobs_init"), ("priority", "numobs_more")
    pair, other = (current, start) if lower.keys() & set(current) else (start, current)
    columns = {role: lower[name] for role, name in zip(("priority", "visits"), pair, strict=True) if name in lower}
    doubt = ""
    lacking = [k for k in (0, 1) if pair[k] not in lower and other[k] in lower]
    if lower.keys() & {"visits", "n_visits", "nvisits"}:  # added by the user
        columns.pop("visits", None)
    elif lacking and columns:
        used, unused = next(iter(columns.values())), lower[other[lacking[0]]]
        doubt = f"the table has the column {used} but not {pair[lacking[0]].upper()}; {unused} is not used instead, "
        doubt += f"because {used} and {unused} describe different times of a survey"
    if "targetid" in lower:
        columns["id"] = lower["targetid"]
    return SurveyFormat("DESI ledger" if "numobs_more" in lower else "DESI targets", columns, bits, doubt=doubt)


def _sdssv(lower: dict) -> SurveyFormat | None:
    """Return the format of candidates of SDSS-V, in which small priorities are more important."""
    groups = (("catalogid", "rsid"), ("fibertype", "fiber_type", "instrument"), ("cadence", "category", "carton"))
    found = [next((lower[name] for name in group if name in lower), None) for group in groups]
    # rfpsurvey writes priorities with the sign that it uses, and names the identifiers id or target_id
    if "priority" not in lower or None in found or lower.keys() & {"id", "target_id"}:
        return None
    return SurveyFormat("SDSS-V candidates", {"priority": f"-{lower['priority']}"}, marks=tuple(found))


def is_unusable(bits: np.ndarray) -> np.ndarray:
    """Return whether each position is unusable, because it is a bad sky position or close to a bright object."""
    return (bits & UNUSABLE) != 0


def kinds_and_visits(bits: np.ndarray, visits: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
    """Return the kind and the requested number of visits of targets of DESI.

    A target that is both a science target with requested visits and a standard star is a science target. No visits of
    unusable positions are requested.
    """
    visits = np.ones(len(bits)) if visits is None else visits
    standard, wanted = (bits & STANDARD) != 0, ((bits & SCIENCE) != 0) & (visits > 0)
    if n := np.count_nonzero(standard & wanted):
        text = f"{n} of {len(bits)} targets are both science targets and standard stars; they are read as science"
        warn(f"{text} targets, and do not count as standard stars")
    kind = np.where(standard & ~wanted, "standard", np.where((bits & SKY) != 0, "sky", "science"))
    unusable = is_unusable(bits)
    kind[unusable] = "science"
    return kind, np.where(unusable, 0, np.where(kind == "science", visits, 1))
