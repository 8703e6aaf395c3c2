"""Failures of positioners in the realizations of a survey with recorded events."""

import importlib.util
from dataclasses import replace
from pathlib import Path

import astropy.units as u
import numpy as np
import pytest

import rfpsurvey as rs
from rfpsurvey._survey.selection.alternate import failure_rates
from rfpsurvey._survey.selection.work import Failures

SCRIPT = Path(__file__).parents[1] / "benchmarks" / "history_weights.py"
PLANE = rs.FocalPlane.hexagonal(rs.Positioner(8 * u.mm, 8 * u.mm, 2 * u.mm), rings=3, pitch=25.6 * u.mm)
PETALS = replace(PLANE, groups={"petal": np.arange(len(PLANE)) // 10})


def visits_of(n, *, lost=(), sky=(), blank=()):
    """Return visits of the first n positioners to science targets, apart from the given rows."""
    row, kind = np.arange(n), np.full(n, "science")
    kind[[*sky]] = "sky"
    row[[*blank]] = -1
    columns = {"positioner": PLANE.id[:n], "target_row": row, "observed": ~np.isin(np.arange(n), lost), "kind": kind}
    return np.rec.fromarrays([*columns.values()], names=[*columns])


def failed(*rows):
    return tuple(map(str, PLANE.id[[*rows]].tolist()))


def test_the_rate_is_the_fraction_of_visits_to_science_targets_without_collisions():
    visits = visits_of(36, lost=[3, 4], sky=[10, 11, 12], blank=[20])
    rates = failure_rates(PLANE, visits, failed(0, 1, 2, 3, 10, 20))
    np.testing.assert_array_equal(rates, 3 / (36 - 2 - 3 - 1))
    assert len(rates) == len(PLANE) == 37
    np.testing.assert_array_equal(failure_rates(PLANE, visits, ()), 0)
    np.testing.assert_array_equal(failure_rates(PLANE, visits_of(20, sky=range(20)), failed(1)), 0)


@pytest.mark.parametrize("plane", [PETALS, replace(PLANE, spectrograph=PETALS.groups["petal"])])
def test_a_petal_of_which_all_visits_failed_fails_in_all_realizations(plane):
    """Positioners of the petal without a visit fail, too, and the rate of the other petals does not count it."""
    visits = visits_of(36, sky=[10])
    visits = visits[np.arange(36) != 13]
    rates = failure_rates(plane, visits, failed(2, *(k for k in range(10, 20) if k != 13)))
    np.testing.assert_array_equal(rates, np.where(np.arange(37) // 10 == 1, 1, 1 / 26))


def test_a_petal_with_few_visits_can_fail_by_chance():
    few = np.arange(36) % 10 < 7  # seven visits in each petal
    rates = failure_rates(PETALS, visits_of(36)[few], failed(*range(10, 17)))
    np.testing.assert_array_equal(rates, 7 / few.sum())


def test_failures_at_several_times_are_coherent_and_have_the_given_rates():
    n, seeds = 5000, (3, 4)
    rates = {(): np.zeros(n), ("1",): np.full(n, 0.1), ("1", "2"): np.repeat([0.3, 1.0], n // 2)}
    fails = Failures((7, 2), rates).draw(seeds)
    assert fails.shape == (3, 2, n)
    assert not fails[0].any()
    assert (fails[1] <= fails[2]).all()
    assert fails[2, :, n // 2 :].all()
    np.testing.assert_allclose(fails[1].mean(axis=1), 0.1, atol=0.02)
    np.testing.assert_allclose(fails[2, :, : n // 2].mean(axis=1), 0.3, atol=0.03)


def test_failures_depend_only_on_the_seed_the_tile_its_plan_and_the_positioner():
    rates = {("1",): np.full(5000, 0.5)}
    fails = Failures((7, 2), rates).draw((3, 2**62))[0]
    np.testing.assert_array_equal(Failures((7, 2), rates).draw((2**62,))[0], fails[1:])
    others = [fails[1], *(Failures(key, rates).draw((3,))[0, 0] for key in ((2, 7), (8, 2), (7, 3)))]
    for other in others:
        assert 0.45 < (fails[0] == other).mean() < 0.55


def test_weights_of_targets_and_pairs_are_unbiased(monkeypatch):
    """Regression: realizations in which the same positioners failed gave sums of weights of 0.90 and 0.83."""
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1764547200")  # all plans are made before the observations
    spec = importlib.util.spec_from_file_location("history_weights", SCRIPT)
    script = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(script)
    found = script.sums(0.2, range(3), 128)
    error = {name: values.std() / len(values) ** 0.5 for name, values in found.items()}
    assert error["targets"] < 0.015
    assert error["pairs"] < 0.025
    for name, values in found.items():
        assert abs(values.mean() - 1) < 3 * error[name]
