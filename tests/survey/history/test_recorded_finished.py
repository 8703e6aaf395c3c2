"""Joint plans that finish targets after observations, compared with an integer program of the remaining tiles."""

from dataclasses import replace

import numpy as np
import pytest
from astropy.table import Table
from joint_program import JointProgram, goals_of, with_categories

import rfpsurvey as rs

SEEDS = [*range(6), *(pytest.param(k, marks=pytest.mark.exhaustive) for k in range(6, 75))]
WEIGHTS = {None: {}, "category": {}, "b=2 a=0.5": {"b": 2.0, "a": 0.5}}
pytestmark = pytest.mark.filterwarnings("ignore::rfpsurvey.RfpsurveyWarning")


def record_first_tiles(rng, survey, is_simple):
    """Record random outcomes of the first tiles; return the state and the successful visits (rows) of each tile."""
    rows, meaning = [], {}
    for tile in range(int(rng.integers(1, len(survey)))):
        state = rng.choice(["done", "done", "bad", "dropped"] + ["partly"] * is_simple)
        rows.append((tile, "2026-01-03", state, ""))
        visits = survey._visits(tile)
        is_made = np.asarray(visits["observed"]) & (rng.random(len(visits)) > 0.3 * (state == "done"))
        failed = visits["positioner"][~is_made] if state == "done" else []
        rows += [(tile, "2026-01-03", "", str(name)) for name in failed]
        meaning[tile] = state, np.asarray(visits["target_row"])[is_made]
    survey.record(Table(rows=rows, names=["tile", "date", "state", "positioner"]))
    return meaning


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("share", WEIGHTS)
def test_visits_that_were_made_count_toward_finished_targets(seed, share, tmp_path):
    """Regression: shares omitted the targets that were finished before."""
    rng, weights = np.random.default_rng([seed, 3]), WEIGHTS[share]
    instrument, tiles, catalog, options = with_categories(seed)
    if not {*np.unique(catalog.category[catalog.visits > 0])} >= {*weights, "a"}:
        return
    catalog = replace(catalog, visits=np.where(catalog.visits == 3, 4, catalog.visits) if seed % 3 else catalog.visits)
    joint = rs.JointOptions(objective="finished", share=share, iterations=3, allocator=options)
    survey = rs.plan_survey(catalog, instrument, tiles, allocator=joint, folder=tmp_path / "plan")
    is_simple = instrument.focal_plane.positioner.handedness != "both"
    meaning, made = record_first_tiles(rng, survey, is_simple), np.zeros(len(catalog), dtype=int)
    for state, rows in meaning.values():
        made[rows] += state == "done"
    assert survey.state().observed.tolist() == made.tolist()
    survey = survey.replan(instrument=instrument)
    assert len(rs.survey.verify_survey(survey.folder)) == 0
    for state, rows in meaning.values():  # they will be completed
        made[rows] += (state == "partly") & (made[rows] < catalog.visits[rows])
    needed, done = np.maximum(catalog.visits - made, 0), np.asarray(survey.outcomes["observed"]) >= catalog.visits
    done &= catalog.visits > 0
    planned = [k for k in range(len(tiles)) if meaning.get(k, ("bad",))[0] == "bad"]

    def program_of():
        """Return a program of the remaining tiles."""
        return JointProgram(instrument, tiles[planned], replace(catalog, visits=needed), options.parked_obstacles)

    levels, before = survey.summary["joint"]["levels"], (needed == 0) & (catalog.visits > 0)
    assert levels[-1]["n_complete"] == done.sum() == survey.summary["n_complete"]
    if share is None:
        check_numbers(program_of(), catalog, needed, before, done, levels)
        return
    rows = {row["category"]: row for row in survey.summary["joint"]["shares"]}
    names = catalog.category
    for name, row in rows.items():
        assert row["n_complete"] == done[names == name].sum()
        assert row["n_targets"] >= (before & (names == name)).sum()
    units = {name: row["n_targets"] * row["weight"] for name, row in rows.items()}
    best = 0.0
    for value in sorted({k / unit for name, unit in units.items() for k in range(rows[name]["n_targets"] + 1)}):
        program = program_of()
        goals, first = goals_of(program, needed)
        least = {name: int(np.ceil(value * unit - 1e-9)) for name, unit in units.items()}
        for name, n in least.items():
            program.add(first[names[goals] == name], np.inf, n - (before & (names == name)).sum())
        if any(n > rows[name]["n_targets"] for name, n in least.items()) or not program.is_feasible():
            break
        best = value
    smallest = min(row["n_complete"] / units[name] for name, row in rows.items())
    assert best - 1e-4 <= smallest <= best + 1e-9
    assert survey.summary["joint"]["bound_of_smallest"] >= best - 1e-12


def check_numbers(program, catalog, needed, before, done, levels):
    """Compare the finished targets of each priority, and the bounds, with the program."""
    goals, first = goals_of(program, needed)
    classes = np.unique(catalog.priority[needed > 0])[::-1]
    weights = np.zeros((len(classes), len(program.target)))
    for k, value in enumerate(classes):
        weights[k, first[catalog.priority[goals] == value]] = 1.0
    if not len(classes):
        return
    best = weights @ program.maximize(64.0 ** np.arange(len(classes) - 1, -1, -1) @ weights)
    assert [(done & ~before & (catalog.priority == value)).sum() for value in classes] == best.tolist()
    bounds = {float(level["priority"]): level["bound_complete"] for level in levels if level["priority"] != "all"}
    for k, value in enumerate(classes[:-1]):
        goal = weights[: k + 1].sum(axis=0)
        most = round(goal @ program.maximize(goal)) + (before & (catalog.priority >= value)).sum()
        assert bounds.get(value, most) >= most
    goal = weights.sum(axis=0)
    assert levels[-1]["bound_complete"] >= round(goal @ program.maximize(goal)) + before.sum()


def test_a_survey_without_remaining_tiles_is_planned_again(tmp_path):
    """Regression: the last record of a survey caused a ValueError of numpy."""
    instrument, tiles, catalog, options = with_categories(0)
    joint = rs.JointOptions(objective="finished", iterations=1, allocator=options)
    survey = rs.plan_survey(catalog, instrument, tiles, allocator=joint, folder=tmp_path / "plan")
    survey.record([{"tile": tile, "date": "2026-01-03", "state": "done"} for tile in range(len(tiles))])
    expected = survey.state().observed.tolist()
    assert survey.replan(instrument=instrument).outcomes["observed"].tolist() == expected
    assert sum(expected) > 0
