"""Convert the results of designs to records and tables."""

import hashlib

import astropy.units as u
import numpy as np
from astropy.table import QTable

from rfpsurvey._units import to_plain
from rfpsurvey.design._axes import AXES

UNITS = {
    **dict.fromkeys(("central_arm", "eccentric_arm", "pitch", "clearance", "min_separation"), u.mm),
    **dict.fromkeys(("positioners_per_area", "usable_per_area"), u.cm**-2),
}
FIGURES = (
    "multiplicity",
    "reach_0",
    "reach_1",
    "reach_2",
    "reach_3",
    "coverage",
    "targets",
    "empty",
    "assigned",
    "loss",
    "loss_error",
    "usable",
    "positioners_per_area",
    "usable_per_area",
)
FORMATS = {
    **dict.fromkeys((*AXES, "eccentric_arm", "min_separation"), ".5g"),
    **dict.fromkeys(("reach_0", "reach_1", "reach_2", "reach_3", "coverage", "assigned", "loss", "usable"), ".4f"),
    **dict.fromkeys(("value", "best", "other"), ".5g"),
    "share": ".3f",
    "slope": ".2f",
    **dict.fromkeys(("loss_error", "loss_gap", "empty", "change"), ".2g"),
    **dict.fromkeys(("multiplicity", "targets", "positioners_per_area", "usable_per_area"), ".4g"),
}
"""Formats of printed tables of designs; values are not rounded."""
ROW = np.dtype(
    [
        *((name, float) for name in ("central_arm", "eccentric_arm", "ratio", "pitch", "clearance", "min_separation")),
        ("collision_type", np.int64),
        *((name, float) for name in FIGURES),
        ("estimand", "U16"),
        ("method", "U16"),
        ("n_unproven", np.int64),
        ("loss_gap", float),
        ("reason", "U80"),
    ]
)


def blank(designs: np.ndarray, estimand: str) -> np.ndarray:
    """Return records of designs (central_arm, ratio, pitch, clearance) whose results are not yet computed."""
    rows = np.zeros(len(designs), ROW)
    for name in ("min_separation", *FIGURES, "loss_gap"):
        rows[name] = np.nan
    for name, values in zip(AXES, designs.T, strict=True):
        rows[name] = values
    rows["eccentric_arm"], rows["estimand"] = rows["central_arm"] * rows["ratio"], estimand
    return rows


def to_table(rows: np.ndarray, meta: dict) -> QTable:
    """Return records as a table with units."""
    columns = {name: rows[name] << UNITS[name] if name in UNITS else rows[name] for name in ROW.names}
    table = QTable(columns, meta=meta)
    set_formats(table)
    return table


def set_formats(table: QTable) -> None:
    """Set the formats of a table so that its numbers are printed with few digits; the values are not rounded."""
    for name in table.colnames:
        if name in FORMATS:
            table[name].info.format = FORMATS[name]


def to_rows(table: QTable) -> np.ndarray:
    """Return the records of a table that `to_table` made."""
    rows = np.zeros(len(table), ROW)
    for name in ROW.names:
        rows[name] = to_plain(table[name])  # files can contain empty text as masked values
    return rows


def digest_of(rows: np.ndarray) -> str:
    """Return a digest of records, which does not depend on the representation of NaN."""
    found = hashlib.sha256()
    for name in ROW.names:
        values = rows[name]
        found.update(np.where(np.isnan(values), np.nan, values) if values.dtype.kind == "f" else values.copy())
    return found.hexdigest()
