"""Cover the targets of a catalog, or a region, in passes, with coverings of a circle on the sphere by equal circles.

The center of the widest empty circle between points is the circumcenter of a Delaunay triangle, and the Delaunay
triangles of points on the sphere are the facets of their convex hull.
"""

from collections.abc import Callable
from functools import partial
from itertools import product

import astropy.units as u
import numpy as np
from astropy.table import QTable

from rfpsurvey._field.constraints import project_field
from rfpsurvey._field.plan import field_radius_rad
from rfpsurvey._instruments.instrument import Instrument
from rfpsurvey._sky import shapes as _healpix
from rfpsurvey._sky.arrays import SkyIndex
from rfpsurvey._sky.region import Region
from rfpsurvey._sky.shapes import circle_around, distance_to, is_inside
from rfpsurvey._survey.tiling.centers import Centers, Declinations
from rfpsurvey._survey.tiling.problem import TilingProblem, TilingState, visit_all
from rfpsurvey.errors import InputError

# Spacing of the samples of a region as a fraction of the radius of a tile, and the largest number of samples.
FINE = 1 / 40
MOST_SAMPLES = 200_000


def cover_targets(problem: TilingProblem, make: Callable) -> TilingState:
    """Add passes until the given number of passes or a goal is reached, or until a pass observes no target."""
    state = TilingState(problem)
    center, reach = problem.circle()
    number, whole = 0, problem.open_ended
    while number < problem.passes if whole else not state.done:
        centers = make(center, reach, problem.radius, number)
        points = problem.index.vectors[problem.wanted > 0 if whole else state.left > 0]
        if problem.where.vectors is not None:
            centers = snap(centers, problem.where.vectors, points, problem.radius)
        elif not problem.where.limits.anywhere:
            # centers outside the limits of declination are moved onto the limits if they then cover further targets
            outside = problem.where.limits.distance(centers) > 0
            moved = problem.where.limits.fit(centers[outside], problem.radius)
            inner = np.arange(np.count_nonzero(~outside))
            centers = _add_needed(inner, np.vstack([centers[~outside], moved]), points, problem.radius)
        number += 1
        if visit_all(state, centers, number, every=whole) == 0:
            break
    return state


class RegionCover:
    """Coverings of a region, except for the regions in ``exclude``, and their quality; radii are in radians."""

    def __init__(self, region: Region, radius: float, exclude: tuple[Region, ...]):
        self.region, self.radius = region, radius
        self.center, self.reach = circle_around(region)
        self.samples, self.margin = _conservative(region, exclude, self.reach, radius)
        if len(self.samples) == 0:
            raise InputError("exclude must leave a part of the region to cover, but nothing is left")
        inside = is_inside(region, self.samples) & ~in_any(exclude, self.samples)
        self.look = self.samples[inside] if inside.any() else self.samples

    def make_passes(self, make: Callable, passes: int, where: Centers) -> list[np.ndarray]:
        """Return the centers of each pass."""
        index, centers_of_passes, allowed = SkyIndex(self.samples), [], where.vectors
        for number in range(passes):
            centers = where.limits.fit(make(self.center, self.reach, self.radius, number), self.radius)
            centers = centers[distance_to(self.region, centers) <= self.radius * (1 + 1e-12)]
            if allowed is not None:
                centers = snap(centers, allowed, self.look, self.radius)
            else:
                centers = _needed(index, centers, self.radius, self.margin)
            centers_of_passes.append(centers)
        return centers_of_passes

    def quality(self, tiles: np.ndarray, limits: Declinations) -> dict:
        """Return numbers that describe how well tiles cover the region."""
        depth = SkyIndex(tiles).sum_near(self.look, self.radius, np.ones(len(tiles)))
        quality = {
            "covering_fraction": float(np.mean(depth > 0)),
            "mean_depth": float(depth.mean()),
            "n_samples": len(self.look),
        }
        if not limits.anywhere:
            quality["fraction_beyond_declination"] = float(np.mean(limits.distance(self.look) > self.radius))
        return quality

    def fraction_in_reach(self, instrument: Instrument, table: QTable) -> float:
        """Return the fraction of the region that positioners reach in at least one tile; refraction is neglected."""
        index, radius = SkyIndex(self.look), field_radius_rad(instrument)
        in_reach = np.zeros(len(index), dtype=bool)
        places = np.deg2rad([table[name].to_value(u.deg) for name in ("ra", "dec", "position_angle")])
        types = instrument.distortion if isinstance(instrument.distortion, dict) else ("",)  # types with their own maps
        for place, kind in product(places.T.tolist(), types):
            projection = instrument.field_projection(*place)
            slot = index.near(projection.basis[2], radius)
            slot = slot[~in_reach[slot]]
            points, fiber_type = project_field(instrument, projection, index.vectors[slot], np.full(len(slot), kind))
            in_reach[slot] = instrument.focal_plane.arrays.reach(points, fiber_type).covered
        return float(in_reach.mean())


