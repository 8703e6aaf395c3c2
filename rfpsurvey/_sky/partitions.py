"""Catalogs in the HATS layout (one Parquet file for each HEALPix pixel, which is read on use), and their properties."""

import os
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np
from astropy.coordinates import BaseCoordinateFrame, SkyCoord
from astropy.table import MaskedColumn, Table

from rfpsurvey._common.files import check_new_folder, check_texts, to_path
from rfpsurvey._common.io import temporary_folder
from rfpsurvey._common.read_documents import content_of, is_present
from rfpsurvey._common.read_tables import import_parquet, unit_metadata
from rfpsurvey._sky import shapes as _healpix
from rfpsurvey._sky.catalog import Catalog
from rfpsurvey._sky.catalog_files import origin_of
from rfpsurvey._sky.frames import is_table
from rfpsurvey._sky.parts import INDEX_ORDER, Partitions
from rfpsurvey._sky.tables import catalog_roles
from rfpsurvey._sky.time import to_time
from rfpsurvey.errors import InputError, InputTypeError, check_keywords, check_whole, number_of, short, warn

PROPERTIES = ("hats.properties", "properties")
COLLECTION = "collection.properties"
MOST_PROPERTIES = 2**20
# Roles of columns that properties name, with the current name and the former name of each property.
NAMED = {
    "ra": ("hats_col_ra", "hats_col_j2000_ra"),
    "dec": ("hats_col_dec", "hats_col_j2000_dec"),
    "id": ("hats_cols_survey_id",),
}
NO_TARGETS = {
    "margin": "copies of the targets near the edges of the pixels",
    "association": "pairs of rows of two catalogs",
    "index": "an index of another catalog",
    "map": "values of pixels",
}


def main_table(folder: Path) -> tuple[Path, str]:
    """Return the folder of the main table of a HATS collection, and text that lists the other tables.

    If the folder is not a collection, the folder itself and empty text are returned.
    """
    path = folder / COLLECTION
    if not is_present(path) or any(is_present(folder / name) for name in PROPERTIES):
        return folder, ""
    properties = _read(path)
    url = properties.get("hats_primary_table_url", "")
    main = folder / url
    if not url or "://" in url or not main.is_dir():
        raise InputError(f"{path}: hats_primary_table_url must be the folder of the main table, got {url!r}")
    margins, indexes = properties.get("all_margins", "").split(), properties.get("all_indexes", "").split()[1::2]
    left = [f"margin {name}" for name in margins] + [f"index {name}" for name in indexes]
    return main, f"main table {url}" + (f"; not read: {', '.join(left)}" if left else "")


def properties_of(folder: Path, first: Path) -> dict[str, str]:
    """Return the properties of a catalog; raise an error if the catalog does not contain targets.

    ``folder`` is the folder of the catalog or its folder ``dataset``, and ``first`` is the path of a partition.
    """
    top = next(path.parent for path in first.parents if path.name.startswith("Norder="))
    places = [folder, top] + ([top.parent] if top.name == "dataset" else [])
    paths = (place / name for place in places for name in PROPERTIES)
    path = next((path for path in paths if is_present(path)), None)
    if path is None:
        return {}
    properties = _read(path)
    kind, main = properties.get("dataproduct_type", ""), properties.get("hats_primary_table_url", "")
    if kind in NO_TARGETS:
        remedy = f"; open the main table, {main}" if main else ""
        raise InputError(f"{path}: dataproduct_type must be object, got {kind}, which means {NO_TARGETS[kind]}{remedy}")
    if kind == "source":
        warn(f"{path}: dataproduct_type is source: each detection of an object is planned as a separate target")
    frame = properties.get("hats_frame", "equatorial")
    if frame.lower() not in ("equatorial", "icrs", ""):
        raise InputError(f"{path}: hats_frame must be equatorial, because pixels must be in ICRS, got {frame}")
    if "hats_coordinate_epoch" in properties:
        to_time(properties["hats_coordinate_epoch"], f"{path}: hats_coordinate_epoch")
    return properties


