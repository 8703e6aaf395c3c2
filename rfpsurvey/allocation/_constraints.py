"""Constraints of an allocation: identifiers of required targets, and circles on the sky that no arm may cover."""

import hashlib

import numpy as np

from rfpsurvey._units import to_labels, to_lonlat
from rfpsurvey.errors import InputError, InputTypeError
from rfpsurvey.region import Region

__all__ = ["as_keep_out", "as_required", "brief", "circle_text", "recorded"]

# Results record lists of at most this many identifiers or circles. For a longer list, they record the length and a
# digest.
MOST_LISTED = 1000


def as_required(required: object) -> tuple[int, ...] | tuple[str, ...]:
    """Return the distinct identifiers of required targets in the given order; all are integers or all are text."""
    if required is None or np.size(required) == 0:
        return ()
    names = to_labels(np.atleast_1d(required), "required")
    if np.asarray(required).dtype.kind == "b":
        raise InputTypeError("required must contain ids of targets (integers or text), got booleans")
    if names.ndim != 1:
        raise InputError(f"required must be a one-dimensional list of target ids, got the shape {names.shape}")
    return tuple(dict.fromkeys(names.tolist()))


def as_keep_out(keep_out: object) -> tuple[Region, ...]:
    """Convert one circle on the sky, a list of circles, or None to a tuple of circles."""
    regions = () if keep_out is None else (keep_out,) if isinstance(keep_out, Region) else keep_out
    what = "keep_out must be one or more circles made by Region.cap"
    if not isinstance(regions, list | tuple):
        raise InputTypeError(f"{what}, got {type(keep_out).__name__}")
    for region in regions:
        if not isinstance(region, Region):
            raise InputTypeError(f"{what}, got {type(region).__name__} in the list")
        if region.kind != "cap":
            raise InputError(f"{what}, got {region!r}")
    return tuple(regions)


def circle_text(region: Region) -> str:
    """Return a circle in the form ``cap RA DEC RADIUS`` (deg), with all digits."""
    lon, lat = to_lonlat(region.values[:3])
    degrees = np.rad2deg([lon % (2 * np.pi), lat, region.values[3]])
    return " ".join(["cap", *(repr(value) for value in degrees.tolist())])


def recorded(texts: list[str]) -> list[str]:
    """Return the list that results store for identifiers or circles; a long list becomes its length and a digest."""
    if len(texts) <= MOST_LISTED:
        return texts
    return [f"{len(texts)} in all, digest {hashlib.sha256(chr(10).join(texts).encode()).hexdigest()[:16]}"]


def brief(values: tuple, most: int = 5) -> str:
    """Return text with the first values of a list and the total number of values."""
    listed = ", ".join(str(value) for value in values[:most])
    return f"{listed} ({len(values)} in all)"
