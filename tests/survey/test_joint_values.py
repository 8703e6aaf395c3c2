"""Joint plans that maximize values of targets, compared with an integer program that contains all tiles."""

from dataclasses import replace

import numpy as np
import pytest
from astropy.table import QTable, Table
from joint_program import program_of, survey_with
from raising import refused

import rfpsurvey as rs
from rfpsurvey._survey.joint.values import to_objective

pytestmark = pytest.mark.filterwarnings("ignore::rfpsurvey.RfpsurveyWarning")
TABLES = {
    "finish": {"": {1: 0.1, 2: 0.3, 3: 1.0}},
    "begin": {"": {1: 0.7, 3: 1.0}},
    "late": {"": {2: 2.5}},
    "categories": {"a": {1: 1.0, 2: 1.5}, "b": {2: 4.0}},
}


def text_of(tables):
    return " ".join(
        f"{name}:{n}={value}" if name else f"{n}={value}" for name in tables for n, value in tables[name].items()
    )


def worth(table, n):
    return max([0.0, *(value for number, value in table.items() if number <= n)])


def with_values(program, catalog, tables, made):
    """Return, for each class, weights of the variables that are 1 if a target has a number of visits in total."""
    weights = []
    for t in np.flatnonzero(catalog.visits > made):
        table = tables.get("") or tables[catalog.category[t]]
        visits, numbers = np.flatnonzero(program.target == t), np.arange(1, catalog.visits[t] - made[t] + 1)
        new = program.extend(len(numbers))
        program.add(new, 1)
        program.add([*visits, *new], np.inf, 0, [1.0] * len(visits) + (-numbers.astype(float)).tolist())
        k = np.flatnonzero(program.classes == catalog.priority[t])[0]
        gains = [worth(table, made[t] + n) - worth(table, made[t]) for n in numbers]
        weights += [(k, y, gain) for y, gain in zip(new, gains, strict=True)]
    result = np.zeros((len(program.classes), len(program.target)))
    for k, y, gain in weights:
        result[k, y] = gain
    return result


def total_by_class(survey, catalog, tables, classes, visits=None):
    """Return the sum of the values of each priority; ``visits`` are all visits, by default those of the survey."""
    n = np.asarray(survey.outcomes["observed"]) if visits is None else visits
    assert (n <= catalog.visits).all()
    wanted = np.flatnonzero(catalog.visits > 0)
    values = {t: worth(tables.get("") or tables[catalog.category[t]], n[t]) for t in wanted}
    return np.array([sum(values[t] for t in wanted if catalog.priority[t] == k) for k in classes])


def scene(seed, name):
    """Return a survey and its tables of values; ``several`` priorities, and categories if the table has them."""
    instrument, tiles, catalog, options, _ = survey_with(seed, "science")
    if name == "categories":
        category = np.random.default_rng([seed, 5]).choice(["a", "b"], len(catalog))
        catalog = replace(catalog, category=category)
    return instrument, tiles, catalog, options


@pytest.mark.parametrize("seeds", [range(8), pytest.param(range(8, 60), marks=pytest.mark.exhaustive)])
@pytest.mark.parametrize("name", TABLES)
def test_values_are_the_largest_possible(name, seeds):
    """Values in the order of the priorities, with valid bounds."""
    tables, n_best, n_cases = TABLES[name], 0, 0
    for seed in seeds:
        instrument, tiles, catalog, options = scene(seed, name)
        wanted = catalog.visits > 0
        if not wanted.any() or (name == "categories" and {*catalog.category[wanted]} != {"a", "b"}):
            continue
        joint = rs.JointOptions(objective=text_of(tables), iterations=2, allocator=options)
        survey = rs.plan_survey(catalog, instrument, tiles, allocator=joint)
        program = program_of(instrument, tiles, catalog, options, [], [])
        weights = with_values(program, catalog, tables, np.zeros(len(catalog), int))
        best = weights @ program.maximize(200.0 ** np.arange(len(weights) - 1, -1, -1) @ weights)
        sums = [w @ program.maximize(w) for w in np.cumsum(weights, axis=0)]
        values = total_by_class(survey, catalog, tables, program.classes)
        levels = survey.summary["joint"]["levels"]
        assert np.allclose([level["value"] for level in levels], np.cumsum(values)), seed
        bounds = np.array([level["bound_value"] for level in levels])
        assert (bounds >= np.array(sums) - 1e-9).all(), (seed, bounds, sums)
        assert tuple(np.round(values, 6)) <= tuple(np.round(best, 6)), seed
        assert not any(np.asarray(part["in_collision"]).any() for part in survey), seed
        n_best += np.allclose(values, best)
        n_cases += 1
    assert n_best == n_cases > 0.7 * len(seeds)


