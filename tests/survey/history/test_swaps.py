"""Swaps of targets that were recorded, against a naive count of the visits of all targets."""

import living
import numpy as np
import pytest
from astropy.table import QTable
from raising import refused, warned

import rfpsurvey as rs
from rfpsurvey._survey.history.event_files import FRAME


def reachable(case, survey, name):
    """Return the targets in reach of each positioner that no positioner of a tile observes in the plan."""
    catalog, model, _ = case
    row = survey.tiles["tile"].tolist().index(name)
    place = [survey.tiles[axis][row].to_value("rad") for axis in ("ra", "dec", "position_angle")]
    points = model.field_projection(*place, None).project(catalog.coord.cartesian.xyz.value.T)
    can = model.focal_plane.arrays.reach(points).matrix.toarray()
    can[:, np.isin(catalog.id, survey.tile(name)["target_id"])] = False
    return {str(i): catalog.id[row].tolist() for i, row in zip(model.focal_plane.id, can, strict=True)}


def naive(catalog, records, plans):
    """Return the numbers of successful and of failed visits of each target."""
    science = {i: catalog.kind is None or "science" in str(catalog.kind[k]) for k, i in enumerate(catalog.id.tolist())}
    good, bad = dict.fromkeys(science, 0), dict.fromkeys(science, 0)
    for tile, (swaps, failed) in records.items():
        target_of = {str(v["positioner"]): int(v["target_id"]) for v in plans[tile] if v["observed"]}
        for positioner, target in (target_of | swaps).items():
            (bad if positioner in failed else good)[target] += science[target]
    return [list(counts.values()) for counts in (good, bad)]


def assert_counts(survey, case, records, plans):
    """Compare the state and the status of a survey with the naive count."""
    state, (good, bad) = survey.state(), naive(case[0], records, plans)
    assert state.observed.tolist() == good
    assert state.failed.tolist() == bad
    science = (
        np.ones(len(good), bool) if case[0].kind is None else np.char.find(case[0].kind.astype(str), "science") >= 0
    )
    assert state.table["left"].tolist() == np.maximum(case[0].visits * science - good, 0).tolist()
    status = survey.status()
    counted = np.minimum(case[0].visits * science, good)  # more visits than requested do not count
    assert (status["n_observed"][0], status["n_failed"][0]) == (counted.sum(), sum(bad))
    assert status.meta["progress"]["n_observed"]["all"][-1] == sum(good)


@pytest.mark.filterwarnings("ignore:requirement standard=1")
@pytest.mark.parametrize("kinds", [False, True])
@pytest.mark.parametrize("seed", range(4))
def test_visits_are_those_of_a_naive_count(seed, kinds, tmp_path):
    rng, case = (
        np.random.default_rng(seed),
        (living.targets(seed, kinds=kinds, n=45), living.instrument(), living.tiling(seed)),
    )
    options = rs.AllocationOptions("nearest", constraints=["standard=1"] if kinds else [])
    survey = rs.plan_survey(*case, allocator=options, folder=tmp_path / "plan")
    records, plans, n_idle, n_swaps = {}, {}, 0, 0
    for night, names in enumerate([(11, 12), (13, 14)], 3):
        rows = []
        for name in names:
            plans[name], free = survey.tile(name), reachable(case, survey, name)
            planned, swaps = plans[name]["positioner"].astype(str).tolist(), {}
            for positioner in rng.permutation([*free]).tolist():
                others = [target for target in free[positioner] if target not in swaps.values()]
                if others and len(swaps) < 3:
                    swaps[positioner] = int(rng.choice(others))
            failed = {str(name) for name in rng.choice([*swaps], min(len(swaps), 1))} if night == 4 else set()
            failed_planned = {str(p) for p in planned[:1] if p not in swaps}
            records[name] = swaps, failed | failed_planned
            rows += [(name, "done", "", "", "", False)]
            rows += [(name, "", p, str(t), "no" if p in failed else "", True) for p, t in swaps.items()]
            rows += [(name, "", p, "", "", False) for p in failed_planned]
            n_idle, n_swaps = n_idle + len({*swaps} - {*planned}), n_swaps + len(swaps)
        columns = dict(
            zip(
                ("tile", "state", "positioner", "target", "good", "swaps"),
                map(list, zip(*rows, strict=True)),
                strict=True,
            )
        )
        table = living.events(date=f"2026-01-0{night}", **columns)
        said = survey.record(table)
        assert len(said["changes"].get("swapped targets", [])) == sum(len(records[name][0]) for name in names)
        assert survey.record(table)["n_known"] == 2  # the same record changes nothing
        assert_counts(survey, case, records, plans)
        survey = survey.replan()
        assert_counts(survey, case, records, plans)
        assert len(rs.survey.verify_survey(survey.folder)) == 0
        assert (survey.outcomes["observed"] >= naive(case[0], records, plans)[0]).all()
    assert n_swaps > n_idle
    assert n_idle > 0 or not kinds  # without other kinds, idle positioners have no free target in reach


@pytest.fixture
def survey(tmp_path):
    case = living.targets(2), living.instrument(), living.tiling(2)
    return case, rs.plan_survey(*case, allocator="nearest", folder=tmp_path / "plan")


