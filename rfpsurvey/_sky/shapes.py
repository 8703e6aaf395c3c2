"""Geometry of regions and of their shapes, for arrays of unit vectors and of angles in radians, and HEALPix pixels.

HEALPix pixels are in the nested order; astropy-healpix is imported on first use.

A distance is the angle from a direction to the nearest point of the region; it is 0 inside the region.
"""

from collections.abc import Callable
from numbers import Number

import numpy as np

from rfpsurvey._common.units import from_lonlat, to_lonlat
from rfpsurvey._sky import shapes as _healpix
from rfpsurvey.errors import refusal

MOST_NSIDE = 2**20


def check_nside(nside: object) -> int:
    """Return the resolution ``nside`` as an integer; raise an error unless it is a power of two."""
    good = isinstance(nside, int | np.integer) and not isinstance(nside, bool) and 1 <= nside <= MOST_NSIDE
    if not good or int(nside) & (int(nside) - 1):
        raise refusal(f"nside must be a power of two from 1 to {MOST_NSIDE}", nside, Number)
    return int(nside)


def centers(nside: int, pixels: np.ndarray) -> np.ndarray:
    """Return the unit vectors of the centers of pixels, shape (n, 3)."""
    from astropy_healpix import healpy

    xyz = healpy.pix2vec(nside, np.asarray(pixels, dtype=np.int64), nest=True)
    return np.ascontiguousarray(np.column_stack([np.atleast_1d(c) for c in xyz]), dtype=np.float64).reshape(-1, 3)


def pixels_of(nside: int, vectors: np.ndarray) -> np.ndarray:
    """Return the number of the pixel that contains each unit vector."""
    from astropy_healpix import healpy

    if len(vectors) == 0:
        return np.empty(0, dtype=np.int64)
    return np.atleast_1d(healpy.vec2pix(nside, *vectors.T, nest=True)).astype(np.int64)


def pixels_near(nside: int, distance: Callable, margin: float) -> np.ndarray:
    """Return the pixels whose centers are at most ``margin`` away from an object on the sky.

    The search begins with the twelve pixels of ``nside = 1``. If a pixel is too far away, the search also excludes all
    smaller pixels inside this pixel.

    Parameters
    ----------
    nside : int
        Resolution of the pixels.
    distance : callable
        Function that returns the distances (radians) of unit vectors from the object.
    margin : float
        Largest distance of a pixel center from the object, in radians.

    Returns
    -------
    ndarray of int
        Numbers of the pixels, in increasing order.
    """
    pixels, level = np.arange(12), 1
    while True:
        allowance = margin if level == nside else margin + pixel_radius(level)
        pixels = pixels[distance(centers(level, pixels)) <= allowance + 1e-12]
        if level == nside:
            return pixels
        pixels, level = (4 * pixels[:, None] + np.arange(4)).ravel(), 2 * level


def to_nested(nside: int, pixels: np.ndarray) -> np.ndarray:
    """Convert pixel numbers in the ring order to the nested order."""
    from astropy_healpix import healpy

    return np.atleast_1d(healpy.ring2nest(nside, pixels)).astype(np.int64)


def pixel_radius(nside: int) -> float:
    """Return an upper limit of the distance (radians) from the center of a pixel to its corners."""
    # According to measurements, nside times the largest distance increases with nside from 0.84 toward 1.07.
    return 1.07 / nside


def nside_for(radius_rad: float) -> int:
    """Return the lowest ``nside`` for which the radius of a pixel is about ``radius_rad`` (radians) or smaller."""
    return int(min(2 ** max(np.ceil(np.log2(1.0 / radius_rad)), 0), MOST_NSIDE))


# Largest product of the number of directions and the number of edges that are processed together.
CHUNK = 2_000_000


def angle(a, b):
    """Return the angles between unit vectors; the formula is accurate even for angles close to 0 or pi."""
    return 2 * np.arctan2(np.linalg.norm(a - b, axis=-1), np.linalg.norm(a + b, axis=-1))


def arc(a, b, n):
    """Return n equidistant points on the great-circle arc from a to b, including both ends."""
    t = np.linspace(0, 1, n)[:, None] * angle(a, b)
    side = b - (a @ b) * a
    length = np.linalg.norm(side)
    return a + 0 * t if length == 0 else np.cos(t) * a + np.sin(t) * side / length


def box_area(box):
    """Return the solid angle of a box, which is given as (first ra, width, lower dec, upper dec)."""
    return box[1] * (np.sin(box[3]) - np.sin(box[2]))


