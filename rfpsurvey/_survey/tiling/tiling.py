"""The tiles of a survey: centers, position angles, passes."""

import os
from dataclasses import dataclass
from functools import cached_property

import astropy.units as u
import numpy as np
from astropy.coordinates import SkyCoord
from astropy.table import QTable, Table
from astropy.time import Time

from rfpsurvey._common import io as _io
from rfpsurvey._common.descriptions import to_html
from rfpsurvey._common.files import lacks_units
from rfpsurvey._common.read_tables import read_table
from rfpsurvey._common.small_figures import figure_of_tiles
from rfpsurvey._common.units import (
    to_direction,
    to_labels,
    to_lonlat,
    to_plain,
    to_scalar,
    to_unit,
    to_vectors,
)
from rfpsurvey._sky import shapes as _healpix
from rfpsurvey._sky.arrays import SkyIndex
from rfpsurvey._sky.conditions import ObservingConditions, check_conditions
from rfpsurvey._sky.frames import as_table, is_table, select_rows
from rfpsurvey._survey.tiling.columns import (
    COLUMNS,
    convert_when,
    find_names,
    is_of_pfs,
    pfs_angle,
    read_angles,
    times_of_tiles,
    without_others,
)
from rfpsurvey.errors import InputError, InputTypeError, number_of


