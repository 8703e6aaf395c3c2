"""The designs of a scan as axes, records and tables, the best designs, and the checkpoint of a scan."""

import hashlib
import itertools
import json
from contextlib import ExitStack
from time import monotonic

import astropy.units as u
import numpy as np
from astropy.table import QTable

from rfpsurvey._common.files import WRITABLE, check_output, to_path
from rfpsurvey._common.folder import check_request, locked, warn_of_software
from rfpsurvey._common.io import write_table
from rfpsurvey._common.read_tables import read_table
from rfpsurvey._common.units import to_mm, to_plain
from rfpsurvey._field.facts import versions
from rfpsurvey.errors import INCONVERTIBLE, InputError, check_choice, check_switch, check_whole, refusal

AXES = ("central_arm", "ratio", "pitch", "clearance")
MOST = 10_000_000


def to_axes(central_arm: u.Quantity, ratio: object, pitch: u.Quantity, clearance: u.Quantity) -> dict[str, np.ndarray]:
    """Return the values of each parameter of a scan, with lengths in mm; raise an error if a value is not valid."""
    lengths = {"central_arm": central_arm, "pitch": pitch, "clearance": clearance}
    axes = {name: to_mm(value, name) for name, value in lengths.items()}
    try:
        axes["ratio"] = to_plain(u.Quantity(ratio, u.dimensionless_unscaled).value).astype(float)
    except INCONVERTIBLE:
        text = "ratio (eccentric arm length divided by central arm length) must be one or several numbers"
        raise refusal(text, ratio, str, int, list, np.ndarray) from None
    for name, values in axes.items():
        wrong = values[~((values >= 0 if name == "clearance" else values > 0) & (values < 1e6))]
        if wrong.size:
            what = "at least 0" if name == "clearance" else "above 0"
            raise InputError(f"{name} must be finite and {what}, got {wrong.flat[0]:g}")
        if values.ndim > 1 or values.size == 0:
            raise InputError(f"{name} must be one value or a one-dimensional array, got the shape {values.shape}")
    return {name: np.atleast_1d(axes[name]) for name in AXES}


def to_designs(axes: dict[str, np.ndarray], n_designs: int | None, seed: int) -> np.ndarray:
    """Return the designs of a scan as rows (central_arm, ratio, pitch, clearance)."""
    if n_designs is None:
        for name, values in axes.items():
            if len(np.unique(values)) < len(values):
                raise InputError(f"the values of {name} must differ from each other, got {values}")
        n = np.prod([float(len(values)) for values in axes.values()])
        if n > MOST:
            raise InputError(f"a grid must have at most {MOST:.0e} designs, got {n:.3g}")
        return np.array(list(itertools.product(*axes.values())))
    check_whole(n_designs, "n_designs", high=MOST)
    for name, values in axes.items():
        if len(values) > 2 or (len(values) == 2 and not values[0] < values[1]):
            raise InputError(f"if n_designs is given, {name} must be one value or two limits (low, high), got {values}")
    low, high = (np.array([values[k] for values in axes.values()]) for k in (0, -1))
    points = np.zeros((n_designs, len(axes)))
    free = low < high
    if free.any():
        points[:, free] = _sobol(int(n_designs), int(free.sum()), seed)
    return low + points * (high - low)


def _sobol(n, n_axes, seed):
    """Return scrambled Sobol points of the unit cube; for the same seed, larger sets begin with the same points."""
    from scipy.stats import qmc  # importing this takes longer than importing all of this package

    return qmc.Sobol(n_axes, scramble=True, seed=seed).random_base2(int(np.ceil(np.log2(n))))[:n]


