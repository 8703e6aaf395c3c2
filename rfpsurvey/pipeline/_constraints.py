"""Constraints of a field: circles that no arm may cover as obstacles, and the rows of required targets."""

from collections.abc import Iterable
from dataclasses import replace

import astropy.units as u
import numpy as np

from rfpsurvey.allocation import AllocationOptions
from rfpsurvey.errors import InputError
from rfpsurvey.instrument import Instrument
from rfpsurvey.projection import FieldProjection

__all__ = ["are_among", "mark_required", "with_keep_out"]


def with_keep_out(instrument: Instrument, projection: FieldProjection, options: AllocationOptions) -> Instrument:
    """Return the instrument with the circles of ``keep_out`` that its arms can touch in a field as obstacles."""
    if not options.keep_out:
        return instrument
    circles, plane = options.circles, instrument.focal_plane
    points = projection.project(circles[:, :3])
    radius = circles[:, 3] * instrument.plate_scale.to_value(u.mm / u.rad)
    arrays = plane.arrays
    size = (np.hypot(*arrays.xy.T) + arrays.arm_reach).max() + arrays.separation
    near = np.hypot(*points.T) <= size + radius  # False where there is no image
    if not near.any():
        return instrument
    obstacles = np.vstack([arrays.obstacles, np.column_stack([points, radius])[near]]) * u.mm
    return replace(
        instrument,
        focal_plane=replace(plane, obstacles=obstacles),
        plate_scale=None if instrument.distortion else instrument.plate_scale,
    )


def mark_required(required: tuple, parts: Iterable[np.ndarray]) -> np.ndarray | None:
    """Mark the required targets of a catalog whose identifiers are given in parts; None if none are required."""
    if not required:
        return None
    marked, known = [], np.zeros(len(required), dtype=bool)
    names = np.array(required)
    for ids in parts:
        wanted, comparable = _alike(names, ids)
        marked.append(np.isin(ids, wanted[comparable]))
        known |= comparable & np.isin(wanted, ids[marked[-1]])
    if not known.all():
        strange = names[~known]
        raise InputError(f"required must hold ids of the catalog, got {strange[0]} ({len(strange)} of {len(names)})")
    return np.concatenate(marked)


def are_among(required: tuple, ids: np.ndarray) -> np.ndarray:
    """Return for each required identifier whether it is among others."""
    wanted, comparable = _alike(np.array(required), ids)
    return comparable & np.isin(wanted, ids)


def _alike(names: np.ndarray, ids: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return names as the type of the identifiers, integers or text, and which of them can be of this type."""
    if names.dtype.kind == ids.dtype.kind:
        return names, np.ones(len(names), dtype=bool)
    if ids.dtype.kind == "U":
        return names.astype(str), np.ones(len(names), dtype=bool)
    # the command line has text, and the ids of a catalog may be integers
    numbers = np.zeros(len(names), dtype=np.int64)
    comparable = np.zeros(len(names), dtype=bool)
    for k, name in enumerate(names.tolist()):
        try:
            numbers[k] = int(name)
        except (ValueError, OverflowError):
            continue
        comparable[k] = str(numbers[k]) == name
    return numbers, comparable
