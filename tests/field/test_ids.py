"""Identifiers of blank sky positions."""

import gc
import weakref

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord

import rfpsurvey as rs
from rfpsurvey._field.plan import blank_ids

SMALLEST, LARGEST = np.iinfo(np.int64).min, np.iinfo(np.int64).max


@pytest.mark.parametrize(
    "parts",
    [
        [np.arange(5)],
        [np.array([3, -7]), np.array([-9, 100])],
        [np.array([SMALLEST, 5])],
        [np.array(["a", "blank-sky-0"]), np.array(["__blank-sky-x", "_b"])],
        [np.array(["long identifier of a star"])],
        [np.array([], dtype=int)],
    ],
)
def test_they_differ_from_those_of_a_catalog(parts):
    found = blank_ids(parts)
    names = found.take(2000)
    assert len(np.unique(names)) == 2000
    assert not np.isin(names, np.concatenate(parts)).any()
    assert np.array_equal(names.astype(found.dtype), names)
    assert all(np.array_equal(part.astype(found.dtype), part) for part in parts)


def test_without_room_for_them_there_is_an_error():
    with pytest.raises(rs.InputError, match="ids must leave unused integers for blank sky positions"):
        blank_ids([np.array([SMALLEST, LARGEST])])


def test_a_catalog_is_freed_at_once():
    """The arrays of a catalog do not refer to it; otherwise, memory would be freed only by the garbage collector."""
    catalog = rs.synthetic_catalog("uniform", SkyCoord("6h 0d"), 1 * u.deg, n_targets=10, rng=1)
    assert len(catalog.arrays.vectors) == 10
    there = weakref.ref(catalog)
    gc.disable()
    try:
        del catalog
        assert there() is None
    finally:
        gc.enable()
