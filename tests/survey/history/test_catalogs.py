"""Tables of changes to targets with the columns of a catalog, and catalogs that changed after the first plan."""

import shutil
from dataclasses import replace

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.table import QTable, Table
from astropy.time import Time
from living import CENTER, events, instrument, replan, targets, tiling

import rfpsurvey as rs
from rfpsurvey.survey import SurveyState, survey_status


def begin(sky, tmp_path, **options):
    """Plan a survey in a folder, and return it."""
    options = {"allocator": "nearest", "folder": tmp_path / "survey", **options}
    return rs.plan_survey(sky, instrument(), tiling(), **options)


def plan_again(sky, survey, state, **options):
    return replan((sky, instrument(), tiling()), survey, visits=state, **options)


@pytest.fixture
def ranked(tmp_path):
    """A survey of a catalog whose columns have other names, and whose smallest ranks have precedence."""
    sky = targets()
    table = Table({"star": sky.id, "ra": sky.coord.ra, "dec": sky.coord.dec, "rank": -sky.priority, "n": sky.visits})
    catalog = rs.Catalog.from_table(table, columns={"id": "star", "priority": "-rank", "visits": "n"})
    return catalog, begin(catalog, tmp_path)


def test_the_columns_of_the_catalog_are_read_in_tables_of_targets(ranked):
    """Regression: columns with the names of the catalog were ignored, and the sign of priorities could not be given."""
    catalog, survey = ranked
    survey.record(events(star=[1003, 5000], rank=[7, -2], n=[1, 5], ra=[np.nan, CENTER.ra.deg], dec=[np.nan, 30.0]))
    state = survey.state(catalog)
    rows = {int(target): row for row, target in enumerate(state.table["target_id"])}
    assert [state.table["priority"][rows[one]] for one in (1003, 5000)] == [-7, 2]
    assert [state.requested[rows[one]] for one in (1003, 5000)] == [1, 5]
    survey.record(events(target=1004, k=3), columns={"priority": "-k"})
    assert survey.state(catalog).table["priority"][rows[1004]] == -3
    with pytest.warns(rs.RfpsurveyWarning, match="columns that are not used: NUMOBS_MORE"):
        survey.record(events(target=1005, visits=2, NUMOBS_MORE=3))
    with pytest.raises(rs.InputError, match="must have a column target or positioner, got the column 'star'"):
        survey.record(events(tile=11, star=1003, good=False))


def test_added_targets_have_the_number_of_visits_of_the_plan(tmp_path):
    """Regression: one visit of added targets was requested although the survey was planned with another number."""
    sky = rs.Catalog(targets().coord, id=targets().id)
    survey = begin(sky, tmp_path, visits=3)
    survey.record(events(target=[5000], ra=CENTER.ra.deg, dec=CENTER.dec.deg))
    assert survey.state(sky, visits=3).requested[-1] == 3


def test_a_target_with_the_identifier_of_another_target(tmp_path):
    """Regression: the failure of a target with a repeated identifier was recorded for an arbitrary positioner."""
    points = np.array([[-12.0, 0], [12.0, 0]]) / 200 * u.deg
    sky = SkyCoord([CENTER.spherical_offsets_by(x, y) for x, y in points])
    sky = rs.Catalog(SkyCoord(sky.ra, sky.dec), id=[7, 7])
    options = {"allocator": "nearest", "folder": tmp_path / "survey"}
    with pytest.warns(rs.RfpsurveyWarning):
        survey = rs.plan_survey(sky, instrument(), CENTER.reshape(1), **options)
    used = np.asarray(survey.tile(0)["positioner"])
    assert len(used) == 2
    with pytest.raises(rs.InputError, match="positioner must be given for target 7 of tile 0, because 2 targets"):
        survey.record(events(tile=0, target=7, date="2026-01-03"))
    for one in used:
        survey.record(events(tile=0, target=7, positioner=one, date="2026-01-03"))
    assert survey.state(sky).failed.tolist() == [1, 1]


def test_the_state_of_standards_and_sky_positions(tmp_path):
    """Regression: the table of the state contained requested visits of standards and sky positions."""
    sky = targets(kinds=True)
    survey = begin(sky, tmp_path)
    state = survey.state(sky)
    status = survey_status(survey, state)
    for name in ("requested", "left"):
        assert state.table[name].sum() == status[f"n_{name}"][0]
    assert {*state.table["kind"][state.table["requested"] > 0].tolist()} == {"science"}


@pytest.mark.parametrize("replanned", [False, True])
def test_a_catalog_that_changed_is_refused(tmp_path, replanned):
    """Regression: the command status accepted another catalog, with wrong numbers."""
    sky = targets()
    survey = begin(sky, tmp_path)
    if replanned:
        plan_again(sky, survey, survey.state(sky))
    SurveyState.read(tmp_path / "survey", sky)
    other = rs.Catalog(sky.coord, id=sky.id, priority=-sky.priority, visits=sky.visits)
    with pytest.raises(rs.InputError, match="must be that of the first plan, with 60 targets, .* record a table"):
        SurveyState.read(tmp_path / "survey", other)


def test_an_interrupted_replan_is_not_called_damaged(ranked, tmp_path):
    """Regression: tables of the earlier plan without lines in the index were called damaged."""
    _, survey = ranked
    shutil.copytree(survey.folder, tmp_path / "copy")
    index = tmp_path / "copy" / "index.csv"
    index.write_text("".join(line for line in index.read_text().splitlines(keepends=True) if "tiles.fits" not in line))
    with pytest.raises(rs.InputError, match="is not finished"):
        rs.Survey.read(tmp_path / "copy")


