"""Methods of `Instrument` that read instruments as built from the files of observatories, and columns of these files.

Values that cannot be true count as missing.
"""

import os
from pathlib import Path
from typing import Self

import astropy.units as u
import numpy as np
from astropy.time import Time

from rfpsurvey._common.lazy import importer
from rfpsurvey._common.read_documents import reading
from rfpsurvey._common.read_tables import is_number
from rfpsurvey._common.units import check_columns, rows_of, to_plain
from rfpsurvey.errors import InputError, InputTypeError, InputUnitsError, number_of

MOST_DEVICE, N_PETALS = 542, 10  # LOCATION is 1000 times the petal plus the device
MOST_ANGLE = 400.0
"""Largest absolute value of a joint angle that can be true, deg."""
ROW = "_row"
"""Name of a column with the number of each row in the file, counted from 1."""

SPELLED = {"degrees": u.deg}
"""Names of units that desimodel writes and astropy does not accept."""


def number_rows(table, names, path) -> None:
    """Raise an error if a table is empty or lacks a column; number the rows."""
    check_columns(table.colnames, names, f"{path}: the table")
    if len(table) == 0:
        raise InputError(f"{path}: the table must have at least one row, got none")
    table[ROW] = np.arange(1, len(table) + 1)


def numbers(
    table, name: str, unit: u.UnitBase, path, most: float = np.inf, *, low: float | None = None, codes: bool = False
) -> np.ndarray:
    """Return a column of finite numbers in a unit; a column without a unit is assumed to have this unit.

    Numbers from ``low`` (by default, ``-most``) to ``most`` are valid, except codes for missing values if ``codes`` is
    true.
    """
    column, what = table[name], f"{path}: column {name!r}"
    values = to_plain(column, what)
    if values.dtype.kind not in "iuf" or values.ndim != 1:
        raise InputTypeError(f"{what} must hold one number for each row, got {_example(values)}")
    given = getattr(column, "unit", None)
    given = SPELLED.get(str(given), given) or unit
    if not given.is_equivalent(unit):
        raise InputUnitsError(f"{what} must have a unit convertible to {unit}, got {given}")
    missing = ~np.isfinite(values)
    if missing.any():
        in_file = np.zeros(table[ROW].max(), dtype=bool)
        in_file[table[ROW][missing] - 1] = True
        raise InputError(f"{what} must hold a finite number for each row, but {rows_of(in_file)} have none")
    converted = (values * given).to_value(unit)
    low = -most if low is None else low
    for k in np.flatnonzero(is_missing(converted, low, most, codes=codes)):
        raise InputError(
            f"{what} must hold numbers from {low:g} to {most:g} {unit}{', and no codes such as 99 or -999' * codes}, "
            f"got {converted[k]:g} in row {table[ROW][k]}"
        )
    return converted


def whole(table, name: str, path) -> np.ndarray:
    """Return a column of whole numbers."""
    what = f"{path}: column {name!r}"
    values = to_plain(table[name], what)
    if values.dtype.kind not in "iuf" or values.ndim != 1:
        raise InputTypeError(f"{what} must hold one whole number for each row, got {_example(values)}")
    with np.errstate(invalid="ignore"):
        wrong = ~(values == np.floor(values)) | ~(np.abs(values) < 2.0**53)
    if wrong.any():
        raise InputError(f"{what} must hold a whole number for each row, but {rows_of(wrong)} have none")
    return values.astype(np.int64)


def some(ids, mask) -> str:
    """Return text with the number of positioners for which a mask is true, and the first few of their ids."""
    few = ", ".join(map(str, ids[mask][:3])) + (", ..." if mask.sum() > 3 else "")
    return f"{number_of(int(mask.sum()), 'positioner')} ({few})"


def _example(values) -> str:
    if values.ndim != 1:
        return f"the shape {values.shape}"
    text = [value for value in values.tolist() if not is_number(value)]
    return f"{values.dtype.name}" if not text else f"{text[0]!r}"


