"""The index of directions, compared with a search of all directions."""

import numpy as np
import pytest

from rfpsurvey._sky.arrays import SkyIndex


def unit(lon, lat):
    lon, lat = np.deg2rad(lon), np.deg2rad(lat)
    return np.column_stack([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)])


def scattered(rng, n):
    vectors = rng.normal(size=(n, 3))
    vectors /= np.linalg.norm(vectors, axis=1, keepdims=True)
    # directions at which right ascension wraps around or is undefined
    special = unit([0, 360, 1e-13, 360 - 1e-13, 0, 90, 0, 180], [0, 0, 0, 0, 90, 90, -90, 0])
    return np.vstack([vectors, special, special])


CENTERS = [(0, 0), (359.99, 10), (0.01, -70), (123, 89.9), (0, 90), (45, -90), (200, -88), (180, 0), (12, 45)]


@pytest.mark.parametrize("n", [0, 1, 5000])
@pytest.mark.parametrize("radius", [1e-6, 1.6, 89, 90, 180])
def test_near_is_what_a_look_at_all_finds(rng, n, radius):
    vectors = scattered(rng, n)
    index = SkyIndex(vectors)
    for lon, lat in CENTERS:
        (center,) = unit([lon], [lat])
        separation = np.rad2deg(np.arctan2(np.linalg.norm(np.cross(vectors, center), axis=1), vectors @ center))
        clear = np.abs(separation - radius) > 1e-7
        rows = index.order[index.near(center, np.deg2rad(radius))]
        assert (np.diff(rows) > 0).all()
        found = np.isin(np.arange(len(vectors)), rows)
        assert np.array_equal(found[clear], (separation < radius)[clear])


def test_near_leaves_out_what_has_nothing_left(rng):
    index = SkyIndex(scattered(rng, 3000))
    left, center = rng.integers(0, 3, len(index)).astype(np.uint8), unit([10], [80])[0]
    all_of_them, some = index.near(center, 0.5), index.near(center, 0.5, left)
    assert 0 < len(some) < len(all_of_them)
    assert np.array_equal(some, all_of_them[left[all_of_them] > 0])


def test_an_empty_index():
    assert len(SkyIndex(np.empty((0, 3))).near(np.array([0.0, 0.0, 1.0]), 1.0)) == 0


@pytest.mark.parametrize("radius", [0.02, 0.5, 3.0])
def test_sums_of_weights(rng, radius):
    vectors = scattered(rng, 2000)
    index = SkyIndex(vectors)
    weight = rng.integers(0, 5, len(index)).astype(float)
    centers = np.vstack([unit(*zip(*CENTERS, strict=True)), vectors[:20]])
    expected = [weight[index.near(center, radius)].sum() for center in centers]
    assert np.array_equal(index.sum_near(centers, radius, weight), expected)