def columns_and_rows(known: dict[str, str]) -> tuple[dict[str, str], str | None]:
    """Return the column of each role that the properties name, and the number of rows (None if it is not stated)."""
    columns = {role: next((known[name] for name in names if name in known), "") for role, names in NAMED.items()}
    return {role: name for role, name in columns.items() if len(name.split()) == 1}, known.get("hats_nrows")


def _read(path: Path) -> dict[str, str]:
    """Return the names and values in a properties file."""
    try:
        text = content_of(path, most=MOST_PROPERTIES).decode("utf-8")
    except UnicodeDecodeError as error:
        raise InputError(f"{path} must be text in UTF-8, got the byte 0x{error.object[error.start]:02x}") from None
    lines = (line.partition("=") for line in text.splitlines() if not line.lstrip().startswith(("#", "!")))
    return {key.strip(): value.strip() for key, sign, value in lines if sign}


ROWS_PER_PART = 20_000
MOST_ORDER = 13


@check_keywords
@dataclass(frozen=True, eq=False)
class PartitionedCatalog:
    """A catalog in a folder with the HATS layout, which has a Parquet file for each HEALPix pixel (nested, ICRS).

    A survey reads only the partitions (files) around its fields, and only the columns that a `~rfpsurvey.Catalog` uses.
    This class requires pyarrow (``rfpsurvey[parquet]``).

    Parameters
    ----------
    folder : str or path-like
        Folder with files such as ``dataset/Norder=5/Dir=0/Npix=77.parquet``, or the folder of a HATS collection, of
        which only the main table is read. ``meta["collection"]`` lists the other tables.
    columns, units : dict, optional
        Names and units of columns, as in `~rfpsurvey.Catalog.from_table`. Positions without a unit are assumed to be in
        degrees; no warning is issued.
    frame : str, optional
        Frame of the coordinates, as in `~rfpsurvey.Catalog.from_table`.
    fill : dict, optional
        Values that replace missing values, as in `~rfpsurvey.Catalog.from_table`.
    keep : list of str, optional
        Names of further columns that results include, as in `~rfpsurvey.Catalog.from_table`.
    kept_rows : int, optional
        Largest number of rows of recently read partitions that a survey keeps in memory; a row uses about 60 bytes.

    Raises
    ------
    InputError
        If pyarrow or a column is missing, if the folder contains no partitions, if partitions overlap, or if a file
        cannot be read.

    See Also
    --------
    partition_catalog : Write a catalog in this layout.

    Examples
    --------
    >>> import tempfile
    >>> import astropy.units as u
    >>> from astropy.coordinates import BaseCoordinateFrame, SkyCoord
    >>> import rfpsurvey as rs
    >>> stars = rs.synthetic_catalog("uniform", SkyCoord("6h +23d"), 5 * u.deg, n_targets=1000, rng=1)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     _ = rs.catalog.partition_catalog(stars, f"{folder}/stars", order=3)
    ...     print(len(rs.catalog.PartitionedCatalog(f"{folder}/stars")))
    1000
    """

    folder: Path
    columns: dict = field(default_factory=dict)
    units: dict = field(default_factory=dict)
    frame: str = "icrs"
    fill: dict = field(default_factory=dict)
    keep: list | None = None
    kept_rows: int = 10_000_000

    def __post_init__(self):
        object.__setattr__(self, "folder", to_path(self.folder))
        for name, what in (("columns", "column"), ("units", "unit"), ("fill", "value")):
            if not isinstance(getattr(self, name), dict | None):
                raise InputError(f"{name} must be a dict from role to {what}, got {short(getattr(self, name))}")
        keep = [self.keep] if isinstance(self.keep, str) else list(self.keep or [])
        object.__setattr__(self, "keep", keep)
        if not isinstance(self.frame, str):
            raise InputError(f"frame must be the name of a frame, got {short(self.frame)}")
        check_whole(self.kept_rows, "kept_rows")
        if not self.folder.is_dir():
            raise InputError(f"{self.folder}: there is no such folder")
        for name, value in zip(("folder", "_collection"), main_table(self.folder), strict=True):
            object.__setattr__(self, name, value)
        if not self.parts.files:
            files = "(files such as Norder=5/Dir=0/Npix=77.parquet)"
            raise InputError(f"{self.folder} must contain partitions {files}, got a folder without partitions")
        object.__setattr__(self, "properties", properties_of(self.folder, self.parts.files[0][2]))
        named, said = columns_and_rows(self.properties)
        for name, default in (("columns", self.parts.existing(named)), ("units", {}), ("fill", {})):
            object.__setattr__(self, name, {**default, **(getattr(self, name) or {})})
        self.parts.refuse_overlaps()
        self.parts.finder.warn_of_doubt()
        self.parts.names, self.parts.rows  # noqa: B018  (raises an error if columns are missing)
        if said is not None and said != str(len(self)):
            text = f"{self.folder}: the catalog must have the {said} rows that its properties file states"
            warn(f"{text}, got {len(self)} rows")

    @cached_property
    def parts(self) -> Partitions:
        """The partitions of the catalog (an instance of ``Partitions``)."""
        return Partitions(self)

    def __len__(self):
        return int(self.parts.rows[-1])

    def __repr__(self):
        parts = number_of(len(self.parts.files), "partition")
        return f"<PartitionedCatalog of {number_of(len(self), 'target')} in {parts}>"

    @property
    def meta(self) -> dict:
        """Information on the origin of the catalog."""
        columns = self.parts.finder.statement(catalog_roles(self.frame), self.keep)
        about = {"folder": self.folder.name, "n_partitions": len(self.parts.files), "columns": columns}
        return about | ({"collection": self._collection} if self._collection else {})

    @property
    def origin(self) -> dict:
        """The arguments with which the catalog was opened, as text and numbers, with the absolute path."""
        given = {name: getattr(self, name) for name in ("columns", "units", "fill", "keep", "frame")}
        return origin_of(self.folder, "", given)

    def read(self) -> Catalog:
        """Return the whole catalog, which must fit into memory, with the rows in the order of the partitions.

        Returns
        -------
        Catalog
            All targets.

        Raises
        ------
        InputError
            If a file cannot be read, or contains values that are not valid in a `~rfpsurvey.Catalog`.
        """
        tables = [self.parts.table(k, self.parts.names) for k in range(len(self.parts.files))]
        try:
            merged = Table({name: _joined([table[name] for table in tables]) for name in self.parts.names})
        except (KeyError, TypeError, ValueError) as error:
            raise InputError(f"{self.folder}: each column must have the same type in all partitions: {error}") from None
        catalog = self.parts.to_catalog(merged, self.folder)
        catalog.meta.update(self.meta)
        return catalog


