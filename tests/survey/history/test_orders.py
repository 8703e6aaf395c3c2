"""States and plans do not depend on the order of rows, on the number of workers, or on the checkpoint."""

import shutil
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from living import content, differences, events, part, replan, targets

import rfpsurvey as rs
from rfpsurvey._survey.history.event_files import read_events
from rfpsurvey.survey import VisitRule


@pytest.fixture(scope="module")
def planned(case, tmp_path_factory):
    folder = tmp_path_factory.mktemp("planned") / "survey"
    rs.plan_survey(*case, folder=folder, allocator="repair")
    return folder


def copies(planned, tmp_path, n):
    return [rs.Survey.read(shutil.copytree(planned, tmp_path / f"survey-{k}")) for k in range(n)]


def table_of(survey):
    """Return a table with observations of two nights, failures, and a tile that is dropped."""
    visits = survey.tile(12)
    rows = [
        ("11", "2026-01-04", "done", ""),
        ("12", "2026-01-03", "done", ""),
        *(("12", "2026-01-03", "", str(one)) for one in visits["positioner"][:3]),
        ("13", "2026-01-03", "bad", ""),
        ("13", "2026-01-05", "done", ""),
        ("14", "2026-01-05", "partly", ""),
        ("15", "", "dropped", ""),
    ]
    tile, date, state, positioner = (list(column) for column in zip(*rows, strict=True))
    return events(tile=tile, date=date, state=state, positioner=positioner)


def stated(survey):
    """Return the events in all files, without the rows of the tables, which keep their order."""
    return [(file.targets, file.tiles) for file in read_events(survey.folder).files]


def in_order(table):
    """Return whether the tiles of each night have the order in which they were observed."""
    tiles = [[*dict.fromkeys(table["tile"][table["date"] == f"2026-01-0{day}"].tolist())] for day in (3, 5)]
    return tiles == [["12", "13"], ["13", "14"]]


def test_the_order_of_the_rows_of_a_table(case, planned, tmp_path, rng):
    """Regression: a late record of an earlier night was refused in some orders, and the last visits were others."""
    first, *others = copies(planned, tmp_path, 6)
    table = table_of(first)
    assert first.record(table)["n_events"] == 6
    for survey in others:
        # the tiles of a night remain in their order, which is that of the observations
        order = rng.permutation(len(table))
        while not in_order(table[order]):
            order = rng.permutation(len(table))
        survey.record(table[order])
        assert stated(survey) == stated(first)


def test_the_order_of_several_tables(case, planned, tmp_path, rng):
    """A night that is recorded late gives the same state, with the same last visits."""
    first, *others = copies(planned, tmp_path, 4)
    table = table_of(first)
    first.record(table)
    state = first.state(case[0])
    assert {*state.table["last_date"].tolist()} == {"", "2026-01-03", "2026-01-04", "2026-01-05"}
    for k, survey in enumerate(others):
        nights = ["2026-01-03", "2026-01-04", "2026-01-05"]
        for night in np.roll(nights, k):
            if night == nights[-1]:  # the failed observation of a tile is recorded before its repetition
                survey.record(table[(table["tile"] == "13") & (table["date"] == nights[0])])
            survey.record(table[table["date"] == night])
        found = survey.state(case[0])
        for name in ("observed", "failed", "left", "last", "last_tile", "last_date"):
            assert (found.table[name] == state.table[name]).all(), name
        # the checkpoint of the first nights is not that of all nights
        replan(case, survey, allocator="repair")
        assert (survey.state(case[0]).table["last_tile"] == state.table["last_tile"]).all()


def test_observations_without_dates_follow_those_before_them(case, planned, tmp_path):
    (survey,) = copies(planned, tmp_path, 1)
    survey.record(events(tile=11, date="2026-01-04"))
    survey.record(events(tile=14, state="done"))
    both = {*survey.tile(11)["target_id"].tolist()} & {*survey.tile(14)["target_id"].tolist()}
    own = {row["target_id"]: row for row in survey.state(case[0]).table}
    assert {own[one]["last_tile"] for one in both} == {"14"}
    assert survey.state(case[0], until="2026-01-01").summary["n_tiles_observed"] == 1


