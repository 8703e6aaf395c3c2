"""The size of the error, the rule that ends iterations, and the independence of results from all other settings."""

from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor

import numpy as np
import pytest
from raising import refused, warned
from scipy import stats

import flat
import rfpsurvey as rs
from rfpsurvey._studies.intervals import INTERVALS, converged, effective_number, quantile, wilson
from rfpsurvey.probability import Precision
from scenes import MM, both_hands, lamost_like, sdss_like

FIELDS = ("value", "value_assigned", "low", "high", "standard_error", "n", "n_effective", "pairs_per_positioner")
METHODS = ("conditional", "monte_carlo", "quadrature")


def assert_identical(one, other):
    for name in FIELDS:
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    np.testing.assert_array_equal(one.per_positioner, other.per_positioner)


class Recorder:
    """A function that draws targets and records them."""

    def __init__(self, n=20, edge=45):
        self.n, self.edge, self.skies = n, edge, []

    def __call__(self, rng):
        self.skies.append(rng.uniform(-self.edge, self.edge, (self.n, 2)) * MM)
        return self.skies[-1]

    def rates(self, plane):
        """Return the rates of one configuration for each sky, computed with public functions."""
        reports = [rs.find_collisions(plane, rs.allocate(plane, xy, allocator="lamost_rule")) for xy in self.skies]
        return np.array([r.rate for r in reports])


@pytest.mark.parametrize("confidence", [0.68, 0.9, 0.95, 0.999])
@pytest.mark.parametrize(("k", "n"), [(0, 1), (1, 1), (0, 50), (50, 50), (3, 7), (11, 400), (399, 400), (20, 10_000)])
def test_wilson_is_that_of_scipy(k, n, confidence):
    expected = stats.binomtest(k, n).proportion_ci(confidence, method="wilson")
    got = wilson(k / n, n, stats.norm.ppf((1 + confidence) / 2))
    assert got == pytest.approx((expected.low, expected.high), abs=1e-12)
    assert got[0] == 0 or k > 0


def test_wilson_without_trials_and_with_endless_ones():
    assert wilson(0.3, 0, 1.96) == (0, 1)
    assert wilson(0.3, np.nan, 1.96) == (0, 1)
    assert wilson(0.3, np.inf, 1.96) == (0.3, 0.3)


def test_effective_trials_would_have_the_error():
    for p, error in ((0.1, 0.02), (0.5, 1e-3), (0.99, 0.1)):
        assert np.sqrt(p * (1 - p) / effective_number(p, error, 7)) == pytest.approx(error)
    assert effective_number(0.3, 0.0, 7) == effective_number(0.0, 0.1, 7) == effective_number(1.0, 0.1, 7) == 7


def test_a_bootstrap_in_pieces_is_one_in_a_piece():
    """If there are many rates, resampling is done in several parts to limit the memory."""
    rates, n = np.random.default_rng(1).random(1000), 1500
    drawn = rates[np.random.default_rng(2).integers(0, len(rates), (n, len(rates)))].mean(axis=1)
    found = INTERVALS["bootstrap"]([rates], rates.mean(), 1000.0, 1000, 2.0, 0.9, np.random.default_rng(2), n_samples=n)
    assert found == pytest.approx(np.quantile(drawn, [0.05, 0.95]).tolist(), abs=1e-12)


def test_quantiles():
    for confidence in (0.5, 0.95, 0.999):
        level = (1 + confidence) / 2
        assert quantile(confidence, np.inf) == pytest.approx(stats.norm.ppf(level))
        for freedom in (1, 7, 300):
            assert quantile(confidence, freedom) == pytest.approx(stats.t.ppf(level, freedom))


@pytest.mark.parametrize("n", [2, 30, 200])
@pytest.mark.parametrize("confidence", [0.8, 0.95])
def test_the_interval_comes_from_the_scatter_of_iterations(n, confidence):
    plane, sampler = sdss_like(1), Recorder(8, 30)
    options = {"targets": sampler, "allocator": "lamost_rule", "confidence": confidence, "max_iterations": n}
    got = flat.collision_probability(plane, method="monte_carlo", **options)
    rates = sampler.rates(plane)
    p, error = rates.mean(), rates.std(ddof=1) / np.sqrt(n)
    assert 0 < p < 1
    assert got.standard_error == pytest.approx(error)
    trials = p * (1 - p) / error**2
    assert got.n_effective == pytest.approx(trials)
    q = stats.t.ppf((1 + confidence) / 2, n - 1)
    # definition of Wilson's interval: p differs from each end by q standard errors, computed at this end
    for bound in (got.low, got.high):
        assert (p - bound) ** 2 == pytest.approx(q**2 * bound * (1 - bound) / trials, rel=1e-6)
    assert got.low < p < got.high
    assert got.meta["design_effect"] == pytest.approx(got.meta["trials"] / trials)


