"""Methods of `Instrument` that read instruments as built from the files of observatories."""

import os
from pathlib import Path
from typing import Self

from astropy.time import Time

from rfpsurvey._lazy import importer
from rfpsurvey._readers import reading

# the modules that read the files, which are imported on first use
_module = importer("rfpsurvey.instrument", {"_desi": (), "_pfs": (), "_sdssv": ()})


class AsBuilt:
    """Methods that `Instrument` inherits, which read instruments as built."""

    @classmethod
    def _read_as_built(cls, path: Path, time: Time | str | None):
        """Return the instrument that files of an observatory describe, or None for any other file or folder."""
        if _module("_desi").recognizes(path):
            has_log = path.is_dir() and any(path.glob("desi-state_*"))
            return cls.from_desi(path, time=time if has_log else None)
        if _module("_sdssv").recognizes(path):
            return cls.from_sdssv(path)
        files = _module("_pfs").find_pfs_files(path)
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
            Time at which the state is evaluated, in UTC. By default, the state after the last event is used.

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
            return _module("_desi").read(cls.preset("desi"), path, state=state, exclusions=exclusions, time=time)

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
            return _module("_pfs").read_pfs(cls.preset("pfs"), dots, fiducials, interference, cobras)

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
            return _module("_sdssv").read(cls.preset, folder, site=site, disabled=disabled)
