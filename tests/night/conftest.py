"""Tests of nights compare with astropy, without a download of the tables of the Earth's rotation."""

from contextlib import ExitStack

import pytest
from astropy.utils import iers


@pytest.fixture(autouse=True)
def _no_network():
    changed = {"auto_download": False, "auto_max_age": None, "iers_degraded_accuracy": "ignore"}
    with ExitStack() as stack:
        for name, value in changed.items():
            stack.enter_context(iers.conf.set_temp(name, value))
        yield