@check_keywords
def partition_catalog(
    catalog: Catalog | SkyCoord | Table, folder: str | os.PathLike, *, order: int | None = None
) -> PartitionedCatalog:
    """Write a catalog in the HATS layout, with one Parquet file for each HEALPix pixel.

    Parameters
    ----------
    catalog : Catalog, SkyCoord, Table or DataFrame
        The targets. Positions are written at the epoch of the catalog.
    folder : str or path-like
        Folder to create; it must not exist yet. If writing fails, no incomplete folder remains.
    order : int, optional
        HEALPix order of the partitions, 0 to 13; by default, the lowest order for which the partitions contain at most
        20,000 targets on average.

    Returns
    -------
    PartitionedCatalog
        The same targets, sorted by HEALPix pixel (nested).

    Raises
    ------
    InputError
        If the catalog is empty, if the folder exists, if the order is out of range, or if pyarrow is missing.

    Examples
    --------
    >>> import tempfile
    >>> import astropy.units as u
    >>> from astropy.coordinates import BaseCoordinateFrame, SkyCoord
    >>> import rfpsurvey as rs
    >>> stars = rs.synthetic_catalog("uniform", SkyCoord("6h +23d"), 5 * u.deg, n_targets=1000, rng=1)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     parts = rs.catalog.partition_catalog(stars, f"{folder}/stars", order=3)
    ...     print(len(parts), len(parts.read()))
    1000 1000
    """
    folder, parquet, catalog = check_new_folder(folder), import_parquet(), as_catalog(catalog)
    import pyarrow as pa

    if len(catalog) == 0:
        raise InputError("the catalog must have at least one target, got none")
    vectors = catalog.arrays.vectors
    if order is None:
        order = next((k for k in range(MOST_ORDER) if _mean_rows(vectors, k) <= ROWS_PER_PART), MOST_ORDER)
    check_whole(order, "order", 0, MOST_ORDER)
    fine = _healpix.pixels_of(2**INDEX_ORDER, vectors)
    along = np.argsort(fine, kind="stable")
    table = catalog[along].to_table()
    check_texts(table, folder)
    columns = {f"_healpix_{INDEX_ORDER}": fine[along]}
    columns.update((name, np.asarray(getattr(table[name], "value", table[name]))) for name in table.colnames)
    content = pa.table(columns, metadata=unit_metadata(table))
    # in the nested scheme, each lower order removes two bits
    pixel = fine[along] >> 2 * (INDEX_ORDER - order)
    pixels, first = np.unique(pixel, return_index=True)
    with temporary_folder(folder) as temporary:
        for number, begin, end in zip(pixels.tolist(), first, [*first[1:], len(pixel)], strict=True):
            place = temporary / "dataset" / f"Norder={order}" / f"Dir={number // 10000 * 10000}"
            place.mkdir(parents=True, exist_ok=True)
            part = content.slice(begin, end - begin)
            parquet.write_table(part, place / f"Npix={number}.parquet", write_page_checksum=True)
        parquet.write_metadata(content.schema, temporary / "dataset" / "_common_metadata")
        lines = [f"{order},{number}" for number in pixels.tolist()]
        (temporary / "partition_info.csv").write_text("\n".join(["Norder,Npix", *lines]) + "\n")
        (temporary / "hats.properties").write_text(
            f"obs_collection={to_path(folder).name}\ndataproduct_type=object\nhats_nrows={len(catalog)}\n"
            f"hats_col_ra=ra\nhats_col_dec=dec\nhats_order={order}\nhats_npix_suffix=.parquet\n"
        )
    return PartitionedCatalog(folder)


