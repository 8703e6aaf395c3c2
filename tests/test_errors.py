"""Errors are sentences, and of the kinds that callers of astropy and the standard library expect."""

import astropy.units as u
import pytest
from astropy.coordinates import SkyCoord

import rfpsurvey as rs

ROBOT = rs.Positioner(8.25 * u.mm, 8.25 * u.mm, 2.25 * u.mm)
PLANE = rs.FocalPlane([[0, 0], [25.6, 0]] * u.mm, ROBOT)
WRONG_TYPES = [
    lambda: rs.Positioner(8.25, 8.25 * u.mm, 2.25 * u.mm),
    lambda: rs.allocate("lamost", [[0, 0]] * u.mm),
    lambda: rs.allocate(PLANE, [[0, 0]]),
    lambda: rs.plan_tile(SkyCoord([0] * u.deg, [0] * u.deg), 5, SkyCoord("0h 0d")),
    lambda: rs.plan_tile(SkyCoord([0] * u.deg, [0] * u.deg), "lamost", (0, 0)),
    lambda: rs.place_tiles(5, "lamost"),
]
WRONG_UNITS = [
    lambda: rs.Positioner(8.25 * u.s, 8.25 * u.mm, 2.25 * u.mm),
    lambda: rs.allocate(PLANE, [[0, 0]] * u.deg),
    lambda: rs.AllocationOptions(time_limit=5 * u.mm),
]


@pytest.mark.parametrize("call", WRONG_TYPES)
def test_wrong_types_are_type_errors_too(call):
    with pytest.raises(rs.InputError) as told:
        call()
    assert isinstance(told.value, TypeError)


@pytest.mark.parametrize("call", WRONG_UNITS)
def test_wrong_units_are_units_errors_too(call):
    with pytest.raises(rs.InputError) as told:
        call()
    assert isinstance(told.value, u.UnitsError)
