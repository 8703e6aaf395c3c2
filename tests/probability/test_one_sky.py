"""The interval of given targets, which describes other skies of the same kind."""

import numpy as np
import pytest
from scipy import stats

import flat
import rfpsurvey as rs
from rfpsurvey._studies.intervals import BEYOND, CORRELATION, sky_variance
from rfpsurvey._studies.run import rate_interval, summarize
from rfpsurvey._studies.simulate import Simulation
from rfpsurvey._studies.targets import make_source
from rfpsurvey.probability import Precision, ProbabilityQuestion, RandomTargets
from scenes import MM, lamost_like, sdss_like


def dense(plane, *, ring):
    """Return as matrices the adjacency of the nearest ring or of all neighbors, that of the neighbors beyond, and the
    projection that removes the profile.
    """
    n = len(plane)
    everyone, apart = np.zeros((n, n)), np.hypot(*(plane.arrays.xy[:, None] - plane.arrays.xy[None]).transpose(2, 0, 1))
    first, second = plane.neighbor_pairs().T
    everyone[first, second] = everyone[second, first] = 1
    design = np.column_stack([np.ones(n), everyone.sum(axis=1)])
    adjacency = everyone * (apart < 1.1 * apart[apart > 0].min()) if ring else everyone
    return adjacency, everyone - adjacency, np.eye(n) - design @ np.linalg.pinv(design)


def quadratic_form(adjacency, base, projection):
    """Return the symmetric matrix M of the only unbiased combination of e'e and e'Ae, by solving the two equations."""
    n, p, pa = len(base), projection, projection @ adjacency
    moments = np.array([[np.trace(p @ base), np.trace(pa)], [np.trace(pa @ p @ base), np.trace(pa @ pa)]])
    a, b = np.linalg.solve(moments.T, [base.sum() / n**2, adjacency.sum() / n**2])
    return p @ (a * np.eye(n) + b * adjacency) @ p


@pytest.mark.parametrize(
    ("plane", "ring"), [(lamost_like(2), False), (lamost_like(4), False), (sdss_like(3), True), (sdss_like(9), False)]
)
def test_the_variance_is_unbiased_for_correlated_neighbors_and_a_profile_at_the_edge(plane, ring, rng):
    adjacency, beyond, projection = dense(plane, ring=ring)
    n = len(plane)
    base = np.eye(n) + BEYOND * beyond
    form, covariance = quadratic_form(adjacency, base, projection), 0.04 * (base + 0.17 * adjacency)
    assert np.trace(form @ covariance) == pytest.approx(covariance.sum() / n**2, rel=1e-9)
    profile = 0.1 + 0.01 * (adjacency + beyond).sum(axis=1)
    correlated = np.linalg.cholesky(np.eye(n) + 0.1 * adjacency + 5 * np.eye(n))
    for _ in range(3):
        risk = profile + 0.02 * correlated @ rng.normal(size=n)
        away = projection @ risk
        floor = away @ away * base.sum() / np.trace(projection @ base) / n**2
        variance, degrees = sky_variance(plane, risk)
        assert variance == pytest.approx(max(risk @ form @ risk, floor), rel=1e-9)
    typical = form @ (base + CORRELATION * adjacency * (1 if ring else _share(plane)))
    assert degrees == pytest.approx(np.trace(typical) ** 2 / np.trace(typical @ typical), rel=1e-9)


def test_the_variance_is_not_below_that_of_positioners_with_uncorrelated_nearest_neighbors():
    plane = sdss_like(3)
    adjacency, beyond, projection = dense(plane, ring=True)
    vectors = np.linalg.eigh(projection @ adjacency @ projection)[1]
    away = projection @ vectors[:, 0]  # neighbors differ as much as possible
    assert away @ adjacency @ away < -1
    base = np.eye(37) + BEYOND * beyond
    floor = away @ away * base.sum() / np.trace(projection @ base) / 37**2
    assert sky_variance(plane, 0.3 + 0.1 * away)[0] == pytest.approx(0.01 * floor, rel=1e-9)


def test_without_neighbors_the_variance_is_that_of_a_mean_of_independent_values(rng):
    plane = rs.FocalPlane.hexagonal(lamost_like(1).positioner, rings=2, pitch=100 * MM)
    risk = rng.random(19)
    assert sky_variance(plane, risk) == pytest.approx((np.var(risk, ddof=1) / 19, 18), rel=1e-12)