LENGTHS = ("central_arm", "eccentric_arm", "pitch", "clearance", "min_separation")
REACH, BY_AREA = ("reach_0", "reach_1", "reach_2", "reach_3"), ("positioners_per_area", "usable_per_area")
UNITS = {**dict.fromkeys(LENGTHS, u.mm), **dict.fromkeys(BY_AREA, u.cm**-2)}
FIGURES = ("multiplicity", *REACH, "coverage", "targets", "empty", "assigned", "loss", "loss_error", "usable", *BY_AREA)
FORMATS = {
    **dict.fromkeys((*LENGTHS, "ratio", "value", "best", "other"), ".5g"),
    **dict.fromkeys((*REACH, "coverage", "assigned", "loss", "usable"), ".4f"),
    **dict.fromkeys(("multiplicity", "targets", *BY_AREA), ".4g"),
    **dict.fromkeys(("loss_error", "loss_gap", "empty", "change"), ".2g"),
    "share": ".3f",
    "slope": ".2f",
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


def instruments_of(table: QTable) -> np.ndarray:
    """Return the name of the instrument for rows that are designs of instruments, and empty text for other rows."""
    if "instrument" not in table.colnames:
        return np.full(len(table), "")
    return np.asarray(np.ma.filled(table["instrument"], "")).astype(str)


def digest_of(rows: np.ndarray) -> str:
    """Return a digest of records, which does not depend on the representation of NaN."""
    digest = hashlib.sha256()
    for name in ROW.names:
        values = rows[name]
        digest.update(np.where(np.isnan(values), np.nan, values) if values.dtype.kind == "f" else values.copy())
    return digest.hexdigest()


OBJECTIVES = {"coverage": "max", "loss": "min"}


def check_objectives(objectives: object, columns: tuple[str, ...]) -> dict[str, str]:
    """Return the two objectives (a dict from column to "max" or "min"), or raise an error."""
    pairs = list(objectives.items()) if isinstance(objectives, dict) else []
    if len(pairs) != 2:
        text = f"objectives must be two columns with 'max' or 'min', such as {OBJECTIVES}"
        raise refusal(text, objectives, dict)
    for name, direction in pairs:
        check_choice(name, columns, "column for an objective")
        check_choice(direction, ("max", "min"), f"direction of {name}")
    return dict(pairs)


def on_front(table: QTable, objectives: dict[str, str]) -> np.ndarray:
    """Return whether each row is on the Pareto front.

    A row is on the front if no other row is at least as good in both columns and better in one. If several rows have
    the same best values, all of them are on the front. Rows without a value are not on the front.
    """
    signs = {"max": -1.0, "min": 1.0}
    first, second = (signs[aim] * to_plain(table[name]) for name, aim in objectives.items())
    known = np.flatnonzero(np.isfinite(first) & np.isfinite(second))
    order = known[np.lexsort((second[known], first[known]))]
    a, b = first[order], second[order]
    start = np.searchsorted(a, a, side="left")  # first row with the same first value; its second value is the best
    least = np.append(np.inf, np.minimum.accumulate(b))[start]  # best second value of all rows before start
    front = np.zeros(len(table), dtype=bool)
    front[order] = (b == b[start]) & (b < least)
    return front


EVERY = 10.0  # seconds


class Checkpoint:
    """The file of a scan, which contains all finished designs and is a valid table at any time.

    The file is locked while the checkpoint is used as a context manager.

    Parameters
    ----------
    path : str, path-like or None
        Path of the file; None for no file.
    request : dict
        The arguments of the scan; a scan can be resumed only with the same arguments.
    designs : ndarray of float, shape (n, 4)
        All designs, in the order in which they are computed.
    resume, overwrite : bool
        Whether to continue the scan in an existing file, and whether to replace an existing file.
    """

    def __init__(self, path: object, request: dict, designs: np.ndarray, *, resume: bool, overwrite: bool):
        self.meta = {"request": json.loads(json.dumps(request)), "software": versions()}
        self._path, self._designs = path if path is None else to_path(path), designs
        self._resume, self._overwrite = check_switch(resume, "resume"), check_switch(overwrite, "overwrite")
        self.parts: list[np.ndarray] = []
        self.done = 0
        if path is None and self._resume:
            raise InputError("resume requires the path of the file with the unfinished scan")

    def __enter__(self):
        with ExitStack() as stack:
            if self._path is not None:
                check_output(self._path, WRITABLE, overwrite=True)
                stack.enter_context(locked(self._path))
            self._open()
            self._lock = stack.pop_all()  # the file remains locked until the end of the scan
        return self

    def __exit__(self, kind, *_):
        """Unlock the file; if the scan was interrupted, first write the finished designs."""
        try:
            if kind is not None and self.done:
                self.write(self.table())
        finally:
            self._lock.close()

    def _open(self):
        if self._path is not None and self._path.exists():
            if self._resume:
                self.add(self._load())
                self._overwrite = True
            elif not self._overwrite:
                raise InputError(
                    f"{self._path} exists; continue the scan (--resume, resume=True) or overwrite the file "
                    "(--overwrite, overwrite=True)"
                )
        self._last = monotonic()

    @property
    def rows(self) -> np.ndarray:
        """The rows of all finished designs."""
        self.parts = [np.concatenate(self.parts)] if self.parts else [np.zeros(0, ROW)]
        return self.parts[0]

    def add(self, rows: np.ndarray) -> None:
        """Add the rows of finished designs, in the order of the scan."""
        self.parts.append(rows)
        self.done += len(rows)

    def table(self, **meta: object) -> QTable:
        """Return the table of the finished designs, with additional entries of its ``meta``."""
        return to_table(self.rows, {**self.meta, **meta, "digest": digest_of(self.rows)})

    def save(self) -> None:
        """Write the finished designs, unless the file was written in the last ten seconds."""
        if self._path is not None and monotonic() - self._last > EVERY:
            self.write(self.table())
            self._last = monotonic()

    def write(self, table: QTable) -> None:
        """Write the table of the finished designs."""
        if self._path is not None:
            write_table(table, self._path, overwrite=self._overwrite)
            self._overwrite = True  # from now on, the file is the file of this scan

    def _load(self):
        """Return the rows of the finished designs in an existing file."""
        table = read_table(self._path)
        before, now = table.meta.get("request"), self.meta["request"]
        if not isinstance(before, dict) or not set(ROW.names) <= set(table.colnames):
            raise InputError(f"{self._path} must contain a scan of designs; give another path")
        check_request(self._path, before, now, "scan", "path")
        warn_of_software(self._path, table.meta.get("software"), self.meta["software"], "designs")
        rows = to_rows(table)
        designs = np.column_stack([rows[name] for name in AXES])
        if not np.array_equal(designs, self._designs[: len(designs)]):
            raise InputError(f"{self._path} is damaged: its designs differ from the designs of the scan")
        if table.meta.get("digest") != digest_of(rows):
            raise InputError(
                f"{self._path} is damaged: its values differ from the values that the scan wrote; give another path"
            )
        return rows
