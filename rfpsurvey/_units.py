"""The door where units come off: everything inside is float64 in mm, radians or plain numbers."""

import astropy.units as u
import numpy as np
from astropy.coordinates import SkyCoord, UnitSphericalRepresentation

from rfpsurvey.errors import InputError

__all__ = ["to_mm", "to_points_mm", "to_radian", "to_unit", "to_vectors"]


def to_unit(value: object, unit: u.UnitBase, name: str) -> np.ndarray:
    """Return ``value`` as a fresh float64 array in ``unit``, or raise a sentence about ``name``."""
    if isinstance(value, str):
        try:
            value = u.Quantity(value)
        except (TypeError, ValueError):
            raise InputError(f"{name} must be a quantity such as '5 {unit}', got {value!r}") from None
    if not isinstance(value, u.Quantity):
        raise InputError(
            f"{name} must be a Quantity with a unit convertible to {unit}, got {_short(value)} without a unit"
        )
    try:
        return np.array(value.to_value(unit), dtype=np.float64, order="C")
    except u.UnitConversionError:
        raise InputError(f"{name} must have a unit convertible to {unit}, got {value.unit}") from None


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


def to_vectors(coord: object, name: str = "coord") -> np.ndarray:
    """Return directions as ICRS unit vectors, shape (n, 3); distances do not matter."""
    if not isinstance(coord, SkyCoord):
        raise InputError(f"{name} must be a SkyCoord, got {_short(coord)}")
    try:
        icrs = coord.icrs
    except Exception as error:  # frames raise what they like when an observer or a time is missing
        raise InputError(f"{name} in the frame {coord.frame.name!r} cannot be brought to ICRS: {error}") from error
    xyz = icrs.represent_as(UnitSphericalRepresentation).to_cartesian().xyz.value
    return np.ascontiguousarray(np.atleast_2d(xyz.T), dtype=np.float64)


def _short(value: object) -> str:
    text = repr(value)
    return text if len(text) < 60 else f"{type(value).__name__} {text[:40]}..."
