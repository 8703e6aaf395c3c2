"""The class `SelectionProbabilities`: packed bits, and estimates of probabilities from counts of realizations."""

import json
import os
from dataclasses import dataclass, fields, replace
from functools import cached_property

import numpy as np
from astropy.table import QTable

from rfpsurvey._common import io as _io
from rfpsurvey._common.descriptions import Column, describe, facts_of, to_html
from rfpsurvey._common.folder import check_file, read_index
from rfpsurvey._common.read_tables import read_table
from rfpsurvey._common.units import to_visits
from rfpsurvey._survey.selection.columns import OF_CADENCES, SELECTION_FACTS, STORED, TARGETS
from rfpsurvey.errors import InputError, check_whole, number_of, short

COLUMNS = ("target_id", "requested", "n_tiles", "BITWEIGHTS")
NAMES = "SELECTION", "REALIZATIONS"
PER_WORD = 64
"""Number of realizations whose bits one integer contains."""
# Number of rows that are written together.
PART = 1 << 20


@dataclass(frozen=True, eq=False)
class SelectionProbabilities:
    """For each target, the realizations of a survey in which it was observed, and the resulting probabilities.

    Parameters
    ----------
    target_id : ndarray of int or str, shape (n_targets,)
        Identifiers of the targets, in the order of the catalog.
    requested : ndarray of int, shape (n_targets,)
        Requested number of visits; 0 for standards and sky positions, which are never counted as observed.
    n_tiles : ndarray of int, shape (n_targets,)
        Number of tiles in which at least one positioner reaches the target.
    bits : ndarray of uint64, shape (n_targets, n_words)
        Realization r observed a target if bit ``r % 64`` of the integer ``r // 64`` is 1, where bit 0 is the least
        significant bit. The unused bits of the last integer are 0.
    realizations : QTable
        Table with a row for each realization. Columns: ``realization``, ``seed``, ``n_assigned`` (number of usable
        positioners with a target, summed over all tiles), ``n_lost`` (number of targets lost to collisions), and
        ``n_observed`` (number of visits to science targets, except targets lost to collisions). The ``meta`` of
        the table contains ``summary`` and ``provenance``.
    n_with_visits : ndarray of int, shape (n_targets, n_most + 1), optional
        With cadences, the number of realizations in which 0, 1, ..., ``n_most`` visits of each target count. Only the
        visits of complete epochs count.

    See Also
    --------
    selection_probabilities : Plan the realizations.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astropy.coordinates import SkyCoord
    >>> import rfpsurvey as rs
    >>> sky = rs.synthetic_catalog("uniform", SkyCoord("6h20m +23d"), 0.3 * u.deg, n_targets=4000, rng=1)
    >>> found = rs.selection_probabilities(sky, "desi", SkyCoord(["6h20m"], ["+23d"]), n_realizations=64)
    >>> found.bits.shape, bool(found.observed_in(3).sum() == found.realizations["n_observed"][3])
    ((4000, 1), True)
    """

    target_id: np.ndarray
    requested: np.ndarray
    n_tiles: np.ndarray
    bits: np.ndarray
    realizations: QTable
    n_with_visits: np.ndarray | None = None

    @property
    def n_realizations(self) -> int:
        """Number of realizations."""
        return len(self.realizations)

    @cached_property
    def n_observed(self) -> np.ndarray:
        """Number of realizations that observed each target, shape (n_targets,)."""
        return count_bits(self.bits)

    @property
    def probability(self) -> np.ndarray:
        """Fraction of the realizations that observed each target, shape (n_targets,)."""
        return self.n_observed / self.n_realizations

    @property
    def probability_error(self) -> np.ndarray:
        """Standard error of `probability`, shape (n_targets,).

        This is the standard deviation of the posterior distribution of the probability for a uniform prior. It is never
        0.
        """
        a, b = self.n_observed + 1.0, self.n_realizations - self.n_observed + 1.0
        return np.sqrt(a * b / (a + b + 1.0)) / (a + b)

    @property
    def weight(self) -> np.ndarray:
        """Inverse probability (n + 1) / (k + 1) of a target that k of n realizations observed, shape (n_targets,).

        This is the weight of a target that the survey observed. The survey itself counts as one more realization that
        observed the target. If a realization observes the target with the probability p, the expected value of the
        weight is ``(1 - (1 - p)**(n + 1)) / p``.
        """
        return (self.n_realizations + 1) / (self.n_observed + 1.0)

    @property
    def weight_error(self) -> np.ndarray:
        """Standard error of `weight`, by first-order propagation of `probability_error`, shape (n_targets,)."""
        return self.weight**2 * self.probability_error

    @property
    def n_complete(self) -> np.ndarray | None:
        """Number of realizations that complete the cadence of each target, shape (n_targets,); None without cadences.

        This is 0 for targets without requested visits.
        """
        if self.n_with_visits is None:
            return None
        whole = self.requested[:, None] <= np.arange(self.n_with_visits.shape[1])
        return np.where(self.requested > 0, (self.n_with_visits * whole).sum(axis=1), 0)

    @property
    def probability_complete(self) -> np.ndarray | None:
        """Fraction of the realizations that complete the cadence of each target; None without cadences."""
        return None if self.n_with_visits is None else self.n_complete / self.n_realizations

    @property
    def unreachable(self) -> np.ndarray:
        """Whether no positioner reaches the target in any tile, shape (n_targets,)."""
        return self.n_tiles == 0

    @property
    def never_observed(self) -> np.ndarray:
        """Whether no realization observed the target, shape (n_targets,)."""
        return ~self.bits.any(axis=1)

    def observed_in(self, realization: int) -> np.ndarray:
        """Return which targets a realization observed.

        Parameters
        ----------
        realization : int
            Number of the realization, counted from 0.

        Returns
        -------
        ndarray of bool, shape (n_targets,)
            Whether the realization observed each target.

        Raises
        ------
        InputError
            If there is no such realization.
        """
        check_whole(realization, "realization", 0, self.n_realizations - 1)
        word, bit = divmod(int(realization), PER_WORD)
        return (self.bits[:, word] >> np.uint64(bit) & np.uint64(1)).astype(bool)

    def pair_counts(self, first: np.ndarray, second: np.ndarray) -> np.ndarray:
        """Return, for each pair of targets, the number of realizations that observed both targets.

        Parameters
        ----------
        first, second : array_like of int, shape (k,)
            Rows of the targets of each pair.

        Returns
        -------
        ndarray of int, shape (k,)
            Number of realizations that observed both targets. The weight of a pair that the survey observed is
            ``(n_realizations + 1) / (pair_counts + 1)``.

        Raises
        ------
        InputError
            If a row is not a whole number from 0 to the number of targets minus 1.

        Examples
        --------
        >>> import astropy.units as u
        >>> from astropy.coordinates import SkyCoord
        >>> import rfpsurvey as rs
        >>> sky = rs.synthetic_catalog("uniform", SkyCoord("6h20m +23d"), 0.3 * u.deg, n_targets=4000, rng=1)
        >>> found = rs.selection_probabilities(sky, "desi", SkyCoord(["6h20m"], ["+23d"]), n_realizations=64)
        >>> bool((found.pair_counts([0, 1, 2], [0, 1, 2]) == found.n_observed[:3]).all())
        True
        """
        return count_bits(self._bits_of(first, "first") & self._bits_of(second, "second"))

    def _bits_of(self, rows: object, name: str) -> np.ndarray:
        """Return the bits of the targets in some rows; raise an error for rows that do not exist."""
        rows, last = np.asarray(rows), len(self.bits) - 1
        is_whole = rows.ndim == 1 and (rows.dtype.kind in "iu" or rows.size == 0)
        if not is_whole or rows.min(initial=0) < 0 or rows.max(initial=0) > last:
            text = f"{name} must be a list of rows of targets (whole numbers from 0 to {last})"
            raise InputError(f"{text}, got {short(rows.tolist())}")
        return self.bits[rows.astype(np.int64)]

    @cached_property
    def summary(self) -> dict:
        """Numbers of realizations, tiles, fibers, visits and targets.

        ``n_targets`` is the number of targets with requested visits. Of these targets, ``n_unreachable`` are reached in
        no tile, ``n_never_observed`` are observed in no realization, ``n_always_observed`` are observed in all
        realizations, and ``n_sometimes_observed`` are observed in some, but not all, realizations.
        """
        asked = self.requested > 0
        never, always = self.never_observed & asked, (self.n_observed == self.n_realizations) & asked
        n = int(asked.sum())
        table = self.realizations
        return {
            **table.meta["summary"],
            "n_targets": n,
            "n_unreachable": int((self.unreachable & asked).sum()),
            "n_never_observed": int(never.sum()),
            "n_always_observed": int(always.sum()),
            "n_sometimes_observed": n - int(never.sum()) - int(always.sum()),
            **{name: int(table[name].sum()) for name in ("n_assigned", "n_lost", "n_observed")},
            **{
                name: float(values[asked].mean()) if n else float("nan")
                for name in ("mean_probability", "mean_probability_complete")
                if (values := getattr(self, name.removeprefix("mean_"))) is not None
            },
        }

    @property
    def provenance(self) -> dict:
        """Instrument, catalog and parameters, and the versions of the software."""
        return self.realizations.meta["provenance"]

    @property
    def table(self) -> QTable:
        """Table with a row for each target, as it is written to files.

        Columns: ``target_id``, ``requested``, ``n_tiles``, ``BITWEIGHTS`` (the bits as 64-bit signed integers),
        ``n_observed``, ``probability``, ``probability_error``, ``weight``, ``weight_error``, ``unreachable`` and
        ``never_observed``; with cadences also ``n_with_visits``, ``n_complete`` and ``probability_complete``.
        """
        return describe(self._rows(slice(None)), self._columns)

    @property
    def _columns(self) -> dict[str, Column]:
        return TARGETS if self.n_with_visits is None else TARGETS | OF_CADENCES

    def _rows(self, rows: slice) -> QTable:
        """Return the table for a slice of the targets."""
        part = part_of(self, rows)
        # bits are written as signed integers, because FITS has no unsigned integers of 64 bits
        values = {n: part.bits.view(np.int64) if n == "BITWEIGHTS" else getattr(part, n) for n in self._columns}
        values |= {name: values[name].astype(kind) for name, kind in STORED.items() if name in values}
        return QTable(values, copy=False, meta={"summary": self.summary, "provenance": self.provenance})

    def write(self, path: str | os.PathLike, *, overwrite: bool = False) -> None:
        """Write the bits and probabilities of all targets, and the table of realizations, to a FITS file.

        Parameters
        ----------
        path : str or path-like
            Path that ends in ``.fits``.
        overwrite : bool, optional
            Whether to replace an existing file.

        Raises
        ------
        InputError
            If the folder does not exist, if the file exists and ``overwrite`` is False, or if FITS cannot represent
            some of the text.
        """
        meta = json.dumps({"summary": self.summary, "provenance": self.provenance}, separators=(",", ":"))
        cards = {
            "NREALIZ": (self.n_realizations, "number of realizations"),
            "BITORDER": ("LSB", "realization r is bit r%64 of element r//64"),
            _io.META_KEY: meta,
        }
        first, second = self._rows(slice(0, 0)), self.realizations
        parts = (self._rows(slice(k, k + PART)).as_array() for k in range(0, len(self), PART))
        texts = {name: column.text for name, column in self._columns.items()}
        about = {name: second[name].info.description or "" for name in second.colnames}
        _io.write_fits_rows(
            path,
            _io.FitsRows(first.dtype, {**_io.table_cards(NAMES[0], first.colnames, texts), **cards}, parts),
            _io.FitsRows(second.dtype, _io.table_cards(NAMES[1], second.colnames, about), [second.as_array()]),
            overwrite=overwrite,
        )

    @classmethod
    def read(cls, path: str | os.PathLike) -> "SelectionProbabilities":
        """Read selection probabilities from a FITS file.

        Parameters
        ----------
        path : str or path-like
            Path of the file, or of the folder in which `selection_probabilities` wrote it. The content is compared with
            the checksum that the index of this folder contains; a file without an index is not checked.

        Returns
        -------
        SelectionProbabilities
            The selection probabilities.

        Raises
        ------
        InputError
            If the file does not contain selection probabilities, or is damaged.
        """
        path = _io.to_path(path)
        in_folder = path.is_dir()
        path = path / "selection.fits" if in_folder else path
        known = read_index(path.parent)
        if path.is_file() and (in_folder or path.name in known):
            check_file(path.parent, path.name, known)
        table = read_table(path)
        meta = table.meta
        lacking = [name for name in COLUMNS if name not in table.colnames]
        if lacking or not all(isinstance(meta.get(name), dict) for name in ("summary", "provenance")):
            what = f"a table without {', '.join(lacking)}" if lacking else "a table without provenance"
            raise InputError(f"{path} must contain selection probabilities, got {what}")
        realizations = read_table(path, hdu=2)
        kinds = {name: np.asarray(table[name]).dtype.kind for name in ("BITWEIGHTS", "n_tiles")}
        if set(kinds.values()) - {*"iu"} or np.asarray(table["n_tiles"]).min(initial=0) < 0:
            raise InputError(f"{path} must store integers in BITWEIGHTS, and integers of at least 0 in n_tiles")
        bits = np.asarray(table["BITWEIGHTS"]).astype(np.int64, copy=False).reshape(len(table), -1).view(np.uint64)
        if bits.shape[1] != n_words(len(realizations)):
            raise InputError(
                f"{path} must store the bits of each target in {number_of(n_words(len(realizations)), 'integer')}, got "
                f"{bits.shape[1]}"
            )
        kept = ["n_realizations", "n_tiles", "n_rounds", "n_fibers", "model"]
        kept += ["epoch"] if "epoch" in meta["summary"] else []
        summary = {name: meta["summary"].get(name) for name in kept}
        realizations.meta = {"summary": summary, "provenance": meta["provenance"]}
        n_tiles = np.asarray(table["n_tiles"])
        n_tiles = n_tiles.astype(count_type(n_tiles.max(initial=0)))
        requested, with_visits = to_visits(table["requested"], len(table)), None
        if "n_with_visits" in table.colnames:
            with_visits = np.asarray(table["n_with_visits"]).reshape(len(table), -1)
            if with_visits.dtype.kind not in "iu" or (with_visits.sum(axis=1) != len(realizations)).any():
                raise InputError(f"{path} must store integers in n_with_visits whose sum is the number of realizations")
        return cls(np.asarray(table["target_id"]), requested, n_tiles, bits, realizations, with_visits)

    def __len__(self):
        return len(self.target_id)

    def _repr_html_(self) -> str:
        return to_html(self, self.summary, self.realizations)

    def __repr__(self):
        s = self.summary
        return (
            f"<SelectionProbabilities of {number_of(s['n_targets'], 'target')} in "
            f"{number_of(s['n_realizations'], 'realization')}: {s['n_never_observed']} never observed, "
            f"{s['n_always_observed']} always>"
        )


def selection_facts(selection: SelectionProbabilities) -> dict:
    """Return the labels and values of the numbers of selection probabilities."""
    return facts_of(SELECTION_FACTS, selection.summary)


def part_of(selection: SelectionProbabilities, rows: slice) -> SelectionProbabilities:
    """Return the selection probabilities of a slice of the targets."""
    columns = {column.name: getattr(selection, column.name) for column in fields(selection)}
    del columns["realizations"]
    return replace(selection, **{name: values[rows] for name, values in columns.items() if values is not None})


def count_type(n: int) -> type:
    """Return uint16 if this type can represent all integers up to n, otherwise uint32."""
    return np.uint16 if n < 1 << 16 else np.uint32


def n_words(n_realizations: int) -> int:
    """Return the number of 64-bit integers that contain the bits of one target."""
    return -(-n_realizations // PER_WORD)


def count_bits(bits: np.ndarray) -> np.ndarray:
    """Return, for each target, the number of bits that are 1, shape (n_targets,)."""
    return np.bitwise_count(bits).sum(axis=1, dtype=np.int64)
