"""Surveys with cadences after observations, compared with a second implementation and with an integer program."""

from collections import Counter
from copy import deepcopy

import numpy as np
import pytest
from cadence_program import counts_of, random_survey, with_sequences
from naive_cadences import TABLE
from recorded_cadences import counted, naive_state, outcomes

import rfpsurvey as rs
from rfpsurvey._survey.history.nights import History
from rfpsurvey.survey import Cadences

SEEDS = [*range(7), *(pytest.param(k, marks=pytest.mark.exhaustive) for k in range(7, 100))]
pytestmark = pytest.mark.filterwarnings("ignore::rfpsurvey.RfpsurveyWarning")


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("allocator", ["nearest", "optimal", "joint"])
def test_epochs_that_were_observed_count_and_the_rest_is_planned(seed, allocator, tmp_path):
    rng = np.random.default_rng([seed, 7])
    instrument, tiling, catalog, options = random_survey(seed)
    given = rs.JointOptions(iterations=3, allocator=options) if allocator == "joint" else allocator
    common = {"visits": Cadences(TABLE), "rng": seed, "allocator": given, "folder": tmp_path / "plan"}
    first = rs.plan_survey(catalog, instrument, tiling, **common)
    days, brightness = (np.array(tiling.table[name]) for name in ("mjd", "skybrightness"))
    plans = list(first)
    table, meaning = outcomes(rng, first, tiling)
    if table is None:
        return
    first.record(table, allow_future=True)
    targets, now = naive_state(catalog, plans, meaning, brightness)
    state = rs.Survey.read(tmp_path / "plan").state()
    assert state.observed.tolist() == counted(targets)
    status = first.status()
    words = [own[-1][1] for own in History(first, state).states.values()]
    tiles = status.meta["tiles"]
    assert Counter(words) == Counter({w: n for w in tiles[0] if w != "pass" if (n := sum(row[w] for row in tiles))})
    assert status["n_observed"][0] == sum(counted(targets))
    partly = {tile for tile, (_, name, _) in meaning.items() if name == "partly"}
    if allocator == "joint" and partly and instrument.focal_plane.positioner.handedness == "both":
        with pytest.raises(rs.InputError, match="partly observed tiles needs positioners of one handedness"):
            first.replan(instrument=instrument)
        return
    survey = first.replan(instrument=instrument)
    done = {tile for tile, (_, name, _) in meaning.items() if name == "done"}
    is_past = {k for k, day in enumerate(days) if day < now or (k in meaning and day <= now)} - done - partly
    names = np.full(len(days), "planned")
    for name, rows in (("done", done), ("partly", partly), ("past", is_past)):
        names[[*rows]] = name
    assert survey.tiles["state"].tolist() == names.tolist()
    assert survey.summary["n_tiles_past"] == len(is_past)
    for tile in done | partly:
        assert (survey._visits(tile) == plans[tile]).all()
    assert not any(len(survey._visits(tile)) for tile in is_past)
    for tile in sorted(partly):  # they will be completed
        visits = survey._visits(tile)
        for row in visits["target_row"][np.asarray(visits["observed"])]:
            if targets[row].allows(now, brightness[tile])[0]:
                targets[row].observe(now)
    before = deepcopy(targets)
    later = [k for k in np.argsort(days).tolist() if names[k] == "planned"]
    for tile in later:
        rows = np.asarray(survey._visits(tile)["target_row"])
        assert all(targets[row].allows(days[tile], brightness[tile])[0] for row in rows)
        for row, is_made in zip(rows, survey._visits(tile)["observed"], strict=True):
            if is_made:
                targets[row].observe(days[tile])
    assert survey.outcomes["observed"].tolist() == counted(targets)
    assert survey.outcomes["n_epochs"].tolist() == [len(target.starts) for target in targets]
    assert len(rs.survey.verify_survey(survey.folder)) == 0
    assert survey.replan(instrument=instrument).outcomes["observed"].tolist() == counted(targets)
    if allocator == "joint":
        check_optimum(survey, instrument, tiling, catalog, before, later)


def check_optimum(survey, instrument, tiling, catalog, before, later):
    """Compare the plan of the rest with the program of all sequences of visits of the remaining tiles."""
    program, weights = with_sequences(instrument, tiling, catalog, before, later)
    values, numbers = np.unique(catalog.priority)[::-1], np.array(counted(before))
    whole = [np.array([len(t.starts) == len(t.epochs) for t in before])[catalog.priority == v].sum() for v in values]
    made = [numbers[catalog.priority == value].sum() for value in values]
    found = np.array(counts_of(survey, catalog)) - np.column_stack([whole, made])
    levels = {float(level["priority"]): level for level in survey.summary["joint"]["levels"]}
    for k, value in enumerate(values):
        for j, name in enumerate(("bound_complete", "bound")):
            goal = weights[: k + 1, j].sum(axis=0)
            most = round(goal @ program.maximize(goal)) + (sum(whole[: k + 1]) if j == 0 else 0)
            assert value not in levels or levels[value][name] >= most
    if levels:
        last = survey.summary["joint"]["levels"][-1]
        assert last["n_complete"] == found[:, 0].sum() + sum(whole)
        assert last["n_visits"] == found[:, 1].sum()
    best = []
    for goal in weights.reshape(2 * len(weights), -1):
        best.append(round(goal @ program.maximize(goal)))
        program.add(np.flatnonzero(goal), np.inf, best[-1], goal[goal > 0])
    assert found.ravel().tolist() == best
