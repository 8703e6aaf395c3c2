"""Convert input, which can have units and masks, to float64 arrays in mm, in radians, or without unit."""

from collections.abc import Collection, Iterable
from dataclasses import fields
from numbers import Integral, Number

import astropy.units as u
import numpy as np
from astropy.coordinates import (
    RadialDifferential,
    SkyCoord,
    SphericalCosLatDifferential,
    SphericalRepresentation,
    UnitSphericalCosLatDifferential,
    UnitSphericalRepresentation,
)
from astropy.table import Table
from astropy.time import Time
from astropy.utils.masked import Masked

from rfpsurvey._common.read_tables import is_number
from rfpsurvey.errors import INCONVERTIBLE, InputError, InputTypeError, InputUnitsError, listed, refusing, short

MOST_VISITS, MOST_SEED = 255, 2**128


class ByValue:
    """Base class of frozen dataclasses of settings, which are equal if all their values, units and types are equal."""

    def __eq__(self, other):
        return self._values() == other._values() if type(self) is type(other) else NotImplemented

    def __hash__(self):
        return hash(self._values())

    def _values(self) -> tuple:
        return tuple(value_of(getattr(self, field.name)) for field in fields(self) if field.compare)


def value_of(value: object) -> object:
    """Return an object that can be compared and hashed, and that is equal for equal values; NaN is equal to NaN."""
    if isinstance(value, ByValue):
        return value._values()
    if isinstance(value, u.Quantity):
        return str(value.unit), value_of(value.value)
    if isinstance(value, Time):
        return value.scale, value_of(np.asarray(value.jd1)), value_of(np.asarray(value.jd2))
    if isinstance(value, SkyCoord):
        return repr(value.frame.replicate_without_data()), value_of(value.data.to_cartesian().xyz)
    if isinstance(value, Table):
        return tuple((name, value_of(value[name])) for name in value.colnames)
    if isinstance(value, np.ndarray | np.void):
        return np.shape(value), str(value.dtype), tuple(value.ravel()) if value.dtype.hasobject else value.tobytes()
    if isinstance(value, dict):
        return frozenset((name, value_of(item)) for name, item in value.items())
    return tuple(map(value_of, value)) if isinstance(value, list | tuple) else value


def locked(array: np.ndarray) -> np.ndarray:
    """Return a read-only view of an array."""
    view = np.asarray(array).view()
    view.flags.writeable = False
    return view


def exact_text(value: float) -> str:
    """Return a number as text with at most 15 digits, or with more digits if 15 digits do not determine the number."""
    text = f"{value:.15g}"
    return text if float(text) == value else repr(float(value))


def to_unit(value: object, unit: u.UnitBase, name: str) -> np.ndarray:
    """Return ``value`` as a new float64 array in ``unit``, with NaN in place of masked values."""
    if not isinstance(value, u.Quantity):
        raise InputTypeError(
            f"{name} must be a Quantity with a unit convertible to {unit}, got {short(value)} without a unit"
        )
    try:
        return np.array(_filled(value).to_value(unit), dtype=np.float64, order="C")
    except INCONVERTIBLE:  # the unit is not convertible, or astropy does not know it
        needed = f"have a unit convertible to {unit}" if str(unit) else "be a number without a unit"
        raise InputUnitsError(f"{name} must {needed}, got {value.unit if str(value.unit) else short(value)}") from None


def to_scalar(
    value: object, unit: u.UnitBase, name: str, *, low: float = -np.inf, high: float = np.inf, closed: bool = False
) -> float:
    """Return one finite number in ``unit`` between ``low`` and ``high``; with ``closed``, ``low`` itself is allowed."""
    number = to_unit(value, unit, name)
    if number.shape != ():
        raise InputError(f"{name} must be one value, got the shape {number.shape}")
    if not np.isfinite(number) or not (low < number < high or (closed and number == low)):
        limits = f" above {low:g} {unit}".rstrip() if low > -np.inf else ""
        limits = limits.replace(" above", " of at least") if closed else limits
        limits += f" and below {high:g} {unit}".rstrip() if high < np.inf else ""
        raise InputError(f"{name} must be one finite value{limits}, got {value}")
    return float(number)


def to_mm(value: object, name: str) -> np.ndarray:
    """Return lengths in mm."""
    return to_unit(value, u.mm, name)


def to_radian(value: object, name: str) -> np.ndarray:
    """Return angles in radians."""
    return to_unit(value, u.rad, name)


