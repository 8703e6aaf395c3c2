"""The judge of plans of all programs, which uses shapely and nothing of rfpsurvey, against `score_tile`."""

import sys
from dataclasses import replace
from pathlib import Path

import astropy.units as u
import numpy as np
import pytest
from astropy.table import QTable, Table

import rfpsurvey as rs

sys.path.insert(0, str(Path(__file__).parents[1] / "benchmarks" / "planners"))
import judge
import scene as scenes

ALLOCATORS = ("nearest", "lamost_rule", "repair", "optimal", "network_flow")


def random_case(seed, presets):
    """Return an instrument with a few positioners, some of them stuck or disabled, and targets around them."""
    rng, name = np.random.default_rng(seed), sorted(presets)[seed % len(presets)]
    plane = presets[name].focal_plane
    rows = np.sort(np.argsort(np.hypot(*(plane.xy.value - plane.xy.value[rng.integers(len(plane))]).T))[:60])
    stuck = np.where(rng.uniform(size=(60, 1)) < 0.1, rng.uniform(0, 180, (60, 2)), np.nan)
    part = replace(
        plane,
        xy=plane.xy[rows],
        id=plane.id[rows],
        spectrograph=plane.spectrograph[rows],
        fiber_type=plane.fiber_type[rows],
        groups={name: values[rows] for name, values in (plane.groups or {}).items()},
        disabled=rng.uniform(size=60) < 0.05,
        stuck=stuck * u.deg,
    )
    xy = plane.xy[rows][rng.integers(60, size=150)].value + rng.normal(0, plane.arrays.outer_radius.max() / 2, (150, 2))
    kinds = rng.choice(["science", "sky", "standard"], 150, p=[0.7, 0.2, 0.1])
    table = Table({"x": xy[:, 0], "y": xy[:, 1], "priority": rng.integers(1, 4, 150).astype(float), "kind": kinds})
    types = sorted({one for names in part.fiber_type for one in str(names).split("+")})
    table["fiber_type"] = rng.choice(types, 150)
    return replace(presets[name], focal_plane=part), table


def check(seed, presets):
    """Compare the counts of the judge with those of `score_tile` for one plan."""
    instrument, table = random_case(seed, presets)
    plane, allocator = instrument.focal_plane, ALLOCATORS[seed % len(ALLOCATORS)]
    columns = {name: np.asarray(table[name]) for name in ("priority", "kind", "fiber_type")}
    xy = np.column_stack([table["x"], table["y"]]) * u.mm
    plan = rs.allocate(plane, xy, allocator=allocator, **columns)
    target = plan.target_of_positioner
    rows = np.flatnonzero((target >= 0) & plane.arrays.usable)
    used = Table({"positioner": plane.id[rows], "target": target[rows]})
    given = QTable({"positioner": plane.id[rows], "x": xy[target[rows], 0], "y": xy[target[rows], 1]})
    given["fiber_type"] = columns["fiber_type"][target[rows]]
    if plan.handedness is not None:
        used["side"] = given["handedness"] = np.asarray(plan.handedness)[rows]
    case = scenes.scene_of(instrument, table, name="case")
    found = judge.judge((case.positioners, case.targets, case.settings), used)
    score = rs.score_tile(given, instrument)
    assert not found["wrong"]
    assert found["assigned"] == len(rows) == score.summary["n_assigned"]
    assert found["pairs"] == score.summary["n_colliding_pairs"]
    inside = np.isin(score.table["id"], plane.id[rows])
    assert found["colliding"] == int(np.asarray(score.table["in_collision"])[inside].sum())
    return found["colliding"]


@pytest.mark.filterwarnings("ignore::rfpsurvey.RfpsurveyWarning")
@pytest.mark.parametrize("seeds", [range(6), pytest.param(range(6, 30), marks=pytest.mark.exhaustive)])
def test_the_judge_and_the_score_of_a_tile_agree(presets, seeds):
    assert sum(check(seed, presets) for seed in seeds) > len(seeds) - 6


def test_a_scene_is_read_as_it_was_written(presets, tmp_path):
    instrument, table = random_case(0, presets)
    scene = scenes.scene_of(instrument, table, ("sky=3/spectrograph",), name="case")
    scene.write(tmp_path / "scene.fits")
    again = scenes.Scene.read(tmp_path / "scene.fits")
    assert again.settings == scene.settings
    for one, other in ((again.positioners, scene.positioners), (again.targets, scene.targets)):
        for name in other.colnames:
            np.testing.assert_array_equal(np.asarray(one[name]), np.asarray(other[name]))
