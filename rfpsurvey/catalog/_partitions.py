"""Catalogs in many Parquet files, one for each HEALPix pixel, that are read where they are needed (HATS)."""

import hashlib
import os
import re
import warnings
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np
from astropy.coordinates import SkyCoord
from astropy.table import MaskedColumn, Table

from rfpsurvey import _healpix
from rfpsurvey._io import temporary_folder, to_path
from rfpsurvey._readers import content_of, import_parquet, read_parquet, sentence
from rfpsurvey.catalog._catalog import Catalog
from rfpsurvey.catalog._columns import Finder
from rfpsurvey.catalog._digest import add_stored_columns
from rfpsurvey.errors import InputError, RfpsurveyWarning

__all__ = ["PartitionedCatalog", "as_catalog", "partition_catalog"]

PART = re.compile(r"Norder=(\d+)/(?:Dir=\d+/)?Npix=(\d+)(?:\.parquet|/.+)$")
PROPERTIES = ("hats.properties", "properties")
ROLES = (
    "id",
    "ra",
    "dec",
    "lon",
    "lat",
    "pmra",
    "pmdec",
    "epoch",
    "priority",
    "kind",
    "category",
    "fiber_type",
    "visits",
)
INDEX_ORDER = 29
ROWS_PER_PART = 20_000
MOST_ORDER = 13
MOST_PROPERTIES = 2**20
SLACK_RAD = 1e-9


