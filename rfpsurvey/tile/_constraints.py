"""Constraints on a tile: directions that no arm may cover, and targets that are required by their identifiers."""

from dataclasses import replace

import astropy.units as u
import numpy as np
from astropy.coordinates import SkyCoord

from rfpsurvey._units import to_direction, to_labels, to_scalar
from rfpsurvey.errors import InputError
from rfpsurvey.instrument import Instrument
from rfpsurvey.projection import TangentPlane

__all__ = ["absent_required", "add_keep_out", "find_required"]


def add_keep_out(instrument: Instrument, plane: TangentPlane, keep_out: SkyCoord | None, radius) -> Instrument:
    """Return the instrument with obstacles where no arm may be."""
    if (keep_out is None) != (radius is None):
        raise InputError("keep_out and keep_out_radius must be given together")
    if keep_out is None:
        return instrument
    if isinstance(radius, u.Quantity) and radius.unit.is_equivalent(u.rad):
        radius = to_scalar(radius, radius.unit, "keep_out_radius", low=0) * radius.unit * instrument.plate_scale
    radius = to_scalar(radius, u.mm, "keep_out_radius", low=0)
    points = plane.to_focal_plane(to_direction(keep_out, "keep_out").reshape(-1)).to_value(u.mm)
    points = points[np.isfinite(points).all(axis=1)]
    circles = np.column_stack([points, np.full(len(points), radius)])
    focal_plane = instrument.focal_plane
    obstacles = np.vstack([focal_plane.arrays.obstacles, circles]) * u.mm
    return replace(
        instrument,
        focal_plane=replace(focal_plane, obstacles=obstacles),
        plate_scale=None if instrument.distortion else instrument.plate_scale,
    )


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
