"""Scenes with difficult probabilities: immovable positioners, rare collisions, narrow densities, crowded targets."""

import re

import astropy.units as u
import numpy as np
import pytest

import flat
import rfpsurvey as rs
from rfpsurvey._kernels import simulate
from scenes import MM, lamost_like, sdss_like


def stuck_in_the_middle():
    pose = np.full((19, 2), np.nan)
    pose[9] = [0, 20]
    return rs.FocalPlane.hexagonal(sdss_like(2).positioner, rings=2, pitch=22.4 * MM, stuck=pose * u.deg)


def test_who_never_counts_has_no_probability():
    for method in ("monte_carlo", "conditional", "quadrature"):
        found = rs.collision_probability(stuck_in_the_middle(), method=method, precision=0.01)
        assert np.flatnonzero(np.isnan(found.per_positioner)).tolist() == [9]
        assert np.nanmax(found.per_positioner) <= 1


def test_given_targets_without_a_hit_are_not_precise(rng):
    plane = rs.FocalPlane.hexagonal(lamost_like(2).positioner, rings=2, pitch=36 * MM)
    targets = rng.uniform(-90, 90, (2000, 2)) * MM
    with pytest.warns(rs.RfpsurveyWarning, match="after 640 iterations"):
        found = flat.collision_probability(
            plane, targets=targets, method="monte_carlo", precision=1e-6, max_iterations=640
        )
    assert found.high > 1e-4


def test_targets_fall_where_the_focal_plane_is():
    plane = lamost_like(2)
    away = rs.FocalPlane(plane.xy + [1e4, -2e4] * MM, plane.positioner)
    one, other = (rs.collision_probability(p, precision=5e-3) for p in (plane, away))
    assert one.value == pytest.approx(other.value, rel=1e-6)
    assert rs.collision_probability(away, method="quadrature").value == pytest.approx(
        rs.collision_probability(plane, method="quadrature").value, rel=1e-6
    )


def test_thinning_keeps_each_entry_equally_often(rng):
    indptr, times = np.array([0, 3, 3, 10, 12]), np.zeros(12)
    for _ in range(4000):
        rows, queue = indptr.copy(), np.arange(12)
        simulate.thin(rng, 3, rows, queue)
        assert rows.tolist() == [0, 3, 3, 6, 8]
        kept = queue[: rows[-1]]
        assert (set(kept[:3]), len(set(kept[3:6]))) == ({0, 1, 2}, 3)
        assert ((kept[3:6] >= 3) & (kept[3:6] < 10)).all()
        assert kept[6:].tolist() == [10, 11]
        times[kept] += 1
    np.testing.assert_allclose(times[3:10] / 4000, 3 / 7, atol=4 * np.sqrt(3 / 7 * 4 / 7 / 4000))


USERS = "only monte_carlo and conditional use it"


OPTIONS_WITHOUT_EFFECT = [
    ({"method": "quadrature", "interval": "bootstrap"}, f"interval has no effect with .* 'quadrature'; {USERS}"),
    ({"method": "quadrature", "stop": "convergence"}, f"stop has no effect with the method 'quadrature'; {USERS}"),
    ({"method": "quadrature", "targets": "poisson"}, f"targets has no effect with .* 'quadrature'; {USERS}"),
    ({"method": "quadrature", "allocator": "lamost_rule"}, f"allocator has no effect with .* 'quadrature'; {USERS}"),
    ({"method": "closed_form", "density": "uniform"}, "density has no effect with .*; only quadrature uses it"),
    ({"method": "closed_form", "precision": 0.1}, "precision has no effect with the method 'closed_form'; only qua"),
    ({"method": "close_pair", "rng": 3}, "rng has no effect with the method 'close_pair'; only quadrature, mon"),
    ({"method": "monte_carlo", "most_entries": 3}, "most_entries has no effect .*; only conditional uses it"),
    ({"method": "monte_carlo", "density": "uniform"}, "density has no effect with the method 'monte_carlo'; only"),
    ({"variant": "printed"}, "variant has no effect with .* 'conditional'; only closed_form uses it"),
    ({"center": 3}, "center has no effect because targets is not a Catalog"),
    (
        {"allocator": rs.AllocationOptions("balanced", time_limit=1 * u.s)},
        "time_limit has no effect with the allocator 'balanced'; only network_flow and optimal use it",
    ),
]


@pytest.mark.parametrize(("options", "words"), OPTIONS_WITHOUT_EFFECT)
def test_options_without_effect_cause_one_warning(options, words):
    with pytest.warns(rs.RfpsurveyWarning) as told:
        assert 0 < flat.collision_probability(lamost_like(1), **options).value < 1
    assert [bool(re.search(words, str(one.message))) for one in told] == [True]


@pytest.mark.exhaustive
def test_points_of_neighbors_are_shifted_independently():
    """With equal shifts, few points would repeat, and the product over neighbors would be biased."""
    plane, n = sdss_like(2), 100
    truth = rs.collision_probability(plane, method="quadrature", precision=1e-4)
    few = [flat.collision_probability(plane, method="quadrature", max_iterations=16, rng=k).value for k in range(n)]
    assert abs(np.mean(few) - truth.value) < 4 * np.std(few) / np.sqrt(n) + 3e-4


def test_iterations_end_where_they_cannot_help(rng):
    """For given targets, the precision is that of the simulation.

    More iterations cannot reduce the scatter between skies.
    """
    targets = rng.uniform(-60, 60, (600, 2)) * MM
    found = rs.collision_probability(lamost_like(), targets=targets, method="monte_carlo", precision=5e-3)
    assert found.n < 1000
    assert found.standard_error > 5e-3