CODES = np.array([99, 999, 9999, 99999, 999999], dtype=float)
"""Numbers that observatories write instead of missing values, with either sign."""


IMPOSSIBLE = "layout.impossible_values"
"""Name of the value of an instrument that counts the positioners with impossible values in the files."""


def entry(value: object, source: str, status: str = "published", unit: str | None = None) -> dict:
    """Return an entry of the values of an instrument."""
    return {"value": value, **({} if unit is None else {"unit": unit}), "status": status, "source": source}


def impossible_entry(n: int, source: str) -> dict:
    """Return the value of an instrument that counts positioners with impossible values; empty if there are none."""
    return {IMPOSSIBLE: entry(n, source, "derived")} if n else {}


def impossible_sentence(instrument) -> str:
    """Return text with the number of positioners with impossible values in the files of an instrument."""
    n = instrument.values.get(IMPOSSIBLE, {}).get("value", 0)
    if not n:
        return ""
    n_disabled = np.count_nonzero(instrument.focal_plane.disabled)
    return (
        " The files of the instrument have impossible values, which count as missing, for "
        f"{number_of(n, 'positioner')} (see its notes); {n_disabled} of all positioners are disabled."
    )


def is_missing(values: np.ndarray, low: float, high: float, *, codes: bool = True) -> np.ndarray:
    """Return whether values are NaN, are outside physical limits, or are codes for missing values.

    If ``codes`` is False, codes between the limits are valid values.
    """
    wrong = ~((values >= low) & (values <= high))
    return wrong | np.isin(np.abs(values), CODES) if codes else wrong


# the modules that read the files, which are imported on first use
_module = importer("rfpsurvey._instruments", {"desi": (), "pfs": (), "sdssv": ()})