@dataclass(frozen=True, eq=False)
class PartitionedCatalog:
    """A catalog in a folder, laid out as HATS: Parquet files by HEALPix order and pixel (nested, ICRS).

    Of the files only the columns that a `Catalog` has are read, and only where a survey looks. Needs pyarrow
    (``rfpsurvey[parquet]``).

    Parameters
    ----------
    folder : str or path-like
        With files such as ``dataset/Norder=5/Dir=0/Npix=77.parquet``.
    columns, units : dict, optional
        As in `Catalog.from_table`; positions are in degrees where nothing else is said.
    frame : str, optional
        As in `Catalog.from_table`.
    kept_rows : int, optional
        Partitions that a survey read last stay in memory up to so many rows, of some 60 bytes each.

    Raises
    ------
    InputError
        If pyarrow or a column is missing, the folder has no such files, pixels overlap, or a file cannot be read.

    See Also
    --------
    partition_catalog : Makes such a folder.

    Examples
    --------
    >>> import tempfile
    >>> import astropy.units as u
    >>> from astropy.coordinates import SkyCoord
    >>> import rfpsurvey as rs
    >>> stars = rs.synthetic_catalog("uniform", SkyCoord("6h +23d"), 5 * u.deg, n_targets=1000, rng=1)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     _ = rs.partition_catalog(stars, f"{folder}/stars", order=3)
    ...     print(len(rs.PartitionedCatalog(f"{folder}/stars")))
    1000
    """

    folder: Path
    columns: dict = field(default_factory=dict)
    units: dict = field(default_factory=dict)
    frame: str = "icrs"
    kept_rows: int = 10_000_000

    def __post_init__(self):
        object.__setattr__(self, "folder", to_path(self.folder))
        for name in ("columns", "units"):
            if not isinstance(getattr(self, name), dict | None):
                raise InputError(f"{name} must be a dict from role to {name[:-1]}, got {getattr(self, name)!r}")
        if not isinstance(self.frame, str):
            raise InputError(f"frame must be the name of a frame, got {self.frame!r}")
        kept = self.kept_rows
        if isinstance(kept, bool) or not isinstance(kept, int | np.integer) or kept < 1:
            raise InputError(f"kept_rows must be a whole number of at least 1, got {kept!r}")
        if not self.folder.is_dir():
            raise InputError(f"{self.folder}: there is no such folder")
        if not self._files:
            files = "files such as Norder=5/Dir=0/Npix=77.parquet"
            raise InputError(f"{self.folder} is a folder without partitions, {files}")
        given = {role: name for role, name in _properties(self.folder).items() if role not in (self.columns or {})}
        said = given.pop("nrows", None)
        object.__setattr__(self, "columns", {**given, **(self.columns or {})})
        object.__setattr__(self, "units", dict(self.units or {}))
        self._refuse_overlaps()
        self._names, self._rows  # noqa: B018  (raise where columns are missing)
        if said is not None and said != str(len(self)):
            text = f"{self.folder}: the catalog must have {said} rows, as its properties say, but {len(self)} are there"
            warnings.warn(text, RfpsurveyWarning, stacklevel=3)

    @cached_property
    def _files(self) -> list[tuple[int, int, Path]]:
        """Order, pixel and file of each partition, as they follow each other on the sky."""
        found = []
        for path in sorted(self.folder.rglob("*")):
            match = PART.search(path.relative_to(self.folder).as_posix())
            if match and path.is_file() and path.suffix == ".parquet" and not path.name.startswith(("_", ".")):
                found.append((int(match[1]), int(match[2]), path))
        if any(order > INDEX_ORDER or pixel >= 12 << 2 * order for order, pixel, _ in found):
            raise InputError(f"{self.folder}: a partition has an impossible order or pixel")
        return sorted(found, key=lambda part: (part[1] << 2 * (INDEX_ORDER - part[0]), part[2]))

    def _refuse_overlaps(self):
        """Raise an error where a pixel lies inside another: its targets would be there twice."""
        orders, pixels = (np.array(values) for values in zip(*[part[:2] for part in self._files], strict=True))
        begin = pixels << 2 * (INDEX_ORDER - orders)
        end = (pixels + 1) << 2 * (INDEX_ORDER - orders)
        same = (np.diff(orders) == 0) & (np.diff(pixels) == 0)  # several files of one pixel
        bad = np.flatnonzero((begin[1:] < np.maximum.accumulate(end)[:-1]) & ~same)
        if len(bad):
            one, other = (self._files[k] for k in (bad[0], bad[0] + 1))
            raise InputError(
                f"{self.folder}: partitions must not overlap, but Norder={one[0]}/Npix={one[1]} and "
                f"Norder={other[0]}/Npix={other[1]} do"
            )

    @cached_property
    def _rows(self) -> np.ndarray:
        """First row of each partition, and the number of all rows."""
        parquet, counts, columns = import_parquet(), [], None
        for *_, path in self._files:
            about = _try(path, lambda path=path: parquet.read_metadata(path))
            counts.append(about.num_rows)
            names = set(about.schema.names)
            if columns is not None and names != columns:
                strange = ", ".join(sorted(names ^ columns))
                raise InputError(f"{path}: all partitions must have the same columns, but {strange} differs")
            columns = names
        return np.concatenate([[0], np.cumsum(counts)])

    @cached_property
    def _names(self) -> list[str]:
        """Columns to read."""
        path = self._files[0][2]
        schema = _try(path, lambda: import_parquet().read_schema(path))
        find = Finder(Table(names=schema.names, dtype=["f8"] * len(schema.names)), dict(self.columns), {})
        names = [find.name_of(role) for role in ROLES]
        needed = ("ra", "dec") if self.frame.lower() in ("icrs", "fk5", "fk4", "fk4noeterms") else ("lon", "lat")
        missing = [role for role in needed if names[ROLES.index(role)] is None]
        if missing:
            raise InputError(f"{path}: {find.missing(' and '.join(missing))}")
        return list(dict.fromkeys(name for name in names if name is not None))

    @cached_property
    def _circles(self) -> tuple[np.ndarray, np.ndarray]:
        """Circles about the partitions: unit vectors and radii (radians)."""
        vectors = np.array([_healpix.centers(2**order, [pixel])[0] for order, pixel, _ in self._files])
        return vectors, np.array([_healpix.pixel_radius(2**order) for order, *_ in self._files])

    def __len__(self):
        return int(self._rows[-1])

    def __repr__(self):
        return f"<PartitionedCatalog of {len(self)} targets in {len(self._files)} partitions>"

    @property
    def meta(self) -> dict:
        """Where the catalog comes from."""
        return {"folder": self.folder.name, "n_partitions": len(self._files)}

    def read(self) -> Catalog:
        """Return the whole catalog, its rows in the order of the partitions; it must fit into memory.

        Returns
        -------
        Catalog
            All targets.

        Raises
        ------
        InputError
            If a file cannot be read, or holds values that no `Catalog` may have.
        """
        tables = [self._table(k, self._names) for k in range(len(self._files))]
        try:
            merged = Table({name: _joined([table[name] for table in tables]) for name in self._names})
        except (KeyError, TypeError, ValueError) as error:
            raise InputError(f"{self.folder}: columns must have one type in all partitions: {error}") from None
        return self._catalog(merged, self.folder)

    def _near(self, center: np.ndarray, radius_rad: float) -> np.ndarray:
        """Return the partitions that a circle may touch."""
        vectors, radii = self._circles
        half_chord = 0.5 * np.linalg.norm(vectors - center, axis=1)
        return np.flatnonzero(2 * np.arcsin(np.minimum(half_chord, 1.0)) <= radii + radius_rad + SLACK_RAD)

    def _part(self, k: int) -> Catalog:
        """Return the targets of a partition; without an id of their own, they are numbered by the rows of all."""
        path = self._files[k][2]
        catalog = self._catalog(self._table(k, self._names), path)
        n = int(self._rows[k + 1] - self._rows[k])
        if len(catalog) < n:
            raise InputError(f"{path}: {n - len(catalog)} of {n} rows have no finite coordinates; leave them out")
        middles, radii = self._circles
        chord = np.linalg.norm(catalog._vectors - middles[k], axis=1).max(initial=0.0)
        if 2 * np.arcsin(min(chord / 2, 1.0)) > radii[k] + SLACK_RAD:
            raise InputError(f"{path}: targets lie outside the pixel, which must be that of nested order and ICRS")
        if k and catalog.id.dtype.kind != self._id_kind:
            raise InputError(f"{path}: ids must be integers in all partitions, or text in all")
        return catalog

    @cached_property
    def _id_kind(self) -> str:
        return self._part(0).id.dtype.kind

    def _column(self, name: str) -> np.ndarray | None:
        """Return one column of all targets."""
        if name != "id" and getattr(self._part(0), name) is None:
            return None
        return np.concatenate([getattr(self._part(k), name) for k in range(len(self._files))])

    def _table(self, k: int, names: list[str]) -> Table:
        table = read_parquet(self._files[k][2], names)
        if self._has_no_id:
            table["id"] = np.arange(self._rows[k], self._rows[k + 1])
        return table

    def _digest(self) -> str:
        """Return a digest of the files: of the stored bytes of the columns that are read, and of nothing else."""
        found = hashlib.sha256(repr((sorted(self.columns.items()), sorted(self.units.items()), self.frame)).encode())
        for order, pixel, path in self._files:
            found.update(f"{order}/{pixel}".encode())
            _try(path, lambda path=path: add_stored_columns(found, path, self._names))
        return found.hexdigest()[:16]

    @cached_property
    def _has_no_id(self) -> bool:
        find = Finder(Table(names=self._names, dtype=["f8"] * len(self._names)), dict(self.columns), {})
        return find.name_of("id") is None

    def _catalog(self, table, path) -> Catalog:
        try:
            return Catalog._from_table(table, self.columns, self.units, self.frame, assume_units=True)
        except InputError as error:
            raise InputError(f"{path}: {error}") from None