@dataclass(frozen=True, eq=False)
class Tiling:
    """The tiles of a survey, one per row, in the order in which they are to be observed.

    Parameters
    ----------
    table : QTable
        Columns ``tile`` (integer or text, unique), ``ra`` and ``dec`` (ICRS), ``position_angle`` (of the +y axis, from
        north toward east) and ``pass`` (integer); further columns are kept. ``meta["summary"]`` describes how the
        tiling was made.

    Raises
    ------
    InputError
        If a column is missing or has invalid values, if an identifier occurs twice, or if two tiles have the same
        center, position angle and pass (and ``program``, if there is such a column).

    Examples
    --------
    >>> import astropy.units as u
    >>> from astropy.table import QTable
    >>> import rfpsurvey as rs
    >>> tiling = rs.Tiling.from_table(QTable({"racen": [95, 97] * u.deg, "deccen": [23, 23] * u.deg}))
    >>> tiling.table["pass"].tolist(), len(tiling)
    ([1, 1], 2)
    """

    table: QTable

    def __post_init__(self):
        if not isinstance(self.table, QTable):
            raise InputTypeError(f"table must be a QTable, got {type(self.table).__name__}")
        lacking = [name for name in COLUMNS if name not in self.table.colnames]
        if lacking:
            raise InputError(f"the table does not describe a tiling: it lacks {', '.join(lacking)}")
        tile = to_labels(self.table["tile"], "tile")
        angles = {name: to_unit(self.table[name], u.deg, name) for name in ("ra", "dec", "position_angle")}
        for name, low, high in (("ra", -180, 360), ("dec", -90, 90), ("position_angle", -3600, 3600)):
            bad = np.flatnonzero(~((angles[name] >= low) & (angles[name] <= high)))
            if len(bad):
                raise InputError(
                    f"{name} must lie between {low} and {high} deg for every tile, got {angles[name][bad[0]]:g} for "
                    f"tile {tile[bad[0]]}" + (f"; further invalid values: {len(bad) - 1}" if len(bad) > 1 else "")
                )
        number = _integers(self.table["pass"], tile)
        names, times = np.unique(tile, return_counts=True)
        if (times > 1).any():
            again = np.argmax(times > 1)
            raise InputError(f"every tile must have a unique id, but {names[again]} occurs {times[again]} times")
        table = self.table.copy()
        _refuse_twins(tile, angles, number, table)
        for name, values in {"tile": tile, "pass": number}.items():
            table.replace_column(name, values)
        for name, values in angles.items():
            table.replace_column(name, (values % 360 if name == "ra" else values) * u.deg)
        if table.meta.get("conditions") is not None:
            convert_when(table, tile)
        object.__setattr__(self, "table", table[(*COLUMNS, *(c for c in table.colnames if c not in COLUMNS))])

    def __len__(self):
        return len(self.table)

    def _repr_html_(self) -> str:
        return to_html(self, self.summary, self.table, figure_of_tiles(self.table))

    def __repr__(self):
        n = len(np.unique(self.table["pass"]))
        return f"<Tiling of {number_of(len(self), 'tile')} in {number_of(n, 'pass', 'passes')}>"

    @property
    def coord(self) -> SkyCoord:
        """Centers of the tiles, ICRS."""
        return SkyCoord(self.table["ra"], self.table["dec"], frame="icrs")

    @property
    def summary(self) -> dict:
        """Description of the method and quality of the tiling; empty if `place_tiles` did not place the tiles."""
        return self.table.meta.get("summary", {})

    @property
    def conditions(self) -> ObservingConditions | None:
        """Observing conditions of the tiles; None if refraction is neglected."""
        record = self.table.meta.get("conditions")
        return None if record is None else ObservingConditions.from_record(record)

    @property
    def times(self) -> Time | None:
        """Time of each tile, from its conditions or its column ``time``, ``mjd`` or ``date``; None without times."""
        return times_of_tiles(self)

    def with_conditions(self, conditions: ObservingConditions | None) -> "Tiling":
        """Return a copy of the tiling with observing conditions, which `plan_survey` takes into account.

        Parameters
        ----------
        conditions : ObservingConditions or None
            The conditions of all tiles. The table may have a column ``hour_angle`` (of the center; numbers without a
            unit are in hours) or ``time`` (midpoint of the exposure; text is in UTC). The values in this column replace
            the time or hour angle of ``conditions``.

        Returns
        -------
        Tiling
            The tiling with the conditions, which `write` stores in the file. The column ``hour_angle`` is in degrees,
            and the column ``time`` is text (UTC).

        Raises
        ------
        InputError
            If ``conditions`` has a wrong type, if the table has both columns, or if a time or hour angle is not valid.

        Examples
        --------
        >>> import astropy.units as u
        >>> from astropy.table import QTable
        >>> import rfpsurvey as rs
        >>> tiles = QTable({"ra": [95, 97] * u.deg, "dec": [23, 23] * u.deg, "hour_angle": [-1, 2] * u.hourangle})
        >>> conditions = rs.ObservingConditions("paranal", hour_angle=0 * u.deg)
        >>> rs.Tiling.from_table(tiles).with_conditions(conditions).table["hour_angle"]
        <Quantity [-15.,  30.] deg>
        """
        check_conditions(conditions, optional=True)
        table = self.table.copy()
        table.meta["conditions"] = None if conditions is None else conditions.record
        return Tiling(table)

    @cached_property
    def vectors(self) -> np.ndarray:
        """Unit vectors of the centers, shape (n, 3)."""
        return to_vectors(self.coord)

    @classmethod
    def from_table(
        cls, table: Table, columns: dict | None = None, units: dict | None = None, select: dict | None = None
    ) -> "Tiling":
        """Make a tiling from a table whose columns have common names.

        Parameters
        ----------
        table : Table, QTable or DataFrame
            Table with centers (``ra`` and ``dec``, ``racen`` and ``deccen``, ``tile_ra`` and ``tile_dec``, ...).
            These columns are optional: the identifier (``tile``, ``tileid``, ``field``, ...; the row number by
            default), ``pass`` (1 by default) and the position angle (``position_angle``, ``pa``, ``field_pa``,
            ``posang``; 0 by default). Other columns are kept. Tiles whose value in the column ``IN_DESI`` is 0 are not
            part of DESI's survey, and are omitted. Lists of pointings of PFS (``ppc_ra``) are recognized; ``ppc_pa``
            is the angle POSANG, which differs from the position angle (:ref:`as-built-pfs`). A DataFrame of pandas
            or Polars and an Arrow table are accepted.
        columns : dict, optional
            Dict from role (``tile``, ``ra``, ``dec``, ``position_angle`` or ``pass``) to column name, for columns whose
            names are not recognized.
        units : dict, optional
            Dict from role to unit, for columns without a unit, for example ``{"ra": "hourangle", "dec": "deg"}``. If
            neither right ascensions nor declinations have a unit in the table, degrees are assumed, and a warning is
            issued. There is no warning for DataFrames, which cannot have units, and for lists of tiles of DESI.
        select : dict, optional
            Dict from column to value; only rows with these values, compared as numbers or text, are read.

        Returns
        -------
        Tiling
            The tiles in the order of the table; ``table.meta`` states which column has which role (``columns``),
            and how many tiles are omitted (``omitted``).

        Raises
        ------
        InputError
            If coordinates are missing or out of range, if only one of the two coordinates has a unit, or if an
            identifier or a tile occurs twice.
        """
        return cls._from_table(table, columns, units, select, assume_units=False)

    @classmethod
    def _from_table(cls, table, columns, units, select, *, assume_units):
        table, is_plain = as_table(table, index_as_id=False)
        table, selected = select_rows(table, select)
        names = find_names(table, columns)
        table, said = without_others(table)
        meta = {name: value for name, value in table.meta.items() if name not in ("omitted", "selected")}
        meta |= {"columns": names}
        meta |= {"omitted": said} if said else {}
        meta |= {"selected": selected.removeprefix("; selected: ")} if selected else {}
        silent = assume_units or is_plain or bool(said) or is_of_pfs(table)
        n, angles = len(table), read_angles(table, names, units, silent=silent)
        tile = to_labels(table[names["tile"]], "tile") if "tile" in names else np.arange(n)
        angle = angles.get("position_angle", np.zeros(n) * u.deg) + pfs_angle(table, names)
        number = table[names["pass"]] if "pass" in names else np.ones(n, dtype=np.int64)
        result = QTable([tile, angles["ra"], angles["dec"], angle, number], names=COLUMNS, meta=meta)
        for name in table.colnames:
            if name not in names.values() and name not in COLUMNS:
                result[name] = table[name]
        return cls(result)

    @classmethod
    def read(
        cls,
        path: str | os.PathLike,
        columns: dict | None = None,
        units: dict | None = None,
        hdu: int | str | None = None,
        select: dict | None = None,
    ) -> "Tiling":
        """Read a tiling from a file that this package wrote, or from a file with another list of tiles.

        Parameters
        ----------
        path : str or path-like
            FITS, ECSV, CSV, VOTable or Parquet file, optionally with ``.gz``. Angles without units in CSV and Parquet
            files are in degrees; no warning is issued.
        columns, units : dict, optional
            Names and units of the columns, as in `from_table`.
        hdu : int or str, optional
            Number or name (EXTNAME) of the header-data unit that contains the table, for FITS files with several
            tables. By default, the first table is read.
        select : dict, optional
            Values of columns of the rows to read, as in `from_table`.

        Returns
        -------
        Tiling
            The tiles.

        Raises
        ------
        InputError
            If the file does not exist, or is not a list of tiles.
        """
        path = _io.to_path(path)
        table = read_table(path, hdu, "; to read another table, give hdu= or --set tiles.hdu=NAME")
        table.meta = {k: v for k, v in table.meta.items() if not k.startswith("__")}
        try:
            return cls._from_table(table, columns, units, select, assume_units=lacks_units(path))
        except InputError as error:
            raise InputError(f"{path}: {error}") from None

    def write(self, path: str | os.PathLike, *, overwrite: bool = False) -> None:
        """Write the tiling as FITS or ECSV; if writing fails, no incomplete file remains.

        Parameters
        ----------
        path : str or path-like
            Path that ends in ``.fits`` or ``.ecsv``, optionally followed by ``.gz``.
        overwrite : bool, optional
            Whether to replace an existing file.

        Raises
        ------
        InputError
            If the folder does not exist, or if the file exists and ``overwrite`` is False.
        """
        _io.write_table(self.table, path, overwrite=overwrite, cards={"NTILES": len(self)})

    def coverage(self, radius: u.Quantity, *, nside: int = 64) -> np.ndarray:
        """Return the number of tiles that cover each pixel of the sky.

        Parameters
        ----------
        radius : Quantity
            Angular radius of a tile.
        nside : int, optional
            Resolution of the HEALPix map, a power of two.

        Returns
        -------
        ndarray of int, shape (12 * nside**2,)
            Number of tiles that contain the center of each pixel, in the nested order and ICRS.

        Raises
        ------
        InputError
            If ``radius`` or ``nside`` is out of range.
        """
        radius_rad = to_scalar(radius, u.rad, "radius", low=0, high=np.pi)
        nside = _healpix.check_nside(nside)
        index = SkyIndex(self.vectors)
        centers = _healpix.centers(nside, np.arange(12 * nside**2))
        return np.rint(index.sum_near(centers, radius_rad, np.ones(len(index)))).astype(np.int64)


