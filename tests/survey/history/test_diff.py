"""Differences of two plans of a survey, compared with a comparison of all fibers one by one."""

import shutil

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.table import QTable, Table

import rfpsurvey as rs
from rfpsurvey.survey import VisitRule, diff_surveys

CENTER = SkyCoord(95, 23, unit="deg")
OPTIONS = {"allocator": "repair"}


@pytest.fixture
def scene(small, tmp_path):
    """Return a catalog, tiles, and a survey in a folder that has a copy."""
    sky = rs.synthetic_catalog("poisson", CENTER, 1 * u.deg, density=200 / u.deg**2, rng=3)
    rng = np.random.default_rng(2)
    sky = rs.Catalog(sky.coord, priority=rng.integers(1, 4, len(sky)), visits=rng.integers(1, 3, len(sky)))
    tiles = QTable({"ra": [94.7, 95.3, 94.8, 95.2] * u.deg, "dec": [23, 23, 23.1, 23.1] * u.deg, "pass": [1, 1, 2, 2]})
    survey = rs.plan_survey(sky, small, tiles, folder=tmp_path / "plan", **OPTIONS)
    shutil.copytree(tmp_path / "plan", tmp_path / "before")
    return sky, tiles, survey


@pytest.fixture
def again(scene, small, tmp_path):
    """Return a function that records tables, plans the survey again, and returns the differences of both plans.

    The fibers with another target are compared with those that are found one by one. The plans are also returned.
    """

    def again(*tables, **options):
        sky, tiles, survey = scene
        for table in tables:
            survey.record(Table(table))
        state = survey.state(sky, **options)
        folder = {"folder": survey.folder, "resume": True}
        new = rs.plan_survey(sky, small, tiles, visits=state, **folder, **OPTIONS)
        first = rs.Survey.read(tmp_path / "before")
        table = diff_surveys(first, new)
        if len(first) == len(new):
            assert rows_of(table) == fibers(first, new)
        return table, first, new

    return again


def fibers(first, second):
    """Return the fibers with another target, found one by one: tile, positioner, and both targets."""
    found = set()
    for name in first.tiles["tile"].tolist():
        plans = [
            dict(zip(map(str, one["positioner"].tolist()), map(str, one["target_id"].tolist()), strict=True))
            for one in (first.tile(name), second.tile(name))
        ]
        for fiber in {*plans[0], *plans[1]}:
            pair = plans[0].get(fiber, ""), plans[1].get(fiber, "")
            if pair[0] != pair[1]:
                found.add((str(name), fiber, *pair))
    return found


def rows_of(table):
    rows = table[table["positioner"] != ""]
    return {(row["tile"], row["positioner"], row["before"], row["after"]) for row in rows}


def tiles_of(table):
    rows = table[table["positioner"] == ""]
    return dict(zip(rows["tile"].tolist(), rows["reason"].tolist(), strict=True))


def test_equal_surveys_have_no_differences(scene, small, tmp_path):
    sky, tiles, survey = scene
    table = diff_surveys(tmp_path / "before", survey)
    assert (len(table), table.colnames) == (0, ["tile", "positioner", "before", "after", "reason"])
    memory = rs.plan_survey(sky, small, tiles, **OPTIONS)
    assert len(diff_surveys(memory, survey)) == 0


def test_damaged_surveys_are_not_compared(scene, tmp_path):
    """Regression: a missing file, or the file of another tile, was not noticed if the plans were equal."""
    part = tmp_path / "before" / "tiles" / "000" / "000001.fits"
    shutil.copy(part.with_name("000002.fits"), part)
    with pytest.raises(rs.InputError, match="000001.fits is damaged"):
        diff_surveys(scene[2], tmp_path / "before")
    part.unlink()
    with pytest.raises(rs.InputError, match="000001.fits is missing"):
        diff_surveys(tmp_path / "before", scene[2])