def to_points_mm(value: object, name: str) -> np.ndarray:
    """Return points on the focal plane as an (n, 2) array in mm."""
    points = to_mm(value, name)
    if points.ndim != 2 or points.shape[1] != 2:
        raise InputError(f"{name} must have the shape (n, 2), got {points.shape}")
    return points


def to_direction(coord: object, name: str = "coord") -> SkyCoord:
    """Return coordinates in the same frame, with proper motions but without distances and radial velocities.

    Masked coordinates and proper motions become NaN.
    """
    if not isinstance(coord, SkyCoord):
        raise InputTypeError(f"{name} must be a SkyCoord, got {short(coord)}")
    data = coord.frame.data
    motion = data.differentials.get("s")
    place = data.without_differentials().represent_as(UnitSphericalRepresentation)
    place = UnitSphericalRepresentation(_filled(place.lon), _filled(place.lat), copy=False)
    if motion is not None and not isinstance(motion, RadialDifferential):
        if not hasattr(motion, "d_lon_coslat"):
            full = data.represent_as(SphericalRepresentation, SphericalCosLatDifferential)
            motion = full.differentials["s"]
        motion = UnitSphericalCosLatDifferential(_filled(motion.d_lon_coslat), _filled(motion.d_lat), copy=False)
        if motion.d_lat.unit.is_equivalent(u.mas / u.yr):
            place = place.with_differentials({"s": motion})
    kind = {"representation_type": "spherical", "differential_type": "sphericalcoslat"}
    return SkyCoord(coord.frame.realize_frame(place, **kind))


def _filled(value: u.Quantity) -> u.Quantity:
    """Return a Quantity without a mask, with NaN in place of masked values."""
    return value.filled(np.nan * value.unit) if isinstance(value, Masked) else value


def to_center(center: object, name: str = "center") -> SkyCoord:
    """Convert a SkyCoord, or text such as "06h20m00s +23d00m00s" or "95.0 23.0" (degrees), to one direction."""
    if not isinstance(center, str):
        center = to_direction(center, name)
        if not center.isscalar:
            raise InputError(f"{name} must be one direction, got the shape {center.shape}")
        if not (np.isfinite(center.data.lon) and np.isfinite(center.data.lat)):
            raise InputError(f"{name} must have finite coordinates, got {short(center)}")
        return center
    words = center.replace(",", " ").split()
    try:
        if len(words) < 2:
            raise ValueError("the declination is missing")
        if len(words) == 2 and all(is_number(word) for word in words):
            if not abs(float(words[0])) <= 360:
                raise ValueError("the right ascension must lie between -360 and 360 deg")
            return SkyCoord(float(words[0]), float(words[1]), unit="deg")
        return SkyCoord(" ".join(words), unit=("hourangle", "deg"))
    except Exception as error:  # astropy's parsers can raise any exception
        raise InputError(
            f"{name} must be coordinates such as '06h20m00s +23d00m00s' or '95.0 23.0', got {short(center)} ({error})"
        ) from None


def to_vectors(coord: object, name: str = "coord", *, scalar: bool = False) -> np.ndarray:
    """Convert directions to ICRS unit vectors, shape (n, 3); distances are ignored."""
    direction = to_direction(coord, name)
    if scalar and not direction.isscalar:
        raise InputError(f"{name} must be one direction, got the shape {direction.shape}")
    if direction.ndim > 1:
        raise InputError(f"{name} must have the shape (n,), got {direction.shape}")
    direction = SkyCoord(direction.frame.realize_frame(direction.data.without_differentials()))
    try:
        icrs = direction.icrs
    except Exception as error:  # frames that lack an observer or a time can raise any exception
        raise InputError(f"{name} in the frame {coord.frame.name!r} cannot be converted to ICRS: {error}") from error
    xyz = icrs.represent_as(UnitSphericalRepresentation).to_cartesian().xyz.value
    return np.ascontiguousarray(np.atleast_2d(xyz.T), dtype=np.float64)


