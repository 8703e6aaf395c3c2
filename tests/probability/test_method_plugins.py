"""Methods of collision probability of other packages."""

from dataclasses import replace

import astropy.units as u
import numpy as np
import pytest
from raising import refused

import flat
import rfpsurvey as rs
from packages import PAIR, always
from rfpsurvey.probability import Precision


def test_a_formula_of_a_package(small, hers):
    plane = replace(small.focal_plane, disabled=np.arange(37) < 2)
    found = rs.collision_probability(plane, method="quarter", dynamic=0.5)
    assert (found.value, found.value_assigned, found.method, found.estimand) == (0.625, 0.625, "quarter", "independent")
    assert np.isnan(found.per_positioner[:2]).all()
    assert (found.per_positioner[2:] == 0.625).all()
    assert np.isnan([found.low, found.high, found.standard_error, found.pairs_per_positioner]).all()
    assert found.meta["software"] == {"hers": "1.0"}
    refused(
        "'quarter' estimates the probability for 'independent' targets, not for 'allocated' targets",
        lambda: rs.collision_probability(plane, method="quarter", estimand="allocated"),
    )
    flat.collision_probability(plane, method="quarter", interval="bootstrap")  # a method of a package may use it
    table = rs.benchmark.benchmark_probability(small, efforts={"quarter": [0]}, repeats=1, precision=0.01)
    assert (table["method"][0], table["value"][0]) == ("quarter", 0.25)


def test_a_question_says_everything(small):
    seen = []

    def answer(question):
        seen.append(question)
        return {"value": 0.5, "n": 7, "meta": {"words": "mine"}}

    plane = small.focal_plane
    options = {"precision": 0.01, "max_iterations": 9, "confidence": 0.9, "parked_obstacles": False, "rng": 3}
    found = flat.collision_probability(plane, method=answer, **options)
    assert (found.value, found.n, found.meta["words"], found.meta["confidence"]) == (0.5, 7, "mine", 0.9)
    assert np.isnan(found.per_positioner).all()
    (question,) = seen
    assert question.focal_plane is plane
    assert question.precision == Precision(0.01, max_iterations=9, confidence=0.9)
    assert question.rng.random() == np.random.default_rng(3).random()
    assert (question.parked_obstacles, question.realize) == (False, None)
    rs.collision_probability(plane, method=answer)
    assert seen[1].precision == Precision(0.001, max_iterations=1_000_000)


def test_allocated_targets_are_those_asked_for(small, rng):
    xy = rng.uniform(-70, 70, (60, 2)) * u.mm

    def count(question):
        return {"value": rs.find_collisions(question.focal_plane, question.realize(question.rng)).rate}

    count.estimand = "allocated"
    for parked in (True, False):
        options = rs.AllocationOptions("nearest", parked_obstacles=parked)
        plan = rs.allocate(small.focal_plane, xy, allocator=options)
        found = rs.collision_probability(small, method=count, targets=xy, allocator=options)
        assert found.value == rs.find_collisions(small.focal_plane, plan).rate
    assert (found.estimand, found.meta["targets"], found.meta["allocator"]) == ("allocated", "given", "nearest")


def test_an_error_gives_an_interval(small):
    """The interval is Wilson's interval of 30 of 100 trials, as for the binomial distribution."""
    from astropy.stats import binom_conf_interval

    def answer(question):
        return {"value": 0.3, "standard_error": np.sqrt(0.3 * 0.7 / 100), "n": 100}

    with pytest.warns(
        rs.RfpsurveyWarning, match="the standard error after 100 iterations is 0.046: the confidence interval is"
    ):
        found = flat.collision_probability(small, method=answer, confidence=0.9)
    low, high = binom_conf_interval(30, 100, confidence_level=0.9, interval="wilson")
    assert (found.low, found.high, found.n_effective) == pytest.approx((low, high, 100))


def test_simulations_take_allocators_of_others(small, hers):
    options = {"method": "auto", "n_targets": 100, "max_iterations": 20}
    usual = flat.collision_probability(small, allocator="lamost_rule", **options)
    mine = flat.collision_probability(small, allocator="begin", **options)
    assert (mine.value, mine.method) == (usual.value, "monte_carlo")
    assert mine.meta["software"] == {"hers": "1.0"}
    own = flat.collision_probability(small, allocator=lambda problem: problem.start(), **options)
    assert own.value == usual.value
    assert own.meta["allocator"].endswith("<lambda>")


NO_ESTIMATES = [
    (None, r"must return a dict, or an array of the shape \(37,\) with a probability for each positioner, got None"),
    (0.5, r"got float of the shape \(\)"),
    (np.zeros(3), r"got ndarray of the shape \(3,\)"),
    (["a"] * 37, "must return a dict, or an array"),
    ([[1], [1, 2]], "must return a dict, or an array"),
    (np.full(37, 1.1), "per_positioner must be from 0 to 1, or NaN, got 1.1"),
    (np.full(37, -0.1), "per_positioner must be from 0 to 1, or NaN, got -0.1"),
    (np.full(37, np.nan), "the result must contain value, or per_positioner with the probability of"),
    ({}, "the result must contain value, or per_positioner"),
    ({"n": 3}, "the result must contain value, or per_positioner"),
    ({"values": 0.5}, "unknown field of a result 'values'; choose one of: high, low, meta, .* Did you mean 'value'"),
    ({"value": 0.5, "method": "x"}, "unknown field of a result 'method'"),
    ({"value": np.nan}, "value must be a number of at least 0 and at most 1, got nan"),
    ({"value": 1.5}, "value must be a number of at least 0 and at most 1, got 1.5"),
    ({"value": "0.5"}, "value must be a number"),
    ({"value": np.ones(3)}, "value must be a number"),
    ({"value": 0.5, "standard_error": -1}, "standard_error must be a number of at least 0, got -1"),
    ({"value": 0.5, "n": 1.5}, "n must be a whole number of at least 0, got 1.5"),
    ({"value": 0.5, "low": 0.6, "high": 0.7}, "must be in ascending order, got 0.6, 0.5 and 0.7"),
    ({"value": 0.5, "low": 0.4}, "low, value and high must be in ascending order, got 0.4, 0.5 and nan"),
    ({"value": 0.5, "meta": 3}, "meta must be a dict, got 3"),
]


@pytest.mark.parametrize(("answer", "words"), NO_ESTIMATES)
def test_what_no_estimate_can_be_is_refused(small, answer, words):
    with pytest.raises(rs.InputError, match=f"^the method of collision probability .*<lambda>': .*{words}"):
        rs.collision_probability(small, method=always(answer))


def test_an_estimand_must_be_one():
    def method(question):
        raise AssertionError

    method.estimand = "both"
    with pytest.raises(rs.InputError, match="method': unknown estimand 'both'; choose one of: allocated, independent"):
        rs.collision_probability(PAIR, method=method)
    with pytest.raises(rs.InputError, match="every positioner is disabled or stuck"):
        rs.collision_probability(replace(PAIR, disabled=[True, True]), method=lambda question: [0, 0])