def test_equal_values_of_visits_give_the_largest_number_of_visits():
    for seed in range(6):
        instrument, tiles, catalog, options = scene(seed, "finish")
        catalog = replace(catalog, priority=None)
        objectives = "visits", "1=1 2=2 3=3"
        made = [
            rs.plan_survey(
                catalog, instrument, tiles, allocator=rs.JointOptions(objective=one, iterations=4, allocator=options)
            ).summary["joint"]["levels"][-1]["n_visits"]
            for one in objectives
        ]
        assert made[0] == made[1], seed


def test_one_value_of_all_visits_finishes_targets():
    for seed in range(6):
        instrument, tiles, catalog, options = scene(seed, "finish")
        catalog = replace(catalog, visits=np.where(catalog.visits > 0, 2, 0))
        if not catalog.visits.any():
            continue
        numbers = []
        for objective, name in (("finished", "n_complete"), ("2=1", "value")):
            joint = rs.JointOptions(objective=objective, iterations=4, allocator=options)
            levels = rs.plan_survey(catalog, instrument, tiles, allocator=joint).summary["joint"]["levels"]
            numbers.append([level[name] for level in levels])
        assert numbers[0] == numbers[1], seed


def test_visits_that_were_made_count(tmp_path):
    """After observations, values are those of all visits, and the new plan is the best one."""
    tables, n_cases = TABLES["finish"], 0
    for seed in range(14):
        instrument, tiles, catalog, options = scene(seed, "finish")
        if not catalog.visits.any():
            continue
        joint = rs.JointOptions(objective=text_of(tables), iterations=3, allocator=options)
        folder = tmp_path / str(seed)
        survey = rs.plan_survey(catalog, instrument, tiles, allocator=joint, folder=folder)
        survey.record(QTable({"tile": [0], "state": ["done"], "date": ["2026-02-01"]}))
        made = np.asarray(survey.state().observed)
        again = survey.replan(instrument=instrument)
        program = program_of(instrument, tiles[1:], catalog, options, [], [])
        weights = with_values(program, catalog, tables, made)
        total = made + visits_of(again, catalog, skip=0)
        values = total_by_class(again, catalog, tables, program.classes, total)
        start = total_by_class(again, catalog, tables, program.classes, made)
        best = start + weights @ program.maximize(200.0 ** np.arange(len(weights) - 1, -1, -1) @ weights)
        assert np.allclose(values, best), seed
        n_cases += 1
    assert n_cases > 7


def visits_of(survey, catalog, skip):
    n = np.zeros(len(catalog), int)
    for tile, part in zip(survey.tiles["tile"], survey, strict=True):
        if tile != skip:
            np.add.at(n, np.asarray(part["target_row"])[np.asarray(part["observed"])], 1)
    return n


def test_tables_are_text(tmp_path):
    table = Table({"visits": [1, 3], "value": [0.25, 1.0]})
    assert to_objective(table) == "1=0.25 3=1.0"
    table["category"] = ["main", "guest"]
    joint = rs.JointOptions(objective=table)
    assert joint.objective == "main:1=0.25 guest:3=1.0"
    assert rs.JointOptions.from_record(joint.record) == joint
    instrument, tiles, catalog, options = scene(3, "categories")
    survey = rs.plan_survey(
        catalog,
        instrument,
        tiles,
        allocator=rs.JointOptions(objective=text_of(TABLES["categories"]), iterations=1, allocator=options),
        folder=tmp_path / "s",
    )
    again = rs.survey.continue_survey(tmp_path / "s")
    assert again.summary["joint"] == survey.summary["joint"]


REFUSED = {
    "most": "unknown objective 'most'; choose one of: finished, visits",
    "1=-1": "values of at least 0 for numbers of visits .* got '1=-1'",
    "0=1": "numbers of visits .* got '0=1'",
    "1=1 1=2": "objective must contain each number of visits once, got 1 twice",
    "1=2 2=1": "must not decrease with the number of visits, and must not all be 0, got 1=2 2=1",
    "a:1=0": "must not all be 0, got 1=0 for a",
    "a:1=1 2=1": "objective must name a category for all values or for none",
}


@pytest.mark.parametrize("text", REFUSED)
def test_wrong_values_are_refused(text):
    refused(REFUSED[text], rs.JointOptions, objective=text)


def test_categories_must_be_those_of_the_catalog():
    instrument, tiles, catalog, options = scene(3, "categories")
    allocator = rs.JointOptions(objective="a:1=1 c:1=2", iterations=1, allocator=options)
    message = r"objective must contain values of all categories of targets \(a, b\)"
    refused(message, rs.plan_survey, catalog, instrument, tiles, allocator=allocator)
    plain, message = replace(catalog, category=None), "values of categories require a catalog with categories"
    refused(message, rs.plan_survey, plain, instrument, tiles, allocator=allocator)
    refused("must have the columns visits and value", rs.JointOptions, objective=Table({"value": [1.0]}))
    spaces = Table({"visits": [1], "value": [1.0], "category": ["a b"]})
    refused("a category in a table of values must be one word, got 'a b'", rs.JointOptions, objective=spaces)
