"""Scenes with difficult probabilities: immovable positioners, rare collisions, narrow densities, crowded targets."""

import re

import astropy.units as u
import numpy as np
import pytest
from raising import refused
from scipy.spatial import cKDTree

import flat
import rfpsurvey as rs
from rfpsurvey._kernels import simulate
from rfpsurvey.probability import RandomTargets
from rfpsurvey.probability._run import HITS
from rfpsurvey.probability._simulate import Simulation
from rfpsurvey.probability._targets import make_source
from scenes import MM, lamost_like, sdss_like


def stuck_in_the_middle():
    pose = np.full((19, 2), np.nan)
    pose[9] = [0, 20]
    return rs.FocalPlane.hexagonal(sdss_like(2).positioner, rings=2, pitch=22.4 * MM, stuck=pose * u.deg)


@pytest.mark.exhaustive
def test_neighbors_of_an_immovable_unit_differ(rng):
    """The six neighbors see the fixed arm from different directions. A simulation of independent targets agrees."""
    plane = stuck_in_the_middle()
    got = rs.collision_probability(plane, method="quadrature", precision=5e-4)
    n, m = 4000, len(plane)
    unit = plane.positioner
    r = np.sqrt(rng.uniform(unit.inner_radius.value**2, unit.outer_radius.value**2, (n, m)))
    r = np.clip(r, unit.inner_radius.value + 1e-9, unit.outer_radius.value - 1e-9)
    alpha = rng.uniform(0, 2 * np.pi, (n, m))
    tips = plane.xy.value + np.stack([r * np.cos(alpha), r * np.sin(alpha)], axis=-1)
    tips[:, 9] = np.nan
    counts = rs.collision.count_collisions(plane, tips * MM)
    rates = counts.rate
    assert abs(got.value - rates.mean()) < 3 * rates.std() / np.sqrt(n) + 0.001
    assert np.isnan(got.per_positioner[9])
    others = np.arange(m) != 9
    p = counts.per_positioner / n
    assert (np.abs(got.per_positioner - p) < 4.5 * np.sqrt(p * (1 - p) / n) + 0.003)[others].all()
    pairs = counts.n_pairs / 18
    assert abs(got.pairs_per_positioner - pairs.mean()) < 3 * pairs.std() / np.sqrt(n) + 0.001


def test_who_never_counts_has_no_probability():
    for method in ("monte_carlo", "conditional", "quadrature"):
        found = rs.collision_probability(stuck_in_the_middle(), method=method, precision=0.01)
        assert np.flatnonzero(np.isnan(found.per_positioner)).tolist() == [9]
        assert np.nanmax(found.per_positioner) <= 1


@pytest.mark.exhaustive
@pytest.mark.parametrize("n", [36, 100])
def test_rare_collisions_do_not_stop_the_simulation_early(n):
    """A single collision does not show how much rates scatter."""
    plane = rs.FocalPlane.hexagonal(lamost_like(2).positioner, rings=2, pitch=35 * MM)
    found = [rs.collision_probability(plane, precision=1e-3, rng=k) for k in range(n)]
    assert min(e.n for e in found) > 4 * HITS
    truth = flat.collision_probability(plane, max_iterations=1000 * n, rng=99)
    values = np.array([e.value for e in found])
    assert abs(values.mean() - truth.value) < 3 * values.std() / np.sqrt(n)
    assert np.mean([e.low <= truth.value <= e.high for e in found]) > 0.95 - 3.5 * np.sqrt(0.95 * 0.05 / n)


def test_given_targets_without_a_hit_are_not_precise(rng):
    plane = rs.FocalPlane.hexagonal(lamost_like(2).positioner, rings=2, pitch=36 * MM)
    targets = rng.uniform(-90, 90, (2000, 2)) * MM
    with pytest.warns(rs.RfpsurveyWarning, match="after 640 iterations"):
        found = flat.collision_probability(
            plane, targets=targets, method="monte_carlo", precision=1e-6, max_iterations=640
        )
    assert found.high > 1e-4


@pytest.mark.parametrize("factor", [1e-170, 1.0, 1e160])
def test_the_factor_of_a_density_does_not_matter(factor):
    def density(xy):
        return np.full(len(xy), factor)

    found = flat.collision_probability(lamost_like(1), method="quadrature", density=density, max_iterations=256)
    plain = flat.collision_probability(
        lamost_like(1), method="quadrature", density=lambda xy: np.ones(len(xy)), max_iterations=256
    )
    assert found.pairs_per_positioner == pytest.approx(plain.pairs_per_positioner, rel=1e-12)
    assert found.value == pytest.approx(plain.value, rel=1e-12)


def test_targets_fall_where_the_focal_plane_is():
    plane = lamost_like(2)
    away = rs.FocalPlane(plane.xy + [1e4, -2e4] * MM, plane.positioner)
    one, other = (rs.collision_probability(p, precision=5e-3) for p in (plane, away))
    assert one.value == pytest.approx(other.value, rel=1e-6)
    assert rs.collision_probability(away, method="quadrature").value == pytest.approx(
        rs.collision_probability(plane, method="quadrature").value, rel=1e-6
    )


