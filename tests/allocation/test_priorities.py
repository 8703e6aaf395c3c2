"""Priorities that are close to each other, or too large."""

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.table import Table
from raising import refused

import rfpsurvey as rs
from rfpsurvey.allocation import METHODS

PLANE = rs.FocalPlane.hexagonal(rs.Positioner(5 * u.mm, 5 * u.mm, 1 * u.mm), rings=3, pitch=9 * u.mm)
CLOSE = {"tenths": (0.3, 0.1 + 0.2), "large": (1e16, 1e16 + 2), "integers": (2**53 - 1, 2**53)}


@pytest.mark.parametrize("allocator", METHODS)
@pytest.mark.parametrize("pair", CLOSE.values(), ids=CLOSE)
def test_close_priorities_are_different_classes(allocator, pair):
    """Classes were once identified by 15 digits; two allocators failed with an internal error."""
    n = 60
    xy = np.random.default_rng(0).uniform(-35, 35, (n, 2)) * u.mm
    priority = np.array(pair)[np.arange(n) % 2]
    found = rs.allocate(PLANE, xy, allocator=allocator, priority=priority)
    names = [level.name.removeprefix("priority ") for level in found.levels]
    assert [float(name) for name in names] == sorted(map(float, pair), reverse=True)
    used = found.target_of_positioner[found.target_of_positioner >= 0]
    assert [level.value for level in found.levels] == [(priority[used] == p).sum() for p in sorted(pair, reverse=True)]


@pytest.mark.few(1)
@pytest.mark.parametrize("allocator", ["optimal", "joint"])
def test_completeness_of_surveys_separates_close_priorities(allocator):
    sky = SkyCoord(180 + 0.01 * np.arange(20), 20, unit="deg")
    catalog = rs.Catalog(sky, priority=np.where(np.arange(20) % 2, 0.3, 0.1 + 0.2))
    survey = rs.plan_survey(catalog, "moons", SkyCoord([180], [20], unit="deg"), allocator=allocator)
    assert survey.completeness["priority"].tolist() == ["all", "0.30000000000000004", "0.3"]


def test_integers_without_an_exact_float_are_refused():
    """Integers above 2^53 once became one class."""
    large, xy = [2**53 + 1, 2**53 + 2], [[0, 0], [1, 1]] * u.mm
    message = "integers from -2\\^53 to 2\\^53, or floating-point numbers, got 9007199254740993"
    refused(message, rs.allocate, PLANE, xy, priority=large, allocator="balanced")
    refused(message, rs.Catalog, SkyCoord([1, 2], [3, 4], unit="deg"), priority=large)
    table = Table({"ra": [1.0, 2.0] * u.deg, "dec": [3.0, 4.0] * u.deg, "priority": large})
    refused(message, rs.Catalog.from_table, table, columns={"priority": "-priority"})
    refused("priority must be numbers: could not convert", rs.allocate, PLANE, xy, priority=["a", "b"])