def test_rows_of_the_catalog(case, planned, tmp_path, rng):
    """A state needs the rows of the first plan; a survey of targets in another order gives the same state."""
    (survey,) = copies(planned, tmp_path, 1)
    order = rng.permutation(len(case[0]))
    survey.record(table_of(survey))
    words = "the catalog must be that of the first plan, with 60 targets, digest .*, got another catalog"
    with pytest.raises(rs.InputError, match=words):
        survey.state(case[0][order])
    other = rs.plan_survey(case[0][order], *case[1:], folder=tmp_path / "other", allocator="repair")
    other.record(table_of(survey))
    one, two = survey.state(case[0]), other.state(case[0][order])
    for name in ("requested", "observed", "failed", "left"):
        assert (getattr(one, name)[order] == getattr(two, name)).all(), name
    both = (case[0], one), (case[0][order], two)
    plans = [rs.plan_survey(sky, *case[1:], visits=state, allocator="repair") for sky, state in both]
    for name in ("n_observed", "n_assigned", "n_failed", "completeness"):
        assert (plans[0].tiles[name] == plans[1].tiles[name]).all(), name


def test_workers(case, planned, tmp_path):
    one, two = copies(planned, tmp_path, 2)
    for survey in (one, two):
        survey.record(table_of(survey))
    replan(case, one, allocator="repair")
    with ThreadPoolExecutor(2) as executor:
        replan(case, two, allocator="repair", executor=executor)
    assert content(one.folder) == content(two.folder)
    for row in (0, 1, 3):
        assert part(one.folder, row) == part(planned, row)


def test_a_partitioned_catalog(case, tmp_path):
    """The states and plans of a catalog in partitions and in memory are equal, also after another state was read."""
    rs.catalog.partition_catalog(targets(kinds=True), tmp_path / "catalog", order=8)
    sky = rs.catalog.PartitionedCatalog(tmp_path / "catalog")
    both, found = (sky, sky.read()), []
    assert len(sky.parts.files) > 5
    for k, catalog in enumerate(both):
        folder = tmp_path / f"survey-{k}"
        survey = rs.plan_survey(catalog, *case[1:], folder=folder, allocator="nearest")
        survey.record(table_of(survey))
        for number in (1, 2):
            rule = VisitRule(visits=number)
            state = survey.state(catalog, rule=rule)
            again = replan((catalog, *case[1:]), survey, visits=state)
        found.append((state, again))
    (one, plan), (two, other) = found
    for name in ("requested", "observed", "failed", "left"):
        assert (getattr(one, name) == getattr(two, name)).all(), name
    assert (one.summary, differences(plan, other)) == (two.summary, [])
    survey = rs.Survey.read(tmp_path / "survey-0")
    with pytest.raises(rs.InputError, match="rules that change priorities must be used with a catalog in memory"):
        survey.state(sky, rule=VisitRule(function=lambda table: {"priority": np.ones(len(table))}))
    with pytest.raises(rs.InputError, match="targets must be changed only in a survey of a catalog in memory"):
        survey.record(events(target=1001, state="dropped"))


def test_the_order_of_new_targets_and_tiles(case, planned, tmp_path, rng):
    """Regression: the rows of added targets and tiles were those of the table."""
    first, *others = copies(planned, tmp_path, 4)
    new = events(target=[1003, 2001, 2002, 1001], state=["dropped", "", "", ""], ra=120.1, dec=30.0, priority=2.0)
    new["visits"] = [1, 1, 2, 3]
    tiles = events(tile=[101, 30, 9, 14], state=["added"] * 3 + ["dropped"], ra=[120.0, 120.1, 119.9, 0.0], dec=30.0)
    for survey in (first, *others):
        order = np.arange(4) if survey is first else rng.permutation(4)
        assert survey.record(new[order])["n_events"] == survey.record(tiles[order])["n_events"] == 4
        assert stated(survey) == stated(first)


@pytest.mark.parametrize("tiles", [[11, 14], [14, 11]])
@pytest.mark.parametrize("date", ["2026-01-03", ""])
def test_the_last_visit_of_a_night_is_that_of_the_last_tile_of_the_table(case, planned, tmp_path, tiles, date):
    """Regression: tiles of a night were sorted by their rows in the list of tiles."""
    (survey,) = copies(planned, tmp_path, 1)
    survey.record(events(tile=tiles, date=date, state="done"))
    both = {*survey.tile(11)["target_id"].tolist()} & {*survey.tile(14)["target_id"].tolist()}
    own = {row["target_id"]: row["last_tile"] for row in survey.state(case[0]).table}
    assert {own[one] for one in both} == {str(tiles[-1])}
    again = replan(case, survey, allocator="repair")
    assert {row["last_tile"] for row in again.state(case[0]).table if row["target_id"] in both} == {str(tiles[-1])}
