"""The work on one tile: collisions that rounding could decide, and repeated identifiers."""

import astropy.units as u
import numpy as np
import pytest
from astropy.table import Table

import rfpsurvey as rs
from realizations import sky_of, tiles_of
from rfpsurvey._field.plan import FieldReach
from rfpsurvey._kernels.batch import BORDERLINE
from rfpsurvey._survey.selection import work as _work
from rfpsurvey._survey.selection.work import find_lost

D = 4.5


@pytest.fixture
def calls(monkeypatch):
    """Return a list to which the number of decisions in exact arithmetic is added."""
    found, find = [], _work.find_collisions

    def counted(*args, **kwargs):
        found.append(len(found))
        return find(*args, **kwargs)

    monkeypatch.setattr(_work, "find_collisions", counted)
    return found


@pytest.mark.parametrize(("gap", "collides"), [(D, False), (np.nextafter(D, 0), True), (D + 1, False), (D - 1, True)])
def test_tips_whose_distance_is_the_minimum_separation(calls, gap, collides):
    unit = rs.Positioner(8 * u.mm, 8 * u.mm, D / 2 * u.mm, arm_model="fiber_tip")
    plane = rs.FocalPlane([[-5.0, 0.0], [9.0, 0.0], [90.0, 0.0]] * u.mm, unit)
    xy = np.array([[0.0, 0.0], [gap, 0.0]])
    pairs = plane.arrays.reach(xy)
    k = [int(np.flatnonzero((pairs.target == t) & (pairs.owner == i))[0]) for t, i in ((0, 0), (1, 1))]
    chosen = np.array([[*k, -1], [k[0], -1, -1], [-1, -1, -1]])
    lost = find_lost(plane, FieldReach(None, xy, None, 0.0), pairs, chosen, parked_obstacles=False)
    assert (lost.tolist(), len(calls)) == ([[collides, collides, False], [False] * 3, [False] * 3], abs(gap - D) < 0.1)


@pytest.mark.parametrize(("gap", "collides"), [(0.0, False), (-1e-15, True), (0.5, False), (-0.5, True)])
def test_a_tip_at_the_clearance_of_an_obstacle(calls, gap, collides):
    unit = rs.Positioner(8 * u.mm, 8 * u.mm, D / 2 * u.mm, arm_model="fiber_tip")
    plane = rs.FocalPlane([[-5.0, 0.0], [90.0, 0.0]] * u.mm, unit, obstacles=[[4.25, 0.0, 2.0]] * u.mm)
    xy = np.array([[-gap, 0.0]])
    reach, pairs = FieldReach(None, xy, None, 0.0), plane.arrays.reach(xy)
    lost = find_lost(plane, reach, pairs, np.array([[0, -1]]), parked_obstacles=False)
    assert (lost.tolist(), len(calls)) == ([[collides, False]], abs(gap) < 0.1)


def test_all_collisions_in_exact_arithmetic(small, monkeypatch, calls):
    """If all realizations are uncertain, the result is the same."""
    sky, tiles = sky_of(1.0, 1200), tiles_of(0.5, 2)
    expected = rs.selection_probabilities(sky, small, tiles, 5, allocator="nearest")
    assert expected.realizations["n_lost"].min() > 0
    assert not calls

    count = _work.count_poses

    def unsure(*args):
        counts = count(*args)
        counts[:, BORDERLINE], args[5][:] = 1, 0
        return counts

    monkeypatch.setattr(_work, "count_poses", unsure)
    found = rs.selection_probabilities(sky, small, tiles, 5, allocator="nearest")
    assert len(calls) == 5 * len(tiles)
    np.testing.assert_array_equal(found.bits, expected.bits)


@pytest.mark.filterwarnings("ignore:some targets have the same id")
@pytest.mark.parametrize("allocator", ["nearest", "repair"])
def test_targets_with_the_same_identifier_are_refused(small, allocator):
    """Regression: some of these targets had the probability 0, because their order was the same in all realizations."""
    sky = sky_of(0.8, 800)
    sky = rs.Catalog(sky.coord, id=np.arange(len(sky)) // 5)
    with pytest.raises(rs.InputError, match="the targets must have different ids"):
        rs.selection_probabilities(sky, small, tiles_of(0.5, 2), 2, allocator=allocator)


@pytest.mark.parametrize("allocator", ["nearest", "repair"])
def test_a_tile_without_targets_in_reach_changes_no_realization(small, allocator):
    sky, tiles = sky_of(0.8, 400), tiles_of(0.5, 2)
    table = Table({"ra": tiles.coord.ra, "dec": tiles.coord.dec, "pass": [1] * len(tiles)})
    far = table.copy()
    far.add_row([table["ra"][0], -20.0, 1])
    few, more = (
        rs.selection_probabilities(sky, small, rs.Tiling.from_table(one), 3, allocator=allocator)
        for one in (table, far)
    )
    assert few.bits.any()
    np.testing.assert_array_equal(more.bits, few.bits)