def to_lonlat(vectors: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return longitudes from -pi to pi and latitudes (radians) of vectors, shape (..., 3)."""
    x, y, z = np.moveaxis(vectors, -1, 0)
    return np.arctan2(y, x), np.arctan2(z, np.hypot(x, y))


def from_lonlat(lon: np.ndarray, lat: np.ndarray) -> np.ndarray:
    """Return the unit vectors of longitudes and latitudes (radians), shape (..., 3)."""
    return np.stack(np.broadcast_arrays(np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)), axis=-1)


def to_axes(lon: np.ndarray, lat: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the unit vectors of positions, and of the directions east and north there, shape (..., 3) each."""
    east = np.stack([-np.sin(lon), np.cos(lon), np.zeros_like(lon)], axis=-1)
    north = np.stack([-np.sin(lat) * np.cos(lon), -np.sin(lat) * np.sin(lon), np.cos(lat)], axis=-1)
    return from_lonlat(lon, lat), east, north


def to_plain(column: object, name: str = "the values", what: str = "numbers or text") -> np.ndarray:
    """Return an array without unit and mask; masked numbers become NaN, and masked text becomes empty."""
    values = getattr(column, "value", column)
    try:
        mask = np.asarray(getattr(column, "mask", False))
        values = np.asarray(getattr(values, "unmasked", values))
    except INCONVERTIBLE:  # rows of different lengths
        raise InputTypeError(f"{name} must hold {what}, got {short(column)}") from None
    values = values.astype(values.dtype.newbyteorder("="), copy=False)  # tables in FITS files are big-endian
    if values.dtype.kind == "S":
        try:
            values = np.char.decode(values, "utf-8")
        except UnicodeDecodeError as error:
            raise InputError(f"{name} must be text in ASCII or UTF-8, got the bytes {error.object[:20]!r}") from None
    elif values.dtype.kind == "O":
        values = np.array([_plain_object(v, name, what) for v in values.ravel()]).reshape(values.shape)
    elif values.dtype.kind not in "biufU":
        raise InputTypeError(f"{name} must hold {what}, got {values.dtype.name}")
    if mask.any():
        values = (
            np.where(mask, "", values) if values.dtype.kind == "U" else np.where(mask, np.nan, values.astype(float))
        )
    return values


def _plain_object(value: object, name: str, what: str) -> object:
    """Return a number or text unchanged, bytes as text, and a missing value as empty text."""
    if value is None or value is np.ma.masked:
        return ""
    if isinstance(value, bytes):
        return value.decode("utf-8", "backslashreplace")
    if not isinstance(value, str | int | float | np.number | np.bool_):
        raise InputTypeError(f"{name} must hold {what}, got {short(value)}")
    return value


def values_at(values: np.ndarray, row: np.ndarray) -> np.ndarray:
    """Return the values of the given rows; row -1 has the value NaN, empty text, False or -1, depending on the type."""
    if (row >= 0).all():
        return values[row]
    picked = np.full(len(row), {"f": np.nan, "U": "", "b": False}.get(values.dtype.kind, -1), dtype=values.dtype)
    picked[row >= 0] = values[row[row >= 0]]
    return picked


def to_flags(value: object, name: str) -> np.ndarray:
    """Convert booleans, numbers, or the words true and false to booleans; masked values become False."""
    values = to_plain(value, name, "booleans")
    if values.dtype.kind == "U":
        words = np.char.lower(np.char.strip(values))
        yes, no = np.isin(words, ("true", "t", "yes", "1")), np.isin(words, ("false", "f", "no", "0", ""))
        if not (yes | no).all():
            strange = str(words[~(yes | no)].flat[0])
            raise InputError(f"{name} must hold booleans or numbers, got text such as {strange!r}")
        return yes
    return np.nan_to_num(to_numbers(values, name)) != 0


def to_labels(value: object, name: str) -> np.ndarray:
    """Convert identifiers to an array of int64, or of text without leading and trailing blanks."""
    blank = np.asarray(getattr(value, "mask", False))
    if blank.any() and np.asarray(value).dtype.kind in "iu":
        raise InputError(f"{name} must be integers or text for every row, but {rows_of(blank)} have none")
    values = to_plain(value, name)
    if values.dtype.kind == "f" and (np.abs(values) < 2.0 ** (np.finfo(values.dtype).nmant + 1)).all():
        whole = values.astype(np.int64)
        values = whole if (whole == values).all() else values
    if values.dtype.kind in "iu" and (values.size == 0 or values.max() < 2**63):
        return values.astype(np.int64)
    if values.dtype.kind == "f" and values.size:
        where = np.isnan(values)
        what = f"but {rows_of(where)} have none" if where.any() else f"got numbers such as {values.flat[0]}"
        raise InputError(f"{name} must be integers or text for every row, {what}")
    if values.size == 0:  # NumPy cannot replace text in an empty array
        return values.astype(str)
    return np.char.strip(np.char.replace(values.astype(str), "\n", " "))


def rows_of(mask: np.ndarray) -> str:
    """Return text with the number of rows for which a mask is true, and the first few row numbers, counted from 1."""
    rows = np.flatnonzero(mask)
    few = ", ".join(str(row + 1) for row in rows[:3]) + (", ..." if len(rows) > 3 else "")
    return f"{len(rows)} of {np.size(mask)} rows (row{'s' if len(rows) > 1 else ''} {few})"


def to_numbers(value: object, name: str, *, unitless: bool = False) -> np.ndarray:
    """Return numbers as float64; raise an error if two integers could become the same number.

    With ``unitless``, raise an error if the numbers have a unit.
    """
    values = to_dimensionless(value, name) if unitless else to_plain(value, name)
    try:
        numbers = values.astype(float)
    except INCONVERTIBLE as error:
        raise InputError(f"{name} must be numbers: {error}") from None
    if values.dtype.kind in "iu" and values.size and (wide := (values > 2**53) | (values < -(2**53))).any():
        raise InputError(
            f"{name} must be integers from -2^53 to 2^53, or floating-point numbers, got {values[wide].flat[0]}; "
            "larger integers are not distinct as 64-bit floating-point numbers"
        )
    return numbers


def to_dimensionless(value: object, name: str) -> np.ndarray:
    """Return plain numbers; raise an error for a Quantity with a unit that is not dimensionless."""
    if not isinstance(value, u.Quantity):
        return to_plain(value, name)
    try:
        return to_plain(value.to(u.dimensionless_unscaled), name)
    except u.UnitConversionError:
        raise InputUnitsError(f"{name} must be numbers without a unit, got {short(value)}") from None


def check_unique(values: np.ndarray, name: str) -> None:
    """Raise an error if a value occurs more than once."""
    unique, counts = np.unique(values, return_counts=True)
    if (counts > 1).any():
        twice = unique[counts > 1].tolist()[0]
        text = f"{twice:g}" if isinstance(twice, float) else repr(twice)
        raise InputError(f"{name} must be unique, but {text} occurs more than once")


def check_columns(names: Collection[str], required: Iterable[str], what: str) -> None:
    """Raise an error if a required column is missing; ``names`` are the names of the columns of a table."""
    for name in required:
        if name not in names:
            raise InputError(f"{what} must have the column {name!r}, got {listed(names)}")


def to_visits(visits: object, n: int) -> np.ndarray:
    """Return the requested number of visits of each of n targets as 8-bit integers."""
    with refusing("visits must be whole numbers", visits, object):
        values = to_dimensionless(visits, "visits").astype(float)
    if values.shape not in ((), (n,)):
        raise InputError(f"visits must be one number or have the shape ({n},), got {values.shape}")
    low = 0 if values.ndim else 1  # without any visits, there is nothing to plan
    strange = values[~((values >= low) & (values <= MOST_VISITS) & (values == np.floor(values)))]
    if strange.size:
        raise InputError(f"visits must be whole numbers from {low} to {MOST_VISITS}, got {strange.flat[0]:g}")
    return np.broadcast_to(values.astype(np.uint8), (n,)).copy()


def to_generator(rng: object) -> np.random.Generator:
    """Convert a seed, a Generator or None to a NumPy Generator."""
    with refusing("rng must be a seed from 0 to 2^128 - 1, a numpy Generator or None", rng, Number):
        if isinstance(rng, np.random.RandomState):
            raise TypeError
        if isinstance(rng, Integral) and rng >= MOST_SEED:
            raise ValueError
        return np.random.default_rng(rng)


def is_seed_given(rng) -> bool:
    """Return whether ``rng`` is a valid value other than the default seed 0."""
    return rng is None or isinstance(rng, np.random.Generator) or (isinstance(rng, Integral) and rng > 0)


def to_seed(rng: object) -> int:
    """Return ``rng`` if it is an integer seed; otherwise, draw a new seed, so that results can record the seed."""
    generator = to_generator(rng)
    return int(rng) if isinstance(rng, int | np.integer) else int(generator.integers(2**63))


def to_spawner(rng: object) -> np.random.Generator:
    """Return a Generator that can spawn other generators; raise an error if this is not possible."""
    generator = to_generator(rng)
    try:
        generator.spawn(0)
    except TypeError:
        raise InputError(f"rng must be able to spawn Generators, but {generator!r} has no seed sequence") from None
    return generator
