"""Observations on other dates than those for which tiles were planned."""

import warnings

import astropy.units as u
import living
import numpy as np
from astropy.coordinates import SkyCoord
from astropy.table import Table
from astropy.time import Time
from raising import refused, warned

import rfpsurvey as rs

TIMES = ("2020-01-10T05:00:00", "2020-01-10T05:00:00", "2020-07-01T05:00:00")
STARTS = ["2020-02-01", "2020-06-01", "2020-01-10T12:00:00", "2020-01-10T03:00:00"]
STATES = {"id": [1, 2, 3, 4], "state": ["broken"] * 4, "from": STARTS}


def planned(folder, *, speed=0.0, states=None):
    """Return a survey of three tiles in a folder, whose targets move by ``speed`` mas per year in declination."""
    sky, table = living.targets(), living.tiling(0, 3, size=0.1).table.copy()
    motion = {"pm_ra_cosdec": np.zeros(len(sky)) * u.mas / u.yr, "pm_dec": np.full(len(sky), speed) * u.mas / u.yr}
    coord = SkyCoord(sky.coord.ra, sky.coord.dec, **motion, obstime=Time(2016.0, format="jyear"))
    table["time"] = list(TIMES)
    tiling, worn = rs.Tiling.from_table(table), living.instrument()
    worn = worn if states is None else worn.with_states(Table(states), time=tiling.times)
    catalog = rs.Catalog(coord if speed else sky.coord, id=sky.id, visits=sky.visits)
    return rs.plan_survey(catalog, worn, tiling, folder=folder)


def said(survey, date, tile=11):
    """Return the warnings for an observation of a tile."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        survey.record(living.events(tile=[tile], date=date, state="done"), dry_run=True)
    return [str(warning.message) for warning in caught]


def test_a_warning_states_how_far_targets_moved(tmp_path):
    survey = planned(tmp_path / "survey", speed=1000.0)
    assert said(survey, "2020-01-10") == said(survey, "2020-01-09") == []  # the night can begin on the day before
    assert said(survey, "2020-02-14") == []  # 34.8 days, 0.095 arcsec
    (text,) = said(survey, "2020-02-17")  # 37.8 days, 0.103 arcsec
    assert text.startswith("targets moved by more than 0.1 arcsec by their proper motions between the time of the plan")
    assert "tile 11, planned for 2020-01-10 and observed on 2020-02-17 (up to 0.1 arcsec)" in text
    assert "(up to 1 arcsec)" in said(survey, "2021-01-10")[0]
    assert "(up to 0.47 arcsec)" in said(survey, "2020-01-10", tile=13)[0]  # earlier than planned


def test_a_warning_names_the_positioners_whose_states_changed(tmp_path):
    survey = planned(tmp_path / "survey", states=STATES)
    # positioners 3 and 4 break on the date of the plan, which does not state the time of the observation
    assert said(survey, "2020-01-10") == []
    (text,) = said(survey, "2020-02-01")
    used = {*survey.tile(11)["positioner"].tolist()}
    assert "tile 11, planned for 2020-01-10 and observed on 2020-02-01" in text
    assert f"(2 positioners, {len(used & {1, 3})} with a planned target: 1, 3)" in text
    (text,) = said(survey, "2020-01-20", tile=13)
    assert "(2 positioners, 0 with a planned target: 1, 2)" in text
    assert said(survey, "2020-06-20", tile=13) == []


def test_surveys_without_times_and_missing_tables_of_states(tmp_path):
    still = planned(tmp_path / "still")
    assert said(still, "2025-01-01") == []
    survey = planned(tmp_path / "survey", states=STATES)
    next((tmp_path / "survey" / "inputs").glob("instrument*")).unlink()
    table = living.events(tile=[11], date="2020-02-01", state="done")
    warned("the states of positioners .* were not compared: .*instrument", survey.record, table)
    assert len(survey.events()) == 1


def test_tiles_are_not_added_to_a_survey_with_times(tmp_path):
    survey, added = planned(tmp_path / "survey", speed=1000.0), {"state": "added", "ra": 120.01, "dec": 30.0}
    refused("without observing conditions and times of tiles", survey.record, living.events(tile=["99"], **added))
