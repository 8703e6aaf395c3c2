"""Selection probabilities of a survey with recorded events, compared with surveys of single realizations."""

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.table import Table

import rfpsurvey as rs
from rfpsurvey.survey import VisitRule

INSTRUMENT = "sdss_apo"
TILES = SkyCoord([120.0, 120.7, 120.0, 120.7, 120.3] * u.deg, [30.0, 30.0, 30.6, 30.6, 30.3] * u.deg)


@pytest.fixture(scope="module")
def stars():
    sky = rs.synthetic_catalog(
        "poisson", SkyCoord(120.3 * u.deg, 30.3 * u.deg), 1.8 * u.deg, density=60 / u.deg**2, rng=1
    )
    rng = np.random.default_rng(2)
    return rs.Catalog(sky.coord, priority=rng.integers(1, 3, len(sky)), visits=rng.integers(1, 3, len(sky)))


def observe(survey, tile, date, failed=(), fraction=1.0):
    """Record an observation of a tile, in which the given positioners fail if they have a target."""
    used = {*np.asarray(survey.tile(tile)["positioner"]).tolist()} & {*failed}
    survey.record(Table({"tile": [tile], "date": [date], "fraction": [fraction]}))
    if used:
        survey.record(Table({"tile": [tile] * len(used), "date": [date] * len(used), "positioner": sorted(used)}))


def plan_in(folder, stars, options, seed):
    """Return a function that plans a survey or, given the survey, plans its rest."""

    def plan(survey=None):
        state = {} if survey is None else {"visits": survey.state(stars), "resume": True}
        return rs.plan_survey(stars, INSTRUMENT, TILES, allocator=options, folder=folder, rng=seed, **state)

    return plan


def live(stars, folder, options, seed, failed):
    """Plan a survey, record three nights, plan the rest after each night, and return the last plan and its state."""
    plan = plan_in(folder, stars, options, seed)
    survey = plan()
    observe(survey, 1, "2026-01-03", failed[1])
    observe(survey, 4, "2026-01-03", fraction=0.5)
    observe(survey, 3, "2026-01-03", fraction=0.0)
    survey = plan(survey)
    observe(survey, 0, "2026-01-04")
    new = {"target": [10**6, 5], "state": ["added", "dropped"], "ra": [120.3, np.nan], "dec": [30.3, np.nan]}
    survey.record(Table({**new, "priority": [5, np.nan]}))
    survey = plan(survey)
    observe(survey, 4, "2026-01-05", failed[4])
    return plan(survey), survey.state(stars)


def live_and_correct(stars, folder, options, seed, failed):
    """Plan a survey whose observations are completed and corrected after the rest was planned."""
    plan = plan_in(folder, stars, options, seed)
    survey = plan()
    observe(survey, 1, "2026-01-03")
    observe(survey, 4, "2026-01-03", fraction=0.5)
    survey = plan(survey)
    observe(survey, 0, "2026-01-04")
    observe(survey, 1, "2026-01-03", failed[1])  # the failures are reported late
    survey = plan(survey)
    survey.record(Table({"tile": [0, 3], "date": ["2026-01-04", ""], "state": ["bad", "dropped"]}))
    survey = plan(survey)
    observe(survey, 2, "2026-01-05")
    return plan(survey), survey.state(stars)


@pytest.mark.filterwarnings("ignore:rng has no effect")
@pytest.mark.parametrize("allocator", ["nearest", "repair"])
def test_observations_that_were_corrected_are_repeated_as_they_were_known(stars, tmp_path, allocator):
    """Regression: realizations omitted partly observed tiles, plans after which an observation was corrected, and the
    order in which failures were reported."""
    names = rs.plan_tile(stars, INSTRUMENT, center=TILES[0]).table["id"].tolist()
    options = rs.AllocationOptions(allocator, subpriority=1)
    survey, state = live_and_correct(stars, tmp_path / "survey", options, 0, {1: names[::3]})
    failed = {row: list(event.failed) for row, event in state.kept.items()}
    assert len(failed[1]) > 20
    assert len(state.begun) == 1
    found = rs.selection_probabilities(state, INSTRUMENT, TILES, 2, allocator=allocator)
    for r, seed in enumerate(found.realizations["seed"].tolist()):
        options = rs.AllocationOptions(allocator, subpriority=seed)
        own, _ = live_and_correct(stars, tmp_path / f"{r}", options, seed, failed)
        np.testing.assert_array_equal(found.observed_in(r), np.asarray(own.outcomes["observed"]) > 0)
        assert found.realizations["n_observed"][r] == own.summary["n_visits_observed"]
    kept = [0, 1, 2, 4]  # the last tile was dropped
    reached = rs.selection.potential_assignments(stars, INSTRUMENT, TILES, survey=survey)
    assert len(reached) == found.summary["n_tiles"] == 4
    alone = rs.selection.potential_assignments(stars, INSTRUMENT, TILES[kept]).n_tiles()
    np.testing.assert_array_equal(found.table["n_tiles"], alone)
    assert (reached.n_tiles() <= alone).all()


@pytest.mark.filterwarnings("ignore:rng has no effect")
@pytest.mark.parametrize("allocator", ["nearest", "balanced", "lamost_rule", "repair"])
def test_each_realization_repeats_the_observations(stars, tmp_path, allocator):
    """The tiles that were observed are observed in each realization with its own plans; the same positioners fail."""
    names = rs.plan_tile(stars, INSTRUMENT, center=TILES[0]).table["id"].tolist()
    failed = names[::7]
    options = rs.AllocationOptions(allocator, subpriority=1)
    _, state = live(stars, tmp_path / "survey", options, 0, dict.fromkeys((1, 4), failed))
    # what failed is known only for positioners that had a target
    failed = {row: list(event.failed) for row, event in state.kept.items()}
    assert failed[1]
    assert failed[4]
    found = rs.selection_probabilities(state, INSTRUMENT, TILES, 2, allocator=allocator)
    for r, seed in enumerate(found.realizations["seed"].tolist()):
        options = rs.AllocationOptions(allocator, subpriority=seed)
        survey, _ = live(stars, tmp_path / f"{r}", options, seed, failed)
        np.testing.assert_array_equal(found.observed_in(r), np.asarray(survey.outcomes["observed"]) > 0)
        assert found.realizations["n_observed"][r] == survey.summary["n_visits_observed"]
    assert found.requested[5] == 0
    assert found.requested[-1] == 1


def test_rules_that_depend_on_observations_are_refused(stars, tmp_path):
    options = rs.AllocationOptions("nearest", subpriority=1)
    survey = rs.plan_survey(stars, INSTRUMENT, TILES[:1], allocator=options, folder=tmp_path / "survey")
    state = survey.state(stars, rule=VisitRule(after_success=3))
    with pytest.raises(rs.InputError, match="rule that has only visits, got after_success"):
        rs.selection_probabilities(state, INSTRUMENT, TILES[:1], 2, allocator="nearest")
