"""Joint plans that finish targets, compared with an integer program that contains all tiles of a small survey."""

from dataclasses import replace

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.table import QTable
from joint_program import finished_by_class, plans_of, program_of, survey_with, with_finished

import rfpsurvey as rs

SEEDS = [range(8), *(pytest.param(range(k, k + 20), marks=pytest.mark.exhaustive) for k in range(0, 100, 20))]
pytestmark = pytest.mark.filterwarnings("ignore::rfpsurvey.RfpsurveyWarning")


@pytest.mark.parametrize("seeds", SEEDS)
@pytest.mark.parametrize("roles", ["science", "kinds", "several"])
def test_plans_finish_as_many_targets_as_possible(roles, seeds):
    n_best = n_better = n_cases = 0
    cases = ((seed, survey_with(seed, roles)) for seed in seeds)
    for seed, (_, _, catalog, *_), program, first, survey in plans_of(cases, objective="finished", iterations=4):
        weights = with_finished(program, catalog)
        best = weights @ program.maximize(64.0 ** np.arange(len(weights) - 1, -1, -1) @ weights)
        sums = [w @ program.maximize(w) for w in np.cumsum(weights, axis=0)]
        done, old = (finished_by_class(one, catalog, program.classes) for one in (survey, first))
        assert tuple(done) <= tuple(best), seed
        levels = survey.summary["joint"]["levels"]
        bounds = np.array([level["bound_complete"] for level in levels])
        assert [level["n_complete"] for level in levels] == np.cumsum(done).tolist(), seed
        assert (bounds >= sums).all(), (seed, bounds, sums)
        n_best += tuple(done) == tuple(best)
        n_better += tuple(done) > tuple(old)
        n_cases += 1
    assert n_best >= 0.9 * n_cases
    assert n_better


@pytest.mark.parametrize("seeds", [range(12), pytest.param(range(12, 80), marks=pytest.mark.exhaustive)])
def test_visits_of_fixed_tiles_count(seeds):
    """The fixed tile keeps its plan, and the optimum and the bounds are those of plans with this tile."""
    n_cases = n_only_fixed = 0
    for seed in seeds:
        instrument, tiles, catalog, options, _ = survey_with(seed, "science")
        if instrument.focal_plane.positioner.handedness == "both" or not catalog.visits.any():
            continue
        before = rs.plan_survey(catalog, instrument, tiles[:1], allocator=options)
        joint = rs.JointOptions(objective="finished", iterations=4, allocator=options, fixed=before)
        survey = rs.plan_survey(catalog, instrument, tiles, allocator=joint)
        rows = np.asarray(before.tile(0)["target_row"])
        assert np.array_equal(np.asarray(survey.tile(0)["target_row"]), rows), seed
        program = program_of(instrument, tiles, catalog, options, [], [])
        here = program.tile == 0
        for t in np.unique(program.target[here & (program.target >= 0)]):
            program.add(np.flatnonzero(here & (program.target == t)), int(t in rows), int(t in rows))
        weights = with_finished(program, catalog)
        best = weights @ program.maximize(64.0 ** np.arange(len(weights) - 1, -1, -1) @ weights)
        sums = [w @ program.maximize(w) for w in np.cumsum(weights, axis=0)]
        done = finished_by_class(survey, catalog, program.classes)
        levels = survey.summary["joint"]["levels"]
        assert tuple(done) == tuple(best), seed
        assert [level["n_complete"] for level in levels] == np.cumsum(done).tolist(), seed
        assert (np.array([level["bound_complete"] for level in levels]) >= sums).all(), seed
        n_cases += 1
        n_only_fixed += bool((catalog.visits[rows] == 1).any())
    assert n_cases > 0.5 * len(seeds)
    assert n_only_fixed


def test_options_without_effect_are_named():
    instrument, tiles, catalog, options, _ = survey_with(3, "science")
    options = replace(options, subpriority=1)
    joint = rs.JointOptions(objective="finished", early=True, iterations=1, allocator=options)
    with (
        pytest.warns(rs.errors.RfpsurveyWarning, match="early has no effect with the objective 'finished'"),
        pytest.warns(rs.errors.RfpsurveyWarning, match="subpriority has no effect with the objective 'finished'"),
    ):
        rs.plan_survey(catalog, instrument, tiles, allocator=joint)
    with pytest.raises(rs.errors.InputError, match="unknown objective 'targets'; choose one of: finished, visits"):
        rs.JointOptions(objective="targets")


