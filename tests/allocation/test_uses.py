"""Warnings about options that an allocator does not use."""

from dataclasses import fields

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord

import rfpsurvey as rs
from rfpsurvey._assignment.methods import OPTIONS
from rfpsurvey.allocation import METHODS

CENTER = SkyCoord("6h20m +23d")
TILES = SkyCoord([95.0] * u.deg, [23.0] * u.deg)
INDEPENDENT = ("keep_out", "sky_separation", "constraints", "rules")
"""Options that affect the results of every allocator, and that no entry of the table names."""


@pytest.fixture(scope="module")
def sky():
    sky = rs.synthetic_catalog("uniform", CENTER, 0.2 * u.deg, n_targets=60, rng=1)
    return rs.Catalog(sky.coord, kind=np.where(np.arange(60) < 20, "sky", "science"))


def told_by(call):
    """Return the warnings that a call issues, as text."""
    with pytest.warns(rs.RfpsurveyWarning) as told:
        call()
    return [str(one.message) for one in told]


def test_the_table_contains_only_options_and_those_that_affect_every_allocator_are_not_in_it():
    names = {field.name for field in fields(rs.AllocationOptions)} - {"allocator"}
    assert {*OPTIONS} - {"rng"} <= names - {*INDEPENDENT}
    some = {"requirements", "objective", "time_limit", "start", "required", "subpriority", "moves", "programs"}
    assert some <= {*OPTIONS}


EFFECT = "has no effect with the allocator"
RNG = f"rng {EFFECT} 'network_flow'; only balanced uses it"
PARKED = "parked_obstacles has no effect because no positioner has two arms of equal"
UNUSED = [
    ("lamost_rule", {"objective": "count"}, f"objective {EFFECT} 'lamost_rule'; only network_flow and optimal use it"),
    ("repair", {"time_limit": 5 * u.s}, f"time_limit {EFFECT} 'repair'; only network_flow and optimal use"),
    ("optimal", {"start": "nearest"}, f"start {EFFECT} 'optimal'; only repair uses it"),
    ("nearest", {"requirements": "sky=2"}, f"requirements {EFFECT} 'nearest'; only lamost_rule, network_flow,"),
    ("balanced", {"required": [3]}, f"required {EFFECT} 'balanced'; only nearest, lamost_rule, network_flow,"),
    *(("network_flow", {"rng": rng}, RNG) for rng in (3, np.random.default_rng(1))),
    ("lamost_rule", {"parked_obstacles": False}, PARKED),
]


@pytest.mark.few(2)
@pytest.mark.parametrize(("allocator", "options", "words"), UNUSED)
def test_plans_warn_of_an_option_that_the_allocator_does_not_use(sky, allocator, options, words):
    own = {name: value for name, value in options.items() if name != "rng"}
    rng, asked = options.get("rng", 0), rs.AllocationOptions(allocator, **own)
    calls = {
        "plan_tile": lambda: rs.plan_tile(sky, "moons", CENTER, allocator=asked, rng=rng),
        "plan_survey": lambda: rs.plan_survey(sky, "moons", TILES, allocator=asked, rng=rng),
    }
    if "required" not in own:
        calls["place_tiles"] = lambda: rs.place_tiles(sky, "moons", allocator=asked, rng=rng)
    for name, call in calls.items():
        found = [text for text in told_by(call) if "no effect" in text]
        assert len(found) == 1, name
        assert found[0].startswith(words), name


@pytest.mark.filterwarnings("error")
def test_an_option_that_the_start_of_repair_uses_causes_no_warning(sky):
    asked = rs.AllocationOptions("repair", start="optimal", objective="count", time_limit=50 * u.s)
    tile = rs.plan_tile(sky, "moons", CENTER, allocator=asked)
    assert tile.provenance["parameters"]["objective"] == "count"
    rs.plan_tile(sky, "moons", CENTER, allocator=rs.AllocationOptions("repair", start="balanced"), rng=4)


def test_a_function_may_use_every_option(sky):
    asked = rs.AllocationOptions(METHODS["lamost_rule"].function, objective="count", time_limit=5 * u.s)
    rs.plan_tile(sky, "moons", CENTER, allocator=asked, rng=4)


@pytest.mark.filterwarnings("error")
def test_comparisons_warn_only_of_options_that_no_allocator_uses(sky):
    options = rs.AllocationOptions(requirements="sky=2", time_limit=50 * u.s)
    rs.compare_allocators(
        sky, "moons", CENTER, allocators=["nearest", "balanced", "lamost_rule"], options=options, rng=3
    )
    options = rs.AllocationOptions(start="nearest", parked_obstacles=False)
    one, two = told_by(lambda: rs.compare_allocators(sky, "moons", CENTER, allocators=["nearest"], options=options))
    assert one.startswith("start has no effect with the allocators 'network_flow' and 'nearest'; only repair uses it")
    assert two.startswith("parked_obstacles has no effect")
    (one,) = told_by(lambda: rs.compare_instruments(sky, ["moons"], allocators=["nearest"], rng=2))
    assert one.startswith("rng has no effect")
    rs.compare_instruments("uniform", ["moons"], allocators=["nearest"], n_realizations=1, rng=2)


def test_arrays_of_allocate_without_effect_cause_a_warning():
    plane = rs.FocalPlane([[0, 0]] * u.mm, rs.Positioner(8.25 * u.mm, 8.25 * u.mm, 2.25 * u.mm))
    points = [[3, 3], [5, 5]] * u.mm
    (text,) = told_by(lambda: rs.allocate(plane, points, allocator="balanced", required=[1]))
    assert text.startswith("required has no effect with the allocator 'balanced'")
    (text,) = told_by(lambda: rs.allocate(plane, points, avoid=points, allocator="balanced"))
    assert text.startswith("avoid has no effect without sky_separation")