def test_identifiers_of_digits_and_dates_with_a_time_zone(tmp_path):
    """Regression: numbers in place of text of digits, dates that end in Z, and times in FITS tables were refused."""
    sky = targets()
    sky = rs.Catalog(sky.coord, id=sky.id.astype(str), visits=sky.visits)
    survey = begin(sky, tmp_path)
    survey.record(events(target=[1003, 1004], visits=5))
    survey.record(events(tile=11, date="2026-01-03T05:00:00Z", state="done"))
    table = QTable({"tile": [12], "date": Time(["2026-01-04T23:00:00"]), "state": ["done"]})
    table.write(tmp_path / "night.fits")
    survey.record(tmp_path / "night.fits")
    state = survey.state(sky)
    assert (state.kept[1].date, state.requested[[3, 4]].tolist()) == ("2026-01-04", [5, 5])
    assert state.kept[0].date == "2026-01-03"
    with pytest.raises(rs.InputError, match="must be text, as in the catalog, got numbers"):
        survey.record(events(target=12, visits=5))


CHANGES = {
    "reordered": lambda table: table[::-1],
    "foreign": lambda table: QTable({**table, "id": table["id"] + 5000}),
    "moved": lambda table: QTable({**table, "dec": table["dec"] + 0.01 * u.deg}),
    "other priorities": lambda table: QTable({**table, "priority": -table["priority"]}),
}


@pytest.mark.parametrize("change", [*CHANGES])
@pytest.mark.parametrize("replanned", [False, True])
def test_visits_are_not_attributed_to_the_targets_of_another_catalog(tmp_path, change, replanned):
    """Regression: once the state of a survey had a checkpoint, other catalogs with as many targets were accepted."""
    sky = targets()
    table = QTable({"id": sky.id, "ra": sky.coord.ra, "dec": sky.coord.dec, "priority": sky.priority})
    sky = rs.Catalog.from_table(table)
    survey = begin(sky, tmp_path)
    survey.record(events(tile=11, date="2026-01-03"))
    if replanned:
        plan_again(sky, survey, survey.state(sky))
        assert (survey.folder / "events/state.npz").exists()
    observed = survey.state(sky).observed.sum()
    # the types of columns, which depend on the format of the file, do not matter
    table["id"], table["priority"] = table["id"].astype(np.int32), table["priority"].astype(np.float32)
    assert survey.state(rs.Catalog.from_table(table)).observed.sum() == observed > 0
    with pytest.raises(rs.InputError, match="the catalog must be that of the first plan, .* got another catalog"):
        survey.state(rs.Catalog.from_table(CHANGES[change](table)))


@pytest.mark.parametrize("column", ["visits", "mag"])
@pytest.mark.parametrize("replanned", [False, True])
def test_visits_and_columns_that_rules_use_are_those_of_the_first_catalog(tmp_path, column, replanned):
    """Catalogs with other magnitudes under a rule on magnitudes, or with other numbers of visits, were accepted."""
    sky = replace(targets(), visits=np.tile([1, 2], 30), extra=QTable({"mag": np.linspace(5, 15, 60)}))
    magnitudes = rs.AllocationOptions("nearest", constraints=["magnitude mag 6 inf science"])
    survey = begin(sky, tmp_path, allocator=magnitudes)
    survey.record(events(tile=11, date="2026-01-03"))
    if replanned:
        plan_again(sky, survey, survey.state(sky), allocator=magnitudes)
    mag = QTable({"mag": sky.extra["mag"][::-1]})
    other = replace(sky, visits=sky.visits[::-1]) if column == "visits" else replace(sky, extra=mag)
    observed = survey.state(sky).observed.sum()
    with pytest.raises(rs.InputError, match=f"must be that of the first plan, .* other values of '{column}'"):
        survey.state(other)
    if column == "visits":  # visits of the catalog are not used if they are given
        assert survey.state(other, visits=np.asarray(sky.visits)).observed.sum() == observed


def test_the_catalog_is_compared_at_its_own_epoch_and_without_the_rule(tmp_path):
    """Regression: a survey with an epoch was compared with the targets at another epoch."""
    coord = targets().coord
    motion = np.ones(60) * u.mas / u.yr
    sky = rs.Catalog(SkyCoord(coord.ra, coord.dec, pm_ra_cosdec=9 * motion, pm_dec=motion), epoch=2016.0)
    rule = rs.survey.VisitRule(visits=2, table=Table({"observed": [0], "priority": [3.0]}))
    survey = begin(sky, tmp_path, epoch=2026.5, visits=rule)
    survey.record(events(tile=11, date="2026-01-03"))
    state = survey.state(sky, rule=rule)
    again = plan_again(sky, survey, state, epoch=2026.5)
    assert survey_status(again, again.state(sky, rule=rule))["n_observed"][0] == state.observed.sum() > 0
    with pytest.raises(rs.InputError, match="the catalog must be that of the first plan"):
        again.state(sky.at_epoch(2026.5), rule=rule)


def test_further_columns_are_compared_when_the_survey_is_planned_again(tmp_path):
    """Further columns do not matter for the state, but new plans need those of the first plan."""
    sky = targets()
    full = replace(sky, extra=QTable({"g": np.full(60, 15.0)}))
    survey = begin(full, tmp_path)
    survey.record(events(tile=11, date="2026-01-03"))
    state = survey.state(sky)
    assert (state.observed == survey.state(full).observed).all()
    with pytest.raises(rs.InputError, match="extra differs"):
        plan_again(sky, survey, state)
    assert len(plan_again(full, survey, survey.state(full))) == 6
