"""Alternates of the fibers of tiles of a survey, against naive counts of visits and moves of one arm at a time."""

import astropy.units as u
import living
import numpy as np
import pytest
from astropy.table import QTable
from raising import refused

import rfpsurvey as rs


def naive(survey, case, name, state):
    """Return (positioner, target, visits left, other tiles) of all possible alternates of a tile, best first."""
    catalog, model, _ = case
    plane, row = model.focal_plane, survey.tiles["tile"].tolist().index(name)
    place = [survey.tiles[axis][row].to_value(u.rad) for axis in ("ra", "dec", "position_angle")]
    points = model.field_projection(*place, None).project(catalog.coord.cartesian.xyz.value.T)
    is_open = [event is None for event in map(state.closed.get, range(len(survey)))]
    n_planned = dict.fromkeys(catalog.id.tolist(), 0)
    for k in np.flatnonzero(is_open):
        for visit in survey.tile(survey.tiles["tile"][k]):
            n_planned[int(visit["target_id"])] += bool(visit["observed"])
    visits = survey.tile(name)
    target_of = dict(zip(visits["positioner"].tolist(), visits["target_id"].tolist(), strict=True))
    index = {target: k for k, target in enumerate(catalog.id.tolist())}
    tips = np.array([points[index[target_of[i]]] if i in target_of else [np.nan] * 2 for i in plane.id.tolist()])
    can, rows = plane.reachable(points * u.mm).toarray(), []
    for i, positioner in enumerate(plane.id.tolist()):
        for t in np.flatnonzero(can[i]).tolist():
            target, moved = int(catalog.id[t]), tips.copy()
            moved[i] = points[t]
            if (
                state.left[t] == 0
                or target in target_of.values()
                or rs.find_collisions(plane, moved * u.mm).in_collision[i]
            ):
                continue
            left = max(int(state.left[t]) - n_planned[target], 0)
            here = tips[i] if positioner in target_of else plane.arrays.xy[i]
            key = left == 0, -catalog.priority[t], -left, np.hypot(*(points[t] - here))
            rows.append((i, *key, positioner, target, left, n_planned[target]))
    return [row[-4:] for row in sorted(rows)]


def listed(path):
    table = QTable.read(path)
    return [*zip(*(table[name].tolist() for name in ("positioner", "target_id", "n_left", "n_elsewhere")), strict=True)]


@pytest.mark.parametrize("seed", range(4))
def test_alternates_are_those_of_naive_counts(seed, tmp_path):
    case = living.targets(seed, n=90), living.instrument(), living.tiling(seed)
    fewest = rs.AllocationOptions("nearest", subpriority="fewest remaining visits")
    survey = rs.plan_survey(*case, allocator=fewest if seed == 3 else "nearest", folder=tmp_path / "plan")
    failed = {"tile": [11, 11, 12], "positioner": ["", str(survey.tile(11)["positioner"][0]), ""]}
    survey.record(living.events(date="2026-01-03", state=["done", "", "done"], **failed))
    for number in range(2):  # before and after the rest is planned with the recorded observations
        state, folder = survey.state(), tmp_path / f"files{number}"
        table = survey.export([13, 14, 15, 16], output=folder, alternates=99)
        assert table["alternates"].tolist() == [f"alternates-{tile}.ecsv" for tile in (13, 14, 15, 16)]
        n_elsewhere = 0
        for name in (13, 14, 15, 16):
            expected = naive(survey, case, name, state)
            assert listed(folder / f"alternates-{name}.ecsv") == expected
            n_elsewhere += sum(n > 0 for *_, n in expected)
        assert n_elsewhere > 5
        survey = survey.replan()


@pytest.mark.filterwarnings("ignore:constraint motion fold")
@pytest.mark.parametrize("name", ["sdss_apo", "moons"])
def test_alternates_of_a_survey_of_one_tile_are_those_of_the_tile(name, presets, tmp_path):
    model, rng, n = presets[name], np.random.default_rng(1), 6000
    sky = rs.synthetic_catalog("uniform", living.CENTER, 1.1 * model.field_radius, n_targets=n, rng=1)
    types = rng.choice([*model.focal_plane.fiber_types, ""], n) if name == "sdss_apo" else None
    catalog = rs.Catalog(
        sky.coord,
        id=[f"T{k}" for k in range(n)],
        kind=rng.choice([*living.SEVERAL_ROLES], n, p=[*living.SEVERAL_ROLES.values()]),
        priority=rng.integers(1, 3, n),
        fiber_type=types,
        extra={"h": rng.uniform(9, 15, n)},
    )
    rules = ["standard=20", "sky=20", "magnitude h 10 14", "magnitude h 12 14 standard"]
    rules += ["motion fold"] if name == "sdss_apo" else ["keep_out 120 30 0.02"]
    options = rs.AllocationOptions("repair", constraints=rules, subpriority=5)
    tile = rs.plan_tile(catalog, model, living.CENTER, allocator=options)
    survey = rs.plan_survey(catalog, model, living.CENTER[None], allocator=options, folder=tmp_path / "plan")
    (record,) = survey.export(output=tmp_path, alternates=3)
    table, expected = QTable.read(tmp_path / record["alternates"]), tile.alternates()
    assert len(table) > len(model.focal_plane)
    for column in (
        "positioner",
        "rank",
        "target_id",
        "kind",
        "priority",
        "planned",
        *(["fiber_type"] if types is not None else []),
    ):
        assert table[column].astype(str).tolist() == expected[column].astype(str).tolist(), column
    for column in ("ra", "dec", "x", "y", "separation"):
        np.testing.assert_allclose(table[column].value, expected[column].value, rtol=0, atol=1e-7, err_msg=column)


def test_refused_alternates_leave_no_file(tmp_path):
    case = living.targets(1), living.instrument(), living.tiling(1)
    survey = rs.plan_survey(*case, allocator="nearest", folder=tmp_path / "plan")
    refused("alternates must be a whole number of at least 1", survey.export, output=tmp_path / "out", alternates=0)
    survey.record([{"tile": 12, "state": "added", "ra": 120.1, "dec": 30.0}])
    refused("tile 12 must have its planned position", survey.export, output=tmp_path / "out", alternates=2)
    assert not (tmp_path / "out").exists()