def _share(plane):
    """Return the fraction of the neighbors that are in the nearest ring."""
    (ring, _, _), (everyone, _, _) = dense(plane, ring=True), dense(plane, ring=False)
    return ring.sum() / everyone.sum()


def test_alike_neighbors_make_the_variance_larger():
    plane = lamost_like(3)
    x = plane.xy.value[:, 0]
    variance, degrees = sky_variance(plane, 0.1 + 0.001 * x)
    assert variance > 3 * np.var(0.001 * x) / 37
    assert degrees == pytest.approx(7.6, abs=0.1)


@pytest.mark.few(1)
@pytest.mark.parametrize(("rings", "each"), [(2, 4), pytest.param(3, 4, marks=pytest.mark.exhaustive), (4, 1)])
def test_intervals_of_one_sky_hold_the_expectation_over_skies(rings, each):
    """With normal quantiles and uncorrected residuals, only 84 and 88 of 100 intervals contained the expected value
    over skies.
    """
    plane, n = lamost_like(rings), 400
    source = make_source(plane, None, RandomTargets(number=each * len(plane)))
    simulation, precision = Simulation(plane, source, rs.AllocationOptions("balanced")), Precision(None, 1)
    truth = simulation.expect(4000, np.random.default_rng(1)).rates().mean()
    rng = np.random.default_rng(2)
    question = ProbabilityQuestion(plane, precision=precision, rng=rng)  # each realization is one sky
    found = [summarize([simulation.expect(1, rng)], question) for _ in range(n)]
    assert stats.binom.ppf(1e-3, n, 0.95) <= sum(f["low"] <= truth <= f["high"] for f in found)
    scatter = np.std([f["value"] for f in found])
    # four standard errors: 5 % for the scatter of 400 skewed values, 3 % for the root of the mean variance
    assert np.sqrt(np.mean([f["standard_error"] ** 2 for f in found])) == pytest.approx(scatter, rel=0.25)


@pytest.mark.parametrize("method", ["conditional", "monte_carlo"])
def test_seven_positioners_have_no_interval_and_the_result_states_the_reason(method):
    xy = np.random.default_rng(1).uniform(-40, 40, (28, 2)) * MM
    got = flat.collision_probability(lamost_like(1), method=method, targets=xy, max_iterations=100)
    assert 0 < got.value < 1
    assert np.isnan([got.low, got.high, got.standard_error, got.n_effective]).all()
    assert got.meta["no_interval"].startswith("the focal plane has too few positioners to estimate how much")
    assert "[" not in repr(got)
    assert "no_interval" not in flat.collision_probability(lamost_like(1), n_targets=28, max_iterations=100).meta


def test_iterations_on_a_given_sky_end_although_it_has_no_interval():
    xy = np.random.default_rng(1).uniform(-40, 40, (28, 2)) * MM
    got = rs.collision_probability(lamost_like(1), method="monte_carlo", targets=xy, precision=0.005)
    assert got.n < 5000
    assert "no_interval" in got.meta


def test_iterations_without_a_collision_say_nothing_of_other_skies():
    """One sky with 37 positioners has at most 37 trials, for any number of configurations."""
    plane = lamost_like(3)
    got = flat.collision_probability(plane, method="monte_carlo", targets=plane.xy, max_iterations=500)
    assert (got.value, got.low) == (0, 0)
    assert got.high > stats.binomtest(0, 37).proportion_ci(method="wilson").high


def test_fields_together_have_an_interval_where_a_single_one_has_none(rng):
    plane, fields = lamost_like(1), [(rng.random(7) < 0.3).astype(float) for _ in range(6)]
    value, low, high = rate_interval(plane, fields[:1], 0.95)
    assert value == fields[0].mean()
    assert np.isnan([low, high]).all()
    value, low, high = rate_interval(plane, fields, 0.95)
    assert low < value < high


def test_too_few_positioners_that_count_have_no_variance():
    risk = np.full(37, np.nan)
    risk[:2] = 0.1, 0.2
    variance, degrees = sky_variance(lamost_like(3), risk)
    assert np.isnan(variance)
    assert degrees == 0
