"""Maps without radial symmetry from the tangent plane to the focal plane, for atmospheric dispersion compensators."""

import os
from dataclasses import dataclass, field, replace

import astropy.units as u
import numpy as np
from astropy.table import QTable

from rfpsurvey._common.files import to_path
from rfpsurvey._common.read_tables import read_table
from rfpsurvey._common.units import ByValue, check_columns, to_mm, to_scalar, to_unit
from rfpsurvey.errors import INCONVERTIBLE, InputError, check_keywords, check_whole, refusal

COLUMNS = ("ADC1", "ADC2", "X_TAN", "Y_TAN", "X_FP", "Y_FP")
# The maximum tangent for which a map is valid is the maximum tangent of the traced directions, multiplied by this
# factor.
MARGIN = 1.04
MOST_STEPS, N_AZIMUTHS, ENOUGH = 30, 72, 1e-12


@check_keywords
@dataclass(frozen=True, eq=False)
class DistortionMap(ByValue):
    """Polynomial map from the tangent plane to the focal plane, for one setting of a dispersion compensator (ADC).

    The compensator consists of two prisms that rotate about the optical axis by the angles a1 and a2. The half
    difference s = (a1 - a2) / 2 determines the strength of the compensation, and the mean (a1 + a2) / 2 determines its
    orientation. The coefficients of the polynomials are Fourier series in s. The system is symmetric about the plane
    y = 0: if s and y change their signs, the position along y also changes its sign, and the position along x does not
    change. The image of the field center is at (0, 0) at every setting, because guiding removes a common shift of all
    images.

    Parameters
    ----------
    coefficients : sequence of float
        Coefficients in mm of the terms that the symmetry allows: first all terms of the position along x, then all
        terms of the position along y.
    degree : int
        Degree of the polynomials.
    harmonics : int
        Order of the Fourier series, that is, the largest k in the terms cos(k s) and sin(k s).
    max_angle : Quantity
        Largest field angle for which the map is valid.
    adc : Quantity, shape (2,), optional
        Angles a1 and a2 of the two prisms.
    mirrored : bool, optional
        Whether +x of the polynomials is -x of the projection. This is true for the tables of DESI, in which +x is west.
    residuals : QTable, optional
        Residuals of the fit. Each row describes one setting of the prisms: ``adc1``, ``adc2``, the number ``n`` of
        residuals, and their ``median``, ``rms`` and ``max``.

    Raises
    ------
    InputError
        If the number of coefficients does not agree with ``degree`` and ``harmonics``, or if a value is not valid.

    Examples
    --------
    >>> import astropy.units as u
    >>> from dataclasses import replace
    >>> import rfpsurvey as rs
    >>> trace = rs.projection.DistortionMap.from_ray_trace("raytrace-tan2fp-4957-v18.csv.gz")  # doctest: +SKIP
    >>> trace.residuals["max"].max()  # doctest: +SKIP
    <Quantity 0.00141 mm>
    >>> desi = rs.Instrument.preset("desi")
    >>> desi = replace(desi, plate_scale=None, distortion=trace.at([-30, 30] * u.deg))  # doctest: +SKIP
    """

    coefficients: tuple[float, ...]
    degree: int
    harmonics: int
    max_angle: u.Quantity
    adc: u.Quantity = field(default=(0.0, 0.0) * u.deg)
    mirrored: bool = True
    residuals: QTable | None = field(default=None, repr=False)

    def __post_init__(self):
        check_whole(self.degree, "degree", 1, 20)
        check_whole(self.harmonics, "harmonics", 0, 20)
        try:
            values = np.array(self.coefficients, dtype=float)
        except INCONVERTIBLE:
            raise refusal("coefficients must be a sequence of numbers", self.coefficients, list, tuple) from None
        n = sum(map(len, _terms(self.degree, self.harmonics)))
        if values.shape != (n,) or not np.isfinite(values).all():
            raise InputError(f"coefficients must be {n} finite numbers, got the shape {values.shape}")
        object.__setattr__(self, "coefficients", tuple(values.tolist()))
        limit = to_scalar(self.max_angle, u.rad, "max_angle", low=0, high=np.pi / 2)
        angles = to_unit(self.adc, u.rad, "adc")
        if angles.shape != (2,) or not np.isfinite(angles).all():
            raise InputError(f"adc must be two finite angles, got {self.adc}")
        unit, mean = np.tan(limit), angles.mean()
        tables = _tables(values, self.degree, self.harmonics, (angles[0] - angles[1]) / 2)
        center = tables[:, 0, 0].copy()
        tables[:, 0, 0] = 0.0
        c, s = np.cos(mean), np.sin(mean)
        turn = np.array([[c, -s], [s, c]])
        flip = np.diag([-1.0 if self.mirrored else 1.0, 1.0])
        # the third item of _setting transforms rows (x, y) of the projection into rows (x, y) of the polynomials
        object.__setattr__(self, "_setting", (tables, unit, flip @ turn, center))
        if not np.linalg.det(self._jacobian(np.zeros((1, 2)))[0]) > 0:
            raise InputError("coefficients must define a map that is invertible at the field center")

    @classmethod
    def from_ray_trace(cls, path: str | os.PathLike, *, degree: int = 5, harmonics: int = 2) -> "DistortionMap":
        """Fit a map to a ray trace of DESI in the format of the package desimeter.

        Parameters
        ----------
        path : str or path-like
            File with a table that has the columns ``ADC1``, ``ADC2`` (deg), ``X_TAN``, ``Y_TAN`` (tangents), ``X_FP``
            and ``Y_FP`` (mm). All settings must have ADC1 = -ADC2.
        degree, harmonics : int, optional
            Degree of the polynomials, and order of the Fourier series.

        Returns
        -------
        DistortionMap
            The map at ADC1 = ADC2 = 0. Its attribute ``residuals`` contains the residuals of all settings.

        Raises
        ------
        InputError
            If the file cannot be read, lacks a column, has invalid values, or has too few rows.
        """
        path = to_path(path)
        table = read_table(path)
        check_columns(table.colnames, COLUMNS, f"{path}: the table")
        try:
            adc1, adc2, x, y, x_fp, y_fp = (np.asarray(table[name], dtype=float) for name in COLUMNS)
        except INCONVERTIBLE as error:
            raise InputError(f"{path}: the columns must contain numbers: {error}") from None
        if not np.isfinite([adc1, adc2, x, y, x_fp, y_fp]).all() or (np.abs(adc1 + adc2) > 1e-6).any():
            raise InputError(f"{path}: all values must be finite, and ADC1 must be -ADC2")
        check_whole(degree, "degree", 1, 20)
        check_whole(harmonics, "harmonics", 0, 20)
        unit = MARGIN * np.hypot(x, y).max()
        strength = np.deg2rad(adc1 - adc2) / 2
        solutions, errors = [], []
        for terms, values in zip(_terms(degree, harmonics), (x_fp, y_fp), strict=True):
            columns = [(x / unit) ** i * (y / unit) ** j * _wave(kind, k, strength) for i, j, kind, k in terms]
            solution, _, rank, _ = np.linalg.lstsq(np.transpose(columns), values, rcond=None)
            if rank < len(terms):
                raise InputError(
                    f"{path}: the table must have enough rows to determine {len(terms)} coefficients, got {len(x)} rows"
                )
            solutions.append(solution)
            errors.append(solution @ columns - values)
        distance = np.hypot(*errors)
        rows = [
            (a1, a2, *_scatter(distance[(adc1 == a1) & (adc2 == a2)]))
            for a1, a2 in np.unique([adc1, adc2], axis=1).T.tolist()
        ]
        residuals = QTable(
            rows=rows,
            names=["adc1", "adc2", "n", "median", "rms", "max"],
            units={"adc1": u.deg, "adc2": u.deg, "median": u.mm, "rms": u.mm, "max": u.mm},
        )
        limit = np.arctan(unit) * u.rad
        return cls(tuple(np.concatenate(solutions)), degree, harmonics, limit.to(u.deg), residuals=residuals)

    def at(self, adc: u.Quantity) -> "DistortionMap":
        """Return the map at another setting of the compensator.

        Parameters
        ----------
        adc : Quantity, shape (2,)
            Angles of the two prisms.

        Returns
        -------
        DistortionMap
            The map at this setting.

        Raises
        ------
        InputError
            If ``adc`` is not two angles.
        """
        return replace(self, adc=adc)

    @property
    def shift(self) -> u.Quantity:
        """Position of the field center on the focal plane, shape (2,), before guiding moves it to (0, 0)."""
        _, _, turn, center = self._setting
        return turn @ center * u.mm

    @property
    def plate_scale(self) -> u.Quantity:
        """Plate scale at the field center: the geometric mean of the largest and smallest scale of all directions."""
        return (
            np.sqrt(np.linalg.det(self._jacobian(np.zeros((1, 2)))[0]))
            * (u.mm / u.rad).to(u.mm / u.deg)
            * (u.mm / u.deg)
        )

    def to_angle(self, radius: u.Quantity) -> u.Quantity:
        """Return the largest field angle at each distance from the field center on the focal plane.

        Parameters
        ----------
        radius : Quantity
            Distances on the focal plane.

        Returns
        -------
        Quantity
            Field angles in deg; NaN if a part of the circle with this radius is outside the range of the map.

        Raises
        ------
        InputError
            If ``radius`` is not a length.
        """
        r = to_mm(radius, "radius")
        turn = np.linspace(0, 2 * np.pi, N_AZIMUTHS, endpoint=False)
        ring = np.column_stack([np.cos(turn), np.sin(turn)])
        tangents = self.unproject((r.reshape(-1, 1, 1) * ring).reshape(-1, 2)).reshape(-1, N_AZIMUTHS, 2)
        return np.rad2deg(np.arctan(np.hypot(*np.moveaxis(tangents, -1, 0)).max(axis=1))).reshape(r.shape) * u.deg

    def project(self, tangents: np.ndarray) -> np.ndarray:
        """Return the points on the focal plane that are images of points in the tangent plane.

        Parameters
        ----------
        tangents : ndarray, shape (n, 2)
            Points in the tangent plane of the unit sphere.

        Returns
        -------
        ndarray, shape (n, 2)
            Points in mm; NaN for field angles larger than ``max_angle``.
        """
        inside = np.hypot(*tangents.T) <= self._setting[1] * (1 + 1e-12)
        return self._image(np.where(inside[:, None], tangents, np.nan))

    def unproject(self, points: np.ndarray) -> np.ndarray:
        """Return the points in the tangent plane whose images are the given points on the focal plane.

        Parameters
        ----------
        points : ndarray, shape (n, 2)
            Points in mm.

        Returns
        -------
        ndarray, shape (n, 2)
            Points in the tangent plane of the unit sphere; NaN for points outside the range of the map.
        """
        unit = self._setting[1]
        tangents = points @ np.linalg.inv(self._jacobian(np.zeros((1, 2)))[0]).T
        for _ in range(MOST_STEPS):
            # the iteration would diverge for points far outside the range of the map
            tangents = np.where(np.hypot(*tangents.T)[:, None] <= 1.5 * unit, tangents, np.nan)
            change = np.linalg.solve(self._jacobian(tangents), (points - self._image(tangents))[..., None])[..., 0]
            tangents = tangents + change
            if not np.nanmax(np.abs(change), initial=0.0) > ENOUGH:  # the next change would be about the square of this
                break
        return np.where(np.hypot(*tangents.T)[:, None] <= unit * (1 + 1e-9), tangents, np.nan)

    def _image(self, tangents):
        """Return the images (mm) of points in the tangent plane, including points beyond ``max_angle``."""
        tables, unit, turn, _ = self._setting
        local = tangents @ turn / unit
        return np.column_stack([np.polynomial.polynomial.polyval2d(*local.T, table) for table in tables]) @ turn.T

    def _jacobian(self, tangents):
        """Return the derivatives (mm) of the images with respect to the tangents, shape (n, 2, 2)."""
        tables, unit, turn, _ = self._setting
        local = tangents @ turn / unit
        rows = [
            [
                np.polynomial.polynomial.polyval2d(*local.T, np.polynomial.polynomial.polyder(table, axis=axis))
                for axis in (0, 1)
            ]
            for table in tables
        ]
        return turn @ np.moveaxis(np.array(rows), -1, 0) @ turn.T / unit


