"""Shares of finished targets, compared with all values of the smallest fraction in an integer program."""

from dataclasses import replace

import astropy.units as u
import numpy as np
import pytest
from joint_program import goals_of, program_of, with_categories
from raising import refused

import rfpsurvey as rs
from rfpsurvey._survey.joint import finished as search

pytestmark = pytest.mark.filterwarnings("ignore::rfpsurvey.RfpsurveyWarning")
WEIGHTS = {"category": {}, "b=2 a=0.5": {"b": 2.0, "a": 0.5}}


def smallest(numbers, sizes, weights):
    return min(numbers[name] / (sizes[name] * weights.get(name, 1.0)) for name in sizes)


@pytest.mark.parametrize(
    "seeds", [range(8), *(pytest.param(range(k, k + 20), marks=pytest.mark.exhaustive) for k in (8, 28, 48))]
)
@pytest.mark.parametrize("share", WEIGHTS)
def test_the_smallest_fraction_is_the_largest_possible(seeds, share):
    weights, n_cases = WEIGHTS[share], 0
    for seed in seeds:
        instrument, tiles, catalog, options = with_categories(seed)
        if not {*np.unique(catalog.category[catalog.visits > 0])} >= {*weights, "a"}:
            continue
        joint = rs.JointOptions(objective="finished", share=share, iterations=2, allocator=options)
        survey = rs.plan_survey(catalog, instrument, tiles, allocator=joint)
        summary = survey.summary["joint"]
        rows = {row["category"]: row for row in summary["shares"]}
        sizes = {name: row["n_targets"] for name, row in rows.items()}
        done = (np.asarray(survey.outcomes["observed"]) >= catalog.visits) & (catalog.visits > 0)
        numbers = {name: int(done[catalog.category == name].sum()) for name in sizes}
        assert numbers == {name: row["n_complete"] for name, row in rows.items()}, seed
        # largest value for which all numbers can be reached at the same time
        values = sorted({k / (n * weights.get(name, 1.0)) for name, n in sizes.items() for k in range(n + 1)})
        best = 0.0
        for value in values:
            program = program_of(instrument, tiles, catalog, options, [], [])
            goals, first = goals_of(program, catalog.visits)
            for name, n in sizes.items():
                mine = first[catalog.category[goals] == name]
                program.add(mine, np.inf, int(np.ceil(value * n * weights.get(name, 1.0) - 1e-9)))
            if any(value * weights.get(name, 1.0) > 1 + 1e-9 for name in sizes) or not program.is_feasible():
                break
            best = value
        assert smallest(numbers, sizes, weights) >= best - 1.0 / 10_000, seed
        assert smallest(numbers, sizes, weights) <= best + 1e-9, seed
        assert summary["bound_of_smallest"] >= best - 1e-12, seed
        n_cases += 1
    assert n_cases > len(seeds) / 2


def test_patches_do_not_decrease_the_smallest_fraction(monkeypatch):
    instrument, tiles, catalog, options = with_categories(12)
    joint = rs.JointOptions(objective="finished", iterations=6, patch_size=20, allocator=options)
    monkeypatch.setattr(search, "MOST_OF_ALL", 0)
    plain, shared = (
        rs.plan_survey(catalog, instrument, tiles, allocator=replace(joint, share=share))
        for share in (None, "category")
    )
    fractions = [
        min(
            np.mean(
                (np.asarray(survey.outcomes["observed"]) >= catalog.visits)[
                    (catalog.category == name) & (catalog.visits > 0)
                ]
            )
            for name in "abc"
        )
        for survey in (plain, shared)
    ]
    assert fractions[0] <= fractions[1] == min(row["fraction"] for row in shared.summary["joint"]["shares"])
    assert not any(np.asarray(part["in_collision"]).any() for part in shared)


def test_wrong_shares_are_refused():
    instrument, tiles, catalog, options = with_categories(12)
    for text in ("a=0", "a", "=1", "a=x"):
        refused(
            "share must be 'category', or weights above 0 of categories",
            rs.JointOptions,
            objective="finished",
            share=text,
        )
    with pytest.raises(rs.InputError, match="share must have one weight for each category, got several for 'a'"):
        rs.JointOptions(objective="finished", share="a=1 a=2")
    refused("share can be given only with the objective 'finished', got 'visits'", rs.JointOptions, share="category")
    for given, what in ((catalog, "nobody=2"), (replace(catalog, category=None), "category")):
        joint = rs.JointOptions(objective="finished", share=what, allocator=options, time_limit=5 * u.s)
        text = (
            r"share must name categories of targets with requested visits \(a, b, c\), got nobody"
            if given is catalog
            else "requires a catalog with categories"
        )
        with pytest.raises(rs.errors.InputError, match=text):
            rs.plan_survey(given, instrument, tiles, allocator=joint)


@pytest.mark.parametrize(
    ("has_categories", "asked", "message"),
    [
        (False, {"objective": "finished", "share": "category"}, "share requires a catalog with categories"),
        (True, {"objective": "finished", "share": "a=2 d=1 e=1"}, r"share must name categories .*, got d, e"),
        (True, {"objective": "a:1=1"}, r"values of all categories of targets \(a, b, c\) and of no others, got a$"),
        (True, {"objective": "a:1=1 b:1=1 c:1=1 d:1=1"}, r"and of no others, got a, b, c, d"),
    ],
)
def test_unknown_categories_are_refused_before_anything_is_written(has_categories, asked, message, tmp_path):
    instrument, tiles, catalog, options = with_categories(12)
    catalog, folder = catalog if has_categories else replace(catalog, category=None), tmp_path / "s"
    joint = rs.JointOptions(**asked, inform=pytest.fail, allocator=options)
    refused(message, rs.plan_survey, catalog, instrument, tiles, allocator=joint, folder=folder)
    assert not folder.exists()
