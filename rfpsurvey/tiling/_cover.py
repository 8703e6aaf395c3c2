"""Cover the targets of a catalog, or a region, in passes."""

from collections.abc import Callable
from functools import partial
from itertools import product

import astropy.units as u
import numpy as np
from astropy.table import QTable

from rfpsurvey import _healpix
from rfpsurvey.catalog import SkyIndex
from rfpsurvey.errors import InputError
from rfpsurvey.instrument import Instrument
from rfpsurvey.pipeline import field_radius_rad, project_field
from rfpsurvey.region import Region, circle_around, distance_to, is_inside
from rfpsurvey.tiling._centers import Centers, Declinations
from rfpsurvey.tiling._problem import TilingProblem, TilingState, visit_all

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
