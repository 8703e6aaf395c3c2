"""Light of point sources that enters the fibers of an instrument, averaged over an exposure of a field."""

from dataclasses import dataclass, replace

import astropy.units as u
import numpy as np
from astropy.coordinates import SkyCoord
from astropy.table import QTable
from scipy.optimize import brentq, minimize_scalar

from rfpsurvey._common.units import check_columns, from_lonlat, to_center, to_mm, to_scalar, to_unit
from rfpsurvey._instruments.entries import value_of
from rfpsurvey._instruments.instrument import Instrument, as_instrument, available_instruments
from rfpsurvey._sky.conditions import ObservingConditions, check_conditions
from rfpsurvey._sky.light import checked, exponent_of, fraction_within, seeing_fwhm, to_number
from rfpsurvey._sky.projection import TangentPlane
from rfpsurvey._sky.wavelengths import observed_light
from rfpsurvey.errors import InputError, check_fiber_type, check_keywords, check_switch, listed, short

# N_POSITIONS: number of positions in the field at which the smallest light is computed. STEP: length (mm) of the
# differences from which the local plate scale is computed. N_MOMENTS: number of moments in the mean over an exposure
# (Gauss-Legendre quadrature).
N_POSITIONS, STEP, N_MOMENTS = 60, 1e-3, 5
# Step and tolerance of hour angles (hours), and tolerance of wavelengths (um).
STEP_H, TOLERANCE_H, TOLERANCE_UM = 0.5, 1e-3, 1e-4


