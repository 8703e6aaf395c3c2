"""The polynomial compared with least squares."""

import astropy.units as u
import numpy as np
import pytest

import rfpsurvey as rs
from reproduction._fit import fit_polynomial

MM = u.mm


def test_the_polynomial_is_found_exactly_where_there_is_one(rng):
    central_arm, ratio, pitch = rng.uniform((7, 1, 25), (14, 2, 35), (60, 3)).T
    value = 0.3 + 0.02 * central_arm - 0.01 * pitch + 0.1 * ratio**2 + (0.003 * central_arm - 0.0005 * pitch) * ratio
    fit = fit_polynomial(central_arm * MM, ratio, pitch * MM, value, rng=1)
    assert fit.r2_held_back > 1 - 1e-9
    assert fit.predict([9, 10] * MM, [1.5, 1.2], [30, 26] * MM) == pytest.approx(
        [0.3 + 0.18 - 0.3 + 0.225 + 0.0405 - 0.0225, 0.3 + 0.2 - 0.26 + 0.144 + 0.036 - 0.0156], abs=1e-5
    )
    again = fit_polynomial(central_arm * MM, ratio, pitch * MM, value, rng=1)
    assert (fit.coefficients == again.coefficients).all()


def test_held_back_designs_have_no_say(rng):
    central_arm, ratio, pitch = rng.uniform((7, 1, 25), (14, 2, 35), (60, 3)).T
    value = rng.random(60)
    fit = fit_polynomial(central_arm * MM, ratio, pitch * MM, value, rng=1)
    assert fit.r2_held_back < 0.5  # all values are equal
    assert fit.r2_held_back < fit.r2 < 0.6


def test_a_penalty_shrinks_what_noise_suggests(rng):
    central_arm, ratio, pitch = rng.uniform((7, 1, 25), (14, 2, 35), (40, 3)).T
    noisy = fit_polynomial(central_arm * MM, ratio, pitch * MM, rng.random(40), rng=1)
    assert noisy.penalty > 1e-3
    left = fit_polynomial(central_arm * MM, ratio, pitch * MM, central_arm * ratio, rng=1)
    assert left.penalty < 1e-6  # regularization has no effect


def test_a_fit_that_makes_no_sense_is_refused(rng):
    central_arm, ratio, pitch = rng.uniform((7, 1, 25), (14, 2, 35), (30, 3)).T
    options = {"central_arm": central_arm * MM, "ratio": ratio, "pitch": pitch * MM, "probability": ratio}
    for name, value, words in (
        ("probability", [0.1] * 5, "30 finite numbers"),
        ("probability", [np.nan] * 30, "30 finite numbers"),
        ("ratio", np.ones(30), "at least two different values"),
        ("held_back", 0.9, "held_back"),
        ("ratio", [[1.0] * 30] * 2, "must be one-dimensional and finite"),
        ("ratio", [1.0, 2.0], r"with the same length, got the shapes \(30,\), \(2,\), \(30,\)"),
    ):
        with pytest.raises(rs.InputError, match=words):
            fit_polynomial(**{**options, name: value})
