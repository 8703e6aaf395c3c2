"""Fixtures of the tests of commands."""

import re
import shlex
from typing import NamedTuple

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.table import QTable, Table

import rfpsurvey as rs
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


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """Return a folder with a catalog and a table of tiles."""
    folder = tmp_path_factory.mktemp("history")
    sky = rs.synthetic_catalog("poisson", SkyCoord("95d +23d"), 1.9 * u.deg, density=60 / u.deg**2, rng=3)
    rng = np.random.default_rng(1)
    sky = rs.Catalog(sky.coord, priority=rng.integers(1, 3, len(sky)), visits=rng.integers(1, 3, len(sky)))
    sky.write(folder / "stars.fits")
    tiles = QTable({"tile": [11, 12, 13, 14], "ra": [94.6, 95.4, 95, 95] * u.deg, "dec": [23, 23, 22.7, 23.4] * u.deg})
    tiles.write(folder / "tiles.ecsv")
    return folder


@pytest.fixture
def words(files):
    """Return the words of the command that plans the survey, without its folder."""
    command = "survey {} --tiles {} --instrument sdss_apo --allocator nearest"
    return (command, files / "stars.fits", files / "tiles.ecsv")


@pytest.fixture
def seen(monkeypatch):
    """Return a dict of the options with which a command calls ``plan_survey``, which then raises an error."""
    seen = {}

    def plan_survey(*_, **options):
        seen.update(options)
        raise rs.InputError("enough")

    monkeypatch.setattr(rs, "plan_survey", plan_survey)
    return seen


@pytest.fixture
def plan(call, words, tmp_path):
    """Return a function that plans a survey with options in the folder ``plan``, and returns the folder."""

    def plan(options="", *values):
        call(f"{words[0]} --folder {{}} {options}", *words[1:], tmp_path / "plan", *values)
        return tmp_path / "plan"

    return plan


@pytest.fixture
def record(call, tmp_path):
    """Return a function that records a table of observations in a folder, and returns what is printed."""

    def record(folder, options="", name="night.csv", **columns):
        Table(columns).write(tmp_path / name, overwrite=True)
        return call(f"record {{}} {{}} {options}", folder, tmp_path / name)

    return record
