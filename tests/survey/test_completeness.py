"""The outcome of each target of a survey, and the completeness after each pass."""

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.table import QTable

import flat
import rfpsurvey as rs
from fields import CENTER, clustered_sky, grid


@pytest.fixture(scope="module")
def sky():
    return clustered_sky()


@pytest.mark.filterwarnings("ignore:no target was observed")
def test_what_became_of_each_target(small):
    """There is one positioner, and one target for each outcome."""
    one = rs.Positioner(8 * u.mm, 8 * u.mm, 2.25 * u.mm)
    plane = rs.FocalPlane([[0, 0], [20, 0]] * u.mm, one)
    instrument = rs.Instrument("two", plane, plate_scale=100 * u.mm / u.deg)
    projection = instrument.projection(CENTER)
    xy = np.array([[0, 1.0], [0, 2.0], [9.0, 0.0], [11.0, 0.0], [0.0, 30.0], [-2.0, 0.0], [24.0, 5.0]])
    coord = SkyCoord([*projection.to_sky(xy * u.mm), CENTER.directional_offset_by(0 * u.deg, 9 * u.deg)])
    names = ["first", "second", "left", "right", "beyond", "unwanted", "often", "far"]

    def outcome(chosen, visits, **options):
        rows = [names.index(name) for name in chosen]
        catalog = rs.Catalog(coord[rows], id=chosen, visits=visits)
        survey = flat.plan_survey(catalog, instrument, CENTER.reshape(1), allocator="nearest", **options)
        table = survey.outcomes
        return {str(i): rs.Survey.OUTCOMES[k] for i, k in zip(table["target_id"], table["outcome"], strict=True)}

    assert outcome(["first", "second", "beyond", "unwanted", "often", "far"], [1, 1, 1, 0, 2, 1]) == {
        "first": "observed",
        "second": "in reach not assigned",
        "beyond": "out of reach",
        "unwanted": "not requested",
        "often": "partly observed",
        "far": "in no field",
    }
    both = ["left", "right"]
    assert set(outcome(both, [1, 1]).values()) == {"lost to a collision"}
    assert set(outcome(both, [1, 1], lost_in_collision=False).values()) == {"observed"}


@pytest.mark.parametrize("order", ["color", "given"])
def test_completeness_counts_what_the_visits_say(sky, small, order):
    """A target is complete in the pass of the last tile that observes it, in the order of planning.

    This may not be the last pass.
    """
    tiling = grid(1.2)
    if order == "given":  # tiles of the second pass are planned before and after those of the first pass
        tiling = rs.Tiling(tiling.table[np.random.default_rng(2).permutation(len(tiling))])
    survey = rs.plan_survey(sky, small, tiling, order=order)
    number = dict(zip(survey.tiles["tile"].tolist(), survey.tiles["pass"].tolist(), strict=True))
    visits = survey.targets[survey.targets["observed"]]
    of_pass = np.array([number[t] for t in visits["tile"].tolist()])
    for row in survey.completeness:
        chosen = sky.visits > 0
        if row["priority"] != "all":
            chosen &= sky.priority == float(row["priority"])
        seen = visits["target_row"][of_pass <= row["pass"]]
        times = np.bincount(seen, minlength=len(sky))
        assert (row["n_targets"], row["n_requested"]) == (chosen.sum(), sky.visits[chosen].sum())
        assert (row["n_observed"], row["n_complete"]) == (times[chosen].sum(), (times >= sky.visits)[chosen].sum())
        assert row["completeness"] == pytest.approx(times[chosen].sum() / sky.visits[chosen].sum())
    assert set(survey.completeness["priority"]) == {"all", "1", "2", "3"}


def test_a_target_is_complete_after_the_last_pass_that_it_needs(small):
    """The tile of pass 2 precedes that of pass 1. Two visits are therefore not complete after pass 1 alone."""
    tiles = QTable({"ra": [0.1, 0.1] * u.deg, "dec": [60, 60] * u.deg, "pass": [2, 1]})
    target = rs.Catalog(SkyCoord([CENTER.directional_offset_by(0 * u.deg, 0.05 * u.deg)]), visits=[2])
    survey = rs.plan_survey(target, small, tiles, order="given")
    assert (survey.completeness["n_observed"].tolist(), survey.completeness["n_complete"].tolist()) == ([1, 2], [0, 1])


def classes(sky, small, priority):
    survey = rs.plan_survey(rs.Catalog(sky.coord, priority=priority), small, grid(1.2), passes=[2])
    return survey.completeness[1:]


def test_priorities_are_counted_apart_up_to_twenty(sky, small):
    values = np.arange(len(sky)) % 20 + 1e7
    table = classes(sky, small, values)
    assert table["priority"].tolist() == [str(round(v)) for v in np.unique(values)[::-1]]
    assert table["n_targets"].tolist() == np.bincount((values - 1e7).astype(int))[::-1].tolist()


def test_more_priorities_are_counted_in_ranges(sky, small, rng):
    table = classes(sky, small, rng.random(len(sky)))
    assert (len(table), table["n_targets"].sum()) == (10, len(sky))
    assert np.all(np.abs(table["n_targets"] / len(sky) - 0.1) < 0.01)
    ranges = np.array([[float(x) for x in name.split(" to ")] for name in table["priority"]])
    assert (ranges[:, 0] < ranges[:, 1]).all()
    assert (ranges[1:, 1] < ranges[:-1, 0]).all()
    assert len(classes(sky, small, np.arange(len(sky)) % 21)) == 10


def test_a_common_priority_is_never_split(sky, small):
    """If nine of ten targets have the same priority, it is a separate class, and so are the priorities above and below
    it.
    """
    n = len(sky)
    for low in (True, False):
        priority = np.where(np.arange(n) % 10 > 0, 500.0, np.arange(n) * (0.1 if low else 10.0) + (0 if low else 600))
        table = classes(sky, small, priority)
        common = [name for name in table["priority"] if " " not in name and float(name) == 500]
        parts = [[float(x) for x in name.split(" to ")] for name in table["priority"]]
        holding = [p for p in parts if p[0] <= 500 <= p[-1]]
        assert len(holding) == 1
        assert common or low
        assert table["n_targets"].sum() == n


def test_a_field_without_targets_has_no_completeness(sky, small):
    tiles = SkyCoord([CENTER, CENTER.directional_offset_by(0 * u.deg, 20 * u.deg)])
    survey = rs.plan_survey(sky, small, tiles)
    assert survey.tiles["n_in_field"][1] == survey.tiles["n_assigned"][1] == 0
    assert np.isnan(survey.tiles["completeness"][1])
    near = sky.coord.separation(CENTER) < small.field_radius
    table = survey.outcomes[near]
    assert survey.tiles["completeness"][0] == pytest.approx(table["observed"].sum() / table["requested"].sum())
