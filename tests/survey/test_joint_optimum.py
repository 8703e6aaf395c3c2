"""Joint plans of small random surveys, compared with an integer program that contains all tiles."""

import numpy as np
import pytest
from joint_program import JointProgram, counts_by_tile, kinds_of, plans_of, survey_with

from rfpsurvey._sky.arrays import has_role

SEEDS = [range(10), *(pytest.param(range(k, k + 20), marks=pytest.mark.exhaustive) for k in range(0, 100, 20))]
pytestmark = pytest.mark.filterwarnings("ignore::rfpsurvey.RfpsurveyWarning")


def observed_by_class(survey, catalog, classes):
    rows = [part["target_row"][np.asarray(part["observed"]) & has_role(kinds_of(part), "science")] for part in survey]
    return np.array([(catalog.priority[np.concatenate(rows)] == one).sum() for one in classes])


def size_of(seed):
    """Return the size of the patches of a seed."""
    return [10, 40, 2000][seed % 3]


@pytest.mark.parametrize("seeds", SEEDS)
@pytest.mark.parametrize("roles", ["science", "kinds", "several"])
def test_plans_are_between_those_of_single_tiles_and_the_optimum(roles, seeds):
    """No plan exceeds the bound or is worse than tile after tile; requirements are kept, and targets are reused."""
    n_best = n_better = n_unmet = n_reused = n_cases = 0
    cases = ((seed, survey_with(seed, roles)) for seed in seeds)
    for seed, scene, program, first, survey in plans_of(cases, iterations=4, patch_size=size_of):
        instrument, tiles, catalog, options, needs = scene
        n_unmet += (np.array(counts_by_tile(first, needs)) < [need.minimum for need in needs]).sum()
        best, sums = program.best(), program.sums()
        visits, old = (observed_by_class(one, catalog, program.classes) for one in (survey, first))
        assert tuple(old) <= tuple(visits) <= tuple(best), seed
        levels = survey.summary["joint"]["levels"]
        bounds = np.array([level["bound"] for level in levels])
        assert (bounds >= sums).all(), (seed, bounds, sums)
        assert [level["n_visits"] for level in levels] == np.cumsum(visits).tolist(), seed
        assert [level["n_visits_before"] for level in levels] == np.cumsum(old).tolist(), seed
        if "bound_without_requirements" in levels[0] and roles == "kinds":
            free = JointProgram(instrument, tiles, catalog, options.parked_obstacles).sums()
            assert ([level["bound_without_requirements"] for level in levels] >= free).all(), seed
        if size_of(seed) == 2000:  # a single patch contains all positioners
            assert tuple(visits) == tuple(best), seed
            assert (bounds == sums).all() or roles != "science", seed
        times = np.zeros(len(catalog), dtype=int)
        for part in survey:
            rows, kinds = np.asarray(part["target_row"]), kinds_of(part)
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