def as_tiling(tiles: Tiling | Table | SkyCoord) -> Tiling:
    """Return a tiling from a tiling, a table, a DataFrame or centers."""
    if isinstance(tiles, Tiling):
        return tiles
    if is_table(tiles):
        return Tiling.from_table(tiles)
    if not isinstance(tiles, SkyCoord):
        raise InputTypeError(f"tiles must be a Tiling, a Table or a SkyCoord, got {type(tiles).__name__}")
    icrs = to_direction(tiles, "tiles").reshape(-1).icrs
    return Tiling.from_table(QTable({"ra": icrs.ra.to(u.deg), "dec": icrs.dec.to(u.deg)}))


def to_ra_dec(vectors: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return right ascension and declination of unit vectors in degrees."""
    lon, lat = to_lonlat(vectors)
    return np.rad2deg(lon) % 360, np.rad2deg(lat)


def place_of(ra, dec) -> np.ndarray:
    """Return two integers for each center (degrees); centers that agree to 1e-8 deg have the same integers."""
    ra, dec = (np.rint(np.asarray(angle) * 1e8) for angle in (ra, dec))
    return np.column_stack([ra % round(360e8), dec]).astype(np.int64)


def _integers(column, tile):
    """Return the pass of each tile as an integer; raise an error if a value is not a whole number."""
    values = to_plain(column)
    try:
        numbers = values.astype(float)
    except ValueError:
        raise InputError(
            f"pass must be a whole number for every tile, got text such as {str(values.flat[0])!r}"
        ) from None
    bad = np.flatnonzero(~((np.abs(numbers) < 2.0**53) & (numbers == np.rint(numbers))))
    if len(bad):
        raise InputError(f"pass must be a whole number for every tile, got {numbers[bad[0]]:g} for tile {tile[bad[0]]}")
    return numbers.astype(np.int64)


def _refuse_twins(tile, angles, number, table):
    """Raise an error if two tiles of a pass (and program) have the same center and position angle to 1e-8 deg.

    Tiles with the state ``dropped``, such as retired tiles, are not compared.
    """
    name = next((c for c in table.colnames if c.lower() == "program"), None)
    program = 0 if name is None else np.unique(to_plain(table[name]), return_inverse=True)[1].reshape(-1)
    columns, retired = [angles["ra"], angles["dec"], angles["position_angle"]], np.zeros(len(tile), dtype=np.int64)
    if "state" in table.colnames:
        retired = np.where(np.asarray(table["state"]) == "dropped", 1 + np.arange(len(tile)), 0)
    turn, program = np.rint(columns[2] * 1e8) % round(360e8), np.broadcast_to(program, len(tile))
    key = np.column_stack([place_of(*columns[:2]), turn, number, program, retired])
    _, first, inverse = np.unique(key, axis=0, return_index=True, return_inverse=True)
    first = first[inverse.reshape(-1)]
    twin = np.flatnonzero(first != np.arange(len(tile)))
    if len(twin):
        k = twin[0]
        raise InputError(
            f"tiles {tile[first[k]]} and {tile[k]} are the same: pass {number[k]}, center {angles['ra'][k]:.6f} "
            f"{angles['dec'][k]:+.6f} deg"
            + (f"; further repeated tiles: {len(twin) - 1}" if len(twin) > 1 else "")
            + "; to observe a field several times, number its tiles in a column pass"
        )


def in_passes(tiling: Tiling | None, passes: list[int] | None) -> Tiling | None:
    """Return the tiles of some passes; all tiles if ``passes`` is None."""
    return tiling if None in (tiling, passes) else Tiling(tiling.table[np.isin(tiling.table["pass"], passes)])
