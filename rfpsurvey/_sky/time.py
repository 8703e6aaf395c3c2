"""Epochs and times of observations as Time objects, and proper motions, which are motions along straight lines."""

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import date, datetime
from numbers import Number
from typing import TYPE_CHECKING

import astropy.units as u
import erfa
import numpy as np
from astropy.coordinates import SkyCoord
from astropy.time import Time
from astropy.utils.masked import Masked

from rfpsurvey._common.read_tables import parse_number
from rfpsurvey._common.units import rows_of, to_axes, to_lonlat
from rfpsurvey.errors import INCONVERTIBLE, InputError, is_real, refusal, short, warn

if TYPE_CHECKING:
    from rfpsurvey._sky.catalog import Catalog

FIRST, LAST = 1700, 2300
OF_CONDITIONS = "the time of the observing conditions"
DATED = Time, date, np.datetime64


@contextmanager
def any_year() -> Iterator[None]:
    """Suppress the warnings of ERFA for years whose leap seconds are unknown; also usable as a decorator."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", erfa.ErfaWarning)
        yield


def to_time(value: object, name: str, *, gaps: bool = False, scalar: bool = False) -> Time:
    """Convert a Time, a date, a Julian year, or text with a date or a Julian year, to a Time.

    With ``gaps``, some times may be masked. With ``scalar``, the value must be a single time.
    """
    try:
        time = _of_date(value)
        time = _of_years(_as_number(value)) if time is None else time
    except INCONVERTIBLE:
        text = (
            f"{name} must be a Time, a Julian year from {FIRST} to {LAST} such as 2026.5, or a date such as 2026-07-01"
        )
        raise refusal(text, value, Number, str, u.Quantity, np.ndarray, list) from None
    if scalar and not time.isscalar:
        raise InputError(f"{name} must be one time, got the shape {time.shape}")
    if not gaps and np.any(time.mask):
        raise InputError(f"{name} must not have masked values, got {short(value)}")
    return time


def to_moment(value: object, name: str) -> Time:
    """Convert a Time, or a date and time (UTC) as a datetime or as text, to one Time."""
    text = f"{name} must be a date and time (UTC) such as 2026-07-01T06:30:00"
    try:
        time = _of_date(value)
        time = None if isinstance(value, str) and time.format == "byear_str" else time
    except (ValueError, TypeError, AttributeError):
        time = None
    if time is None:
        year = _as_number(value)
        known = is_real(year) and FIRST < year < LAST
        remedy = f"; the Julian year {year} is {_of_years(year).utc.isot[:16]} in this form" if known else ""
        raise refusal(f"{text}{remedy}", value, Number, str)
    if not time.isscalar or time.mask:
        what = "a masked value" if time.isscalar else f"the shape {time.shape}"
        raise InputError(f"{text}, got {what}")
    return time


def _of_date(value: object) -> Time | None:
    """Return the Time for a Time, for dates, or for text in ISO 8601; None for a number, also as text."""
    if isinstance(value, Time):
        if value.scale == "local":  # cannot be converted to UTC
            raise ValueError
        return value
    if isinstance(value, date) and not isinstance(value, datetime):
        value = value.isoformat()
    if isinstance(value, DATED) or np.asarray(value).dtype.kind == "M":
        return Time(value)
    if not isinstance(value, str) or isinstance(_as_number(value), float):
        return None
    try:
        return Time(value.strip())
    except ValueError:
        return Time(datetime.fromisoformat(value.strip()))  # with a time zone


def _as_number(value: object) -> object:
    """Return the number of a text such as "2026.5" or "J2026.5"; return other values unchanged."""
    try:
        return parse_number(value.strip().removeprefix("J")) if isinstance(value, str) else value
    except ValueError:
        return value


def _of_years(value: object) -> Time:
    """Return the Time for Julian years; masked years become masked times."""
    if isinstance(value, u.Quantity):
        value = value.to_value(u.yr)
    missing = np.asarray(getattr(value, "mask", False))
    years = np.asarray(getattr(value, "unmasked", value), dtype=float)
    if not ((years > FIRST) & (years < LAST) | missing).all():
        raise ValueError
    # a masked year must be a valid year as well
    years = Masked(np.where(missing, 2000.0, years), mask=missing) if missing.any() else years
    return Time(years, format="jyear", scale="tcb")


def known_epochs(epoch: Time, moves: np.ndarray) -> Time | None:
    """Return epochs without masked values; ``moves`` states which targets have a proper motion and need an epoch."""
    missing = np.broadcast_to(np.asarray(epoch.mask), moves.shape)
    if not missing.any():
        return epoch
    if (missing & moves).any():
        lacking = rows_of(missing & moves)
        raise InputError(f"epoch must be a time for every target with a proper motion, but {lacking} have none")
    rows = np.arange(len(moves))
    return None if missing.all() else epoch[np.where(missing, rows[~missing][0], rows)]


def moving(coord: SkyCoord) -> np.ndarray:
    """Return whether each target has a known proper motion that differs from 0."""
    motion = coord.data.differentials.get("s")
    if motion is None:
        return np.zeros(len(coord), dtype=bool)
    motion = np.array([part.value for part in (motion.d_lon_coslat, motion.d_lat)])
    return np.isfinite(motion).all(axis=0) & (motion != 0).any(axis=0)


def move_coordinates(coord: SkyCoord, years: np.ndarray) -> SkyCoord:
    """Return ICRS coordinates after the given numbers of years; targets without both proper motions do not move."""
    icrs = coord.icrs
    lon, lat = icrs.ra.rad, icrs.dec.rad
    motion = np.column_stack([pm.to_value(u.rad / u.yr) for pm in (icrs.pm_ra_cosdec, icrs.pm_dec)])
    known = np.isfinite(motion).all(axis=1)
    moved = move(lon[known], lat[known], motion[known], years[known])
    lon, lat, motion = lon.copy(), lat.copy(), np.where(known[:, None], motion, np.nan)
    lon[known], lat[known], motion[known] = moved
    pm_ra, pm_dec = (motion.T * u.rad / u.yr).to(u.mas / u.yr)
    return SkyCoord(lon * u.rad, lat * u.rad, pm_ra_cosdec=pm_ra, pm_dec=pm_dec)


def move(lon: np.ndarray, lat: np.ndarray, motion: np.ndarray, years: np.ndarray) -> tuple:
    """Return the positions and proper motions of stars after the given numbers of years.

    The motion is computed with unit vectors, so the poles need no special treatment. A star that does not move
    keeps its position.

    Parameters
    ----------
    lon, lat : ndarray, shape (n,)
        Longitudes and latitudes, in radians.
    motion : ndarray, shape (n, 2)
        Proper motions in longitude (with the cosine of the latitude) and in latitude, in radians per year.
    years : ndarray, shape (n,)
        Time during which each star moves, in years.

    Returns
    -------
    lon, lat : ndarray, shape (n,)
        New longitudes (from 0 to 2 pi) and latitudes, in radians.
    motion : ndarray, shape (n, 2)
        New proper motions, in radians per year.
    """
    place, east, north = to_axes(lon, lat)
    velocity = motion[:, :1] * east + motion[:, 1:] * north
    new = place + years[:, None] * velocity
    distance = np.linalg.norm(new, axis=1)[:, None]
    new_lon, new_lat = to_lonlat(new)
    still = (motion == 0).all(axis=1) | (years == 0)
    new_lon, new_lat = np.where(still, lon, new_lon % (2 * np.pi)), np.where(still, lat, new_lat)
    _, east, north = to_axes(new_lon, new_lat)
    velocity = velocity / distance
    across = np.column_stack([(velocity * east).sum(axis=1), (velocity * north).sum(axis=1)])
    return new_lon, new_lat, np.where(still[:, None], motion, across)


def move_vectors(vectors: np.ndarray, motion: np.ndarray, years: float) -> np.ndarray:
    """Return unit vectors after a number of years; ``motion`` is the same as in `move`, and NaN is no motion."""
    _, east, north = to_axes(*to_lonlat(vectors))
    motion = np.where(np.isfinite(motion).all(axis=1)[:, None], motion, 0.0)
    new = vectors + years * (motion[:, :1] * east + motion[:, 1:] * north)
    return new / np.linalg.norm(new, axis=1)[:, None]


@any_year()
def choose_epoch(
    catalog: "Catalog", epoch: object, times: Time | None, *, whole: bool = True, of: str = OF_CONDITIONS
) -> tuple[object, str | None]:
    """Return the epoch to which the targets are moved, and a sentence that states their epoch.

    Parameters
    ----------
    catalog : Catalog
        The targets.
    epoch : Time, str, float or None
        Epoch that the user requested.
    times : Time or None
        Times of the observing conditions or of the tiles. Without a requested epoch, targets are moved to these times.
    whole : bool, optional
        Whether the catalog contains all targets; otherwise, the sentence does not state how far targets move.
    of : str, optional
        Words for the times.

    Returns
    -------
    Time, str, float or None
        The epoch; for several times, their midpoint; None if the targets are not moved.
    str or None
        The sentence; None if the targets have no proper motions, or only proper motions of 0.
    """
    asked = None if epoch is None else to_time(epoch, "epoch", scalar=True)
    if not catalog.has_proper_motion or (whole and not moving(catalog.coord).any()):
        if epoch is not None:
            warn("the epoch has no effect, because the targets have no proper motions")
        return epoch, None
    if epoch is None and times is not None and catalog.epoch is not None:
        times = times.reshape(-1)
        text = f"the targets are moved to {epoch_text(times)}, {of}"
        return times.min() + (times.max() - times.min()) / 2, text
    speed = np.nan_to_num(np.hypot(catalog.coord.icrs.pm_ra_cosdec, catalog.coord.icrs.pm_dec)).to(u.mas / u.yr)
    fastest = np.max(speed, initial=0 * u.mas / u.yr)
    if epoch is not None:
        text = f"the targets are moved to {epoch_text(asked)}, the requested epoch"
    else:
        catalog_epoch = "unknown" if catalog.epoch is None else epoch_text(catalog.epoch)
        text = f"the targets are at the epoch of the catalog ({catalog_epoch}), although they have proper motions"
        text += f" of up to {fastest:.4g}" if whole else ""
    if times is not None and asked is not None:
        moved = (fastest * np.max(np.abs((times.tdb - asked.tdb).to(u.yr)))).to(u.arcsec)
        distance = f" by up to {moved:.2g}" if whole else ""
        text += f"; they move{distance} until {of}, {epoch_text(times)}"
    elif times is not None:
        text += f"; without an epoch of the catalog, they cannot be moved to {of}"
        warn(text)
    return epoch, text


def epoch_text(epoch: Time | None) -> str | None:
    """Return the epoch of the positions as text for the provenance."""
    if epoch is None:
        return None
    years = np.atleast_1d(epoch.jyear)
    low, high = float(years.min()), float(years.max())
    return f"J{low:.3f}" if low == high else f"J{low:.3f} to J{high:.3f}"
