"""Fixtures of the tests of histories: a small survey that is planned once, and a copy of its folder for each test."""

import shutil

import pytest
from living import instrument, targets, tiling

import rfpsurvey as rs


@pytest.fixture(scope="module")
def case():
    """Return a catalog, an instrument and a tiling."""
    return targets(), instrument(), tiling()


@pytest.fixture(scope="module")
def planned(case, tmp_path_factory):
    """Return the folder of a survey without events."""
    folder = tmp_path_factory.mktemp("planned") / "survey"
    rs.plan_survey(*case, folder=folder, allocator="nearest")
    return folder


@pytest.fixture
def survey(planned, tmp_path):
    """Return a survey in a folder of its own."""
    return rs.Survey.read(shutil.copytree(planned, tmp_path / "survey"))
