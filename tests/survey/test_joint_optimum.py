"""Joint plans of small surveys, compared with an integer program that contains all tiles."""

import numpy as np
import pytest
from joint_program import JointProgram, random_survey, visits_by_class

import rfpsurvey as rs

N_CASES, CHUNK = 1000, 20
EXHAUSTIVE = pytest.mark.exhaustive
pytestmark = pytest.mark.filterwarnings("ignore:no target was observed")


@pytest.mark.few(1)
@pytest.mark.parametrize("chunk", [0, 1, *(pytest.param(k, marks=EXHAUSTIVE) for k in range(2, N_CASES // CHUNK))])
def test_no_plan_exceeds_the_bound_and_no_plan_is_worse_than_tile_after_tile(chunk):
    n_best = 0
    for seed in range(CHUNK * chunk, CHUNK * (chunk + 1)):
        instrument, tiles, catalog, options = random_survey(seed)
        if not catalog.visits.any():
            continue
        program = JointProgram(instrument, tiles, catalog, options.parked_obstacles)
        best, sums, classes = program.best(), program.sums(), program.classes
        first = rs.plan_survey(catalog, instrument, tiles, allocator=options)
        size = [10, 40, 2000][seed % 3]
        joint = rs.JointOptions(iterations=4, patch_size=size, allocator=options)
        survey = rs.plan_survey(catalog, instrument, tiles, allocator=joint)
        visits = visits_by_class(survey, catalog, classes)
        before = visits_by_class(first, catalog, classes)
        assert tuple(visits) >= tuple(before), seed
        assert tuple(visits) <= tuple(best), seed
        levels = survey.summary["joint"]["levels"]
        bounds = np.array([level["bound"] for level in levels])
        assert (bounds >= sums).all(), (seed, bounds, sums)
        assert [level["n_visits"] for level in levels] == np.cumsum(visits).tolist(), seed
        assert [level["n_visits_before"] for level in levels] == np.cumsum(before).tolist(), seed
        check_plan(survey, catalog)
        if size == 2000:  # a single patch contains all positioners
            assert tuple(visits) == tuple(best), seed
            assert (bounds == sums).all(), seed
        n_best += tuple(visits) == tuple(best)
    assert n_best >= 0.75 * CHUNK


def check_plan(survey, catalog):
    """Check that no arm with a target collides, and that no target is observed too often."""
    number = np.zeros(len(catalog), dtype=int)
    for part in survey:
        assert not np.asarray(part["in_collision"]).any()
        rows = np.asarray(part["target_row"])
        assert len(np.unique(rows)) == len(rows)
        number[rows] += 1
    assert (number <= catalog.visits).all()
