"""
Clustering of a redshift slice
==============================

This script measures the angular correlation function of the galaxies in a redshift slice, with different weights that
correct for galaxies that a survey does not observe. The galaxies of the mock catalog are drawn from two Thomas
processes (clusters of random points): one for the slice, and one for all other galaxies. The allocator does not
distinguish between targets inside and outside the slice. The script prints one row for each method::

    python docs/examples/scripts/clustering.py
"""

# sphinx_gallery_thumbnail_path = "_static/clustering.png"

import astropy.units as u
import numpy as np
from astropy.coordinates import SkyCoord
from scipy.spatial import cKDTree

import rfpsurvey as rs

CENTER = SkyCoord(180 * u.deg, 0 * u.deg)
HALF = 1.0  # the mock covers a square of 2 x 2 degrees
SIGMA, PARENTS, IN_SLICE, OTHERS = 0.02, 100.0, 8.0, 7.0  # deg; clusters per deg2; galaxies per cluster
EDGES = np.geomspace(10 / 3600, 0.5, 10)  # deg
N_REGIONS = 16
METHODS = ("observed", "nearest neighbor", "individual", "pairwise", "pairwise, angular")


def thomas(rng, per_parent):
    """Return positions (deg) of a Thomas process in the square: clusters of points around random centers (parents)."""
    half = HALF + 5 * SIGMA
    parents = rng.uniform(-half, half, (rng.poisson(PARENTS * 4 * half**2), 2))
    parents = np.repeat(parents, rng.poisson(per_parent, len(parents)), axis=0)
    xy = parents + rng.normal(0, SIGMA, parents.shape)
    return xy[(np.abs(xy) < HALF).all(axis=1)]


def thomas_correlation():
    """Return the exact angular correlation function of a Thomas process, averaged over the area of each bin."""
    scale = 4 * SIGMA**2
    low, high = EDGES[:-1] ** 2 / scale, EDGES[1:] ** 2 / scale
    return (np.exp(-low) - np.exp(-high)) / (high - low) / (np.pi * scale * PARENTS)


def make_mock(seed):
    """Return a mock catalog, and a boolean array that states which targets of the catalog are in the slice."""
    rng = np.random.default_rng(seed)
    inside, outside = thomas(rng, IN_SLICE), thomas(rng, OTHERS)
    xy = np.vstack([inside, outside])
    return rs.Catalog(to_sky(xy), id=np.arange(len(xy))), np.arange(len(xy)) < len(inside)


def to_sky(xy):
    """Return the sky coordinates of positions in the square, which are offsets (deg) from its center."""
    return SkyCoord(CENTER.ra + xy[:, 0] * u.deg, CENTER.dec + xy[:, 1] * u.deg)


def tiles_of(n_passes):
    """Return the center of the tile of each pass; all tiles except the first are shifted by 6 arcmin."""
    turn = 2 * np.pi * np.arange(n_passes) / max(n_passes - 1, 1)
    shift = np.where(np.arange(n_passes) == 0, 0.0, 0.1)
    return to_sky(np.column_stack([shift * np.cos(turn), shift * np.sin(turn)]))


class Points:
    """Points on the sky with weights, divided into square regions for jackknife errors."""

    def __init__(self, catalog, rows, weight=None):
        vectors = catalog.arrays.vectors[rows]
        self.weight = np.ones(len(vectors)) if weight is None else weight
        y, z = np.rad2deg(vectors[:, 1:]).T
        side = round(N_REGIONS**0.5)
        cell = np.clip((np.stack([-y, z]) + HALF) * side / (2 * HALF), 0, side - 1).astype(int)
        self.region = cell[0] * side + cell[1]
        self.vectors = vectors
        parts = [np.arange(len(vectors)), *(np.flatnonzero(self.region == k) for k in range(N_REGIONS))]
        self.trees = [(cKDTree(vectors[part]), self.weight[part]) for part in parts]