def in_any(regions: tuple[Region, ...], vectors: np.ndarray) -> np.ndarray:
    """Return whether each unit vector is inside at least one of the regions."""
    inside = np.zeros(len(vectors), dtype=bool)
    for region in regions:
        inside |= is_inside(region, vectors)
    return inside


def _conservative(region, exclude, reach, radius):
    """Return the centers of the HEALPix pixels that sample a region, and the largest radius of a pixel."""
    nside = _healpix.nside_for(FINE * radius)
    area = region.area.to_value("sr")
    while nside > 1 and 12 * nside**2 * min(area / (4 * np.pi) + reach / nside, 1) > MOST_SAMPLES:
        nside //= 2
    margin = _healpix.pixel_radius(nside)
    samples = _healpix.centers(nside, _healpix.pixels_near(nside, partial(distance_to, region), margin))
    return samples[~_all_inside(exclude, samples, margin)], margin


def _all_inside(regions, samples, margin):
    """Return, for each sample, whether it and eight points around it at the distance ``margin`` are in the regions."""
    helper = np.eye(3)[np.argmin(np.abs(samples), axis=1)]
    x = np.cross(helper, samples)
    x /= np.linalg.norm(x, axis=1)[:, None]
    y = np.cross(samples, x)
    inside = in_any(regions, samples)
    for turn in np.arange(8) * np.pi / 4:
        inside &= in_any(regions, np.cos(margin) * samples + np.sin(margin) * (np.cos(turn) * x + np.sin(turn) * y))
    return inside


def _needed(index, centers, radius, margin):
    """Return the centers that remain after redundant circles are removed.

    A circle is redundant if the remaining circles completely cover all pixels that it touches. If the radius of
    the circles is at most twice the radius of a pixel, only circles that touch no pixel are removed.
    """
    touched = [index.near(center, min(radius + margin, np.pi)) for center in centers]
    if radius <= 2 * margin:
        return centers[[len(rows) > 0 for rows in touched]]
    # a pixel inside this smaller circle is completely inside the tile
    sure = [index.near(center, radius - margin) for center in centers]
    depth = np.zeros(len(index), dtype=np.int64)
    for rows in sure:
        depth[rows] += 1
    keep = np.ones(len(centers), dtype=bool)
    for k in np.argsort([len(rows) for rows in touched], kind="stable"):
        depth[sure[k]] -= 1
        keep[k] = not (depth[touched[k]] > 0).all()
        depth[sure[k]] += keep[k]
    return centers[keep]


def snap(centers: np.ndarray, allowed: np.ndarray, points: np.ndarray, radius: float) -> np.ndarray:
    """Move centers to the nearest allowed centers, and add allowed centers as long as these cover further points."""
    from scipy.spatial import cKDTree

    chosen = np.unique(cKDTree(allowed).query(centers)[1]) if len(centers) else np.empty(0, dtype=np.int64)
    return _add_needed(chosen, allowed, points, radius)