@check_keywords
@dataclass(frozen=True, eq=False)
class FiberLight:
    """Light of point sources in the fibers of an instrument, averaged over an exposure of a field.

    The light is computed at several wavelengths. Dispersion displaces the image of a target at these wavelengths from
    its fiber, which is placed for ``conditions.wavelength``, and images drift during the exposure.

    Parameters
    ----------
    instrument : Instrument or str
        Instrument, name of a preset, or path of a TOML file.
    center : SkyCoord or str
        Field center.
    conditions : ObservingConditions
        The observing conditions.
    seeing : Quantity
        Full width at half maximum of images at the zenith and at 0.5 um; see `seeing_fwhm`.
    wavelengths : Quantity, shape (m,), or dict of str to Quantity, optional
        Wavelengths for which the light is computed, or a dict with m wavelengths for each of some fiber types; other
        types are omitted. By default, the edges of the band of each fiber type and the wavelength for which the
        fibers are placed, which `Light` of the instrument contains.
    position_angle : Quantity, optional
        Position angle of the +y axis of the focal plane, from north toward east.
    fiber_diameter : Quantity, optional
        Diameter of the fibers on the focal plane. By default, ``optics.fiber_diameter`` of the instrument.
    profile, beta : optional
        Profile of the image; see `fiber_fraction`.

    Raises
    ------
    InputError
        If a value is not valid, if the diameter of the fibers or the bands are unknown, or if the field is not above
        the horizon.

    Examples
    --------
    >>> import astropy.units as u
    >>> import rfpsurvey as rs
    >>> conditions = rs.ObservingConditions("apache point", hour_angle=3 * u.hourangle, exposure_time=15 * u.min)
    >>> light = rs.observing.FiberLight("sdss_apo", "10h +32d", conditions, seeing=1.2 * u.arcsec)
    >>> light.wavelengths["BOSS"]
    <Quantity [0.36, 0.54, 1.  ] um>
    >>> table = light.table()
    >>> table["relative"][table["fiber_type"] == "BOSS"].min(axis=0).round(3)
    array([0.623, 0.999, 0.869])
    """

    instrument: Instrument | str
    center: SkyCoord | str
    conditions: ObservingConditions
    seeing: u.Quantity
    wavelengths: u.Quantity | dict[str, u.Quantity] | None = None
    position_angle: u.Quantity = 0 * u.deg
    fiber_diameter: u.Quantity | None = None
    profile: str = "moffat"
    beta: float = 3.5

    def __post_init__(self):
        check_conditions(self.conditions)
        instrument = as_instrument(self.instrument)
        waves = _of_bands(instrument, self.conditions) if self.wavelengths is None else self.wavelengths
        to_scalar(self.seeing, u.arcsec, "seeing", low=0)
        exponent_of(self.profile, self.beta)
        types = instrument.focal_plane.fiber_types
        waves = waves if isinstance(waves, dict) else dict.fromkeys(types, waves)
        for name in waves:
            check_fiber_type(name, types, "fiber type of wavelengths")
        waves = {name: np.atleast_1d(checked(value, u.um, "wavelengths")) * u.um for name, value in waves.items()}
        shapes = {value.shape for value in waves.values()}
        if len(shapes) != 1 or len(shape := shapes.pop()) != 1 or shape == (0,):
            needed = "wavelengths must be an array of the shape (m,), or a dict with such an array for each fiber type"
            raise InputError(f"{needed}, got {short(self.wavelengths)}")
        diameter, entry = self.fiber_diameter, instrument.values.get("optics.fiber_diameter")
        if diameter is None and entry is None:
            raise InputError(f"fiber_diameter must be given for {instrument.name}, which does not state it, got None")
        diameter = value_of(entry) if diameter is None else diameter
        to_scalar(diameter, u.mm, "fiber_diameter", low=0)
        guide = observed_light(instrument.light, self.conditions).guide * u.um  # the same at all wavelengths of fibers
        given = {"instrument": instrument, "center": to_center(self.center), "wavelengths": waves}
        given["conditions"] = replace(self.conditions, guide_wavelength=guide)
        for name, value in {**given, "fiber_diameter": diameter}.items():
            object.__setattr__(self, name, value)
        self._plane(self.conditions)  # raises an error if the field is below the horizon

    @classmethod
    def of_tile(
        cls, tile: object, seeing: u.Quantity, instrument: Instrument | str | None = None, **options: object
    ) -> "FiberLight":
        """Return the light in the field of a tile, with the observing conditions for which the tile was planned.

        Parameters
        ----------
        tile : Tile
            The tile.
        seeing : Quantity
            Full width at half maximum of images at the zenith and at 0.5 um.
        instrument : Instrument or str, optional
            The instrument; by default, the preset with which the tile was made.
        **options
            Other parameters of `FiberLight`, such as ``wavelengths``.

        Returns
        -------
        FiberLight
            The light; ``table(tile)`` returns that of each assigned fiber.

        Raises
        ------
        InputError
            If the tile has no observing conditions, or if the instrument must be given.
        """
        about = getattr(tile, "provenance", None) or {}
        parameters, made = about.get("parameters", {}), about.get("instrument", {})
        if not parameters.get("conditions"):
            raise InputError(f"tile must be a tile that was planned with observing conditions, got {short(tile)}")
        if instrument is None:
            instrument = as_instrument(made["name"]) if made["name"] in available_instruments() else None
            if instrument is None or instrument.provenance["digest"] != made["digest"]:
                raise InputError(
                    f"instrument must be given, because the tile was made with the instrument {made['name']!r}, which "
                    "is not an unchanged preset, got None"
                )
        center = SkyCoord(parameters["ra_deg"], parameters["dec_deg"], unit="deg")
        angle = parameters["position_angle_deg"] * u.deg
        conditions = ObservingConditions.from_record(parameters["conditions"])
        return cls(instrument, center, conditions, seeing, position_angle=angle, **options)

    def table(self, tile: object = None) -> QTable:
        """Return the light that enters each fiber.

        Parameters
        ----------
        tile : Tile or QTable, optional
            Tile, or its table, whose targets and positions of fibers are used. Targets without coordinates are assumed
            to be where their fibers are placed. By default, the table has a fiber of each fiber type at the center of
            each positioner.

        Returns
        -------
        QTable
            Table with a row for each assigned fiber. Columns: ``positioner`` and ``fiber_type``; ``x`` and ``y``, the
            position of the fiber; ``wavelength``, ``fraction`` (fraction of the light that enters the fiber), and
            ``relative`` (fraction divided by that of a fiber whose target is always at its center), each of the shape
            (m,). The light of a target without an image is NaN.

        Raises
        ------
        InputError
            If the table of the tile lacks a column.
        """
        if tile is not None:
            tile = getattr(tile, "table", tile)
            check_columns(getattr(tile, "colnames", ()), ("id", "status", "tip_x", "tip_y"), "tile")
            tile = tile[np.asarray(tile["status"] == "assigned")]
            types = np.asarray(tile["fiber_type"] if "fiber_type" in tile.colnames else [""] * len(tile), dtype=str)
            tile, types = tile[kept := np.isin(types, list(self.wavelengths))], types[kept]
            xy = np.column_stack([to_mm(tile[name], name) for name in ("tip_x", "tip_y")])
            return self._light(np.asarray(tile["id"]), types, xy, tile)
        return self._light(*self._centers())

    @property
    def smallest(self) -> float:
        """The smallest relative light at the wavelengths for 60 or fewer positions in the field and each fiber type."""
        return float(np.nan_to_num(self._light(*self._centers(N_POSITIONS))["relative"]).min())

    def best_guide_wavelength(self, *, move_fibers: bool = True) -> u.Quantity:
        """Return the guide wavelength for which the smallest relative light in the field is largest.

        Parameters
        ----------
        move_fibers : bool, optional
            Whether the fibers are placed for the guide wavelength. Otherwise, they are placed for
            ``conditions.wavelength``, and the guide wavelength has an effect only on the drift during the exposure.

        Returns
        -------
        Quantity
            The wavelength, between the smallest and the largest of ``wavelengths``.
        """
        moved = ("wavelength", "guide_wavelength")[not check_switch(move_fibers, "move_fibers") :]
        waves = np.concatenate([value.value for value in self.wavelengths.values()])

        def lost(wave):
            conditions = replace(self.conditions, **dict.fromkeys(moved, wave * u.um))
            return -replace(self, conditions=conditions).smallest

        limits = {"bounds": (waves.min(), waves.max()), "options": {"xatol": TOLERANCE_UM}}
        return minimize_scalar(lost, method="bounded", **limits).x * u.um

    def hour_angle_window(self, limit: float) -> u.Quantity:
        """Return the hour angles between which the smallest relative light in the field is at least a limit.

        The hour angles replace the time or hour angle of the conditions, and the fibers are placed for each of them.

        Parameters
        ----------
        limit : float
            Smallest permitted relative light, above 0 and below 1.

        Returns
        -------
        Quantity, shape (2,)
            First and last hour angle of the midpoint of the exposure, for the window that contains the meridian, with a
            tolerance of 0.001 h; NaN if the light on the meridian is below the limit.

        Raises
        ------
        InputError
            If the limit is not between 0 and 1.
        """
        limit = to_number(limit, "limit", 0, 1)

        def above(hours):
            try:
                conditions = self.conditions.at_hour_angle(hours * u.hourangle)
                return replace(self, conditions=conditions).smallest - limit
            except InputError:  # the field is not above the horizon
                return -limit

        def end(sign):
            for hours in sign * np.arange(0, 12, STEP_H):
                if above(hours + sign * STEP_H) < 0:
                    return brentq(above, hours, hours + sign * STEP_H, xtol=TOLERANCE_H)
            return sign * 12.0

        return np.array([end(-1), end(1)] if above(0.0) >= 0 else [np.nan] * 2) * u.hourangle

    def _plane(self, conditions: ObservingConditions | None) -> TangentPlane:
        return self.instrument.projection(self.center, self.position_angle, conditions)

    def _centers(self, most: int | None = None) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return identifiers, fiber types and centers (mm) of fibers, for at most some of the positioners of a type."""
        plane, rows, types = self.instrument.focal_plane, [], []
        order = np.argsort(np.hypot(*plane.arrays.xy.T), kind="stable")
        for name in self.wavelengths:
            own = order[[name in row.split("+") for row in plane.fiber_type[order]]]
            some = np.linspace(0, len(own) - 1, min(len(own), most or len(own))).astype(int)
            rows += own[some].tolist()
            types += [name] * len(some)
        return plane.id[rows], np.array(types), plane.arrays.xy[rows]

    def _light(self, ids, types, points, tile=None) -> QTable:
        """Return the table of fibers at points (mm)."""
        placed = self._plane(self.conditions).plain
        vectors = placed.unproject(points, types)
        if tile is not None and {"ra", "dec"} <= set(tile.colnames):
            sky = from_lonlat(*(to_unit(tile[name], u.rad, name) for name in ("ra", "dec")))
            vectors = np.where(np.isfinite(sky), sky, vectors)
        # The local plate scale (mm per radian) is the root of the ratio of areas on the focal plane and on the sky.
        static, factor = self._plane(None).plain, self.conditions.scale
        plain, inward = points / factor, -np.copysign(STEP, points)
        corner, *ends = (static.unproject(plain + inward * axis, types) for axis in ([0, 0], [1, 0], [0, 1]))
        scale = factor * STEP / np.sqrt(np.linalg.norm(np.cross(*(end - corner for end in ends)), axis=1))
        radius, beta = self.fiber_diameter.to_value(u.mm) / 2, exponent_of(self.profile, self.beta)
        m = len(next(iter(self.wavelengths.values())))
        waves = np.array([self.wavelengths[name].value for name in types]).reshape(-1, m)
        light, centered = np.zeros(waves.shape), np.zeros(waves.shape)
        half = self.conditions.exposure_time / 2
        for moment, weight in zip(*np.polynomial.legendre.leggauss(N_MOMENTS if half > 0 else 1), strict=True):
            then = self.conditions.shifted(moment * half).without_exposure
            airmass = 1 / np.sin(self._plane(then).altitude.rad)
            for name, values in self.wavelengths.items():
                rows = types == name
                for k, wave in enumerate(values):
                    plane = self._plane(replace(then, wavelength=wave))
                    offset = np.hypot(*(plane.plain.project(vectors[rows], name) - points[rows]).T)
                    fwhm = seeing_fwhm(self.seeing, wave, airmass).to_value(u.rad) * scale[rows]
                    light[rows, k] += weight / 2 * fraction_within(offset, radius, fwhm, beta)
                    centered[rows, k] += weight / 2 * fraction_within(np.zeros_like(offset), radius, fwhm, beta)
        x, y = points.T * u.mm
        names = ("positioner", "fiber_type", "x", "y", "wavelength", "fraction", "relative")
        table = QTable([ids, types, x, y, waves * u.um, light, light / centered], names=names)
        for name in names[2:]:
            table[name].info.format = ".3f"
        return table


def _of_bands(instrument: Instrument, conditions: ObservingConditions) -> dict[str, u.Quantity]:
    """Return, for each fiber type, the edges of its band, and between them the wavelength of its fibers."""
    used, bands = observed_light(instrument.light, conditions), instrument.light.band
    if bands is None:
        raise InputError(f"wavelengths must be given for {instrument.name}, which states no band, got None")
    waves = {}
    for name in instrument.focal_plane.fiber_types:
        band = bands.get(name) if isinstance(bands, dict) else bands
        if band is None:
            known = f"{instrument.name} states only the band of {listed(bands)}"
            raise InputError(f"wavelengths must be given for the fiber type {name!r}, because {known}, got None")
        low, high = band.to_value(u.um)
        placed = replace(used, compensated=False).of(name)
        waves[name] = [low, np.clip(placed, low, high), high] * u.um
    return waves
