"""The claims of Chen et al. (2024), and the results of rfpsurvey with which the claims are compared."""

from dataclasses import dataclass, fields

import numpy as np
from astropy.table import QTable

__all__ = ["Claim", "claims_page", "claims_table", "verdict"]

REPRODUCED, NOT_REPRODUCED, UNDECIDED = "reproduced", "not reproduced", "cannot be decided from the text"


@dataclass(frozen=True)
class Claim:
    """A claim of Chen et al. (2024), the result of rfpsurvey, the verdict, and the interpretation (``reading``)."""

    experiment: str
    claim: str
    paper: str
    ours: str
    verdict: str
    reading: str = ""


def verdict(paper: float, ours: float, error: float, *, sigmas: float = 2.0) -> str:
    """Return the verdict on a number that the paper states.

    The verdict is "reproduced" if the numbers ``paper`` and ``ours`` differ by at most ``sigmas`` times the error, and
    "not reproduced" otherwise.
    """
    return REPRODUCED if abs(paper - ours) <= sigmas * error else NOT_REPRODUCED


def claims_table(claims: list[Claim]) -> QTable:
    """Return a table with a row for each claim."""
    names = [f.name for f in fields(Claim)]
    return QTable([[getattr(c, name) for c in claims] for name in names], names=names)


def claims_page(table: QTable, settings: dict) -> str:
    """Return a page in reStructuredText that lists the claims and the settings."""
    lines = ["Claims of the paper", "===================", "", "Made by ``python docs/reproduction``: "]
    lines[-1] += ", ".join(f"{key} {value}" for key, value in settings.items()) + "."
    for experiment in dict.fromkeys(np.asarray(table["experiment"])):
        lines += ["", experiment.capitalize(), "-" * len(experiment), "", ".. list-table::", "   :header-rows: 1", ""]
        rows = [("claim", "paper", "here", "verdict", "reading")]
        rows += [tuple(r)[1:] for r in table[table["experiment"] == experiment]]
        for row in rows:
            lines += [f"   {'* -' if k == 0 else '  -'} {cell}".rstrip() for k, cell in enumerate(row)]
    return "\n".join(lines) + "\n"