def _add_needed(chosen: np.ndarray, allowed: np.ndarray, points: np.ndarray, radius: float) -> np.ndarray:
    """Return the allowed centers in the rows ``chosen``, and further allowed centers that cover more points."""
    index, places = SkyIndex(points), SkyIndex(allowed)
    open_ = np.ones(len(points))
    for k in chosen:
        open_[index.near(allowed[k], radius)] = 0.0
    gain = index.sum_near(places.vectors, radius, open_)
    chosen = list(chosen)
    while gain.max(initial=0.0) > 0.5:
        k = int(np.argmax(gain))
        chosen.append(int(places.order[k]))
        open_[index.near(places.vectors[k], radius)] = 0.0
        near = places.near(places.vectors[k], min(2 * radius, np.pi))
        gain[near] = index.sum_near(places.vectors[near], radius, open_)
    return allowed[np.array(chosen, dtype=np.int64)]


GOLDEN = np.pi * (3 - np.sqrt(5))
# Area of a regular hexagon inscribed in a circle of radius 1. No covering by equal circles has a larger area per
# circle.
HEXAGON = 1.5 * np.sqrt(3)
# The plastic number. Its inverse powers define shifts of passes that are as different as possible (Roberts 2018).
PLASTIC = 1.32471795724474602596
MOST = 500_000
# Centers extend by this number of radii beyond the circle, so that the border of the circle is covered like its
# interior.
MARGIN = 4.0


def basis_of(center: np.ndarray) -> np.ndarray:
    """Return a matrix with the rows east, north and center (unit vectors); at the poles, east is +y."""
    flat = np.hypot(center[0], center[1])
    east = np.array([-center[1], center[0], 0.0]) / flat if flat > 1e-12 else np.array([0.0, 1.0, 0.0])
    return np.array([east, np.cross(center, east), center])


def dither(number: int) -> np.ndarray:
    """Return the shift of a pass as fractions of the unit cell of the lattice; pass 0 (the first) is not shifted."""
    return (number * np.array([1 / PLASTIC, 1 / PLASTIC**2])) % 1.0


def lattice(center: np.ndarray, reach: float, pitch: float, shift: np.ndarray) -> np.ndarray:
    """Return a hexagonal lattice in Lambert's equal-area map around a center, out to ``reach``, sorted by distance."""
    limit = 2 * np.sin(min(reach, np.pi - 1e-9) / 2)
    n = int(np.ceil(limit / pitch * 2 / np.sqrt(3))) + 2
    i, j = np.meshgrid(np.arange(-n, n + 1), np.arange(-n, n + 1), indexing="ij")
    i, j = i.ravel() + shift[0], j.ravel() + shift[1]
    x, y = pitch * (i + j / 2), pitch * j * np.sqrt(3) / 2
    r2 = x * x + y * y
    order = np.argsort(r2, kind="stable")
    order = order[r2[order] <= limit**2]
    x, y, r2 = x[order], y[order], r2[order]
    scale = np.sqrt(np.maximum(1 - r2 / 4, 0.0))
    return np.column_stack([scale * x, scale * y, 1 - r2 / 2]) @ basis_of(center)


def widest_gap(vectors: np.ndarray, center: np.ndarray, reach: float) -> float:
    """Return the radius of the widest circle that contains none of ``vectors`` and touches the given circle."""
    from scipy.spatial import ConvexHull

    hull = ConvexHull(vectors)
    middle = hull.equations[:, :3]
    # angles are computed from chords, because cosines are inaccurate for small angles
    half = np.linalg.norm(middle[:, None, :] - vectors[hull.simplices], axis=2).max(axis=1) / 2
    gap = 2 * np.arcsin(np.minimum(half, 1.0))
    away = 2 * np.arcsin(np.minimum(np.linalg.norm(middle - center, axis=1) / 2, 1.0))
    return float(gap[away - gap <= reach].max(initial=0.0))


