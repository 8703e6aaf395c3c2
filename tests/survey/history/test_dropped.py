"""Tiles that were dropped: late reports, other tiles at their positions, and tiles that are observed after all."""

import pytest
from living import events, replan

import rfpsurvey as rs


def state_of(case, survey, tile):
    """Return the state of a tile after the survey was planned again."""
    again = replan(case, survey)
    return again.tiles["state"][again.tiles["tile"].tolist().index(tile)]


@pytest.mark.few(4)
@pytest.mark.parametrize("state", ["partly", "bad"])
@pytest.mark.parametrize("date", ["", "2026-01-05"])
@pytest.mark.parametrize("replanned", [False, True])
def test_a_report_on_the_past_leaves_a_tile_dropped(case, survey, state, date, replanned):
    """Regression: a late report of one fiber of a dropped tile made it a planned tile again."""
    survey.record(events(tile=12, date="2026-01-03", state=state))
    survey.record(events(tile=12, date=date, state="dropped"))
    survey = replan(case, survey) if replanned else survey
    survey.record(events(tile=12, date="2026-01-03", positioner="1"))
    assert state_of(case, survey, 12) == "dropped"
    survey.record(events(tile=12, date="2026-01-03", state="bad", fraction=0.2))
    assert state_of(case, survey, 12) == "dropped"
    survey.record(events(tile=12, date="2026-01-03", state="done"))
    assert state_of(case, survey, 12) == "done"  # the tile was observed before it was dropped
    survey.record(events(tile=12, date="2026-01-03", state="bad", fraction=0.1))
    assert state_of(case, survey, 12) == "dropped"
    survey.record(events(tile=12, state="planned"))
    assert state_of(case, survey, 12) == "planned"


def test_a_new_observation_cancels_that_a_tile_was_dropped_in_any_order(case, survey):
    """Only the dates count: an observation after a tile was dropped makes it a planned tile again."""
    drop, late, later = (
        events(tile=12, date=f"2026-01-0{day}", **more)
        for day, more in ((5, {"state": "dropped"}), (4, {"fraction": 0.5}), (6, {"fraction": 0.7}))
    )
    survey.record(drop)
    survey.record(late)
    assert survey.state(case[0]).summary["n_tiles_dropped"] == 1
    survey.record(later)
    assert survey.state(case[0]).summary["n_tiles_dropped"] == 0
    survey.record(events(tile=12, state="planned"))
    for table in (later, drop):
        survey.record(table)
    assert survey.state(case[0]).summary["n_tiles_dropped"] == 0


def test_a_tile_that_is_added_again_is_not_dropped_any_more(case, survey):
    """Regression: the state added of a dropped tile had no effect, and no message."""
    place = survey.tiles[1]
    survey.record(events(tile=12, state="dropped"))
    same = events(tile=12, state="added", ra=place["ra"].value, dec=place["dec"].value)
    assert (survey.record(same)["n_events"], state_of(case, survey, 12)) == (1, "planned")


@pytest.mark.parametrize("fraction", [0.0, 0.5])
def test_another_tile_takes_the_position_of_a_dropped_tile(case, survey, fraction):
    """Regression: the new tile at the position of a retired tile was refused as the same tile."""
    place, n = survey.tiles[1], len(survey.tile(12))
    new = events(tile=30, state="added", ra=place["ra"].value, dec=place["dec"].value)
    new["pass"] = place["pass"]
    survey.record(events(tile=12, date="2026-01-03", fraction=fraction))
    with pytest.raises(rs.InputError, match="tiles 12 and 30 are the same"):
        survey.record(new)
    survey.record(events(tile=12, date="2026-01-05", state="dropped"))
    survey.record(new)
    again = replan(case, survey)
    assert len(again.tile(30)) == n > 0
    for table in (events(tile=12, state="planned"), events(tile=12, date="2026-01-06", fraction=0.5)):
        with pytest.raises(rs.InputError, match="tiles 12 and 30 are the same|tile 12 was observed must be one of"):
            again.record(table)
    again.record(events(tile=30, date="2026-01-06", state="done"))
    again.record(events(tile=12, date="2026-01-03", positioner="1"))
    assert replan(case, again).tiles["state"].tolist()[1::5] == ["dropped", "done"]
    read = rs.Tiling.read(again.folder / "tiles.fits")
    assert len(read) == 7


def test_a_tile_without_the_date_on_which_it_was_dropped_remains_dropped_after_late_reports(case, survey):
    """It was dropped on the last date of all observations that were recorded before."""
    survey.record(events(tile=11, date="2026-01-05"))
    survey.record(events(tile=12, state="dropped"))
    for date, n in (("2026-01-04", 1), ("2026-01-05", 1), ("2026-01-06", 0)):
        survey.record(events(tile=12, date=date, fraction=0.5))
        assert survey.state(case[0]).summary["n_tiles_dropped"] == n
