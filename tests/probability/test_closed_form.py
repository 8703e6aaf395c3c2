"""Formulas, compared with areas of polygons by shapely and with probabilities by scipy."""

from dataclasses import replace

import astropy.units as u
import numpy as np
import pytest
import shapely
from raising import refused
from scipy import stats

import rfpsurvey as rs
from scenes import MM, lamost_like, sdss_like, with_troubles

EDGES = 512  # number of edges per quarter of a circle; polygons are smaller than circles by 2e-6
MIXED = replace(sdss_like(2), central_arm=np.linspace(7, 9, 19) * MM, eccentric_arm=np.linspace(16, 7.5, 19) * MM)
PLANES = {
    "equal arms": lamost_like(2),
    "unequal arms, two rings": sdss_like(3),
    "long central arms": sdss_like(2, l2=5.0),
    "narrow annuli, whose holes overlap": sdss_like(2, l2=24.0),
    "arms of their own": MIXED,
    "irregular": rs.FocalPlane([[0, 0], [21, 3], [-9, 25], [40, 30], [90, 0]] * MM, sdss_like(1).positioner),
}


def annulus(x, y, inner, outer):
    center = shapely.Point(x, y)
    return center.buffer(outer, quad_segs=EDGES).difference(center.buffer(inner, quad_segs=EDGES))


def lengths(plane):
    unit, n = plane.positioner, len(plane)
    l1 = np.full(n, unit.central_arm.value) if plane.central_arm is None else plane.central_arm.value
    l2 = np.full(n, unit.eccentric_arm.value) if plane.eccentric_arm is None else plane.eccentric_arm.value
    return l1, l2


def patrol_areas(plane):
    l1, l2 = lengths(plane)
    return [annulus(*c, abs(a - b), a + b) for c, a, b in zip(plane.xy.value, l1, l2, strict=True)]


def closed_form(plane, variant):
    """Return the sum over neighbors of the paper, computed with one pair of polygons at a time."""
    (l1, l2), d, xy = lengths(plane), plane.positioner.clearance.value, plane.xy.value
    outer, inner = l1 + l2 + d, np.maximum(abs(l2 - l1) - d, 0)
    if variant == "printed":
        outer, inner = l2 - l1 + d, l2 - l1 - d
    areas = [annulus(*c, a, b) for c, a, b in zip(xy, inner, outer, strict=True)]
    risk = np.zeros(len(plane))
    for i in range(len(plane)):
        for j in range(len(plane)):
            distance = np.hypot(*(xy[i] - xy[j]))
            if i == j or distance >= outer[i] + outer[j]:
                continue
            reach = distance if variant == "corrected" else 22.4
            swept = d * (l2[i] + d) * max(0, (l1[i] + l2[i] - reach / 2) / (l2[i] / 2))
            risk[i] += areas[i].intersection(areas[j]).area / areas[i].area * swept / areas[i].area
    return risk


@pytest.mark.parametrize("name", PLANES)
def test_closed_form_is_the_sum_over_polygons(name):
    plane = PLANES[name]
    got = rs.collision_probability(plane, method="closed_form")
    expected = closed_form(plane, "corrected")
    np.testing.assert_allclose(got.per_positioner, expected, rtol=2e-5, atol=1e-9)
    assert got.value == pytest.approx(expected.mean(), rel=2e-5)
    assert got.value > 0.005
    assert got.meta["variant"] == "corrected"


def test_the_first_two_rings_take_part():
    """Unequal arms at a pitch of 22.4 mm reach beyond their neighbors.

    In three rings, the central positioner has 18 neighbors.
    """
    plane = sdss_like(3)
    middle = np.hypot(*plane.xy.value.T).argmin()
    full, parts = rs.collision_probability(plane, method="closed_form").per_positioner[middle], []
    for low, high in ((0.5, 1.5), (1.5, 2.5), (2.5, 9)):  # in pitches
        r = np.hypot(*plane.xy.value.T) / 22.4
        ring = rs.FocalPlane(plane.xy[((r > low) & (r < high)) | (r == 0)], plane.positioner)
        at = np.hypot(*ring.xy.value.T).argmin()
        parts.append(rs.collision_probability(ring, method="closed_form").per_positioner[at])
    assert full == pytest.approx(sum(parts), rel=1e-12)
    assert parts[0] > parts[1] > parts[2] == 0


@pytest.mark.parametrize("plane", [sdss_like(3), MIXED], ids=["alike", "arms of their own"])
def test_the_variant_with_the_pitch_in_place_of_distances(plane):
    got = rs.collision_probability(plane, method="closed_form", variant="pitch")
    np.testing.assert_allclose(got.per_positioner, closed_form(plane, "pitch"), rtol=2e-5)
    assert got.value > rs.collision_probability(plane, method="closed_form").value
    assert got.meta["variant"] == "pitch"


def test_the_pitch_is_the_distance_of_first_neighbors():
    plane = lamost_like(3)
    assert 25.6 * np.sqrt(3) > 2 * (8.25 + 8.25 + 2.25)
    one, other = (rs.collision_probability(plane, method="closed_form", variant=v) for v in ("corrected", "pitch"))
    np.testing.assert_allclose(one.per_positioner, other.per_positioner, rtol=1e-12)
    assert one.value > 0


def test_the_printed_formula_has_no_area_for_equal_arms():
    words = "if the arms have equal lengths: the outer radius l2 - l1 . d is a misprint for l1 . l2 . d"
    for plane in (lamost_like(1), replace(lamost_like(1), eccentric_arm=([8.25] * 6 + [16]) * MM)):
        refused(words, rs.collision_probability, plane, method="closed_form", variant="printed")