def chord(theta):
    """Return the distance between the ends of two unit vectors that are separated by the angle ``theta`` (deg)."""
    return 2 * np.sin(np.deg2rad(theta) / 2)


def count(first, second):
    """Return the weighted number of pairs in each bin: row 0 for all points, row k + 1 for points outside region k."""

    def between(a, b):
        if not (a[0].n and b[0].n):
            return np.zeros(len(EDGES) - 1)
        return np.diff(a[0].count_neighbors(b[0], chord(EDGES), weights=(a[1], b[1])))

    everything = between(first.trees[0], second.trees[0])
    found = [everything]
    for a, b in zip(first.trees[1:], second.trees[1:], strict=True):
        found.append(everything - between(a, second.trees[0]) - between(first.trees[0], b) + between(a, b))
    return np.array(found)


def count_weighted_pairs(points, weight_of):
    """Return the sum of the weights of the pairs of points in each bin; the rows are the same as in ``count``.

    The weight of the pair of the points i and j is ``weight_of(i, j)``. Each pair counts twice, as (i, j) and (j, i).
    """
    i, j = points.trees[0][0].query_pairs(chord(EDGES[-1]), output_type="ndarray").T
    apart = np.linalg.norm(points.vectors[i] - points.vectors[j], axis=1)
    cell = np.searchsorted(chord(EDGES), apart, side="left") - 1
    keep = cell >= 0
    i, j, cell = i[keep], j[keep], cell[keep]
    weight = 2 * weight_of(i, j)
    found = [np.bincount(cell, weight, len(EDGES) - 1)]
    for k in range(N_REGIONS):
        rest = (points.region[i] != k) & (points.region[j] != k)
        found.append(np.bincount(cell[rest], weight[rest], len(EDGES) - 1))
    return np.array(found)


def totals(first, second, same=False):
    """Return the sum of the weights of all pairs: entry 0 for all points, entry k + 1 for points outside region k."""

    def sums(points, power):
        parts = np.bincount(points.region, points.weight**power, N_REGIONS)
        return parts.sum() - np.append(0.0, parts)

    return sums(first, 1) * sums(second, 1) - (sums(first, 2) if same else 0.0)


def totals_of_pairs(found, points, rows):
    """Return the sum of the pairwise weights of all pairs; the entries are the same as in ``totals``.

    Each pair counts twice, as (i, j) and (j, i).
    """
    n = found.n_realizations
    seen = np.array([found.observed_in(r)[rows] for r in range(n)], dtype=np.float32)
    weight = (n + 1) / (seen.T @ seen + 1.0)
    np.fill_diagonal(weight, 0.0)
    inside = np.eye(N_REGIONS)[points.region]
    parts = inside.T @ weight @ inside
    return parts.sum() - np.append(0.0, parts.sum(axis=0) + parts.sum(axis=1) - np.diag(parts))


def correlation(dd, dr, rr):
    """Return the estimator of Landy & Szalay (1993) and its jackknife covariance, from normalized counts of pairs."""
    w = (dd - 2 * dr + rr) / rr
    apart = w[1:] - w[1:].mean(axis=0)
    return w[0], (N_REGIONS - 1) / N_REGIONS * apart.T @ apart


def pair_weights(found, rows):
    """Return a function that returns the inverse probability that both targets of a pair are observed.

    Bianchi & Percival (2017) define this pairwise weight.
    """
    n = found.n_realizations
    return lambda i, j: (n + 1) / (found.pair_counts(rows[i], rows[j]) + 1)


def nearest_neighbor_weights(vectors, observed, rows):
    """Return a weight for each of the observed targets ``rows``.

    The weight is 1 plus the number of unobserved targets that are closer to this target than to any other observed
    target.
    """
    seen = np.flatnonzero(observed)
    _, closest = cKDTree(vectors[seen]).query(vectors[~observed])
    return (1 + np.bincount(seen[closest], minlength=len(vectors)))[rows]


