"""Fixtures of the tests of commands."""

import re
import shlex
from typing import NamedTuple

import pytest

from refusals import sentence


class Ended(NamedTuple):
    """What a command without an error printed."""

    out: str
    err: str

    @property
    def lines(self):
        """Return the words of each line of the output by the label of the line."""
        return {line[:34].strip(): line[34:].split() for line in self.out.splitlines()}

    @property
    def text(self):
        """Return the output in one line."""
        return " ".join(self.out.split())


def split(words, values):
    """Return the words of a command in a text, in which values replace {}; further values are further words."""
    values = iter(values)
    return [*(re.sub("{}", lambda _: str(next(values)), word) for word in shlex.split(words)), *values]


@pytest.fixture
def call(run):
    """Return a function that runs a command such as ``call("plan {} --rng 1", path)`` and returns what it printed."""

    def call(words, *values):
        code, out, err = run(*split(words, values))
        assert code == 0, err
        return Ended(out, err)

    return call


@pytest.fixture
def refused(run):
    """Return a function that runs a command that is refused, and returns the sentence of the error."""
    return lambda words, *values: sentence(*run(*split(words, values))[::2])