def test_the_printed_formula_works_for_unequal_arms():
    plane = rs.FocalPlane.hexagonal(rs.Positioner(4 * MM, 15 * MM, 2.5 * MM), rings=2, pitch=22.4 * MM)
    got = rs.collision_probability(plane, method="closed_form", variant="printed")
    np.testing.assert_allclose(got.per_positioner, closed_form(plane, "printed"), rtol=2e-5)
    assert got.value > 0
    assert got.value != pytest.approx(rs.collision_probability(plane, method="closed_form").value, rel=0.1)


@pytest.mark.few(2)
@pytest.mark.parametrize("name", PLANES)
def test_overlap_ratio_is_that_of_polygons(name):
    plane = PLANES[name]
    areas = patrol_areas(plane)
    expected = [a.intersection(shapely.union_all([b for b in areas if b is not a])).area / a.area for a in areas]
    got = rs.collision_probability(plane, method="overlap_ratio")
    # integration over 400 rings with exact arcs; the error is about 400^-1.5 for each ring that touches another annulus
    np.testing.assert_allclose(got.per_positioner, expected, atol=1e-3)
    assert got.value == pytest.approx(np.mean(expected), abs=5e-4)
    assert 0 < got.value <= 1


@pytest.mark.parametrize("name", PLANES)
def test_close_pair_is_binomial_in_the_area_of_polygons(name):
    plane = PLANES[name]
    union = shapely.union_all(patrol_areas(plane)).area
    got = rs.collision_probability(plane, method="close_pair")
    assert got.meta["reached_area_mm2"] == pytest.approx(union, rel=1e-3)
    near = np.pi * plane.positioner.min_separation.value**2 / union
    assert got.value == pytest.approx(stats.binom.sf(0, len(plane) - 1, near), rel=1e-3)
    np.testing.assert_allclose(got.per_positioner, got.value, rtol=1e-12)


def test_who_takes_no_target_has_no_patrol_area():
    plane = with_troubles(lamost_like())
    used = ~plane.disabled & np.isnan(plane.stuck.value).any(axis=1)
    rest = rs.FocalPlane(
        plane.xy[used], plane.positioner, eccentric_arm=plane.eccentric_arm[used], obstacles=plane.obstacles
    )
    for method in ("overlap_ratio", "closed_form", "close_pair"):
        got = rs.collision_probability(plane, method=method)
        expected = rs.collision_probability(rest, method=method)
        assert got.value == pytest.approx(expected.value, rel=1e-12)
        np.testing.assert_array_equal(np.isnan(got.per_positioner), ~used)
        np.testing.assert_allclose(got.per_positioner[used], expected.per_positioner, rtol=1e-12)


def test_neither_place_nor_direction_matters():
    plane, angle = sdss_like(2), np.deg2rad(17)
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    for other in (replace(plane, xy=plane.xy @ turn), replace(plane, xy=plane.xy + [500, -300] * MM)):
        for method in ("overlap_ratio", "closed_form", "close_pair"):
            here, there = (rs.collision_probability(p, method=method) for p in (plane, other))
            np.testing.assert_allclose(here.per_positioner, there.per_positioner, rtol=1e-6)


@pytest.mark.parametrize("method", ["overlap_ratio", "closed_form", "close_pair"])
def test_formulas_have_no_error(method):
    got = rs.collision_probability(lamost_like(2), method=method)
    for field in ("low", "high", "standard_error", "n_effective", "pairs_per_positioner"):
        assert np.isnan(getattr(got, field))
    assert (got.value, got.n, got.estimand, got.method) == (got.value_assigned, 0, "independent", method)


@pytest.mark.parametrize("method", ["overlap_ratio", "closed_form", "close_pair"])
def test_who_is_alone_collides_with_nobody(method):
    unit = rs.Positioner(8.25 * MM, 8.25 * MM, 2.25 * MM)
    assert rs.collision_probability(rs.FocalPlane([[3, 4]] * MM, unit), method=method).value == 0
    if method != "close_pair":  # this method does not use the positions
        far = rs.FocalPlane([[0, 0], [2000, 0]] * MM, unit)
        assert rs.collision_probability(far, method=method).value == 0


def test_lengths_in_other_units():
    unit = rs.Positioner(0.74 * u.cm, 1.5 * u.cm, 2.5 * MM, step=0.1 * u.deg)
    plane = rs.FocalPlane.hexagonal(unit, rings=2, pitch=0.0224 * u.m)
    for method in ("overlap_ratio", "closed_form", "close_pair"):
        here, there = (rs.collision_probability(p, method=method) for p in (plane, sdss_like(2)))
        assert here.value == pytest.approx(there.value, rel=1e-9)


@pytest.mark.parametrize("method", ["closed_form", "close_pair"])
def test_formulas_that_need_a_clearance_refuse_outlines(presets, method):
    """The clearance of an outline can be 0; the result was then 0 without a warning."""
    desi = presets["desi"]
    with pytest.raises(rs.InputError, match=f"the arm model must be .* for the method '{method}', got 'outline'"):
        rs.collision_probability(desi, method=method)
    assert rs.collision_probability(desi.with_arm_model("elbow_to_tip"), method=method).value > 0.005


def test_the_closed_form_refuses_arms_of_which_only_the_fibers_collide():
    plane = sdss_like(2, arm_model="fiber_tip")
    refused("must be elbow_to_tip or capsule .* got 'fiber_tip'", rs.collision_probability, plane, method="closed_form")
