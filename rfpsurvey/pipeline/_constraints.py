"""Convert constraints: circles that no arm may cover become obstacles, and required ids become a mask of targets."""

from collections.abc import Iterable
from dataclasses import replace

import astropy.units as u
import numpy as np

from rfpsurvey.allocation import AllocationOptions
from rfpsurvey.errors import InputError
from rfpsurvey.focal_plane import with_circles
from rfpsurvey.instrument import Instrument
from rfpsurvey.projection import FieldProjection

__all__ = ["are_among", "mark_required", "with_keep_out"]


# Number of points on the rim of a circle on the sky, and factor by which the radius of the image is enlarged. The
# factor is larger than 1 because the image of the rim can be slightly farther from the center between two of these
# points.
N_RIM, MARGIN = 360, 1 + 1e-4


def with_keep_out(instrument: Instrument, projection: FieldProjection, options: AllocationOptions) -> Instrument:
    """Return the instrument with an additional obstacle for each circle in ``options.keep_out`` near its arms."""
    if not options.keep_out:
        return instrument
    arrays, circles = instrument.focal_plane.arrays, options.circles
    size = (np.hypot(*arrays.xy.T) + arrays.arm_reach).max() + arrays.separation
    # The arms at the edge extend slightly beyond the field.
    limit = circles[:, 3] + 1.1 * size / instrument.plate_scale.to_value(u.mm / u.rad)
    apart = np.arccos(np.clip(circles[:, :3] @ projection.basis[2], -1, 1))
    images = np.array([image_of_circle(projection, *circles[k]) for k in np.flatnonzero(apart <= limit)])
    images = images.reshape(-1, 3)
    # If a circle contains all directions that have an image, its rim has no image.
    images[np.isnan(images[:, 2]) & (apart < circles[:, 3])[apart <= limit]] = 0, 0, 2 * size
    near = np.hypot(*images[:, :2].T) <= size + images[:, 2]  # false if the circle has no image
    if not near.any():
        return instrument
    return replace(
        instrument,
        focal_plane=with_circles(instrument.focal_plane, images[near]),
        plate_scale=None if instrument.distortion else instrument.plate_scale,
    )


def image_of_circle(
    projection: FieldProjection, x: float, y: float, z: float, radius_rad: float
) -> tuple[float, float, float]:
    """Return x, y and radius (mm) of a circle on the focal plane that contains the image of a circle on the sky.

    The image is not a circle if the plate scale varies across the field. The image can also depend on the fiber type;
    the returned circle contains the images for all fiber types. The center of the circle on the sky may be so far from
    the field that the center has no image, although a part of the circle has an image. The returned radius is NaN if no
    point of the rim has an image.
    """
    center = np.array([x, y, z])
    names = list(projection.distortion) if isinstance(projection.distortion, dict) else [None]
    east = np.cross(center, projection.basis[2])
    # If the circle is around the field center, ``east`` is zero. Any perpendicular direction can then replace it.
    east = east / np.linalg.norm(east) if np.linalg.norm(east) > 1e-9 else projection.basis[0]
    inward = np.cross(east, center)
    turn = np.linspace(0, 2 * np.pi, N_RIM, endpoint=False)[:, None]
    rim = np.cos(radius_rad) * center + np.sin(radius_rad) * (np.cos(turn) * inward + np.sin(turn) * east)
    rims = np.vstack([projection.project(rim, name) for name in names])
    middle = np.mean([projection.project(center[None], name)[0] for name in names], axis=0)
    if not np.isfinite(middle).all():
        # Extrapolate from the point of the rim nearest to the field center, with the scale at that point.
        step = 1e-4
        angles = np.array([[radius_rad], [radius_rad + step]])
        steps = np.cos(angles) * center + np.sin(angles) * inward
        nearest, beyond = projection.project(steps, names[0])
        middle = nearest - (beyond - nearest) * radius_rad / step
    apart = np.hypot(*(rims - middle).T)
    return *middle, np.max(apart[np.isfinite(apart)], initial=np.nan if np.isnan(apart).all() else 0.0) * MARGIN


def mark_required(required: tuple, parts: Iterable[np.ndarray]) -> np.ndarray | None:
    """Return whether each target of a catalog is required, or None if no targets are required.

    The catalog may consist of several parts; ``parts`` contains an array with the identifiers of each part.
    """
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
        raise InputError(
            f"required must hold ids of the catalog, got {strange[0]} ({len(strange)} of {len(names)} unknown)"
        )
    return np.concatenate(marked)


def are_among(required: tuple, ids: np.ndarray) -> np.ndarray:
    """Return whether each required identifier is one of ``ids``."""
    wanted, comparable = _alike(np.array(required), ids)
    return comparable & np.isin(wanted, ids)


def _alike(names: np.ndarray, ids: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return names with the type of ``ids`` (integers or text), and a mask of the names that can be converted."""
    if names.dtype.kind == ids.dtype.kind:
        return names, np.ones(len(names), dtype=bool)
    if ids.dtype.kind == "U":
        return names.astype(str), np.ones(len(names), dtype=bool)
    # Names from the command line are text, but identifiers of a catalog can be integers.
    numbers = np.zeros(len(names), dtype=np.int64)
    comparable = np.zeros(len(names), dtype=bool)
    for k, name in enumerate(names.tolist()):
        try:
            numbers[k] = int(name)
        except (ValueError, OverflowError):
            continue
        comparable[k] = str(numbers[k]) == name
    return numbers, comparable