def partition_catalog(
    catalog: Catalog | SkyCoord | Table, folder: str | os.PathLike, *, order: int | None = None
) -> PartitionedCatalog:
    """Write a catalog as Parquet files by HEALPix pixel, in the layout of HATS.

    Parameters
    ----------
    catalog : Catalog, SkyCoord or Table
        The targets, at their epoch.
    folder : str or path-like
        A folder that does not exist yet; it appears whole or not at all.
    order : int, optional
        HEALPix order of the partitions, 0 to 13; by default such that one holds about 20,000 targets.

    Returns
    -------
    PartitionedCatalog
        The same targets, sorted along the HEALPix curve.

    Raises
    ------
    InputError
        If the catalog is empty, the folder exists, the order is impossible, or pyarrow is missing.

    Examples
    --------
    >>> import tempfile
    >>> import astropy.units as u
    >>> from astropy.coordinates import SkyCoord
    >>> import rfpsurvey as rs
    >>> stars = rs.synthetic_catalog("uniform", SkyCoord("6h +23d"), 5 * u.deg, n_targets=1000, rng=1)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     parts = rs.partition_catalog(stars, f"{folder}/stars", order=3)
    ...     print(len(parts), len(parts.read()))
    1000 1000
    """
    parquet, catalog = import_parquet(), as_catalog(catalog)
    import pyarrow as pa

    if len(catalog) == 0:
        raise InputError("the catalog must have at least one target, got none")
    vectors = catalog._vectors
    if order is None:
        order = next((k for k in range(MOST_ORDER) if _mean_rows(vectors, k) <= ROWS_PER_PART), MOST_ORDER)
    if isinstance(order, bool) or not (isinstance(order, int | np.integer) and 0 <= order <= MOST_ORDER):
        raise InputError(f"order must be a whole number from 0 to {MOST_ORDER}, got {order!r}")
    fine = _healpix.pixels_of(2**INDEX_ORDER, vectors)
    along = np.argsort(fine, kind="stable")
    table = catalog[along].to_table()
    columns = {f"_healpix_{INDEX_ORDER}": fine[along]}
    columns.update((name, np.asarray(getattr(table[name], "value", table[name]))) for name in table.colnames)
    content = pa.table(columns)
    pixel = fine[along] >> 2 * (INDEX_ORDER - order)
    pixels, first = np.unique(pixel, return_index=True)
    with temporary_folder(folder) as temporary:
        for number, begin, end in zip(pixels.tolist(), first, [*first[1:], len(pixel)], strict=True):
            place = temporary / "dataset" / f"Norder={order}" / f"Dir={number // 10000 * 10000}"
            place.mkdir(parents=True, exist_ok=True)
            parquet.write_table(content.slice(begin, end - begin), place / f"Npix={number}.parquet")
        parquet.write_metadata(content.schema, temporary / "dataset" / "_common_metadata")
        lines = [f"{order},{number}" for number in pixels.tolist()]
        (temporary / "partition_info.csv").write_text("\n".join(["Norder,Npix", *lines]) + "\n")
        (temporary / "hats.properties").write_text(
            f"obs_collection={to_path(folder).name}\ndataproduct_type=object\nhats_nrows={len(catalog)}\n"
            f"hats_col_ra=ra\nhats_col_dec=dec\nhats_order={order}\nhats_npix_suffix=.parquet\n"
        )
    return PartitionedCatalog(folder)