def test_without_a_collision_every_iteration_is_a_trial():
    got = flat.collision_probability(lamost_like(1), method="monte_carlo", n_targets=0, max_iterations=40)
    exact = stats.binomtest(0, 40).proportion_ci(method="wilson")
    assert (got.value, got.low, got.n_effective) == (0, 0, 40)
    # the quantile may be larger for few iterations, but is not smaller than that of the normal distribution
    assert exact.high * (1 - 1e-9) <= got.high < 1.1 * exact.high
    # two arms always collide, which is the opposite
    plane = rs.FocalPlane([[0, 0], [8, 0]] * MM, rs.Positioner(8 * MM, 8 * MM, 30 * MM))
    got = flat.collision_probability(plane, method="monte_carlo", n_targets=20, max_iterations=40)
    assert got.value == pytest.approx(got.high) == 1
    assert 1 - 1.1 * exact.high < got.low <= 1 - exact.high + 1e-9


def test_every_positioner_as_a_trial_of_its_own_is_naive():
    plane = sdss_like()
    options = {"method": "monte_carlo", "n_targets": 1000, "max_iterations": 300}
    naive = flat.collision_probability(plane, interval="wilson_naive", **options)
    trials = naive.meta["trials"]
    assert trials == 300 * 37  # all positioners have targets
    k = round(naive.value * trials)
    assert k / trials == pytest.approx(naive.value, abs=1e-12)
    expected = stats.binomtest(k, trials).proportion_ci(method="wilson")
    assert (naive.low, naive.high) == pytest.approx((expected.low, expected.high), abs=1e-12)
    honest = flat.collision_probability(plane, **options)
    assert honest.value == naive.value
    # collisions occur in pairs; if pairs are independent, the variance is at least twice as large
    assert (honest.high - honest.low) > 1.2 * (naive.high - naive.low)
    assert honest.meta["design_effect"] > 1.4


def test_the_midpoint_with_iterations_as_trials_is_the_estimator_of_the_paper():
    plane, options = lamost_like(1), {"method": "monte_carlo", "n_targets": 12, "max_iterations": 300}
    mean = flat.collision_probability(plane, **options)
    paper = flat.collision_probability(plane, interval="wilson_iterations", estimator="midpoint", **options)
    z = stats.norm.ppf(0.975)
    assert paper.value == pytest.approx((mean.value + z**2 / 600) / (1 + z**2 / 300), abs=1e-12)
    assert paper.value == pytest.approx((paper.low + paper.high) / 2)
    assert paper.standard_error == mean.standard_error
    assert (paper.meta["estimator"], "estimator" in mean.meta) == ("midpoint", False)
    warned("estimator", flat.collision_probability, plane, method="quadrature", estimator="midpoint", max_iterations=64)
    refused("unknown estimator", Precision, estimator="median")


@pytest.mark.few(1)
@pytest.mark.parametrize("confidence", [0.8, 0.95])
def test_bootstrap_is_that_of_scipy(confidence):
    plane, sampler = sdss_like(1), Recorder(8, 30)
    options = {"targets": sampler, "allocator": "lamost_rule", "confidence": confidence, "max_iterations": 200}
    got = flat.collision_probability(plane, method="monte_carlo", interval="bootstrap", **options)
    rates = sampler.rates(plane)
    expected = stats.bootstrap(
        (rates,), np.mean, confidence_level=confidence, n_resamples=20_000, method="percentile", random_state=1
    ).confidence_interval
    # percentiles of 2000 resamples scatter by sqrt(q (1 - q) / 2000) over the density, 0.06 standard errors
    error = 4 * 0.065 * got.standard_error
    assert (got.low, got.high) == pytest.approx((expected.low, expected.high), abs=error)
    assert got.low < got.value < got.high


def test_convergence_is_three_small_steps_in_a_row():
    assert converged([1.0, 0.5, 0.49, 0.48, 0.47], 0.011)
    assert not converged([1.0, 0.5, 0.49, 0.48], 0.011)
    assert not converged([0.5, 0.49, 0.48, 0.45], 0.011)
    assert not converged([0.5, 0.5, 0.5], 0.011)
    assert not converged([], 0.011)
    assert not converged([np.nan, 0.5, 0.5, 0.5], 0.011)


