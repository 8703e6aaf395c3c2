"""What is asked of a tile, between sky and focal plane: keep-outs, lengths, ids of targets and of blank sky."""

from dataclasses import replace

import astropy.units as u
import numpy as np
from astropy.coordinates import SkyCoord

from rfpsurvey._units import to_direction, to_labels, to_scalar
from rfpsurvey.allocation import Allocation
from rfpsurvey.catalog import Catalog
from rfpsurvey.errors import InputError
from rfpsurvey.instrument import Instrument
from rfpsurvey.projection import TangentPlane

__all__ = ["describe", "find_ids", "is_required", "keep_clear", "to_length"]


def to_length(value: u.Quantity | None, instrument: Instrument, name: str) -> u.Quantity | None:
    """Return a length on the focal plane from itself, or from an angle at the scale of the field center."""
    if value is None:
        return None
    if isinstance(value, u.Quantity) and value.unit.is_equivalent(u.rad):
        value = to_scalar(value, value.unit, name, low=0) * value.unit * instrument.plate_scale
    return to_scalar(value, u.mm, name, low=0) * u.mm


def keep_clear(instrument: Instrument, plane: TangentPlane, keep_out: SkyCoord | None, radius) -> Instrument:
    """Return the instrument with obstacles where no arm may be."""
    if (keep_out is None) != (radius is None):
        raise InputError("keep_out and keep_out_radius belong together: give both, or neither")
    if keep_out is None:
        return instrument
    radius = to_length(radius, instrument, "keep_out_radius").to_value(u.mm)
    points = plane.to_focal_plane(to_direction(keep_out, "keep_out").reshape(-1)).to_value(u.mm)
    points = points[np.isfinite(points).all(axis=1)]
    circles = np.column_stack([points, np.full(len(points), radius)])
    focal_plane = instrument.focal_plane
    obstacles = np.vstack([focal_plane._obstacles_mm, circles]) * u.mm
    return replace(
        instrument, focal_plane=replace(focal_plane, obstacles=obstacles),
        plate_scale=None if instrument.distortion else instrument.plate_scale,
    )  # fmt: skip


def find_ids(known: np.ndarray, here: np.ndarray, required) -> tuple[np.ndarray | None, list[str]]:
    """Mark the targets ``here`` that are required, and say which required ones are not in the field."""
    if required is None:
        return None, []
    if np.size(required) == 0:
        return None, []
    names = np.atleast_1d(to_labels(np.atleast_1d(required), "required"))
    as_text = known.astype(str)
    strange = names[~np.isin(names.astype(str), as_text)]
    if len(strange):
        raise InputError(f"required must hold ids of the catalog, got {strange[0]} ({len(strange)} of {len(names)})")
    away = names[~np.isin(names.astype(str), here.astype(str))]
    absent = [f"required targets outside the field: {', '.join(str(name) for name in away[:5])} ({len(away)} in all)"]
    return is_required(here, names), absent if len(away) else []


def is_required(ids: np.ndarray, required) -> np.ndarray:
    """Mark the ids that are among those required."""
    if required is None or np.size(required) == 0:
        return np.zeros(len(ids), dtype=bool)
    return np.isin(ids.astype(str), np.atleast_1d(required).astype(str))


def describe(allocation: Allocation, plane: TangentPlane, catalog: Catalog, given: np.ndarray):
    """Ids, ra and dec (deg), kinds of the targets in use, and the row of each positioner's own, -1 for none.

    Sky positions that were found in gaps have ids of their own, below all others, or named so.
    """
    target_of = allocation.target_of_positioner
    used = np.flatnonzero(target_of >= 0)
    row_of = np.full(len(target_of), -1)
    row_of[used] = np.arange(len(used))
    found = target_of[used] >= allocation.n_given
    rows = given[target_of[used[~found]]]
    kind = np.full(len(used), "sky", dtype="U8")
    kind[~found] = "science" if catalog.kind is None else catalog.kind[rows]
    sky_deg = np.empty((2, len(used)))
    icrs = catalog.coord[rows].icrs
    sky_deg[:, ~found] = icrs.ra.deg, icrs.dec.deg
    blank = target_of[used[found]]
    types = None if allocation.wanted is None else allocation.wanted[blank]
    where = plane.to_sky(allocation.xy[blank], types)
    sky_deg[:, found] = where.ra.deg, where.dec.deg
    names = _new_ids(catalog.id, int(found.sum()))
    ids = np.empty(len(used), dtype=np.result_type(catalog.id.dtype, names.dtype))
    ids[found] = names
    ids[~found] = catalog.id[rows]
    return ids, sky_deg, kind, row_of


def _new_ids(known: np.ndarray, n: int) -> np.ndarray:
    """Return n ids that the catalog does not have: below all others, or names."""
    if known.dtype.kind == "i":
        lowest = min(-1, int(known.min(initial=0)))
        if lowest - n >= np.iinfo(np.int64).min:
            return lowest - 1 - np.arange(n)
        return np.setdiff1d(np.arange(-2 * len(known) - 2 * n - 2, -1), known)[::-1][:n]
    names = np.char.add("blank-sky-", np.arange(n + len(known)).astype(str))
    return names[~np.isin(names, known)][:n]
