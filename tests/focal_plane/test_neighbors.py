"""Pairs of centers within a distance, against SciPy's tree."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from rfpsurvey._instruments.reach import nearest_within, pairs_within


@pytest.mark.few(1)
@pytest.mark.parametrize("on_grid", [False, True])
def test_pairs_are_those_of_the_tree(rng, on_grid):
    n_pairs = 0
    for _ in range(300):
        xy = rng.normal(size=(rng.integers(1, 60), 2)) * 10 ** rng.uniform(-3, 4)
        xy = np.round(xy) if on_grid else xy  # distances equal to the limit, and centers at the same place
        limit = float(rng.integers(1, 9)) if on_grid else np.ptp(xy, axis=0).max() * rng.random() ** 2
        expected = cKDTree(xy).query_pairs(limit, output_type="ndarray").astype(np.int64)
        found = pairs_within(xy, limit) if limit > 0 else expected
        assert sorted(map(tuple, expected.tolist())) == list(map(tuple, found.tolist()))
        n_pairs += len(found)
        if len(xy) > 1 and limit > 0:
            nearest = cKDTree(xy).query(xy, k=2)[0][:, 1]
            np.testing.assert_allclose(nearest_within(xy, limit), np.where(nearest <= limit, nearest, np.inf))
    assert n_pairs > 1000


def test_neighbors_and_rivals_of_presets_are_those_of_the_tree(presets):
    for instrument in presets.values():
        plane = instrument.focal_plane
        arrays, tree = plane.arrays, cKDTree(plane.arrays.xy)
        limit = 2 * arrays.arm_reach.max() + arrays.separation + arrays.touch_slack
        pairs = tree.query_pairs(limit, output_type="ndarray").astype(np.int64)
        pairs = pairs[arrays.can_touch(pairs, arrays.touch_slack)] if np.ptp(arrays.arm_reach) else pairs
        np.testing.assert_array_equal(arrays.neighbors, pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))])
        reach = arrays.largest_radius * (1 + 1e-6)
        near = tree.query_ball_point(arrays.xy, reach + reach.max(), return_length=True)
        np.testing.assert_array_equal(arrays.n_sharing, near - 1)
        pairs = plane.neighbor_pairs()
        longest = np.hypot(*(arrays.xy[pairs[:, 0]] - arrays.xy[pairs[:, 1]]).T).max()
        pitch = np.median(tree.query(arrays.xy, k=2)[0][:, 1])
        assert plane.collision_type == (3 if longest > 1.5 * pitch else 2)