def swap_in(case, survey, name=11):
    """Return a positioner with a planned target, this target, and another target in its reach."""
    free, visits = reachable(case, survey, name), survey.tile(name)
    return next(
        (str(v["positioner"]), int(v["target_id"]), free[str(v["positioner"])][0])
        for v in visits
        if free[str(v["positioner"])]
    )


def test_swaps_are_corrected_and_undone(survey):
    case, survey = survey
    positioner, planned, other = swap_in(case, survey)
    plans, row = {11: survey.tile(11)}, {"tile": 11, "date": "2026-01-03", "positioner": positioner, "target": other}
    survey.record([row], swaps=True)  # a table of visits alone states that the tile was observed
    swapped = {11: ({positioner: other}, set())}
    assert_counts(survey, case, swapped, plans)
    survey = survey.replan()  # later records must not use its checkpoint
    survey.record([row | {"reason": "clouds"}])  # the visit of the swapped target failed
    assert_counts(survey, case, {11: ({positioner: other}, {positioner})}, plans)
    survey.record([row | {"target": planned}], swaps=True)  # the planned target was observed after all
    assert_counts(survey, case, {11: ({}, set())}, plans)
    survey.undo(3)
    survey.undo(2)
    assert_counts(survey, case, swapped, plans)
    survey.record([{"tile": 11, "date": "2026-01-03", "state": "done"}], replaces=True)
    assert_counts(survey, case, {11: ({}, set())}, plans)


def test_alternates_are_recorded_as_swaps(survey, tmp_path):
    case, survey = survey
    (record,) = survey.export([12], output=tmp_path, alternates=1)
    table = QTable.read(tmp_path / record["alternates"])[:1]
    table["date"] = "2026-01-03"
    warned("columns that are not used: rank", survey.record, table, swaps=True)
    swaps = {str(table["positioner"][0]): int(table["target_id"][0])}
    assert_counts(survey, case, {12: (swaps, set())}, {12: survey.tile(12)})


def test_swaps_count_in_cadences(tmp_path):
    case = living.targets(2), living.instrument(), living.tiling(2)
    cadences = rs.survey.Cadences(
        QTable({"cadence": ["twice"], "delta_min": ["0 2"], "delta_max": ["0 9"], "n_exp": ["1 1"]})
    )
    stars = rs.Catalog(case[0].coord, id=case[0].id, extra=QTable({"cadence": ["twice"] * len(case[0])}))
    dated = QTable({**case[2].table[["tile", "ra", "dec", "pass"]], "mjd": 61043.2 + np.arange(len(case[2]))})
    tiles = rs.Tiling.from_table(dated)
    survey = rs.plan_survey(stars, case[1], tiles, allocator="nearest", visits=cadences, folder=tmp_path / "plan")
    positioner, planned, other = swap_in((stars, *case[1:]), survey)
    survey.record([{"tile": 11, "date": "2026-01-03", "positioner": positioner, "target": other}], swaps=True)
    observed = dict(zip(stars.id.tolist(), survey.state().observed.tolist(), strict=True))
    assert (observed[planned], observed[other], sum(observed.values())) == (0, 1, len(survey.tile(11)))
    assert len(rs.survey.verify_survey(survey.replan().folder)) == 0


def test_refused_swaps(survey):
    case, survey = survey
    positioner, planned, other = swap_in(case, survey)
    row = {"tile": 11, "date": "2026-01-03", "positioner": positioner, "target": other}
    visits = survey.tile(11)
    second = next(int(v["target_id"]) for v in visits if int(v["target_id"]) != planned)
    rival = next(str(v["positioner"]) for v in visits if int(v["target_id"]) == second)
    for change, text in (
        ({"target": 5}, "target must be one target in the field of tile 11, got '5'"),
        ({"target": ""}, "a swap must have a positioner and a target"),
        ({"positioner": 99}, "positioner must be a positioner of the instrument, got '99'"),
        ({"target": second}, f"must be observed by one positioner, got several for {second}"),
    ):
        refused(text, survey.record, [row | change], swaps=True)
    refused(f"target must be that of positioner {positioner}", survey.record, [row])
    refused("positioner must be in one row of swaps", survey.record, [row, row], swaps=True)
    state = {"tile": 11, "date": "2026-01-03", "state": "partly", "positioner": "", "target": ""}
    refused("must be done if swaps are recorded", survey.record, [state, row | {"state": ""}], swaps=True)
    refused("swaps must be True or False", survey.record, [row], swaps="yes")
    exchanged = [row | {"target": second}, row | {"positioner": rival, "target": planned}]
    assert warned("targets of swaps of tile 11 are out of reach", survey.record, exchanged, swaps=True)["n_events"] == 1


def test_a_damaged_swap_is_refused(survey):
    case, survey = survey
    positioner, _, other = swap_in(case, survey)
    survey.record([{"tile": 11, "date": "2026-01-03", "positioner": positioner, "target": other}], swaps=True)
    path = survey.folder / "events/000001.json"
    (survey.folder / "events/records.txt").unlink()
    body = path.read_text().splitlines()[1].replace(f'"{other}","science"]', f'"{other}"]')
    path.write_text(FRAME.format(living.sha(body.encode()), body))
    refused("000001.json is damaged .its events have other types", survey.state)


def test_files_of_events_without_swaps_do_not_contain_them(survey):
    survey[1].record([{"tile": 11, "date": "2026-01-03"}])
    assert "swaps" not in (survey[1].folder / "events/000001.json").read_text()
