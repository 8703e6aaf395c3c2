"""The class `Catalog`, which contains the targets of a survey."""

import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

import astropy.units as u
import numpy as np
from astropy.coordinates import BaseCoordinateFrame, SkyCoord
from astropy.table import QTable, Table
from astropy.time import Time

from rfpsurvey._common import io as _io
from rfpsurvey._common import units as _units
from rfpsurvey._common.descriptions import to_html
from rfpsurvey._common.files import lacks_units
from rfpsurvey._sky import tables as _tables
from rfpsurvey._sky.arrays import CatalogArrays, extra_columns, to_kinds
from rfpsurvey._sky.catalog_files import EXACT, exact_columns, origin_of, path_and_name, read_table
from rfpsurvey._sky.time import any_year, known_epochs, move_coordinates, moving, to_time
from rfpsurvey.errors import InputError, check_keywords, check_switch, number_of, refusal, warn

_PER_TARGET, TEXTS = _tables.PER_TARGET, ("kind", "category", "fiber_type")


@check_keywords
@dataclass(frozen=True, eq=False)
class Catalog:
    """Targets on the sky, one per row, with priorities and other columns that allocators use.

    Rows whose coordinates are masked or not finite are removed with a warning; ``n_dropped`` is the number of removed
    rows. Columns other than ``id`` are None, and use no memory, if they are not given. Distances and radial velocities
    in ``coord`` are discarded.

    Parameters
    ----------
    coord : SkyCoord, shape (n,)
        Positions in any frame. The SkyCoord may contain proper motions.
    id : array_like, shape (n,), optional
        Identifiers of the targets, integers or text; by default, the row numbers.
    priority : array_like of float, shape (n,), optional
        Priority of each target; larger values are more important. By default, all targets are equally important.
    kind : array_like of str, shape (n,), optional
        Kind of each target: ``science``, ``standard`` or ``sky``, or several of these roles, such as
        ``science+standard``. By default, all targets are science targets.
    category : array_like of str, shape (n,), optional
        Category of each target. Any text is allowed, such as ``sky_boss``.
    fiber_type : array_like of str, shape (n,), optional
        Fiber type that each target requires; ``""`` means any type.
    visits : array_like of int, shape (n,), optional
        Number of visits (observations) that each target requires, 0 to 255; by default 1. Targets of any kind with 0
        visits are not assigned, but at least one visit of each required target (`AllocationOptions`) is requested.
    epoch : Time, optional
        Epoch of the positions, scalar or shape (n,); by default ``coord.obstime``.
    meta : dict, optional
        Information on the origin of the catalog.
    n_dropped : int, optional
        Number of rows that were removed before this catalog was made, because their coordinates were not finite.
    extra : dict or Table, optional
        Further columns that results include, such as magnitudes. Columns contain numbers, text or booleans, with or
        without units. Missing numbers become NaN, missing text becomes empty, and text loses the blanks at its ends.
        Text must not contain control characters. Allocators do not read these columns.
    subpriority : array_like of float, shape (n,), optional
        Order of the targets within each priority class, as the option ``subpriority`` of `AllocationOptions`, which
        replaces this column.
    numbered : bool, optional
        Whether ``id`` contains row numbers; True if ``id`` is not given.

    Raises
    ------
    InputError
        If the length of a column differs from that of ``coord``, or if ``kind`` or ``visits`` contains an invalid
        value.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astropy.coordinates import SkyCoord
    >>> import rfpsurvey as rs
    >>> catalog = rs.Catalog(SkyCoord([95.0, 95.1] * u.deg, [23.0, 23.1] * u.deg), priority=[1, 2])
    >>> len(catalog)
    2
    """

    coord: SkyCoord
    id: np.ndarray | None = None
    priority: np.ndarray | None = None
    kind: np.ndarray | None = None
    category: np.ndarray | None = None
    fiber_type: np.ndarray | None = None
    visits: np.ndarray | None = None
    epoch: Time | None = None
    meta: dict = field(default_factory=dict)
    n_dropped: int = 0
    extra: QTable | None = None
    subpriority: np.ndarray | None = None
    numbered: bool = False

    origin = None  # arguments of `read`, if a file was read

    def __post_init__(self):
        coord = SkyCoord(self.coord) if isinstance(self.coord, BaseCoordinateFrame) else self.coord
        epoch = getattr(coord, "obstime", None) if self.epoch is None else to_time(self.epoch, "epoch", gaps=True)
        coord = _units.to_direction(coord, "coord")
        coord = coord.reshape(1) if coord.isscalar else coord
        if coord.ndim != 1:
            raise InputError(f"coord must have the shape (n,), got {coord.shape}")
        n = len(coord)
        columns = {"id": np.arange(n) if self.id is None else _units.to_labels(self.id, "id")}
        for name in _PER_TARGET[1:]:
            value = getattr(self, name)
            if value is not None and name in TEXTS:
                columns[name] = to_kinds(value, name) if name == "kind" else _units.to_plain(value, name).astype(str)
            elif value is not None:
                columns[name] = _units.to_numbers(value, name, unitless=name == "visits")
        extra = extra_columns(self.extra, n)
        for name, value in columns.items():
            if value.shape != (n,):
                raise InputError(f"{name} must have one value per target, shape ({n},), got {value.shape}")
        for name in {"priority", "subpriority"} & set(columns):
            if (lacking := ~np.isfinite(columns[name])).any():
                raise InputError(
                    f"{name} must be a finite number for every target, but {_units.rows_of(lacking)} have none"
                )
        if "visits" in columns:
            columns["visits"] = _units.to_visits(columns["visits"], n)
        if epoch is not None and epoch.shape not in ((), (n,)):
            raise InputError(f"epoch must be one time or have the shape ({n},), got {epoch.shape}")
        epoch = None if epoch is None else known_epochs(epoch, moving(coord))
        keep = np.isfinite(coord.data.lon.value) & np.isfinite(coord.data.lat.value)
        if n_bad := int(n - keep.sum()):
            coord = coord[keep]
            columns = {name: value[keep] for name, value in columns.items()}
            extra = None if extra is None else extra[keep]
            if epoch is not None and not epoch.isscalar:
                epoch = epoch[keep]
            warn(f"{n_bad} of {n} targets have no finite coordinates and were removed")
        numbered = check_switch(self.numbered, "numbered") or self.id is None
        for name, value in {**columns, "coord": coord, "epoch": epoch, "extra": extra, "numbered": numbered}.items():
            object.__setattr__(self, name, value)
        for name, kind, what in (("n_dropped", int | np.integer, "a whole number"), ("meta", Mapping, "a dict")):
            if not isinstance(getattr(self, name), kind):
                raise refusal(f"{name} must be {what}", getattr(self, name))
        object.__setattr__(self, "n_dropped", self.n_dropped + n_bad)
        object.__setattr__(self, "meta", dict(self.meta))

    def __len__(self):
        return len(self.coord)

    def __getstate__(self):  # another process computes the arrays again
        return {name: getattr(self, name) for name in self.__dataclass_fields__}

    def __getitem__(self, index):
        return self._take(index)

    def __repr__(self):
        carried = [name for name in (*_PER_TARGET[1:], "epoch") if getattr(self, name) is not None]
        carried += list(self.arrays.extra)
        return f"<Catalog of {number_of(len(self), 'target')}{' with ' if carried else ''}{', '.join(carried)}>"

    def _repr_html_(self) -> str:
        return to_html(self, {"targets": len(self), **self.meta}, self[:5].to_table())

    def _take(self, index, **changes):
        """Return a catalog of the rows that ``index`` selects, with ``changes`` of its attributes."""
        index = np.atleast_1d(np.arange(len(self))[index])
        values = {name: getattr(self, name) for name in self.__dataclass_fields__}
        for name in _PER_TARGET:
            if values[name] is not None:
                values[name] = values[name][index]
        values["coord"] = self.coord[index]
        if self.extra is not None:
            values["extra"] = self.extra[index]
        if self.epoch is not None and not self.epoch.isscalar:
            values["epoch"] = self.epoch[index]
        return Catalog(**{**values, **changes})

    @cached_property
    def arrays(self) -> CatalogArrays:
        """The catalog as read-only arrays without units (``CatalogArrays``), which are computed once for all tiles."""
        return CatalogArrays(self)

    @property
    def mean_direction(self) -> SkyCoord:
        """Mean direction of the targets."""
        x, y, z = self.arrays.vectors.mean(axis=0)
        return SkyCoord(x=x, y=y, z=z, representation_type="cartesian", frame="icrs")

    @classmethod
    @check_keywords
    def from_table(
        cls,
        table: Table,
        *,
        columns: dict | None = None,
        units: dict | None = None,
        frame: str = "icrs",
        fill: dict | None = None,
        keep: list | None = None,
        select: dict | None = None,
    ) -> "Catalog":
        """Make a catalog from a table or DataFrame; columns are found by common names or by UCDs.

        Parameters
        ----------
        table : Table, QTable or DataFrame
            Table with a `~astropy.coordinates.SkyCoord` column, or with coordinates in columns such as ``ra`` and
            ``dec``, ``RAJ2000`` and ``DEJ2000``, ``TARGET_RA`` and ``TARGET_DEC``, or ``l`` and ``b`` (with
            ``frame="galactic"``). The columns ``pmra`` (with cos dec), ``pmdec``, ``ref_epoch``, ``id``,
            ``priority``, ``subpriority``, ``kind``, ``category``, ``fiber_type`` and ``visits`` are recognized, and so
            are target tables of DESI, PFS and SDSS-V; small priorities of PFS and SDSS-V are more important
            (:doc:`/conventions`). ``meta["columns"]`` of the catalog states which column has which role. A DataFrame of
            pandas or Polars and an Arrow table are accepted.
        columns : dict, optional
            Names of columns that are not recognized automatically. The keys are recognized names; for example,
            ``{"id": "star"}`` uses the column ``star`` as ``id``. A minus sign before the name of a column reverses the
            sign of its numbers, as in ``{"priority": "-rank"}`` if smaller ranks are more important.
        units : dict, optional
            Units of the columns that have no unit in the table, for example ``{"ra": "hourangle", "dec": "deg"}``. If
            none of the columns of positions and proper motions has a unit, positions are assumed to be in degrees and
            proper motions in mas / yr, and a warning is issued. There is no warning for DataFrames, which cannot have
            units, and for tables of surveys. ``meta["assumed_units"]`` lists the assumed units.
        frame : str, optional
            Frame of the coordinates. For ``icrs``, ``fk5`` and ``fk4`` the columns are right ascension and
            declination; for other frames they are longitude and latitude.
        fill : dict, optional
            Values that replace missing values (masked or NaN) of ``priority``, ``subpriority``, ``visits``, ``kind``,
            ``category`` or ``fiber_type``, as in ``{"priority": 0}``. Minus signs in ``columns`` do not affect them.
        keep : list of str, optional
            Names of further columns that results include; see the parameter ``extra`` of `Catalog`.
        select : dict, optional
            Dict from column to value, such as ``{"resolution": "L"}``; only rows with these numbers or texts are read.

        Returns
        -------
        Catalog
            The targets.

        Raises
        ------
        InputError
            If coordinates are missing or have a wrong unit, if only some of the columns of positions and proper motions
            have units, or if a priority or a number of visits is missing and ``fill`` does not replace it.

        Examples
        --------
        >>> from astropy.table import Table
        >>> import rfpsurvey as rs
        >>> table = Table({"RAJ2000": ["06:20:00", "06:20:24"], "DEJ2000": [23.0, 23.1], "Vmag": [11.5, float("nan")]})
        >>> stars = rs.Catalog.from_table(
        ...     table, columns={"priority": "-Vmag"}, units={"dec": "deg"}, fill={"priority": -99}
        ... )
        >>> stars.priority
        array([-11.5, -99. ])
        """
        return cls(**_tables.read_columns(table, columns, units, frame, fill, keep, select))

    @classmethod
    @check_keywords
    def read(
        cls,
        path: str | os.PathLike,
        *,
        columns: dict | None = None,
        units: dict | None = None,
        frame: str = "icrs",
        fill: dict | None = None,
        keep: list | None = None,
        hdu: int | str | None = None,
        select: dict | None = None,
    ) -> "Catalog":
        """Read a catalog from a FITS, ECSV, CSV (with any usual separator), VOTable or Parquet file.

        Without units, positions are assumed to be in degrees and proper motions in mas / yr.

        Parameters
        ----------
        path : str or path-like
            Path of the file, or ``example:anticenter``. The extension (before ``.gz``) determines the file format.
        columns, units, frame : optional
            Names and units of columns, and the frame of the coordinates, as in `from_table`.
        fill : dict, optional
            Values that replace missing values, as in `from_table`.
        keep : list of str, optional
            Names of further columns that results include, as in `from_table`.
        hdu : int or str, optional
            Number or name (EXTNAME) of a table in a FITS file; by default, the first table is read.
        select : dict, optional
            Values of columns of the rows to read, as in `from_table`.

        Returns
        -------
        Catalog
            The targets; ``meta["file"]`` is the name of the file or of the example.

        Raises
        ------
        InputError
            If the file does not exist or cannot be read, or if a required column is missing.
        """
        path, name = path_and_name(path)
        table = read_table(path, hdu)
        given = {"columns": columns, "units": units, "fill": fill, "keep": keep, "select": select, "frame": frame}
        try:
            plain = lacks_units(path) and not _tables.has_units(table)
            exact = exact_columns(table) if hdu == EXACT else None
            catalog = cls(**(exact or _tables.read_columns(table, **given, assume_units=plain)))
        except InputError as error:
            raise InputError(f"{path}: {error}") from None
        catalog.meta.update({"file": name} if hdu is None else {"file": name, "hdu": hdu})
        object.__setattr__(catalog, "origin", origin_of(path, name, given | {"hdu": hdu}))
        return catalog

    def to_table(self) -> QTable:
        """Return the catalog as a table that `from_table` can read.

        Returns
        -------
        QTable
            Columns ``id``, ``ra``, ``dec`` (ICRS) and all other columns of the catalog.
        """
        return _tables.catalog_table(self)

    def write(self, path: str | os.PathLike, *, overwrite: bool = False) -> None:
        """Write the catalog as FITS or ECSV; if writing fails, no incomplete file remains.

        Parameters
        ----------
        path : str or path-like
            Path that ends in ``.fits`` or ``.ecsv``, optionally followed by ``.gz``.
        overwrite : bool, optional
            Whether to replace an existing file.

        Raises
        ------
        InputError
            If the path is not valid, or if the file exists and ``overwrite`` is False.
        """
        _io.write_table(self.to_table(), path, overwrite=overwrite)

    @property
    def has_proper_motion(self) -> bool:
        """Whether the catalog has proper motions."""
        return "s" in self.coord.data.differentials

    def at_epoch(self, time: Time | str | float) -> "Catalog":
        """Return a catalog with the positions of the targets at the given epoch.

        Targets move along straight lines in space. Targets that lack a component of the proper motion do not move.

        Parameters
        ----------
        time : Time, str or float
            The new epoch. A number is a Julian year; text can have any format that `~astropy.time.Time` reads.

        Returns
        -------
        Catalog
            The same targets at the new epoch; the same catalog if it has no proper motions.

        Raises
        ------
        InputError
            If the catalog has proper motions but no epoch.
        """
        time = to_time(time, "time")
        still = self.epoch is None and not moving(self.coord).any()
        if still or not self.has_proper_motion or len(self) == 0:
            return self
        if self.epoch is None:
            remedy = "give Catalog(..., epoch=), a column of epochs, or --set catalog.epoch=J2016"
            raise InputError(f"the catalog has proper motions but no epoch to which the positions refer; {remedy}")
        if not time.isscalar and time.shape != (len(self),):
            raise InputError(f"time must be one time or have the shape ({len(self)},), got {time.shape}")
        with any_year():
            years = np.broadcast_to((time.tdb - self.epoch.tdb).to_value(u.yr), len(self))
        return self._take(slice(None), coord=move_coordinates(self.coord, years), epoch=time)

    def within(self, center: SkyCoord | str, radius: u.Quantity) -> "Catalog":
        """Return the targets inside a circle on the sky.

        Parameters
        ----------
        center, radius : SkyCoord or str, Quantity
            Center and angular radius of the circle; text is read as in `plan_tile`.

        Returns
        -------
        Catalog
            The targets at a distance of at most ``radius`` from ``center``, in the order of the catalog.

        Raises
        ------
        InputError
            If ``center`` is not a single direction, or if ``radius`` is not a single angle of at least 0.
        """
        radius_rad = _units.to_scalar(radius, u.rad, "radius", low=0, closed=True)
        return self._take(self.arrays.rows_within(_units.to_center(center), radius_rad))
