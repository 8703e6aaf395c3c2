"""Hypothesis strategies."""

import numpy as np
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

# lengths below 1e-100 mm are excluded, because their squares underflow
millimeters = st.floats(-40, 40).map(lambda v: v if abs(v) > 1e-100 else 0.0)
# on a coarse grid, segments meet, touch and are collinear far more often than for random coordinates
coarse = st.integers(-6, 6).map(lambda k: 1.25 * k)
angles = st.floats(-np.pi, np.pi)
lengths = st.sampled_from([1.8, 2.375, 3.0, 7.4, 8.0, 8.25, 15.0, 17.0])


def segments(n):
    """Arrays of ``n`` segments, some of them degenerate."""
    return st.one_of(arrays(float, (n, 4), elements=millimeters), arrays(float, (n, 4), elements=coarse))


def points(n):
    """Arrays of ``n`` points."""
    return st.one_of(arrays(float, (n, 2), elements=millimeters), arrays(float, (n, 2), elements=coarse))
