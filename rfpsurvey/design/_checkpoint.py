"""Checkpoint of a scan on disk, which contains the finished designs and the arguments of the scan."""

import json
from contextlib import ExitStack
from time import monotonic

import numpy as np
from astropy.table import QTable

from rfpsurvey._folder import check_request, locked, warn_of_software
from rfpsurvey._io import WRITABLE, check_output, read_table, to_path, write_table
from rfpsurvey.design._rows import AXES, ROW, digest_of, to_rows, to_table
from rfpsurvey.errors import InputError, check_switch
from rfpsurvey.tile import versions

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
