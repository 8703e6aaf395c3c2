"""The rule that ends iterations does not bias the mean of many estimates."""

import numpy as np
import pytest

from rfpsurvey._studies.quadrature import integrate
from rfpsurvey._studies.run import run
from rfpsurvey._studies.simulate import CollisionSums
from rfpsurvey._studies.targets import Source
from rfpsurvey.probability import Precision, ProbabilityQuestion
from scenes import lamost_like

PLANE = lamost_like(1)
SKIES = Source("poisson", 7.0, 1.0, (0.0, 0.0), 20.0, 0.0)
"""Random targets, so that each realization is another sky."""


def rare(p, counted):
    """Return realizations of ``counted`` positioners, two of which collide with the probability ``p``."""

    def task(size, rng):
        colliding = np.zeros((size, 4))
        colliding[:, 0], colliding[:, 1] = 2 * (rng.random(size) < p), counted
        hits = colliding[:, 0].sum()
        return CollisionSums(colliding, colliding[:, 0] / 2, np.full(7, hits / 7), np.full(7, size * counted // 7 + 1))

    return task


def runs(p, precision, counted, repeats, chunk=64):
    rngs, stop = np.random.default_rng(4).spawn(repeats), Precision(precision, 10_000_000)
    return [run(ProbabilityQuestion(PLANE, SKIES, precision=stop, rng=rng), rare(p, counted), chunk) for rng in rngs]


def estimates(p, precision, counted, repeats, chunk=64):
    found = runs(p, precision, counted, repeats, chunk)
    numbers = [sum(len(tally.pairs) for tally in tallies) for tallies, _ in found]
    return np.array([summary["value"] for _, summary in found]), np.array(numbers)


def test_a_number_of_rare_events_that_ends_the_iterations_is_no_bias():
    """Regression: iterations ended at the 25th collision, so that runs with early collisions ended early, and the mean
    was 4 % too large.
    """
    values, _ = estimates(0.2, 0.005, counted=70, repeats=2000, chunk=8)
    truth = 0.2 * 2 / 70
    assert values.mean() == pytest.approx(truth, abs=4 * values.std() / np.sqrt(2000))
    assert 4 * values.std() / np.sqrt(2000) < 0.025 * truth


@pytest.mark.exhaustive
@pytest.mark.parametrize("p", [0.005, 0.995])
def test_estimates_have_no_bias_and_intervals_have_their_coverage(p):
    """All counted positioners collide, or none does: the largest scatter for a given probability."""
    precision, repeats = min(p, 1 - p) / 10, 2000
    found = [summary for _, summary in runs(p, precision, counted=2, repeats=repeats)]
    values = np.array([summary["value"] for summary in found])
    assert abs(values.mean() - p) < precision / 20
    assert 0.93 < np.mean([summary["low"] <= p <= summary["high"] for summary in found]) < 0.97
    assert values.std() < 1.05 * precision


@pytest.mark.few(1)
@pytest.mark.parametrize("p", [0.003, 0.02])
def test_rare_collisions_are_not_underestimated(p):
    """Regression: a rule based only on the error ended after 128 realizations without a collision, and was 13 to 27 %
    too low.
    """
    values, numbers = estimates(p, 0.01, counted=2, repeats=500)
    # 512 realizations each: 4 times the standard error of the mean of 500 estimates
    assert values.mean() == pytest.approx(p, abs=4 * np.sqrt(p / 512 / 500))
    assert np.median(numbers) == 512


def test_a_precision_of_a_quarter_of_the_probability_is_no_bias():
    """A rule that ends iterations when the estimate itself is accurate has its largest bias in this case."""
    values, _ = estimates(0.04, 0.01, counted=2, repeats=500)
    assert values.mean() == pytest.approx(0.04, abs=4 * 0.0083 / np.sqrt(500))


def test_a_pair_of_many_positioners_needs_no_floor():
    """If a pair is a small fraction of the positioners, the precision is reached without a minimum number."""
    _, numbers = estimates(0.01, 0.01, counted=70, repeats=20)
    assert numbers.max() <= 128


class SkewedQuadrature:
    """A quadrature whose error has an exponential distribution and is proportional to 1 / ``n_points``."""

    plane, density = PLANE, "uniform"
    environments = np.zeros(1, dtype=np.int64), np.zeros(7, dtype=np.int64)

    def __call__(self, i, n_points, rng):
        return 0.1 + 2 * (rng.exponential() - 1) / n_points, 0.0


def test_the_number_of_points_of_a_quadrature_is_no_bias():
    """Regression: points whose error was small by chance were the last points."""
    rngs, stop = np.random.default_rng(4).spawn(4000), Precision(0.004).for_method(2**14, powers_of_two=True)
    questions = [ProbabilityQuestion(PLANE, precision=stop, rng=rng) for rng in rngs]
    values = np.array([integrate(SkewedQuadrature(), question)["value"] for question in questions])
    error = values.std() / np.sqrt(len(values))
    assert values.mean() == pytest.approx(0.1, abs=4 * error)
    assert error < 0.004 / 40
    assert values.std() < 0.004