@pytest.mark.parametrize(("method", "chunk"), [("monte_carlo", 64), ("conditional", 8)])
def test_convergence_stops_at_the_first_quiet_stretch(method, chunk):
    """Apply the rule to the running mean, which the package tests after each task."""
    plane, sampler, tolerance = sdss_like(1), Recorder(8, 30), 0.004
    options = {"method": method, "targets": sampler, "allocator": "lamost_rule"}
    got = flat.collision_probability(plane, stop="convergence", precision=tolerance, **options)
    rates = sampler.rates(plane)
    assert len(rates) == got.n
    means = np.cumsum(rates)[chunk - 1 :: chunk] / np.arange(chunk, got.n + 1, chunk)
    small = np.abs(np.diff(means)) < tolerance
    quiet = [bool(small[k - 3 : k].all()) for k in range(3, len(small) + 1)]
    assert quiet[-1]
    assert not any(quiet[:-1])
    assert len(quiet) > 1


def test_convergence_stops_too_early():
    plane, options = lamost_like(), {"method": "monte_carlo", "n_targets": 200, "precision": 5e-4}
    early = flat.collision_probability(plane, stop="convergence", **options)
    honest = flat.collision_probability(plane, **options)
    assert early.n < honest.n / 2
    assert early.standard_error > 2 * 5e-4
    assert honest.standard_error < 5e-4


@pytest.mark.parametrize("method", METHODS)
def test_an_executor_changes_nothing(method):
    plane, options = lamost_like(1), {"method": method, "n_targets": 30, "precision": 0.002, "rng": 7}
    if method == "quadrature":
        options = {"method": method, "precision": 2e-4, "rng": 7}
    here = flat.collision_probability(plane, **options)
    assert here.n > 64
    for workers in (2, 3):
        with ThreadPoolExecutor(workers) as executor:
            assert_identical(here, flat.collision_probability(plane, executor=executor, **options))


def a_few(rng):
    return rng.uniform(-30, 30, (9, 2)) * MM


def test_nor_do_threads_and_processes_where_python_allocates():
    given = np.random.default_rng(2).uniform(-30, 30, (40, 2)) * MM
    cases = [(lamost_like(1), options) for options in ({}, {"method": "monte_carlo"}, {"method": "quadrature"})]
    for executor, own in (
        (ProcessPoolExecutor(2), [*cases, (lamost_like(1), {"targets": a_few})]),
        (
            ThreadPoolExecutor(3),
            [
                (sdss_like(1), {"targets": a_few}),
                (both_hands(), {"n_targets": 40}),
                (sdss_like(1), {"n_targets": 20, "allocator": "lamost_rule", "method": "monte_carlo"}),
                (sdss_like(1), {"targets": given, "most_entries": 2}),
            ],
        ),
    ):
        with executor:
            for plane, options in own:
                here = flat.collision_probability(plane, max_iterations=80, **options)
                there = flat.collision_probability(plane, max_iterations=80, executor=executor, **options)
                assert_identical(here, there)


@pytest.mark.few(2)
@pytest.mark.parametrize(
    ("method", "interval"),
    [*((m, "wilson") for m in METHODS), ("monte_carlo", "bootstrap"), ("conditional", "bootstrap")],
)
def test_the_same_seed_gives_the_same_result(method, interval):
    plane, options = sdss_like(1), {"method": method, "interval": interval, "max_iterations": 1000}
    one = flat.collision_probability(plane, **options, rng=3)
    assert_identical(one, flat.collision_probability(plane, **options, rng=3))
    assert_identical(one, flat.collision_probability(plane, **options, rng=np.random.default_rng(3)))
    default = flat.collision_probability(plane, **options)
    assert_identical(default, flat.collision_probability(plane, **options, rng=0))
    assert (one.per_positioner != default.per_positioner).any()
    anew = [flat.collision_probability(plane, **options, rng=None).per_positioner for _ in range(2)]
    assert (anew[0] != anew[1]).any()


@pytest.mark.parametrize(
    ("plane", "options"),
    [
        (lamost_like(), {"n_targets": 200}),
        (sdss_like(2), {"n_targets": 30}),
        (lamost_like(), {"targets": "poisson", "n_targets": 100, "confidence": 0.8}),
    ],
    ids=["equal", "unequal", "poisson"],
)
@pytest.mark.parametrize("method", ["conditional", "monte_carlo"])
@pytest.mark.parametrize("precision", [0.004, 0.001])
def test_the_precision_is_reached_and_not_much_more(method, plane, options, precision):
    got = flat.collision_probability(plane, method=method, precision=precision, **options)
    z = stats.norm.ppf((1 + options.get("confidence", 0.95)) / 2)
    assert (got.high - got.low) / 2 <= z * precision
    assert got.standard_error <= precision
    if got.n > 200:  # the number of iterations is predicted from at least 16 of them, which give the error to 20 %
        assert got.standard_error > 0.6 * precision


