"""The files of a partitioned catalog, one for each HEALPix pixel."""

import hashlib
import re
from dataclasses import replace
from functools import cached_property
from pathlib import Path

import numpy as np
from astropy.table import Table, vstack

from rfpsurvey._common.read_documents import check_is_file, reading
from rfpsurvey._common.read_tables import import_parquet, read_parquet
from rfpsurvey._sky import shapes as _healpix
from rfpsurvey._sky.catalog import Catalog
from rfpsurvey._sky.columns import ROLES as COLUMN_ROLES
from rfpsurvey._sky.columns import Finder
from rfpsurvey._sky.survey_formats import check_mode
from rfpsurvey._sky.tables import EQUATORIAL, read_columns
from rfpsurvey.errors import InputError, listed

PART = re.compile(r"Norder=(\d+)/(?:Dir=\d+/)?Npix=(\d+)(?:\.parquet|/.+)$")
ROLES = tuple(role for role in COLUMN_ROLES if role not in ("positioner", "x", "y"))
INDEX_ORDER = 29
# Allowance for rounding errors of angles on the sky.
SLACK_RAD = 1e-9


class Partitions:
    """The individual partitions of a catalog; rows are numbered consecutively through all partitions.

    Parameters
    ----------
    catalog : PartitionedCatalog
        The catalog.
    """

    def __init__(self, catalog):
        self.catalog = catalog

    @cached_property
    def files(self) -> list[tuple[int, int, Path]]:
        """HEALPix order, pixel and file of each partition, sorted by the position of the pixel in the nested scheme."""
        parts = []
        for path in sorted(self.catalog.folder.rglob("*")):
            match = PART.search(path.relative_to(self.catalog.folder).as_posix())
            if match and not path.is_dir() and path.suffix == ".parquet" and not path.name.startswith(("_", ".")):
                check_is_file(path)
                parts.append((int(match[1]), int(match[2]), path))
        tops = sorted({path.as_posix().partition("/Norder=")[0] for *_, path in parts})
        if len(tops) > 1:
            raise InputError(
                f"{self.catalog.folder} must contain one catalog, got partitions in {tops[0]} and {tops[1]}; open the "
                "folder of one catalog"
            )
        if any(order > INDEX_ORDER or pixel >= 12 << 2 * order for order, pixel, _ in parts):
            raise InputError(f"{self.catalog.folder}: a partition has an impossible order or pixel")
        return sorted(parts, key=lambda part: (part[1] << 2 * (INDEX_ORDER - part[0]), part[2]))

    def refuse_overlaps(self) -> None:
        """Raise an error if the pixels of two partitions overlap, because a target could then occur in both."""
        orders, pixels = (np.array(values) for values in zip(*[part[:2] for part in self.files], strict=True))
        begin = pixels << 2 * (INDEX_ORDER - orders)
        end = (pixels + 1) << 2 * (INDEX_ORDER - orders)
        same = (np.diff(orders) == 0) & (np.diff(pixels) == 0)  # one pixel may have several files
        # a large pixel can overlap more than the next partition
        bad = np.flatnonzero((begin[1:] < np.maximum.accumulate(end)[:-1]) & ~same)
        if len(bad):
            first, second = (self.files[k] for k in (bad[0], bad[0] + 1))
            raise InputError(
                f"{self.catalog.folder}: partitions must not overlap, but Norder={first[0]}/Npix={first[1]} and "
                f"Norder={second[0]}/Npix={second[1]} do"
            )

    @cached_property
    def rows(self) -> np.ndarray:
        """Row number of the first target of each partition, followed by the total number of rows."""
        parquet, counts, columns = import_parquet(), [], None
        for *_, path in self.files:
            with reading(path, "parquet"):
                about = parquet.read_metadata(path)
            counts.append(about.num_rows)
            names = set(about.schema.names)
            if columns is not None and names != columns:
                strange = ", ".join(sorted(names ^ columns))
                raise InputError(
                    f"{path}: all partitions must have the same columns, but some partitions have no {strange}"
                )
            columns = names
        return np.concatenate([[0], np.cumsum(counts)])

    @cached_property
    def finder(self) -> Finder:
        """The finder of the columns of all partitions, which have the same columns."""
        names = self._schema
        return Finder(Table(names=names, dtype=["f8"] * len(names)), dict(self.catalog.columns), {})

    @cached_property
    def _schema(self) -> list[str]:
        path = self.files[0][2]
        with reading(path, "parquet"):
            return list(import_parquet().read_schema(path).names)

    def existing(self, columns: dict[str, str]) -> dict[str, str]:
        """Return the entries of a dict from role to column whose column exists; ``ra`` and ``dec`` must exist."""
        return {role: name for role, name in columns.items() if role != "id" or name in self._schema}

    @cached_property
    def names(self) -> list[str]:
        """Names of the columns that are read from each partition."""
        find, path = self.finder, self.files[0][2]
        names = [find.name_of(role) for role in ROLES]
        names += [] if find.format is None else [find.format.bits, find.format.stars, *find.format.marks]
        needed = ("ra", "dec") if self.catalog.frame.lower() in EQUATORIAL else ("lon", "lat")
        missing = [role for role in needed if names[ROLES.index(role)] is None]
        if missing:
            raise InputError(f"{path}: {find.missing(' and '.join(missing))}")
        lacking = [name for name in self.catalog.keep if name not in find.table.colnames]
        if lacking:
            raise InputError(
                f"columns that are kept, or that a rule uses, must be columns of {path} "
                f"({listed(find.table.colnames)}), got {lacking[0]!r}"
            )
        return list(dict.fromkeys(name for name in (*names, *self.catalog.keep) if name is not None))

    @cached_property
    def circles(self) -> tuple[np.ndarray, np.ndarray]:
        """Circles that enclose the partitions: unit vectors of the centers, and radii in radians."""
        vectors = np.array([_healpix.centers(2**order, [pixel])[0] for order, pixel, _ in self.files])
        return vectors, np.array([_healpix.pixel_radius(2**order) for order, *_ in self.files])

    def near(self, center: np.ndarray, radius_rad: float) -> np.ndarray:
        """Return the indices of the partitions that can contain targets inside a circle on the sky."""
        vectors, radii = self.circles
        half_chord = 0.5 * np.linalg.norm(vectors - center, axis=1)
        return np.flatnonzero(2 * np.arcsin(np.minimum(half_chord, 1.0)) <= radii + radius_rad + SLACK_RAD)

    def part(self, k: int) -> Catalog:
        """Return the targets of partition k.

        If the catalog has no column of identifiers, the identifiers are the row numbers in the whole catalog.
        """
        path = self.files[k][2]
        table = self.table(k, self.names)
        catalog = self.to_catalog(table, path)
        self._check_mode(k, table)
        n = int(self.rows[k + 1] - self.rows[k])
        if "ledger" in catalog.meta:
            raise InputError(f"{path}: each target must have a single row, but {catalog.meta['ledger']}")
        if len(catalog) < n:
            raise InputError(
                f"{path}: all coordinates must be finite, got {n - len(catalog)} of {n} rows without finite "
                "coordinates; remove these rows"
            )
        middles, radii = self.circles
        chord = np.linalg.norm(catalog.arrays.vectors - middles[k], axis=1).max(initial=0.0)
        if 2 * np.arcsin(min(chord / 2, 1.0)) > radii[k] + SLACK_RAD:
            raise InputError(
                f"{path}: all targets must lie inside the HEALPix pixel (nested, ICRS), got targets outside the pixel"
            )
        if k and catalog.id.dtype.kind != self._id_kind:
            raise InputError(f"{path}: ids must be integers in all partitions, or text in all partitions")
        return catalog

    def _check_mode(self, k: int, table: Table) -> None:
        """Raise an error if the targets of partition k and of the first partition cannot share an exposure."""
        mode = "" if self.finder.format is None else self.finder.format.mode
        if k and mode:
            try:
                check_mode(vstack([self._first_modes, table[[mode]]]), mode, "catalog")
            except InputError as error:
                raise InputError(f"{self.files[k][2]} and {self.files[0][2]}: {error}") from None

    @cached_property
    def _first_modes(self) -> Table:
        return self.table(0, [self.finder.format.mode])

    @cached_property
    def _id_kind(self) -> str:
        return self.part(0).id.dtype.kind

    def column(self, name: str) -> np.ndarray | None:
        """Return a column of the whole catalog, or None if the catalog does not have this column."""
        if name != "id" and getattr(self.part(0), name) is None:
            return None
        return np.concatenate([getattr(self.part(k), name) for k in range(len(self.files))])

    def table(self, k: int, names: list[str]) -> Table:
        """Return a table with the given columns of partition k."""
        table = read_parquet(self.files[k][2], names)
        if self._has_no_id:
            table["id"] = np.arange(self.rows[k], self.rows[k + 1])
        return table

    def digest(self) -> str:
        """Return a digest of the parameters of the catalog and of the stored bytes of all columns that are read."""
        about = sorted(self.catalog.columns.items()), sorted(self.catalog.units.items()), self.catalog.frame
        about += (sorted(self.catalog.fill.items()),) if self.catalog.fill else ()
        digest = hashlib.sha256(repr(about).encode())
        for order, pixel, path in self.files:
            digest.update(f"{order}/{pixel}".encode())
            with reading(path, "parquet"):
                add_stored_columns(digest, path, self.names)
        return digest.hexdigest()[:16]

    @cached_property
    def _has_no_id(self) -> bool:
        return self.finder.name_of("id") is None

    def to_catalog(self, table: Table, path: Path) -> Catalog:
        """Convert the table of a file to a catalog; error messages contain the name of the file."""
        try:
            asked = self.catalog
            if epoch := asked.properties.get("hats_coordinate_epoch"):
                table.meta["ref_epoch"] = epoch
            given = table, asked.columns, asked.units, asked.frame, asked.fill, asked.keep or None
            catalog = Catalog(**read_columns(*given, assume_units=True))
            return replace(catalog, numbered=True) if self._has_no_id else catalog
        except InputError as error:
            raise InputError(f"{path}: {error}") from None


def add_stored_columns(digest, path: Path, names: list[str]) -> None:
    """Update a ``hashlib`` digest with the types and the stored bytes of the given columns of a Parquet file."""
    from pyarrow import parquet

    about = parquet.read_metadata(path)
    columns = [(about.schema.column(k).path, k) for k in range(about.num_columns)]
    columns = sorted((name, k) for name, k in columns if name.split(".")[0] in names)
    with path.open("rb") as file:
        for name, k in columns:
            kind = about.schema.column(k)
            digest.update(f"{name} {kind.physical_type} {kind.logical_type}".encode())
            for group in range(about.num_row_groups):
                chunk = about.row_group(group).column(k)
                begin = chunk.data_page_offset
                if chunk.has_dictionary_page:
                    begin = min(begin, chunk.dictionary_page_offset or begin)
                digest.update(f"{chunk.compression} {chunk.num_values}".encode())
                file.seek(begin)
                digest.update(file.read(chunk.total_compressed_size))