def test_a_stored_survey_is_the_same_and_can_be_planned_again(tmp_path):
    """A folder contains the objective; after observations, the visits that were made count."""
    instrument, tiles, catalog, options, _ = survey_with(12, "science")
    joint = rs.JointOptions(objective="finished", iterations=2, allocator=options)
    survey = rs.plan_survey(catalog, instrument, tiles, allocator=joint, folder=tmp_path / "s")
    plain = rs.plan_survey(catalog, instrument, tiles, allocator=joint)
    for one, other in zip(survey, plain, strict=True):
        assert np.array_equal(one["target_row"], other["target_row"])
    again = rs.survey.continue_survey(tmp_path / "s")
    assert again.summary["joint"] == survey.summary["joint"]
    survey.record(QTable({"tile": [0], "state": ["done"], "date": ["2026-02-01"]}))
    replanned = survey.replan()
    done = (np.asarray(replanned.outcomes["observed"]) >= catalog.visits) & (catalog.visits > 0)
    assert done.sum() >= ((np.asarray(survey.outcomes["observed"]) >= catalog.visits) & (catalog.visits > 0)).sum()


def test_idle_arms_are_obstacles():
    """The numbers of the search are those of the tiles, also where the arm of an omitted visit would be in the way."""
    pfs = rs.Instrument.preset("pfs")
    xy = pfs.focal_plane.xy[np.argsort(np.hypot(*pfs.focal_plane.xy.T))[:400]]
    pfs = replace(pfs, focal_plane=rs.FocalPlane(xy, pfs.focal_plane.positioner))
    rng, center = np.random.default_rng(23), SkyCoord("10h +20d")
    radius = np.hypot(*xy.T).max() + 4.75 * u.mm
    r, angle = radius * np.sqrt(rng.random(1000)), 2 * np.pi * rng.random(1000)
    sky = pfs.projection(center).to_sky(np.stack([r * np.cos(angle), r * np.sin(angle)], axis=-1))
    catalog = rs.Catalog(sky, visits=rng.choice([1, 2, 3], 1000, p=[0.4, 0.3, 0.3]))
    tiles = QTable({"ra": [150, 150, 150] * u.deg, "dec": [20, 20, 20] * u.deg, "pass": [1, 2, 3]})
    survey = rs.plan_survey(catalog, pfs, tiles, allocator=rs.JointOptions(objective="finished", iterations=1))
    done = np.asarray(survey.outcomes["observed"]) >= catalog.visits
    level = survey.summary["joint"]["levels"][0]
    assert (level["n_complete"], survey.summary["n_colliding"]) == (done.sum(), 0)
    assert level["n_visits"] == survey.summary["n_visits_observed"]


def test_few_remaining_visits_first_finishes_more_targets():
    """Tile by tile, each tile gives precedence to targets with the fewest remaining visits within a priority."""
    better = []
    for seed in range(30):
        instrument, tiles, catalog, options, _ = survey_with(seed, "science")
        if not catalog.visits.any():
            continue
        done, plans = [], []
        for subpriority in (None, "fewest remaining visits"):
            survey = rs.plan_survey(catalog, instrument, tiles, allocator=replace(options, subpriority=subpriority))
            n = np.asarray(survey.outcomes["observed"])
            done.append(int(((n >= catalog.visits) & (catalog.visits > 0)).sum()))
            plans.append(survey)
        better.append(done[1] - done[0])
        # the largest sum of subpriorities of the first tile, among plans with the same numbers of each priority
        first = [np.asarray(plan.tile(0)["target_row"]) for plan in plans]
        counts = [np.bincount(catalog.priority[rows[rows >= 0]].astype(int), minlength=3).tolist() for rows in first]
        sums = [-int(catalog.visits[rows[rows >= 0]].sum()) for rows in first]
        assert counts[0] == counts[1], seed
        assert sums[1] >= sums[0], seed
    assert sum(better) > 0
    with pytest.raises(rs.errors.InputError, match="'fewest remaining visits' can be used only for tiles of a survey"):
        rs.plan_tile(
            catalog, instrument, center=tiles[0], allocator=replace(options, subpriority="fewest remaining visits")
        )