def _east_of(begin, vectors):
    """Return the declinations of directions, and their right ascensions minus ``begin``, from 0 to 2 pi."""
    lon, dec = to_lonlat(vectors)
    return dec, (lon % (2 * np.pi) - begin) % (2 * np.pi)


def box_contains(box, vectors):
    """Return whether directions are inside a box; the border, including a pole on the border, is inside."""
    begin, width, low, high = box
    dec, east = _east_of(begin, vectors)
    # The tolerances allow for rounding at the western and the eastern border.
    inside = (east <= width + 1e-13) | (east >= 2 * np.pi - 1e-13)
    pole = np.abs(dec) >= np.pi / 2 - 1e-15
    return (dec >= low - 1e-15) & (dec <= high + 1e-15) & (inside | pole)


def box_distance(box, vectors):
    """Return the distance from each direction to a box.

    The distance is 0 inside the box. For other directions within the right ascensions of the box, it is the distance to
    the nearer parallel. For all other directions, it is the distance to the nearer of the western and eastern sides.
    """
    begin, width, low, high = box
    dec, east = _east_of(begin, vectors)
    along = np.maximum(np.maximum(low - dec, dec - high), 0.0)
    if width >= 2 * np.pi:
        return along
    sides = from_lonlat(begin + np.array([0.0, 0.0, width, width]), np.array([low, high, low, high]))
    across = np.minimum(_to_arc(vectors, sides[0], sides[1]), _to_arc(vectors, sides[2], sides[3]))
    return np.where(east <= width, along, across)


def _to_arc(vectors, a, b):
    """Return the distance from each direction to the shorter great-circle arc from a to b."""
    normal = np.cross(a, b)
    length = np.linalg.norm(normal)
    ends = np.minimum(angle(vectors, a), angle(vectors, b))
    if length < 1e-15:
        return ends
    normal = normal / length
    height = vectors @ normal
    within = (np.cross(normal, a) @ vectors.T >= 0) & (np.cross(b, normal) @ vectors.T >= 0)
    return np.where(within, np.abs(np.arcsin(np.clip(height, -1, 1))), ends)


def edges_cross(vertices):
    """Return the first pair of edges that cross or touch each other (except at a common vertex), or None."""
    a, b = vertices, np.roll(vertices, -1, axis=0)
    normal, n = np.cross(a, b), len(vertices)
    for i in range(n):
        j = np.arange(i + 2, n if i else n - 1)
        splits_j = (normal[i] @ a[j].T) * (normal[i] @ b[j].T) < 0
        splits_i = (normal[j] @ a[i]) * (normal[j] @ b[i]) < 0
        # Two great circles intersect at two opposite points; the edges cross only if both contain the same one of these
        # points.
        meet = np.cross(normal[i], normal[j])
        side = np.sign(np.sum(meet * (a[i] + b[i]), axis=1)) == np.sign(np.sum(meet * (a[j] + b[j]), axis=1))
        hit = j[splits_j & splits_i & side]
        if len(hit):
            return i, int(hit[0])
        corners = np.delete(np.arange(n), [i, (i + 1) % n])
        touch = corners[_to_arc(a[corners], a[i], b[i]) < 1e-12]
        if len(touch):
            return i, int(touch[0])
    return None


def _left_area(vertices):
    """Return the solid angle, from 0 to 4 pi, to the left of a closed path that does not cross itself."""
    before, after = np.roll(vertices, 1, axis=0), np.roll(vertices, -1, axis=0)
    come, go = np.cross(before, vertices), np.cross(vertices, after)
    turning = np.arctan2(np.sum(np.cross(come, go) * vertices, axis=1), np.sum(come * go, axis=1))
    rough = 2 * np.pi - turning.sum()  # the sum of triangles is more accurate, but determines the area only modulo 4 pi
    a, b, c = vertices[0], vertices[1:-1], vertices[2:]
    volume = np.sum(np.cross(b, c) * a, axis=1)
    fan = 2 * np.sum(np.arctan2(volume, 1 + b @ a + c @ a + np.sum(b * c, axis=1)))
    return fan + 4 * np.pi * np.rint((rough - fan) / (4 * np.pi))


def polygon_area(vertices):
    """Return the solid angle of the smaller of the two regions that a polygon bounds."""
    left = _left_area(vertices)
    return min(left, 4 * np.pi - left)