def test_observed_tiles_do_not_change_and_failed_visits_are_repeated(again, scene):
    _, _, survey = scene
    bad = survey.tile(0)
    bad = bad["positioner"][np.argsort(bad["priority"])[-4:]].tolist()
    table, first, second = again(
        {"tile": [0], "state": ["done"], "date": ["2026-01-03"]},
        {"tile": [0] * 4, "positioner": bad, "date": ["2026-01-03"] * 4},
    )
    table = diff_surveys(first, second)
    assert (tiles_of(table), rows_of(table)) == ({"0": "observed"}, fibers(first, second))
    assert "failed visit" in table["reason"]
    failed = {str(one) for one in survey.tile(0)["target_id"][np.isin(survey.tile(0)["positioner"], bad)].tolist()}
    reasons = table["reason"][np.isin(table["after"], sorted(failed))]
    assert set(reasons.tolist()) <= {"failed visit"}


def test_targets_that_need_no_visit_any_more_are_complete(again):
    table, _, second = again({"tile": [0], "state": ["done"]}, rule=VisitRule(visits=1))
    done = {str(one) for one in second.tile(0)["target_id"].tolist()}
    complete = table[table["reason"] == "target complete"]
    assert len(complete) > 0
    assert set(complete["before"].tolist()) <= done
    assert not done & set(table["before"][(table["reason"] != "target complete") & (table["tile"] != "0")].tolist())


def test_dropped_added_and_changed_targets_are_reasons(again, scene):
    sky, _, survey = scene
    planned = survey.tile(0)["target_id"].tolist()
    place = sky.coord[int(survey.tile(0)["target_row"][3])]
    near = {"ra": [place.ra.deg + 0.01], "dec": [place.dec.deg]}
    table, *_ = again(
        {"target": planned[:3], "state": ["dropped"] * 3},
        {"target": [10**6], "state": ["added"], "priority": [9], "visits": [1], **near},
        {"target": planned[10:12], "priority": [0.5, 0.5]},
    )
    dropped = set(table["before"][table["reason"] == "target dropped"].tolist())
    assert dropped <= {str(one) for one in planned[:3]}
    assert dropped
    assert set(table["reason"][table["after"] == "1000000"].tolist()) <= {"target added", "target dropped"}
    assert "target added" in table["reason"]


def test_targets_that_are_no_longer_requested_are_not_complete(again, scene):
    planned = [str(one) for one in scene[2].tile(0)["target_id"].tolist()]
    table, *_ = again({"target": scene[2].tile(0)["target_id"][:5], "visits": [0] * 5})
    rows = np.isin(table["before"], planned[:5])
    assert set(table["reason"][rows].tolist()) == {"visits changed"}


def test_changed_priorities_are_a_reason(again):
    rule = VisitRule(table=Table({"class": ["1"], "priority": [9.0]}))
    table, *_ = again({"tile": [3], "state": ["bad"]}, rule=rule)
    assert "priority changed" in table["reason"]


def test_dropped_added_and_moved_tiles_are_listed(again):
    table, first, second = again(
        {"tile": [1, 2], "state": ["dropped", "partly"]},
        {"tile": [3, 8], "state": ["added"] * 2, "ra": [95.1, 95.0], "dec": [23.0, 23.0], "pass": [2, 2]},
    )
    assert tiles_of(table) == {"1": "dropped", "2": "partly observed", "3": "moved", "8": "added"}
    assert not [row for row in rows_of(table) if row[0] in ("1", "8")]
    back = diff_surveys(second, first)
    assert tiles_of(back) == {"1": "planned again", "2": "planned again", "3": "moved", "8": "removed"}
    assert {(t, p, b, a) for t, p, a, b in rows_of(back)} == rows_of(table)


def test_other_plans_and_other_catalogs(scene, small):
    sky, tiles, survey = scene
    table = diff_surveys(survey, rs.plan_survey(sky, small, tiles, allocator="nearest"))
    assert set(table["reason"].tolist()) == {"other plan"}
    renamed = rs.Catalog(sky.coord, id=sky.id + 1, priority=sky.priority)
    table = diff_surveys(survey, rs.plan_survey(renamed, small, tiles, **OPTIONS))
    assert set(table["reason"].tolist()) == {"other catalog"}


def test_only_surveys_are_compared(scene, tmp_path):
    with pytest.raises(rs.InputError, match="the second survey must be a Survey or the folder of a survey, got None"):
        diff_surveys(scene[2], None)
    with pytest.raises(rs.InputError, match="does not hold a survey"):
        diff_surveys(scene[2], tmp_path)