def test_the_precision_is_a_thousandth_by_default():
    assert 0.0006 < flat.collision_probability(sdss_like(2), n_targets=40).standard_error <= 0.001


@pytest.mark.parametrize("n", [1, 2, 37, 64, 130])
@pytest.mark.parametrize("method", ["conditional", "monte_carlo"])
def test_so_many_iterations_and_no_more(method, n):
    plane, sampler = lamost_like(1), Recorder(12)
    assert flat.collision_probability(plane, method=method, max_iterations=n).n == n
    got = flat.collision_probability(plane, method=method, targets=sampler, max_iterations=n)
    assert got.n == n == len(sampler.skies)
    assert (got.low <= got.value <= got.high) == (n > 1)  # there is no interval for seven positioners and one sky


@pytest.mark.parametrize("method", ["conditional", "monte_carlo"])
def test_a_precision_out_of_reach_is_a_warning(method):
    words = "after 40 iterations .the maximum. is .* too wide for the requested standard error 0.0001"
    with pytest.warns(rs.RfpsurveyWarning, match=words):
        got = flat.collision_probability(sdss_like(1), method=method, precision=1e-4, max_iterations=40)
    assert got.n == 40
    enough = flat.collision_probability(sdss_like(1), method=method, precision=0.05, max_iterations=1000)
    assert enough.n < 1000


@pytest.fixture(scope="module")
def sky_and_others():
    """Return the targets of one sky, and the values of 300 other skies."""
    rng = np.random.default_rng(20260101)
    xy, skies = rng.uniform(-80, 80, (150, 2)), rng.uniform(-80, 80, (300, 150, 2)) * MM
    return xy, [rs.collision_probability(sdss_like(), targets=sky).value for sky in skies]


@pytest.mark.few(1)
@pytest.mark.parametrize("method", ["conditional", "monte_carlo"])
def test_one_given_sky_has_an_error_all_the_same(method, sky_and_others):
    """The value of given targets is known, but the value of another patch of the same sky is not."""
    plane, (xy, others) = sdss_like(), sky_and_others
    got = flat.collision_probability(plane, method=method, targets=xy * MM, max_iterations=500)
    exact = rs.collision_probability(plane, targets=xy * MM)
    assert got.low < got.value < got.high
    assert abs(got.value - exact.value) <= 3 * got.standard_error
    # the scatter of independent skies, which a single sky shows to about a factor of two
    assert 0.5 < got.standard_error / np.std(others) < 2
    if method == "conditional":
        assert got.n == 1
        assert_identical(exact, rs.collision_probability(plane, targets=xy * MM, rng=99))
        assert_identical(exact, rs.collision_probability(plane, targets=xy * MM, precision=1e-9))


def test_queues_of_one_leave_nothing_to_average():
    plane, options = sdss_like(2), {"n_targets": 6, "max_iterations": 4000}
    methods = "conditional", "monte_carlo"
    conditional, plain = (flat.collision_probability(plane, method=method, **options) for method in methods)
    assert abs(conditional.value - plain.value) < 3 * np.hypot(conditional.standard_error, plain.standard_error)
    # few of 6 targets on 19 positioners are in the same queue, so that the scatter is slightly smaller
    assert 0.7 < conditional.standard_error / plain.standard_error < 1.1
    assert conditional.n == plain.n == 4000


@pytest.mark.parametrize("method", ["conditional", "monte_carlo"])
@pytest.mark.parametrize("n", [1, 50])
def test_a_sampler_that_always_says_the_same_has_an_error(method, n):
    """The iterations do not scatter, but the value of other targets is uncertain."""
    plane, xy = sdss_like(3), np.random.default_rng(5).uniform(-70, 70, (30, 2)) * MM
    options = {"targets": lambda rng: xy, "allocator": "lamost_rule", "max_iterations": n}
    got = flat.collision_probability(plane, method=method, **options)
    report = rs.find_collisions(plane, rs.allocate(plane, xy, allocator="lamost_rule"))
    assert 0 < report.rate < 1
    assert got.value == pytest.approx(report.rate)
    assert got.standard_error > 0.01
    assert got.high - got.low > 0.02
    assert got.low < got.value < got.high


def test_confidence_widens_the_interval():
    plane, widths = lamost_like(1), []
    for confidence in (0.5, 0.9, 0.99):
        got = flat.collision_probability(plane, max_iterations=100, confidence=confidence)
        widths.append(got.high - got.low)
    assert widths == sorted(widths)
    assert widths[0] > 0