def polygon_contains(vertices, vectors):
    """Return whether directions are inside a polygon.

    For each direction, consider the arc from the midpoint of the longest edge to the direction. The function determines
    on which side of this edge the arc starts, and counts how many other edges the arc crosses.
    """
    a, b = vertices, np.roll(vertices, -1, axis=0)
    start = int(np.argmax(angle(a, b)))
    middle = a[start] + b[start]
    middle /= np.linalg.norm(middle)
    normal = np.cross(a[start], b[start])
    normal /= np.linalg.norm(normal)
    inside_left = _left_area(vertices) <= 2 * np.pi
    edges = np.delete(np.arange(len(a)), start)
    out = np.empty(len(vectors), dtype=bool)
    step = max(CHUNK // len(a), 1)
    for k in range(0, len(vectors), step):
        p = vectors[k : k + step]
        height = p @ normal
        # For a direction on the great circle of this edge, the arc would follow the edge. Such directions are moved by
        # 2 microarcseconds.
        p = np.where(np.abs(height)[:, None] < 1e-11, p + 1e-11 * normal, p)
        left = p @ normal > 0
        plane = np.cross(middle, p)
        high_a, high_b = plane @ a[edges].T, plane @ b[edges].T
        straddle = (high_a >= 0) != (high_b >= 0)
        row, edge = np.nonzero(straddle)
        cross = (
            np.abs(high_b[row, edge])[:, None] * a[edges[edge]] + np.abs(high_a[row, edge])[:, None] * b[edges[edge]]
        )
        after = np.sum(np.cross(middle, cross) * plane[row], axis=1) > 0
        ahead = np.sum(np.cross(cross, p[row]) * plane[row], axis=1) > 0
        odd = np.bincount(row[after & ahead], minlength=len(p)) % 2 == 1
        out[k : k + step] = (left == inside_left) != odd
    return out


def polygon_distance(vertices, vectors):
    """Return distances to the smaller of the two regions that a polygon bounds; distances are 0 inside this region."""
    out = np.full(len(vectors), np.pi)
    for a, b in zip(vertices, np.roll(vertices, -1, axis=0), strict=True):
        np.minimum(out, _to_arc(vectors, a, b), out=out)
    out[polygon_contains(vertices, vectors)] = 0.0
    return out


def is_inside(region, vectors: np.ndarray) -> np.ndarray:
    """Return whether unit vectors, shape (n, 3), are inside a `Region`."""
    if region.kind == "healpix":
        return np.isin(_healpix.pixels_of(region.nside, vectors), region.values)
    if region.kind == "cap":
        return angle(vectors, region.values[:3]) <= region.values[3] * (1 + 1e-15) + 1e-15
    return {"box": box_contains, "polygon": polygon_contains}[region.kind](region.values, vectors)


def distance_to(region, vectors: np.ndarray) -> np.ndarray:
    """Return the distances (radians) from unit vectors, shape (n, 3), to a `Region`; distances are 0 inside it.

    Distances to HEALPix pixels can be too small by up to the size of a pixel.
    """
    if region.kind == "cap":
        return np.maximum(angle(vectors, region.values[:3]) - region.values[3], 0.0)
    if region.kind == "healpix":
        from scipy.spatial import cKDTree

        chord = cKDTree(_healpix.centers(region.nside, region.values)).query(vectors)[0]
        return np.maximum(2 * np.arcsin(np.minimum(chord / 2, 1)) - _healpix.pixel_radius(region.nside), 0.0)
    return {"box": box_distance, "polygon": polygon_distance}[region.kind](region.values, vectors)


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
        center = from_lonlat(region.values[0] + region.values[1] / 2, region.values[2:].mean())
    length = np.linalg.norm(center)
    center = center / length if length > 1e-6 else np.array([0.0, 0.0, 1.0])
    if not pixels and is_inside(region, -center[None])[0]:
        return center, np.pi
    radius = angle(border, center).max()
    # The border has 100 points per edge. Between two points, the border may be farther from the center than the points,
    # but by less than 1/1000 of the radius.
    margin = _healpix.pixel_radius(region.nside) if pixels else radius * 1e-3
    return center, float(min(radius + margin, np.pi))


def border_of(region) -> np.ndarray:
    """Return points on the border of a box or polygon as unit vectors."""
    if region.kind == "polygon":
        after = np.roll(region.values, -1, axis=0)
        return np.vstack([arc(a, b, 101)[:-1] for a, b in zip(region.values, after, strict=True)])
    begin, width, low, high = region.values
    t = np.linspace(0, 1, 101)
    lon, lat = begin + t * width, low + t * (high - low)
    sides = [(lon, low), (lon, high), (begin, lat), (begin + width, lat)]
    return np.vstack([from_lonlat(*side) for side in sides])