def as_catalog(catalog: Catalog | PartitionedCatalog | SkyCoord | Table) -> Catalog:
    """Return a catalog from itself, from coordinates, a table or all partitions."""
    if isinstance(catalog, PartitionedCatalog):
        return catalog.read()
    if isinstance(catalog, str | os.PathLike):
        raise InputError(f"the catalog must be read first: Catalog.read({str(catalog)!r})")
    if isinstance(catalog, Catalog):
        return catalog
    return Catalog.from_table(catalog) if isinstance(catalog, Table) else Catalog(catalog)


def _joined(columns: list) -> np.ndarray:
    """Return the values of columns one after the other, masked where one of them is."""
    masked = any(isinstance(column, MaskedColumn) for column in columns)
    kinds = {column.dtype.kind == "U" for column in columns}
    if len(kinds) > 1:
        raise TypeError(f"{columns[0].name} holds numbers and text")
    return (np.ma.concatenate if masked else np.concatenate)(columns)


def _mean_rows(vectors, order) -> float:
    return len(vectors) / len(np.unique(_healpix.pixels_of(2**order, vectors)))


def _properties(folder: Path) -> dict[str, str]:
    """Return the columns of positions that a HATS catalog names, and its number of rows."""
    found = {}
    for name in PROPERTIES:
        path = folder / name
        if path.is_file():
            try:
                text = content_of(path, most=MOST_PROPERTIES).decode("utf-8")
            except UnicodeDecodeError as error:
                raise InputError(
                    f"{path} must be text in UTF-8, got the byte 0x{error.object[error.start]:02x}"
                ) from None
            for line in text.splitlines():
                key, sign, value = line.partition("=")
                if sign and key.strip() in ("hats_col_ra", "hats_col_dec", "hats_nrows"):
                    found[key.strip().removeprefix("hats_").removeprefix("col_")] = value.strip()
    return found


def _try(path, read):
    """Read, or say which file cannot be read."""
    try:
        return read()
    except Exception as error:  # pyarrow raises what it likes
        raise InputError(f"{path} cannot be read: {sentence(error)}") from error
