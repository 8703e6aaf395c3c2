"""Two positioners, four targets, and a package with plugins."""

import astropy.units as u
import numpy as np
from astropy.coordinates import SkyCoord

import rfpsurvey as rs

CENTER = SkyCoord("6h20m +23d")
ROBOT = rs.Positioner(8.25 * u.mm, 8.25 * u.mm, 2.25 * u.mm)
PAIR = rs.FocalPlane([[0, 0], [25.6, 0]] * u.mm, ROBOT)
# the first positioner reaches targets 0 and 1, and the second reaches 1 and 2; target 3 is out of reach
FOUR = [[-10, 0], [13, 0], [30, 0], [99, 0]] * u.mm

HERS = """
import numpy as np

def begin(problem):
    return problem.start()

def swapped(problem):
    return np.array([1, 2])

def idle(problem):
    return np.full(len(problem.focal_plane), -1)

def wrong(problem):
    return [3, 3]

def formula(question):
    return np.full(len(question.focal_plane), 0.25)
"""


def always(answer):
    return lambda problem: answer


def sky_of(instrument, n=300):
    return rs.synthetic_catalog("uniform", CENTER, instrument.field_radius, n_targets=n, rng=5)


def same(one, other):
    np.testing.assert_array_equal(one.target_of_positioner, other.target_of_positioner)
    np.testing.assert_array_equal(one.handedness, other.handedness)