def _terms(degree: int, harmonics: int) -> tuple[list, list]:
    """Return the terms of the positions along x and y; (i, j, 'cos', k) denotes the term x^i y^j cos(k s)."""
    along = [], []
    for i in range(degree + 1):
        for j in range(degree + 1 - i):
            for k in range(harmonics + 1):
                # if y and s change their signs, the position along y also changes its sign, and the position along x
                # does not change
                along[0].append((i, j, "cos" if j % 2 == 0 else "sin", k))
                along[1].append((i, j, "sin" if j % 2 == 0 else "cos", k))
    return tuple([term for term in terms if term[2:] != ("sin", 0)] for terms in along)


def _wave(kind: str, k: int, strength: np.ndarray) -> np.ndarray:
    return np.cos(k * strength) if kind == "cos" else np.sin(k * strength)


def _tables(values, degree, harmonics, strength) -> np.ndarray:
    """Return the coefficients of x^i y^j for one value of s (``strength``), shape (2, degree + 1, degree + 1)."""
    out, used = np.zeros((2, degree + 1, degree + 1)), 0
    for table, terms in zip(out, _terms(degree, harmonics), strict=True):
        for (i, j, kind, k), value in zip(terms, values[used : used + len(terms)], strict=True):
            table[i, j] += value * _wave(kind, k, strength)
        used += len(terms)
    return out


def _scatter(distance: np.ndarray) -> tuple[int, float, float, float]:
    """Return the number of residuals, and their median, root mean square and maximum."""
    return len(distance), float(np.median(distance)), float(np.sqrt(np.mean(distance**2))), float(distance.max())
