"""The record of an allocator: one entry in the table is sufficient for a new allocator."""

import inspect
import subprocess
import sys

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from raising import refused

import rfpsurvey as rs
from rfpsurvey._assignment.methods import DEFAULT_ALLOCATOR, Allocator
from rfpsurvey._common.descriptions import describe_methods, help_of
from rfpsurvey.allocation import METHODS

CENTER = SkyCoord("6h20m +23d")
TILES = SkyCoord([95.0] * u.deg, [23.0] * u.deg)


def lazy(problem):
    """Assign one target."""
    target_of = np.full(len(problem.focal_plane), -1)
    target_of[problem.pairs.owner[:1]] = problem.pairs.target[:1]
    return rs.allocation.AllocationAnswer(target_of)


NEW = Allocator("lazy", lazy, ("required",), "for tests", avoids_collisions=True, searches=True)


@pytest.fixture
def sky():
    return rs.synthetic_catalog("uniform", CENTER, 0.2 * u.deg, n_targets=60, rng=1)


@pytest.fixture
def new(monkeypatch):
    monkeypatch.setitem(METHODS, "lazy", NEW)


def test_one_entry_in_the_table_adds_an_allocator(new, sky):
    options = rs.AllocationOptions("lazy", time_limit=5 * u.s)
    with pytest.warns(
        rs.RfpsurveyWarning, match="time_limit has no effect with the allocator 'lazy'; only network_flow and"
    ):
        tile = rs.plan_tile(sky, "moons", CENTER, allocator=options)
    assert (tile.summary["n_assigned"], tile.provenance["parameters"]["time_limit_s"]) == (1, 60)
    with pytest.warns(rs.RfpsurveyWarning, match="nearest, lamost_rule, network_flow, optimal, repair and lazy use it"):
        rs.plan_tile(sky, "moons", CENTER, allocator=rs.AllocationOptions("balanced", required=[sky.id[0]]))
    assert rs.plan_survey(sky, "moons", TILES, allocator="lazy").summary["n_assigned"] == 1
    repaired = rs.AllocationOptions("repair", start="lazy")
    assert rs.plan_tile(sky, "moons", CENTER, allocator=repaired).summary["n_colliding"] == 0
    refused("a joint plan needs the allocator 'optimal', got 'lazy'", rs.JointOptions, allocator="lazy")
    table = rs.compare_instruments("uniform", ["moons"], allocators=["lazy"], n_realizations=1)
    assert table["high"].tolist() == [0]


def test_comparisons_reports_and_descriptions_contain_a_new_allocator(new, sky, tmp_path):
    table, tiles = rs.compare_allocators(sky, "moons", CENTER, return_tiles=True)
    assert table["allocator"].tolist() == list(METHODS)
    assert "lazy" in METHODS
    page = tmp_path / "tile.html"
    rs.write_report(tiles["lazy"], page)
    assert "time limit" in page.read_text()
    assert help_of(METHODS).endswith(", lazy (for tests)")

    class Options:
        """Options.

        {methods}
        """

    assert "        ``lazy``: Assign one target.\n" in describe_methods({"lazy": NEW})(Options).__doc__


def test_the_help_of_a_command_contains_every_allocator():
    lines = [
        "from rfpsurvey._assignment.methods import METHODS, Allocator",
        "METHODS['lazy'] = Allocator('lazy', len, summary='for tests')",
        "from rfpsurvey._cli import main",
        "main()",
    ]
    words = [sys.executable, "-c", "\n".join(lines), "plan", "--help"]
    text = subprocess.run(words, capture_output=True, text=True, check=True).stdout
    assert all(name in text for name in ["lazy", *METHODS])


def test_functions_can_declare_what_their_plans_have(sky):
    def own(problem):
        return problem.start()

    few = {"allocators": [own], "targets_per_positioner": 0.02, "n_realizations": 1}
    rs.plan_tile(sky, "moons", CENTER, allocator=rs.AllocationOptions(own, objective="count"))  # no warning
    table = rs.compare_instruments("uniform", ["moons"], **few)
    assert table["probability"][0] == 0 < table["high"][0]
    own.options, own.avoids_collisions, own.breaks_ties = ("required",), True, True
    with pytest.warns(
        rs.RfpsurveyWarning, match=r"objective has no effect with the allocator '.*own'; only network_flow and"
    ):
        tile = rs.plan_tile(sky, "moons", CENTER, allocator=rs.AllocationOptions(own, objective="count"))
    assert tile.provenance["parameters"]["objective"] == "priority"
    assert "tie_seed" not in tile.provenance["parameters"]  # only built-in allocators can break ties by a hash
    table = rs.compare_instruments("uniform", ["moons"], **few)
    assert table["high"].tolist() == [0]


INVALID_DECLARATIONS = [
    ("counts", "maybe", "own.*: unknown value of counts 'maybe'; choose one of: exactly, goal, no"),
    ("avoids_collisions", "yes", "own.*: avoids_collisions must be True or False, got 'yes'"),
    ("options", ["require"], "own.*: unknown option of an allocator 'require'.* Did you mean 'required'"),
]


@pytest.mark.parametrize(("name", "value", "words"), INVALID_DECLARATIONS)
def test_an_invalid_declaration_is_an_error(name, value, words):
    def own(problem):
        return lazy(problem)

    setattr(own, name, value)
    refused(words, rs.AllocationOptions, own)


def test_every_function_and_command_has_the_same_default_without_collisions(run, sky):
    assert METHODS[DEFAULT_ALLOCATOR].avoids_collisions
    assert rs.AllocationOptions().allocator == DEFAULT_ALLOCATOR
    for function in (rs.plan_tile, rs.plan_survey, rs.allocate, rs.selection_probabilities):
        assert inspect.signature(function).parameters["allocator"].default == DEFAULT_ALLOCATOR
    tiling = rs.place_tiles(sky, "moons", n_tiles=1)
    assert tiling.summary["completeness_means"].startswith(f"the allocator {DEFAULT_ALLOCATOR} plans")
    for command in ("plan", "survey", "select", "tile"):
        assert f"By default, {DEFAULT_ALLOCATOR}." in " ".join(run(command, "--help")[1].split())