def measure(catalog, in_slice, tiles, random, found, observed):
    """Yield the name of each method, the correlation function of the slice, and the jackknife covariance."""
    able = ~found.unreachable
    r = Points(random, np.flatnonzero(rs.selection.potential_assignments(random, "desi", tiles).n_tiles() > 0))
    rr = count(r, r) / totals(r, r, same=True)[:, None]

    def simple(rows, weight=None):
        d = Points(catalog, rows, weight)
        return d, count(d, d) / totals(d, d, same=True)[:, None], count(d, r) / totals(d, r)[:, None]

    _, dd, dr = simple(np.flatnonzero(in_slice & able))
    yield "complete", correlation(dd, dr, rr)
    rows = np.flatnonzero(in_slice & observed)
    _, dd, dr = simple(rows)
    yield "observed", correlation(dd, dr, rr)
    weight = nearest_neighbor_weights(
        catalog.arrays.vectors[able], observed[able], np.searchsorted(np.flatnonzero(able), rows)
    )
    _, dd, dr = simple(rows, weight)
    yield "nearest neighbor", correlation(dd, dr, rr)
    d, dd, dr = simple(rows, found.weight[rows])
    yield "individual", correlation(dd, dr, rr)
    dd = count_weighted_pairs(d, pair_weights(found, rows)) / totals_of_pairs(found, d, rows)[:, None]
    yield "pairwise", correlation(dd, dr, rr)
    # The positions of all targets are known, even if they were not observed. Angular weights are the pair counts of all
    # targets, divided by the weighted pair counts of the observed targets (Percival & Bianchi 2017).
    everything = np.flatnonzero(observed)
    _, all_dd, all_dr = simple(np.flatnonzero(able))
    a, _, seen_dr = simple(everything, found.weight[everything])
    seen_dd = count_weighted_pairs(a, pair_weights(found, everything)) / totals_of_pairs(found, a, everything)[:, None]
    # The result is NaN in bins in which no pair was observed.
    dd = dd * np.divide(all_dd[0], seen_dd[0], out=np.full(len(EDGES) - 1, np.nan), where=seen_dd[0] > 0)
    yield "pairwise, angular", correlation(dd, dr * all_dr[0] / seen_dr[0], rr)


def survey(catalog, tiles, seed=0):
    """Return selection probabilities, and a boolean array of the targets that one additional plan observes."""
    options = rs.AllocationOptions("nearest")
    found = rs.selection_probabilities(catalog, "desi", tiles, n_realizations=128, allocator=options, rng=seed)
    plan = rs.plan_survey(catalog, "desi", tiles, allocator=rs.AllocationOptions("nearest", subpriority=10**6 + seed))
    return found, np.asarray(plan.outcomes["observed"]) > 0


def main(n_passes=3, seed=0):
    """Print the correlation function of one mock catalog, as measured by each method."""
    catalog, in_slice = make_mock(seed)
    xy = np.random.default_rng(10**6).uniform(-HALF, HALF, (20_000, 2))
    random, tiles = rs.Catalog(to_sky(xy)), tiles_of(n_passes)
    found, observed = survey(catalog, tiles, seed)
    results = dict(measure(catalog, in_slice, tiles, random, found, observed))
    print(f"{observed.sum()} of {len(catalog)} targets observed in {n_passes} passes")
    theta = np.sqrt(EDGES[1:] * EDGES[:-1])
    print(f"{'deg':<20}", *(f"{value:7.4f}" for value in theta))
    print(f"{'closed form':<20}", *(f"{value:7.3f}" for value in thomas_correlation()))
    for name, (w, _) in results.items():
        print(f"{name:<20}", *(f"{value:7.3f}" for value in w))
    print(f"{'error, complete':<20}", *(f"{value:7.3f}" for value in np.sqrt(np.diag(results["complete"][1]))))


if __name__ == "__main__":
    main()
