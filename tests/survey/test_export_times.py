"""Tiles that are exported at times other than the planned ones, and what is recorded of them."""

import shutil

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.table import QTable
from astropy.time import Time
from numpy.testing import assert_allclose
from raising import refused

import rfpsurvey as rs

CENTERS = SkyCoord([95, 95.06, 94.9] * u.deg, [-5, -5, -4.95] * u.deg)
TIMES = Time(["2026-01-03T00:30", "2026-01-03T04:35", "2026-01-03T08:50"])
"""Hour angles of about -4.3, -0.2 and 4.1 h."""


@pytest.fixture(scope="module")
def case(presets, tmp_path_factory):
    """Return a survey of MOONS that was planned for the meridian, its catalog, the table of files, and their folder."""
    n, rng, folder = 9000, np.random.default_rng(0), tmp_path_factory.mktemp("times")
    sky = rs.synthetic_catalog("uniform", CENTERS[0], 0.3 * u.deg, n_targets=n, rng=3)
    kind = rng.choice(["science", "standard", "sky"], n, p=[0.8, 0.1, 0.1])
    catalog = rs.Catalog(sky.coord, id=5_000_000_000 + np.arange(n), kind=kind, priority=rng.integers(1, 4, n))
    table = QTable({"tile": [11, 12, 14], "ra": CENTERS.ra, "dec": CENTERS.dec, "position_angle": [0, 30, -20] * u.deg})
    tiling = rs.Tiling.from_table(table).with_conditions(rs.ObservingConditions("paranal", hour_angle=0 * u.deg))
    survey = rs.plan_survey(catalog, presets["moons"], tiling, allocator="repair", folder=folder / "plan")
    return survey, catalog, survey.export([11, 12, 14], times=TIMES, output=folder / "files"), folder / "files"


def points_at(survey, catalog, model, row, time):
    """Return the positions of all targets on the focal plane at a time."""
    conditions = rs.ObservingConditions("paranal", time=time)
    place = survey.tiles[row]
    projection = model.projection(
        SkyCoord(place["ra"], place["dec"]), position_angle=place["position_angle"], conditions=conditions
    )
    return projection.to_focal_plane(catalog.coord)


def test_positions_are_those_at_the_times(case, presets):
    survey, catalog, files, folder = case
    for row, (file, time) in enumerate(zip(files["file"], TIMES, strict=True)):
        tile, points = rs.Tile.read(folder / file), points_at(survey, catalog, presets["moons"], row, time)
        used = tile.table["status"] == "assigned"
        index = np.array(tile.table["target_id"][used]) - 5_000_000_000
        for axis, name in enumerate(("tip_x", "tip_y")):
            assert_allclose(tile.table[name][used].to_value(u.mm), points[index, axis].to_value(u.mm), atol=3e-3)
        assert tile.summary["n_out_of_reach"] == tile.summary["n_colliding"] == 0
        score = rs.score_tile(rs.plans.read_plan(folder / file))
        assert score.summary["n_assigned"] == files["n_assigned"][row] == used.sum()
        assert score.summary["n_colliding"] == score.summary["n_out_of_reach"] == 0


def test_only_fibers_that_lose_their_targets_change(case, presets):
    survey, catalog, files, folder = case
    changes, plane = QTable.read(folder / "changes.ecsv"), presets["moons"].focal_plane
    assert {*changes["reason"]} == {"out of reach", "would collide"}
    assert {*changes["date"]} == {"2026-01-02"}
    names = plane.id.astype(str).tolist()
    for row, name in enumerate((11, 12, 14)):
        visits, tile = survey.tile(name), rs.Tile.read(folder / files["file"][row]).table
        planned = dict(zip(visits["positioner"].astype(str), visits["target_id"], strict=True))
        used = tile["status"] == "assigned"
        now = dict(zip(tile["id"][used].astype(str), tile["target_id"][used], strict=True))
        of_tile = {str(change["positioner"]): change for change in changes[changes["tile"] == name]}
        assert files["n_changed"][row] == len(of_tile) > (0 if row != 1 else -1)
        assert {key: value for key, value in now.items() if key not in of_tile} == {
            key: value for key, value in planned.items() if key not in of_tile
        }
        points = points_at(survey, catalog, presets["moons"], row, TIMES[row])
        can = plane.reachable(points).toarray()
        index = {i: k for k, i in enumerate(catalog.id.tolist())}
        tips = np.full((len(plane), 2), np.nan)
        for key, value in now.items():
            tips[names.index(key)] = points[index[value]].to_value(u.mm)
        for key, change in of_tile.items():
            k, old = names.index(key), index[planned[key]]
            if change["reason"] == "out of reach":
                assert not can[k, old]
            else:  # the planned targets of all fibers that would collide do so, if the fiber keeps its own
                assert can[k, old]
            if change["good"]:
                assert change["swaps"]
                assert int(change["target"]) == now[key]
                assert now[key] not in planned.values()
                assert can[k, index[now[key]]]
                assert catalog.kind[index[now[key]]] == catalog.kind[old]
                continue
            # no other target of its kind can be observed without a collision
            assert key not in now
            assert not change["swaps"]
            assert int(change["target"]) == planned[key]
            for other in np.flatnonzero(can[k]).tolist():
                is_free = int(catalog.id[other]) not in {*planned.values(), *now.values()}
                if is_free and catalog.kind[other] == catalog.kind[old]:
                    moved = tips.copy()
                    moved[k] = points[other].to_value(u.mm)
                    assert rs.find_collisions(plane, moved * u.mm).in_collision[k]


@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
def test_changes_are_recorded_with_the_tiles(case, order, tmp_path):
    survey, catalog, _, folder = case
    shutil.copytree(survey.folder, tmp_path / "plan")
    copy = rs.Survey.read(tmp_path / "plan")
    tables = [
        QTable({"tile": [11, 12, 14], "state": ["done"] * 3, "date": ["2026-01-02"] * 3}),
        folder / "changes.ecsv",
    ]
    for number in order:
        copy.record(tables[number], replaces=False)
    changes = QTable.read(folder / "changes.ecsv")
    made = np.zeros(len(catalog), dtype=int)
    for name in (11, 12, 14):
        targets = {*map(int, survey.tile(name)["target_id"])}
        for change in changes[changes["tile"] == name]:
            k = survey.tile(name)["positioner"].astype(str).tolist().index(str(change["positioner"]))
            targets.discard(int(survey.tile(name)["target_id"][k]))
            if change["good"]:
                targets.add(int(change["target"]))
        made[np.array([*targets]) - 5_000_000_000] += 1
    is_science = catalog.kind == "science"
    assert copy.state().observed[is_science].tolist() == made[is_science].tolist()


def test_wrong_times(case, presets, tmp_path):
    survey, catalog, _, _ = case
    for options, text in (
        ({"times": TIMES[:2]}, r"times must have one time for each of the 3 tiles, got the shape \(2,\)"),
        ({"times": TIMES, "alternates": 1}, "times must be left out if alternates are given"),
        ({"times": TIMES + 9 * u.hour}, "must be above the horizon"),
    ):
        refused(text, survey.export, [11, 12, 14], output=tmp_path / "none", **options)
        assert not (tmp_path / "none").exists()
    plain = rs.plan_survey(catalog, presets["moons"], CENTERS[:1], allocator="nearest", folder=tmp_path / "plan")
    refused("times must be left out for a survey without", plain.export, [0], times=TIMES[:1], output=tmp_path / "none")
