"""The format of numbers and text on pages."""

from dataclasses import replace

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

import rfpsurvey as rs
from rfpsurvey.report import estimate_facts
from rfpsurvey.report._text import column_texts, text_of


@given(st.lists(st.floats(-1e300, 1e300), min_size=1, max_size=5))
def test_numbers_keep_four_digits(values):
    for value, text in zip(values, column_texts(np.array(values)), strict=True):
        assert abs(float(text) - value) <= 0.5001e-3 * abs(value)


def test_numbers_of_a_column_have_the_same_decimals():
    assert column_texts(np.array([1.5, 12.25, 3.0])) == ["1.50", "12.25", "3.00"]
    assert column_texts(np.array([0.1234567, 1.0])) == ["0.1235", "1.0000"]
    assert column_texts(np.array([1e-7, 12345678.0, 12345.6])) == ["1.000e-07", "1.235e+07", "12346"]
    assert column_texts(np.array([True, False])) == ["yes", "no"]


def test_text_of_any_language_stays_as_it_is():
    """No-break spaces, ideographic spaces and joiners are kept.

    Characters that change the direction of text are replaced.
    """
    words = ["a\u00a0b", "\u65e5\u672c\u3000\u8a9e", "x\u200dy", "1\u202f000"]
    for word in words:
        assert text_of(word) == word
    assert text_of("a\r\nb\tc") == "a\nb\tc"
    assert text_of("a\x00b\u202ec\ud800") == "a\ufffdb\ufffdc\ufffd"


def test_small_probabilities_keep_their_digits(presets):
    estimate = rs.collision_probability(presets["desi"].with_arm_model("elbow_to_tip"), method="closed_form")
    rare = replace(estimate, value=3.2e-7, low=2.8e-7, high=3.6e-7, standard_error=2e-8)
    facts = estimate_facts(rare)
    assert facts["collision probability"].startswith("0.00000032")
    assert "0.00000028 to 0.00000036" in "".join(facts.values()).replace("280 ", "28 ").replace("360", "36")