def hexagonal(center: np.ndarray, reach: float, radius: float, number: int = 0) -> np.ndarray:
    """Cover a field, at most a hemisphere, without gaps: return centers on a hexagonal lattice with the largest pitch.

    Parameters
    ----------
    center : ndarray, shape (3,)
        Center of the circle to cover.
    reach : float
        Radius (radians) of the circle to cover, at most pi / 2.
    radius : float
        Radius of the covering circles in radians.
    number : int, optional
        Number of the pass, which determines the shift of the lattice.

    Returns
    -------
    ndarray, shape (n, 3)
        Centers, including the centers of circles that do not touch the given circle.
    """
    if reach > np.pi / 2 * (1 + 1e-9):
        raise InputError(
            f"the hexagonal lattice covers at most a hemisphere, but the field reaches {np.rad2deg(reach):.1f} deg "
            "from its center; use method='spiral'"
        )
    check_number(reach, radius)

    def make(pitch):
        return lattice(center, reach + MARGIN * radius, pitch, dither(number))

    # the upper limit is the pitch on a plane; on the sphere, the distortion of the map requires a smaller pitch
    low, high = 0.0, np.sqrt(3) * radius
    pitch = high
    for _ in range(40):
        gap = widest_gap(make(pitch), center, reach)
        if gap <= radius:
            low = pitch
            break
        high, pitch = pitch, pitch * min(radius / gap, 0.9999)
    for _ in range(8):
        if high - low <= 1e-4 * high:
            break
        pitch = (low + high) / 2
        if widest_gap(make(pitch), center, reach) <= radius:
            low = pitch
        else:
            high = pitch
    return make(low)


def spiral(center: np.ndarray, reach: float, radius: float, number: int = 0) -> np.ndarray:
    """Cover a field, at most the whole sky, without gaps: return centers on a Fibonacci spiral over the whole sphere.

    Parameters
    ----------
    center : ndarray, shape (3,)
        Center of the circle to cover.
    reach : float
        Radius (radians) of the circle to cover, at most pi.
    radius : float
        Radius of the covering circles in radians.
    number : int, optional
        Number of the pass, which determines the axis of the spiral.

    Returns
    -------
    ndarray, shape (n, 3)
        Centers, including the centers of circles that do not touch the given circle.
    """
    check_number(reach, radius)
    wide = min(reach + MARGIN * radius, np.pi)
    basis = basis_of(center)
    shift = dither(number)
    # the axis of each further pass is shifted within the cell of one circle, and the spiral is rotated
    x, y = radius * np.sqrt(3) * (shift[0] + shift[1] / 2), radius * 1.5 * shift[1]
    tilted = basis_of((lambda v: v / np.linalg.norm(v))(np.array([x, y, 1.0]) @ basis))
    turn = 2 * np.pi * shift[0]

    def make(n):
        used = n if wide >= np.pi else min(int(np.ceil(n * np.sin(min(wide + 2 * radius, np.pi) / 2) ** 2)) + 8, n)
        k = np.arange(used)
        z = 1 - (2 * k + 1) / n
        r, angle = np.sqrt((1 - z) * (1 + z)), GOLDEN * k + turn
        return np.column_stack([r * np.cos(angle), r * np.sin(angle), z]) @ tilted

    fewest = max(4 * np.pi / (HEXAGON * radius**2), 5)
    n = int(fewest * 1.05) + 1
    while (gap := widest_gap(make(n), center, reach)) > radius:
        fewest = n
        n = int(np.ceil(n * min(max((gap / radius) ** 2, 1.002), 1.2))) + 1
    for _ in range(8):
        middle = int((fewest + n) // 2)
        if n - fewest <= max(0.001 * n, 1):
            break
        if widest_gap(make(middle), center, reach) <= radius:
            n = middle
        else:
            fewest = middle
    return make(n)


def check_number(reach: float, radius: float) -> None:
    """Raise an error if the covering requires more than ``MOST`` tiles."""
    expected = 4 * np.pi * np.sin(min(reach + radius, np.pi) / 2) ** 2 / (HEXAGON * radius**2)
    if expected > MOST:
        raise InputError(
            f"radius must be larger: about {expected:.3g} tiles with the radius {np.rad2deg(radius):.3g} deg would "
            f"cover the field, but at most {MOST} tiles are allowed"
        )