def as_catalog(catalog: Catalog | PartitionedCatalog | SkyCoord | Table) -> Catalog:
    """Convert a Catalog, PartitionedCatalog, SkyCoord, table or DataFrame to a Catalog."""
    if isinstance(catalog, PartitionedCatalog):
        return catalog.read()
    if isinstance(catalog, str | os.PathLike):
        raise InputError(f"the catalog must be read first: Catalog.read({str(catalog)!r})")
    if isinstance(catalog, Catalog):
        return catalog
    if is_table(catalog):
        return Catalog.from_table(catalog)
    if not isinstance(catalog, SkyCoord | BaseCoordinateFrame):
        raise InputTypeError(f"catalog must be a Catalog, SkyCoord, Table or DataFrame, got {short(catalog)}")
    return Catalog(catalog)


def _joined(columns: list) -> np.ndarray:
    """Concatenate the values of one column in several partitions; masked values remain masked."""
    masked = any(isinstance(column, MaskedColumn) for column in columns)
    kinds = {column.dtype.kind == "U" for column in columns}
    if len(kinds) > 1:
        raise TypeError(f"the column {columns[0].name} contains numbers and text")
    return (np.ma.concatenate if masked else np.concatenate)(columns)


def _mean_rows(vectors, order) -> float:
    return len(vectors) / len(np.unique(_healpix.pixels_of(2**order, vectors)))
