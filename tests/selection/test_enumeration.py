"""Probabilities of targets and of pairs, compared with all orders of a few targets."""

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.table import QTable

import rfpsurvey as rs
from oracles import tangent_plane_mm
from orders import RULES, observed_sets, pair_chances, reaches_of

CENTER = SkyCoord(200 * u.deg, 30 * u.deg)
SCALE = 200  # mm per deg
UNIT = rs.Positioner(8.25 * u.mm, 8.25 * u.mm, 2.25 * u.mm)
PLANE = rs.FocalPlane([[-20.0, 0.0], [0.0, 3.0], [20.0, 0.0]] * u.mm, UNIT)
INSTRUMENT = rs.Instrument("three", PLANE, plate_scale=SCALE * u.mm / u.deg)
# The same positioners with arms so thin that no arms collide.
THIN = rs.Positioner(8.25 * u.mm, 8.25 * u.mm, 0.001 * u.mm)
THIN_ARMS = rs.Instrument("thin", rs.FocalPlane(PLANE.xy, THIN), plate_scale=SCALE * u.mm / u.deg)
# Positions (mm) relative to the center. Targets at x < -16.5 are in reach of the first positioner only.
POINTS = {
    "five": [[-24.0, 3.0], [-22.0, -6.0], [-10.0, 1.0], [-8.0, 5.0], [9.0, 2.0]],
    "crowded": [[-24.0, 3.0], [-25.0, -4.0], [-21.0, -8.0], [-10.0, 1.0], [8.0, 3.0]],
}
SHIFTS = [[0.0, 0.0], [4.0, -1.5]]


def scene(name):
    """Return targets, tiles, and the positions of the targets on the focal plane in each tile, by astropy's WCS."""
    points, shifts = np.array(POINTS[name]) / SCALE, np.array(SHIFTS) / SCALE
    frame = CENTER.skyoffset_frame()
    coord = SkyCoord(points[:, 0] * u.deg, points[:, 1] * u.deg, frame=frame).icrs
    centers = SkyCoord(shifts[:, 0] * u.deg, shifts[:, 1] * u.deg, frame=frame).icrs
    tiles = rs.Tiling.from_table(QTable({"ra": centers.ra, "dec": centers.dec}))
    return coord, tiles, [tangent_plane_mm(coord, center, SCALE, 0) for center in centers]


def check(found, chances, n_errors=4):
    """Compare the fractions of realizations that observe both targets of each pair with their probabilities."""
    n = found.n_realizations
    observed = np.column_stack([found.observed_in(k) for k in range(n)]).astype(float)
    fractions = observed @ observed.T / n
    errors = np.sqrt(np.maximum(chances * (1 - chances), 0) / n)
    assert (np.abs(fractions - chances) <= n_errors * errors + 1e-12).all(), (fractions, chances)
    first, second = np.triu_indices(len(chances), 1)
    np.testing.assert_array_equal(found.pair_counts(first, second), np.round(fractions[first, second] * n))
    np.testing.assert_array_equal(found.probability, np.diag(fractions))


@pytest.mark.few(2)
@pytest.mark.parametrize(
    ("case", "lost"), [("five", True), ("priorities", True), ("crowded", True), ("visits", True), ("five", False)]
)
@pytest.mark.parametrize("rule", RULES)
def test_fractions_of_realizations_are_those_of_all_orders(rule, case, lost):
    coord, tiles, xy = scene(case if case in POINTS else "five")
    visits = [2, 1, 1, 2, 1] if case == "visits" else [1] * 5
    priority = [2, 1, 1, 1, 2] if case == "priorities" else [1] * 5
    sky = rs.Catalog(coord, visits=visits, priority=priority)
    options = {"allocator": rule, "order": "given", "lost_in_collision": lost}
    found = rs.selection_probabilities(sky, INSTRUMENT, tiles, 5_000, **options)
    sets = observed_sets(PLANE, xy, rule, visits, priority, lost_in_collision=lost)
    assert sum(sets.values()) == pytest.approx(1)
    assert len(sets) > 1 or (rule, case) == ("lamost_rule", "priorities")
    check(found, pair_chances(sets, 5))


@pytest.mark.parametrize("allocator", ["repair", pytest.param("optimal", marks=pytest.mark.exhaustive)])
def test_rivals_for_one_positioner_are_observed_equally_often(allocator):
    """Three targets are in reach of the first positioner only, and each of two tiles observes one of them.

    The most targets are assigned if the other positioners observe the other targets. The order of the three rivals then
    determines which two of them are observed.
    """
    coord, tiles, xy = scene("crowded")
    reaches = np.array(reaches_of(PLANE, xy[0])) & np.array(reaches_of(PLANE, xy[1]))
    np.testing.assert_array_equal(reaches[:, :3], [[True] * 3, [False] * 3, [False] * 3])
    found = rs.selection_probabilities(rs.Catalog(coord), THIN_ARMS, tiles, 60, allocator=allocator, order="given")
    chances = np.array([[2, 1, 1, 2, 2], [1, 2, 1, 2, 2], [1, 1, 2, 2, 2], [2, 2, 2, 3, 3], [2, 2, 2, 3, 3]]) / 3
    check(found, chances)
