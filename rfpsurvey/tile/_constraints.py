"""Constraints on a tile: directions that no arm may cover, and targets that are required by their identifiers."""

from dataclasses import replace

import astropy.units as u
import numpy as np

from rfpsurvey._units import to_labels
from rfpsurvey.errors import InputError, InputTypeError
from rfpsurvey.instrument import Instrument
from rfpsurvey.projection import TangentPlane
from rfpsurvey.region import Region

__all__ = ["absent_required", "add_keep_out", "as_keep_out", "find_required"]


def add_keep_out(instrument: Instrument, plane: TangentPlane, regions: list[Region]) -> Instrument:
    """Return the instrument with obstacles where no arm may be."""
    if not regions:
        return instrument
    values = np.array([region.values for region in regions])
    points = plane.plain.project(values[:, :3])
    radius = values[:, 3] * instrument.plate_scale.to_value(u.mm / u.rad)
    circles = np.column_stack([points, radius])[np.isfinite(points).all(axis=1)]
    focal_plane = instrument.focal_plane
    obstacles = np.vstack([focal_plane.arrays.obstacles, circles]) * u.mm
    return replace(
        instrument,
        focal_plane=replace(focal_plane, obstacles=obstacles),
        plate_scale=None if instrument.distortion else instrument.plate_scale,
    )


def as_keep_out(keep_out: object) -> list[Region]:
    """Return circles on the sky from one, from several, or from None."""
    regions = [] if keep_out is None else [keep_out] if isinstance(keep_out, Region) else keep_out
    what = "keep_out must be circles made by Region.cap, one or a list"
    if not isinstance(regions, list | tuple):
        raise InputTypeError(f"{what}, got {type(keep_out).__name__}")
    for region in regions:
        if not isinstance(region, Region):
            raise InputTypeError(f"{what}, got {type(region).__name__} in the list")
        if region.kind != "cap":
            raise InputError(f"{what}, got {region!r}")
    return list(regions)


def find_required(known: np.ndarray, ids: np.ndarray, required) -> np.ndarray:
    """Mark the required ones among identifiers; all that are required must be known."""
    if required is None or np.size(required) == 0:
        return np.zeros(len(ids), dtype=bool)
    names, known = _alike(required, known)
    strange = names[~np.isin(names, known)]
    if len(strange):
        raise InputError(f"required must hold ids of the catalog, got {strange[0]} ({len(strange)} of {len(names)})")
    return np.isin(ids if names.dtype.kind == ids.dtype.kind else ids.astype(str), names)


def absent_required(ids: np.ndarray, required) -> list[str]:
    """Return a sentence on the required targets that are not among the identifiers, if there are any."""
    if required is None or np.size(required) == 0:
        return []
    names, ids = _alike(required, ids)
    away = names[~np.isin(names, ids)]
    listed = ", ".join(str(name) for name in away[:5])
    return [f"required targets outside the field: {listed} ({len(away)} in all)"] if len(away) else []


def _alike(required, ids):
    """Return required identifiers and others, both integers or both text."""
    names = to_labels(np.atleast_1d(required), "required")
    return (names, ids) if names.dtype.kind == ids.dtype.kind else (names.astype(str), ids.astype(str))
