"""Objects of settings are equal to their copies; ``test_settings.py`` tests classes that describe their options."""

import copy
import pickle
from dataclasses import replace

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.table import QTable

import rfpsurvey as rs

MM, DEG = u.mm, u.deg
CENTERS = QTable({"ra": [1, 2] * DEG, "dec": [3, 4] * DEG})
TRIANGLE = [[0, 0], [4, 0], [0, 1]]


def arms(length, **others):
    return rs.Positioner(length * MM, 8 * MM, 1 * MM, **others)


def plane(ra, **others):
    return rs.projection.TangentPlane(SkyCoord(ra, 23, unit=DEG, **others), 200 * MM / DEG)


PAIRS = {
    "Positioner": (arms(8), arms(9)),
    "Positioner with arrays": (arms(8, home=[0, 180] * DEG), arms(8, home=[1, 180] * DEG)),
    "ArmOutline": tuple(rs.positioner.ArmOutline([np.array(TRIANGLE) * k * MM]) for k in (1, 2)),
    "circle": (rs.Region.parse("cap 1 2 3"), rs.Region.parse("cap 1 2 4")),
    "box": (rs.Region.parse("box 0 10 0 10"), rs.Region.parse("box 0 10 0 11")),
    "polygon": (rs.Region.parse("polygon 0 0 10 0 10 10"), rs.Region.parse("polygon 0 0 10 0 10 11")),
    "pixels": (rs.Region.healpix([1, 2], 4), rs.Region.healpix([1, 2], 2)),
    "KeepOut": (rs.KeepOut.parse("95 23 0.1"), rs.KeepOut.parse("95 23 0.2")),
    "Required": (rs.Required([1, 2]), rs.Required([1, 3])),
    "Requirement": (rs.Requirement.parse("sky=2"), rs.Requirement.parse("sky=3")),
    "TangentPlane": (plane(95), plane(96)),
    "TangentPlane of a frame": (plane(95, frame="fk5"), plane(95, frame="fk5", equinox="J2026")),
    "RadialMap": tuple(rs.projection.RadialMap("theta", [k], max_angle=1 * DEG) for k in (1.0, 2.0)),
    "Centers": (rs.tiling.Centers(CENTERS), rs.tiling.Centers(CENTERS[:1])),
}


@pytest.mark.parametrize("name", PAIRS)
def test_settings_are_equal_to_their_copies(name):
    """Regression: objects with arrays were compared by identity, so that equal options of two processes differed."""
    value, other = PAIRS[name]
    for same in (pickle.loads(pickle.dumps(value)), copy.deepcopy(value), replace(value)):
        assert same == value
        assert hash(same) == hash(value)
    assert value != other
    assert value != "another type"


def test_a_circle_is_equal_however_it_is_given():
    parsed, made = rs.Region.parse("cap 95.5 23 0.1"), rs.Region.cap(SkyCoord(95.5, 23, unit=DEG), 0.1 * DEG)
    assert parsed == made
    assert len({parsed, made}) == 1