def test_disc_targets_keep_apart_and_do_not_crowd_the_edge(rng):
    source = make_source(lamost_like(2), None, RandomTargets("poisson_disc", 900, 60 * MM, 2.7 * MM))
    r2 = []
    for own in rng.spawn(100):
        points = source.draw(own)
        assert points.shape == (900, 2)
        assert cKDTree(points).query(points, k=2)[0][:, 1].min() >= 2.7
        r2.append((points**2).sum(axis=1) / 60**2)
    r2 = np.concatenate(r2)
    assert r2.max() <= 1
    # for random addition to an empty surrounding, the mean is above 0.508
    assert abs(r2.mean() - 0.5) < 0.003


def test_thinned_queues_have_the_same_expectation(rng):
    plane = sdss_like(2)
    all_of_them, some = (
        flat.collision_probability(plane, n_targets=400, max_iterations=2000, most_entries=k, rng=3) for k in (None, 4)
    )
    for name in ("value", "value_assigned"):
        away = getattr(all_of_them, name) - getattr(some, name)
        assert abs(away) < 3 * np.hypot(all_of_them.standard_error, some.standard_error)
    assert abs(all_of_them.pairs_per_positioner - some.pairs_per_positioner) < 0.01
    assert some.standard_error > 1.5 * all_of_them.standard_error


def test_thinning_keeps_each_entry_equally_often(rng):
    indptr = np.array([0, 3, 3, 10, 12])
    times = np.zeros(12)
    for _ in range(4000):
        rows, queue = indptr.copy(), np.arange(12)
        simulate.thin(rng, 3, rows, queue)
        assert rows.tolist() == [0, 3, 3, 6, 8]
        kept = queue[: rows[-1]]
        assert set(kept[:3]) == {0, 1, 2}
        assert len(set(kept[3:6])) == 3
        assert ((kept[3:6] >= 3) & (kept[3:6] < 10)).all()
        assert kept[6:].tolist() == [10, 11]
        times[kept] += 1
    np.testing.assert_allclose(times[3:10] / 4000, 3 / 7, atol=4 * np.sqrt(3 / 7 * 4 / 7 / 4000))


def test_thinned_given_targets_agree_with_all_of_them(rng):
    plane = lamost_like(2)
    targets = rng.uniform(-60, 60, (600, 2)) * MM
    exact = rs.collision_probability(plane, targets=targets)
    thinned = flat.collision_probability(plane, targets=targets, most_entries=3, max_iterations=3000)
    assert thinned.n == 3000
    simulation = Simulation(plane, make_source(plane, None, targets), rs.AllocationOptions("balanced"), 3)
    rates = simulation.expect(3000, rng).rates()
    assert abs(rates.mean() - exact.value) < 3.5 * rates.std() / np.sqrt(3000)


def test_a_generator_that_cannot_spawn_is_refused():

    legacy = np.random.Generator(np.random.RandomState(1)._bit_generator)
    refused("rng must be able to spawn", lambda: rs.collision_probability(lamost_like(1), rng=legacy))


BAD_OPTIONS = [
    ({"method": "quadrature", "density": []}, "density must be one of"),
    ({"method": "quadrature", "density": lambda xy: "much"}, "density must return numbers, got str"),
    ({"most_entries": True}, "most_entries must be a whole number"),
]


@pytest.mark.parametrize(("options", "words"), BAD_OPTIONS)
def test_bad_options_are_named(options, words):
    refused(words, lambda: flat.collision_probability(lamost_like(1), **options))


USERS = "only monte_carlo and conditional use it"


OPTIONS_WITHOUT_EFFECT = [
    ({"method": "quadrature", "interval": "bootstrap"}, f"interval has no effect with .* 'quadrature'; {USERS}"),
    ({"method": "quadrature", "stop": "convergence"}, f"stop has no effect with the method 'quadrature'; {USERS}"),
    ({"method": "quadrature", "targets": "poisson"}, f"targets has no effect with .* 'quadrature'; {USERS}"),
    (
        {"method": "quadrature", "allocator": "lamost_rule"},
        f"allocator has no effect with .* 'quadrature'; {USERS}",
    ),
    ({"method": "closed_form", "density": "uniform"}, "density has no effect with .*; only quadrature uses it"),
    (
        {"method": "closed_form", "precision": 0.1},
        "precision has no effect with the method 'closed_form'; only qua",
    ),
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
        found = flat.collision_probability(lamost_like(1), **options)
    assert 0 < found.value < 1
    assert len(told) == 1
    assert re.search(words, str(told[0].message))


@pytest.mark.parametrize("method", ["closed_form", "close_pair", "overlap_ratio", "quadrature", "conditional"])
def test_a_plane_without_a_usable_unit_is_refused(method):
    pitch = 25.6 if method != "conditional" else 60
    unit = lamost_like(1).positioner
    plane = rs.FocalPlane.hexagonal(unit, rings=1, pitch=pitch * MM, disabled=[True] * 7)
    refused("every positioner is disabled or stuck", rs.collision_probability, plane, method=method)


@pytest.mark.exhaustive
@pytest.mark.parametrize("n", [100, 300])
def test_points_of_neighbors_are_shifted_independently(n):
    """With equal shifts, few points would repeat, and the product over neighbors would be biased."""
    plane = sdss_like(2)
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
