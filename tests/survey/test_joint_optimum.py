"""Joint plans of small random surveys, compared with an integer program that contains all tiles."""

import numpy as np
import pytest
from joint_program import JointProgram, counts_by_tile, kinds_of, program_of, survey_with

import rfpsurvey as rs
from rfpsurvey._sky.arrays import has_role

SEEDS = [range(10), *(pytest.param(range(k, k + 20), marks=pytest.mark.exhaustive) for k in range(0, 100, 20))]
pytestmark = pytest.mark.filterwarnings("ignore::rfpsurvey.RfpsurveyWarning")


def observed_by_class(survey, catalog, classes):
    rows = [part["target_row"][np.asarray(part["observed"]) & has_role(kinds_of(part), "science")] for part in survey]
    return np.array([(catalog.priority[np.concatenate(rows)] == one).sum() for one in classes])


@pytest.mark.parametrize("seeds", SEEDS)
@pytest.mark.parametrize("roles", ["science", "kinds", "several"])
def test_plans_are_between_those_of_single_tiles_and_the_optimum(roles, seeds):
    """No plan exceeds the bound or is worse than tile after tile; requirements are kept, and targets are reused."""
    n_best = n_better = n_unmet = n_reused = n_cases = 0
    for seed in seeds:
        instrument, tiles, catalog, options, needs = survey_with(seed, roles)
        is_science = np.ones(len(catalog), bool) if catalog.kind is None else has_role(catalog.kind, "science")
        if not catalog.visits[is_science].any():
            continue
        first = rs.plan_survey(catalog, instrument, tiles, allocator=options)
        size = [10, 40, 2000][seed % 3]
        joint = rs.JointOptions(iterations=4, patch_size=size, allocator=options)
        survey = rs.plan_survey(catalog, instrument, tiles, allocator=joint)
        before = counts_by_tile(first, needs)
        program = program_of(instrument, tiles, catalog, options, needs, before)
        best, sums = program.best(), program.sums()
        visits, old = (observed_by_class(one, catalog, program.classes) for one in (survey, first))
        assert tuple(old) <= tuple(visits) <= tuple(best), seed
        for row, earlier in zip(counts_by_tile(survey, needs), before, strict=True):
            for need, n, m in zip(needs, row, earlier, strict=True):
                assert n >= min(need.minimum, m), seed
                assert need.maximum is None or n <= need.maximum, seed
                n_unmet += m < need.minimum
        levels = survey.summary["joint"]["levels"]
        bounds = np.array([level["bound"] for level in levels])
        assert (bounds >= sums).all(), (seed, bounds, sums)
        assert [level["n_visits"] for level in levels] == np.cumsum(visits).tolist(), seed
        assert [level["n_visits_before"] for level in levels] == np.cumsum(old).tolist(), seed
        if "bound_without_requirements" in levels[0] and roles == "kinds":
            free = JointProgram(instrument, tiles, catalog, options.parked_obstacles).sums()
            assert ([level["bound_without_requirements"] for level in levels] >= free).all(), seed
        if size == 2000:  # a single patch contains all positioners
            assert tuple(visits) == tuple(best), seed
            assert (bounds == sums).all() or roles != "science", seed
        times = np.zeros(len(catalog), dtype=int)
        for part in survey:
            rows, kinds = np.asarray(part["target_row"]), kinds_of(part)
            assert not np.asarray(part["in_collision"]).any(), seed
            assert len(np.unique(rows)) == len(rows), seed
            np.add.at(times, rows[has_role(kinds, "science")], 1)
            n_reused += 0 if catalog.kind is None else (catalog.kind[rows] != kinds).sum()
        assert (times <= catalog.visits).all(), seed
        assert np.array_equal(np.sort(survey.outcomes["observed"]), np.sort(times)), seed
        n_best += tuple(visits) == tuple(best)
        n_better += tuple(visits) > tuple(old)
        n_cases += 1
    assert n_best >= 0.75 * n_cases
    assert n_better
    assert n_unmet or roles != "kinds"
    assert n_reused or roles != "several"
