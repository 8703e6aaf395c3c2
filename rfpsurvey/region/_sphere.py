"""Functions for regions on the unit sphere: points inside a region, distances, borders and enclosing circles."""

import numpy as np

from rfpsurvey import _healpix
from rfpsurvey.region import _shapes


def is_inside(region, vectors: np.ndarray) -> np.ndarray:
    """Return whether unit vectors, shape (n, 3), are inside a `Region`."""
    if region.kind == "healpix":
        return np.isin(_healpix.pixels_of(region.nside, vectors), region.values)
    if region.kind == "cap":
        return _shapes.angle(vectors, region.values[:3]) <= region.values[3] * (1 + 1e-15) + 1e-15
    return {"box": _shapes.box_contains, "polygon": _shapes.polygon_contains}[region.kind](region.values, vectors)


def distance_to(region, vectors: np.ndarray) -> np.ndarray:
    """Return the distances (radians) from unit vectors, shape (n, 3), to a `Region`; distances are 0 inside it.

    Distances to HEALPix pixels can be too small by up to the size of a pixel.
    """
    if region.kind == "cap":
        return np.maximum(_shapes.angle(vectors, region.values[:3]) - region.values[3], 0.0)
    if region.kind == "healpix":
        from scipy.spatial import cKDTree

        chord = cKDTree(_healpix.centers(region.nside, region.values)).query(vectors)[0]
        return np.maximum(2 * np.arcsin(np.minimum(chord / 2, 1)) - _healpix.pixel_radius(region.nside), 0.0)
    return {"box": _shapes.box_distance, "polygon": _shapes.polygon_distance}[region.kind](region.values, vectors)


def circle_around(region) -> tuple[np.ndarray, float]:
    """Return the center (unit vector) and the radius (radians) of a circle that encloses a `Region`."""
    if region.kind == "cap":
        return region.values[:3], float(region.values[3])
    pixels = region.kind == "healpix"
    border = _healpix.centers(region.nside, region.values) if pixels else border_of(region)
    center = border.sum(axis=0)
    if region.kind == "box" and region.values[1] == 2 * np.pi:
        center = np.array([0.0, 0.0, np.sign(region.values[2:].sum()) or 1.0])
    elif region.kind == "box":
        center = _shapes.from_lonlat(region.values[0] + region.values[1] / 2, region.values[2:].mean())
    length = np.linalg.norm(center)
    center = center / length if length > 1e-6 else np.array([0.0, 0.0, 1.0])
    if not pixels and is_inside(region, -center[None])[0]:
        return center, np.pi
    radius = _shapes.angle(border, center).max()
    # The border has 100 points per edge. Between two points, the border may be farther from the center than the points,
    # but by less than 1/1000 of the radius.
    margin = _healpix.pixel_radius(region.nside) if pixels else radius * 1e-3
    return center, float(min(radius + margin, np.pi))


def border_of(region) -> np.ndarray:
    """Return points on the border of a box or polygon as unit vectors."""
    if region.kind == "polygon":
        after = np.roll(region.values, -1, axis=0)
        return np.vstack([_shapes.arc(a, b, 101)[:-1] for a, b in zip(region.values, after, strict=True)])
    begin, width, low, high = region.values
    t = np.linspace(0, 1, 101)
    lon, lat = begin + t * width, low + t * (high - low)
    sides = [(lon, low), (lon, high), (begin, lat), (begin + width, lat)]
    return np.vstack([_shapes.from_lonlat(*side) for side in sides])
