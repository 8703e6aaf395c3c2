"""Checks of the columns of a focal plane."""

import numpy as np

from rfpsurvey._units import to_flags, to_labels, to_mm, to_plain, to_points_mm, to_radian
from rfpsurvey.errors import InputError, InputTypeError
from rfpsurvey.positioner import Positioner

__all__ = ["check_columns"]


def check_columns(plane) -> None:
    """Check the columns of a focal plane and convert them to plain arrays."""
    if not isinstance(plane.positioner, Positioner):
        raise InputTypeError(f"positioner must be a Positioner, got {type(plane.positioner).__name__}")
    xy = to_points_mm(plane.xy, "xy")
    n = len(xy)
    if n == 0:
        raise InputError("a focal plane needs at least one positioner, got none")
    if not np.isfinite(xy).all():
        raise InputError(f"xy must be finite, but {int((~np.isfinite(xy)).any(axis=1).sum())} rows are not")
    if len(np.unique(xy, axis=0)) < n:
        raise InputError("two positioners have the same center")
    spectrograph, fiber_type = plane.spectrograph, plane.fiber_type
    columns = {
        "id": np.arange(n) if plane.id is None else to_labels(plane.id, "id"),
        "spectrograph": np.zeros(n, int) if spectrograph is None else to_plain(spectrograph, "spectrograph"),
        "fiber_type": np.full(n, "") if fiber_type is None else to_plain(fiber_type, "fiber_type").astype(str),
        "disabled": np.zeros(n, bool) if plane.disabled is None else to_flags(plane.disabled, "disabled"),
    }
    for name, value in columns.items():
        if np.ndim(value) == 0 or len(value) != n or (value.ndim != 1 and name != "spectrograph"):
            raise InputError(f"{name} must have one value per positioner, shape ({n},), got {value.shape}")
        object.__setattr__(plane, name, value)
    if len(np.unique(columns["id"])) < n:
        names, counts = np.unique(columns["id"], return_counts=True)
        raise InputError(f"id must be unique, but {names[counts > 1].tolist()[0]!r} occurs more than once")
    blank = [name for name in columns["id"].tolist() if isinstance(name, str) and (not name or len(name.split()) != 1)]
    if blank:
        raise InputError(f"id must be text without blanks, by which tables list several, got {blank[0]!r}")
    names = ["+".join(part.strip() for part in row.split("+")) for row in columns["fiber_type"].tolist()]
    object.__setattr__(plane, "fiber_type", np.array(names))
    if len(plane.fiber_types) > 1 and "" in plane.fiber_types:
        raise InputError("fiber_type must name a type for every positioner, or for none")
    if len(plane.fiber_types) > 62:
        raise InputError(f"fiber_type must have at most 62 types, got {len(plane.fiber_types)}")
    width = columns["spectrograph"].shape[1:]
    if width not in ((), (len(plane.fiber_types),)):
        raise InputError(
            f"spectrograph must have the shape ({n},) or ({n}, {len(plane.fiber_types)}), "
            f"got {columns['spectrograph'].shape}"
        )
    for name in ("central_arm", "eccentric_arm"):
        value = getattr(plane, name)
        if value is not None:
            lengths = to_mm(value, name)
            if lengths.shape != (n,):
                raise InputError(f"{name} must be {n} positive lengths, got the shape {lengths.shape}")
            strange = lengths[~((lengths > 0) & (lengths < 1e6))]
            if len(strange):
                raise InputError(f"{name} must be {n} positive lengths below 1 km, got {strange[0]:g} mm")
    if plane.stuck is not None:
        angles = to_radian(plane.stuck, "stuck")
        if angles.shape != (n, 2):
            raise InputError(f"stuck must have the shape ({n}, 2), got {angles.shape}")
        if (np.isfinite(angles).sum(axis=1) == 1).any():
            raise InputError("stuck must give both theta and phi of a unit, or neither")
    if plane.obstacles is not None:
        circles = to_mm(plane.obstacles, "obstacles")
        what = "obstacles must be finite rows (x, y, radius) with radius >= 0"
        if circles.ndim != 2 or circles.shape[1] != 3:
            raise InputError(f"{what}, got the shape {circles.shape}")
        strange = circles[~(np.isfinite(circles).all(axis=1) & (circles[:, 2] >= 0))]
        if len(strange):
            raise InputError(f"{what}, got {strange[0].tolist()} mm")