class AsBuilt:
    """Methods that `Instrument` inherits, which read instruments as built."""

    @classmethod
    def _read_as_built(cls, path: Path, time: Time | str | None):
        """Return the instrument that files of an observatory describe, or None for any other file or folder."""
        if _module("desi").recognizes(path):
            has_log = path.is_dir() and any(path.glob("desi-state_*"))
            return cls.from_desi(path, time=time if has_log else None)
        if _module("sdssv").recognizes(path):
            return cls.from_sdssv(path)
        files = _module("pfs").find_pfs_files(path)
        return None if files is None else cls.from_pfs(**files)

    @classmethod
    def from_desi(
        cls,
        path: str | os.PathLike,
        *,
        state: str | os.PathLike | None = None,
        exclusions: str | os.PathLike | None = None,
        time: Time | str | None = None,
    ) -> Self:
        """Read DESI as built: the metrology of desimeter, or a focal plane of desimodel with its state.

        The files contain neither the optics nor the requirements on sky fibers and standard stars; both are taken from
        the preset ``desi``. If the files do not contain the clearance, it is also taken from the preset. The x axis is
        reversed, because +x is west in the files and east in rfpsurvey.

        Parameters
        ----------
        path : str or path-like
            Path of ``fp-metrology.csv`` or of ``desi-focalplane_DATE.ecsv``, or of a folder that contains such files
            and, optionally, the files for ``state`` and ``exclusions``.
        state : str or path-like, optional
            Path of ``desi-state_DATE.ecsv``, a log of stuck, broken and restricted positioners. Without a
            state, all positioners count as working.
        exclusions : str or path-like, optional
            Path of ``desi-exclusion_DATE.json`` (or ``.yaml``), which contains the exclusion polygons of the arms. The
            most common polygons are the outline of all positioners. The clearance of the arm model ``elbow_to_tip`` is
            the median half width of the polygons of the eccentric arm (``phi``).
        time : Time or str, optional
            Time at which the state is evaluated, in UTC. By default, the state after the last event is used. Several
            times are accepted as in `Instrument.with_states`; they must be those of one focal plane.

        Returns
        -------
        Instrument
            The instrument. Its ``notes`` state how many rows are not used because they describe other devices.

        Raises
        ------
        InputError
            If a file cannot be read, if a column is missing or has values that are not valid, if identifiers are not
            unique, or if there is no focal plane or event at or before ``time``.

        Examples
        --------
        >>> import rfpsurvey as rs
        >>> desi = rs.Instrument.from_desi("fp-metrology.csv.gz")  # doctest: +SKIP
        >>> desi.layout, len(desi.focal_plane)  # doctest: +SKIP
        ('as built', 5000)
        """
        with reading(path, "an instrument as built"):
            return _module("desi").read(cls.preset("desi"), path, state=state, exclusions=exclusions, time=time)

    @classmethod
    def from_pfs(
        cls,
        dots: str | os.PathLike,
        *,
        fiducials: str | os.PathLike | None = None,
        interference: str | os.PathLike | None = None,
        cobras: str | os.PathLike | list | None = None,
    ) -> Self:
        """Read PFS as built from files of the observatory.

        The ids of the positioners are the cobraIds, 1 to 2394. Values that the files do not contain are taken from the
        preset ``pfs``.

        Parameters
        ----------
        dots : str or path-like
            File of the black dots (``black_dots_mm*.csv``) with the columns ``spotId``, ``x``, ``y`` and ``r``, or a
            folder with this file and, optionally, the other files. Targets behind a dot are out of reach.
        fiducials : str or path-like, optional
            File of the fiducials (``fiducial_positions*.csv``), which are obstacles of radius 0.
        interference : str or path-like, optional
            File of the cobras whose joint angles are limited by a fiducial (``cobraInterference*.csv``).
        cobras : str, path-like or list of them, optional
            XML files with the calibration model of the cobras: centers, arm lengths, joint limits and status. Without
            this model, arms and joint limits are nominal, and the center of a cobra is the position of its dot minus
            the mean offset of all dots from the nominal centers.

        Returns
        -------
        Instrument
            The instrument; its ``notes`` list the data that were read.

        Raises
        ------
        InputError
            If a file is incomplete, lacks a column, or has values that are impossible for PFS.
        """
        with reading(dots, "an instrument as built"):
            return _module("pfs").read_pfs(cls.preset("pfs"), dots, fiducials, interference, cobras)

    @classmethod
    def from_sdssv(
        cls, folder: str | os.PathLike, *, site: str | None = None, disabled: list[str] | tuple[str, ...] = ()
    ) -> Self:
        """Read SDSS-V as built: the calibration of the focal plane system at Apache Point or Las Campanas.

        The ids of the positioners are the names of their holes, such as R-1C14. The joint angles theta and phi are
        alpha and beta of the robots. Positions are coordinates of the wok, the plate that carries the robots. Values
        that the files do not contain are taken from the preset of the site, ``sdss_apo`` or ``sdss_lco``.

        Parameters
        ----------
        folder : str or path-like
            Folder with ``positionerTable.csv`` and ``wokCoords.csv`` and, optionally, ``fiberAssignments.csv`` (fibers
            of each robot), ``fiducialCoords.csv`` (obstacles), ``focalPlaneModel.csv`` (radial maps) and
            ``wokOrientation.csv`` (shift and tilt of the wok; values other than 0 are neglected, with a warning).
        site : {"APO", "LCO"}, optional
            Site of the rows to use; it is required if ``positionerTable.csv`` has rows of several sites.
        disabled : sequence of str, optional
            Robots to disable, as the names of their holes; these robots take no target and are parked.

        Returns
        -------
        Instrument
            The instrument. Its ``notes`` state the number of rows that are not used, and the robots that are disabled
            because values are missing.

        Raises
        ------
        InputError
            If a required file is missing, if a file is incomplete or lacks a column, or if the site is unknown.

        Examples
        --------
        >>> import rfpsurvey as rs
        >>> sdss = rs.Instrument.from_sdssv("sloanFlatCMM")  # doctest: +SKIP
        >>> sdss.name, sdss.layout, len(sdss.focal_plane)  # doctest: +SKIP
        ('sdss_apo', 'as built', 500)
        """
        with reading(folder, "an instrument as built"):
            return _module("sdssv").read(cls.preset, folder, site=site, disabled=disabled)
