"""A focal plane with more circles that no arm may touch equals a focal plane that is made with these circles."""

from dataclasses import replace

import astropy.units as u
import numpy as np

import rfpsurvey as rs
from rfpsurvey._instruments.margins import with_circles


def test_circles_that_are_added_are_obstacles_of_the_new_focal_plane_only(presets):
    plane = presets["sdss_apo"].focal_plane
    n_before = len(plane.arrays.obstacle_pairs)
    circles = np.array([[10.0, 20.0, 3.0], [-50.0, 0.0, 8.0]])
    found = with_circles(plane, circles)
    expected = replace(plane, obstacles=np.vstack([plane.arrays.obstacles, circles]) * u.mm)
    assert np.array_equal(found.obstacles, expected.obstacles)
    for name in ("obstacles", "obstacle_pairs", "obstacle_slack", "neighbors", "usable"):
        assert np.array_equal(getattr(found.arrays, name), getattr(expected.arrays, name))
    assert found.arrays.plane is found
    assert len(plane.arrays.obstacle_pairs) == n_before < len(found.arrays.obstacle_pairs)
    tips = plane.xy + [0, 12] * u.mm
    reports = [rs.find_collisions(one, tips) for one in (found, expected)]
    assert np.array_equal(*(report.obstacle_pairs for report in reports))
    assert len(reports[0].obstacle_pairs)
