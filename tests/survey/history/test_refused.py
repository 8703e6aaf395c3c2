"""Tables that `Survey.record` refuses with one sentence, without any change in the folder."""

import errno
import os
import warnings
from pathlib import Path

import astropy.units as u
import numpy as np
import pytest
from astropy.table import MaskedColumn, QTable, Table, vstack
from astropy.time import Time
from living import content, differences, events, replan, tiling

import rfpsurvey as rs


def refuse(survey, table, sentence, **options):
    before = content(survey.folder)
    with pytest.raises(rs.InputError, match=sentence) as caught:
        survey.record(table, **options)
    assert "\n" not in str(caught.value)
    assert content(survey.folder) == before


def missing(value):
    return MaskedColumn([value], mask=[True])


def added(name=30, **columns):
    return Table({"tile": [name], "state": ["added"], **{key: np.atleast_1d(v) for key, v in columns.items()}})


FRACTION = "fraction must be a number from 0 to 10, where 1 is complete, got"
STATE = "state of tile 11 must be given in a row without a positioner"
PLACE, WHOLE = "the position of tile 30 must be finite angles", "the pass of tile 30 must be a whole number, got"
NAMES = "the names of added tiles must be whole numbers, as those of the survey, got"
UNKNOWN, TEXT = "tile must be a tile of the survey, such as 11, got '99'", "tile must be integers or text for every row"
DATES = {"yesterday": "yesterday", "2026-13-03": "2026-13-03", 5.0: "5", True: "True"}
LIST = "must have one of the columns state, good, date, fraction, positioner"
TILES = [
    (events(tile=99, state="done"), UNKNOWN),
    (events(tile=11, target=99), "target must be a target of tile 11 with a visit, got '99'"),
    (events(tile=11, positioner=99), "positioner must be a positioner of tile 11 with a visit, got '99'"),
    (events(tile=11, state="fine"), "unknown state of a tile 'fine'"),
    *(
        (events(tile=11, date=date), f"date must be a date such as 2026-01-03, got '{got}'")
        for date, got in DATES.items()
    ),
    *((events(tile=11, fraction=value), f"{FRACTION} {value}") for value in (-0.1, np.nan, np.inf)),
    (events(tile=11, fraction="half"), "fraction must be numbers"),
    (Table({"tile": [11], "fraction": missing(1.0)}), f"{FRACTION} nan"),
    (Table({"tile": [11], "good": missing(True)}), "good must be given for every tile, got a missing value"),
    (events(tile=11, good=np.nan), "good must be given for every tile, got a missing value"),
    (events(tile=11, good="perhaps"), "good must hold booleans or numbers, got text such as 'perhaps'"),
    (Table({"tile": missing(11), "good": [True]}), TEXT),
    (events(tile=11.5, state="done"), f"{TEXT}, got numbers such as 11.5"),
    (Table(), "must have a column tile or target, got the columns none"),
    (events(tile=11), f"a table of observations {LIST}"),
    (tiling().table, f"{LIST}, target, got tile, ra, dec"),
    (Table({"color": [1]}), "must have a column tile or target, got the columns color"),
    (events(tile=[11, 11], good=True), "must have one row for each tile and date, got 2 rows for tile 11"),
    (events(tile=11, date=["2026-01-03", "2026-01-04", ""]), "date must be given in all rows of tile 11"),
    (
        events(tile=11, positioner=["", "1"], state=["done", "bad"]),
        "state of a tile must be in a row without a positioner or target, got .bad.",
    ),
    (events(tile=11, positioner=["", "1"], state=""), STATE),
    *((events(tile=11, positioner="1", state=state), STATE) for state in ("", "unobs")),
    (events(tile=[12, 11], positioner=["", "1"], good=False), f"{STATE} or target, got only rows of visits"),
    (events(tile=99, positioner="1", state=""), UNKNOWN),
    (events(tile=11, target="1", fraction=0.5), STATE),
    (added(), "an added tile must have the columns ra and dec, got no ra and dec"),
    *((added(ra=ra, dec=dec), PLACE) for ra, dec in ((np.nan, 0), (missing(1.0), 0), (1, 95))),
    (added(ra="08:00:00", dec=30), "ra must be numbers"),
    (added(ra=1 * u.mm, dec=30 * u.deg), "ra must have the unit deg, got mm"),
    (added(ra=1, dec=30, **{"pass": 1.5}), f"{WHOLE} 1.5"),
    (added(ra=1, dec=30, **{"pass": missing(1)}), f"{WHOLE} nan"),
    (added(ra=1, dec=30, **{"pass": "x"}), "pass must be numbers"),
    (added(ra=1, dec=30, **{"pass": 1e30}), rf"{WHOLE} 1e\+30"),
    *((added(name, ra=1, dec=1), f"{NAMES} '{name}'") for name in ("x", "011")),
    (5, "table must be an astropy Table, a QTable or a DataFrame, got 5"),
    ("nothing.ecsv", "nothing.ecsv: there is no such file"),
]


@pytest.mark.parametrize("name", ["id", "FIBER", "fiber_id", "robotId", "catalogid", "LOCATION"])
def test_a_column_that_states_a_part_of_a_tile_is_not_ignored(survey, name):
    """A failed visit in a column ``id`` was recorded as a failure of the whole tile."""
    for table, tile in ((events(tile=11, good=0, **{name: 1}), None), (events(good=0, **{name: 1}), 11)):
        refuse(survey, table, f"must have a column target or positioner, got the column '{name}'", tile=tile)
    visits = survey.tile(11)
    target, positioner = visits["target_id"][0], visits["positioner"][0]
    for role, value in (("target", target), ("positioner", positioner)):
        table = events(tile=[11, 11], good=[True, False], date="2026-01-02", **{name: ["", str(value)]})
        found = survey.record(table, columns={role: name}, dry_run=True)
        assert found["changes"] == {"tiles observed": ["11"], "failed visits": [f"11/{positioner}"]}


TARGETS = [
    (Table({"target": missing(1001), "visits": [2]}), "target must be integers or text for every row"),
    (events(target="a", visits=2), "the identifiers of targets must be numbers, as in the catalog, got text"),
    (events(target=1001), "a table of targets must have one of the columns priority, .*, got target"),
    (
        events(target=1001, ra=120.0, dec=30.0, priority=1),
        "must have a column state if it contains positions of targets of the first plan, got target, ra, dec, priority",
    ),
    (events(target=1001, good=False), "a table of targets must have one of the columns .*, got target, good"),
    (events(target=9, priority=1), r"target must be a target of the survey, or have the columns ra and dec, got 9"),
    (events(target=9, ra=1.0, dec=1.0), "priority must be a finite number for every new target, got none for 9"),
    (events(target=9, ra=np.nan, dec=1.0, priority=1), "ra must be a finite number for every new target"),
    (events(target=9, ra=1.0, dec=99.0, priority=1), "dec must lie between -90 and 90 deg, got 99"),
    *(
        (events(target=1001, visits=n), f"visits must be whole numbers from 0 to 255, got {n}")
        for n in (256, -1, 1.5, np.inf)
    ),
    (events(target=1001, visits="x"), "visits must be numbers"),
    (events(target=1001, priority=np.inf), "priority must be finite numbers, got inf"),
    (Table({"target": [1001], "priority": [1.0] * u.mm}), "priority must have the unit of a plain number, got mm"),
    (events(target=1001, kind="star"), "kind must be science, standard or sky, .* got 'star'"),
    (events(target=1001, state="done"), "the state of a target must be dropped, planned or added, got 'done'"),
    (events(target=[1001, 1001], visits=2), "must have one row for each target, got 2 rows for 1001"),
]


def test_tables_that_are_refused(survey):
    """Regression: some tables of targets were recorded, and no state could be read afterward."""
    for table, sentence in (*TILES, *TARGETS):
        refuse(survey, table, sentence)


def test_categories_of_a_survey_without_categories(case, tmp_path):
    """Regression: the table was recorded, and no state could be read afterward."""
    plain = rs.Catalog(case[0].coord)
    survey = rs.plan_survey(plain, *case[1:], folder=tmp_path / "survey", allocator="nearest")
    survey.record(events(target=5, visits=2, category="a"))
    state = survey.state(plain)
    assert (state.left[5], state.catalog.category.tolist()) == (2, [""] * 5 + ["a"] + [""] * 54)


def test_text_that_files_cannot_contain(case, tmp_path):
    """Regression: some texts were recorded, and the survey could not be planned afterward."""
    named = rs.Catalog(case[0].coord, id=[f"s{k}" for k in range(60)])
    survey = rs.plan_survey(named, *case[1:], folder=tmp_path / "survey", allocator="nearest")
    for text in ("tab\tb", "étoile"):
        for table in (events(target=text, ra=120.0, dec=30.0), events(target="s1", category=text)):
            refuse(survey, table, "FITS files can contain only printable ASCII text")


def test_names_of_tiles_that_files_cannot_contain(case, tmp_path):
    table = case[2].table.copy()
    table.replace_column("tile", [f"t{k}" for k in range(6)])
    own = (*case[:2], table)
    survey = rs.plan_survey(*own, folder=tmp_path / "survey", allocator="nearest")
    refuse(survey, added("é", ra=120, dec=30), "FITS files can contain only printable ASCII text, but 1 names of added")
    survey.record(added("longer name", ra=120, dec=30))
    again = replan(own, survey)
    assert again.tiles["tile"].tolist() == [f"t{k}" for k in range(6)] + ["longer name"]
    assert again.record(events(tile="longer name", state="done"))["n_events"] == 1


def test_a_tile_is_given_once(survey):
    sentence = "tile must be given only for a table without a column of tiles"
    refuse(survey, events(tile=11, state="done"), sentence, tile=11)
    refuse(survey, events(positioner=1), "tile must be a tile of the survey, such as 11, got '99'", tile=99)
    assert survey.record(events(positioner=1), tile=11)["n_events"] == 1


def test_an_observed_tile_is_not_dropped_or_moved_or_observed_again(survey):
    survey.record(events(tile=11, date="2026-01-03"))
    survey.record(events(tile=12, date="2026-01-03", state="bad"))
    refuse(survey, events(tile=11, state="dropped"), "tile 11 must not be dropped, because it was observed on 2026")
    refuse(survey, added(11, ra=1, dec=1), "tile 11 must not be moved, because an observation of it was recorded")
    refuse(survey, added(12, ra=1, dec=1), "tile 12 must not be moved, because an observation of it was recorded")
    refuse(survey, events(tile=11, date="2026-01-04"), "tile 11 was already observed on 2026-01-03")
    refuse(survey, events(tile=11, state="done"), "tile 11 was already observed on 2026-01-03")
    first = survey.tiles[1]
    twin = added(ra=first["ra"].value, dec=first["dec"].value, **{"pass": first["pass"]})
    refuse(survey, twin, "tiles 12 and 30 are the same")


def test_a_positioner_and_a_target_of_one_visit(survey):
    """Regression: the target was not compared if a row had a positioner."""
    visits = survey.tile(11)
    own, other = visits[0], visits[1]
    name, wrong = own["positioner"], other["target_id"]
    table = events(tile=11, positioner=str(name), target=str(wrong))
    refuse(survey, table, f"target must be that of positioner {name} of tile 11, got '{wrong}'")
    table["target"] = [str(own["target_id"])]
    assert survey.record(table)["n_events"] == 1


def test_tiles_are_not_added_without_their_observing_conditions(case, tmp_path):
    """Regression: an added tile had the hour angle of the first tile."""
    table = QTable(case[2].table, meta={})
    table["hour_angle"] = np.linspace(-1, 1, 6) * u.hourangle
    site = rs.ObservingConditions("paranal", hour_angle=0 * u.deg)
    tiles = rs.Tiling.from_table(table).with_conditions(site)
    survey = rs.plan_survey(*case[:2], tiles, folder=tmp_path / "survey", allocator="nearest")
    refuse(survey, added(ra=120, dec=30), "tiles must be added only to a survey without observing conditions and times")
    assert survey.record(added(12, ra=120, dec=30))["n_events"] == 1


def test_a_full_disk(survey, monkeypatch):
    def full(*_, **__):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    mkdir = Path.mkdir
    with monkeypatch.context() as patch:
        patch.setattr(Path, "mkdir", lambda path, *_, **k: full() if path.name == "events" else mkdir(path, *_, **k))
        refuse(survey, events(tile=11, state="done"), "events cannot be written: No space left on device")
    with monkeypatch.context() as patch:
        patch.setattr("os.fsync", full)
        refuse(survey, events(tile=11, state="done"), "cannot be written: No space left on device")
    assert survey.record(events(tile=11, state="done"))["n_events"] == 1


def test_a_survey_without_a_folder(case):
    survey = rs.plan_survey(*case, allocator="nearest")
    with pytest.raises(rs.InputError, match="record needs a survey in a folder, got a survey that was planned without"):
        survey.record(events(tile=11, state="done"))
    with pytest.raises(rs.InputError, match="a state needs a survey in a folder"):
        survey.state(case[0])


def test_dates(survey):
    """Regression: dates in columns of floating-point numbers were refused."""
    dates = "2026-01-03", 20260103, 20260103.0, "2026-1-3", "20260103", "2026-01-03T23:59:59"
    some = *([date] for date in dates), Time(["2026-01-03T23:59:59"]), np.array(["2026-01-03"], dtype="datetime64[D]")
    for known, group in (({"date": "2026-01-03"}, some), ({}, ([""], [0], [None], [np.nan], missing("2026-01-03")))):
        for date in group:
            survey.record(Table({"tile": [11], "date": date}))
            assert survey.record(events(tile=11, state="done", **known))["n_known"] == 1
            survey.record(events(tile=11, state="planned"))


@pytest.mark.filterwarnings("ignore:columns that are not used")
def test_stacked_tables_have_missing_values(survey, case):
    """Regression: the missing fraction in the row of a failed visit was refused, and missing positioners were 'nan'."""
    tiles = Table({"tile": [11, 12], "date": ["2026-01-03"] * 2, "good": [True, False], "fraction": [1.0, 0.5]})
    failed = Table({"tile": [11], "date": ["2026-01-03"], "positioner": [1], "reason": ["stuck"]})
    one = vstack([tiles, failed])
    assert (survey.record(one)["n_events"], survey.record(one.to_pandas())["n_known"]) == (2, 2)
    floats = events(tile=[11, 11], date="2026-01-03", positioner=[np.nan, 1.0])
    floats["reason"] = ["", "stuck"]
    assert (survey.record(floats)["n_known"], survey.state(case[0]).summary["n_visits_failed"]) == (1, 1)


def test_tables_of_bytes(survey, case):
    """Regression: text in columns of bytes, as astropy reads them from FITS files, was not understood."""
    table = events(tile=["11", "11", "12"], date="2026-01-03", state=["done", "", "bad"], positioner=["", "1", ""])
    for name in table.colnames:
        table[name] = np.array(table[name], dtype="S10")
    assert survey.record(table)["n_events"] == 2
    assert survey.record(events(tile=[12], date="2026-01-03", state="bad"))["n_known"] == 1
    assert survey.state(case[0]).summary["n_visits_failed"] == 1


def test_failed_visits_keep_the_state_of_the_tile(survey, case):
    """Regression: a tile whose observation was bad became observed if failed visits of this tile were recorded."""
    for state in ("bad", "partly"):
        survey.record(events(tile=11, date="2026-01-03", state=state))
        survey.record(events(tile=11, date="2026-01-03", positioner=1))
        assert survey.state(case[0]).summary["n_tiles_observed"] == 0
    # regression: failed visits of another night finished a tile that was partly observed
    refuse(survey, events(tile=11, date="2026-01-05", positioner=1), "the state of tile 11 on 2026-01-05 must be given")
    survey.record(events(tile=13, positioner=1))
    assert survey.state(case[0]).summary["n_tiles_observed"] == 1
    refuse(survey, events(tile=13, date="2026-01-05", positioner=1), "tile 13 was already observed")
    survey.record(events(tile=12, date="2026-01-03", state="bad"))
    survey.record(events(tile=12, date="2026-01-05", positioner=1))  # the bad tile was not observed before
    assert survey.state(case[0]).summary["n_tiles_observed"] == 2


def test_angles_of_added_tiles_have_units(survey):
    """Regression: units of the columns of added tiles were ignored."""
    survey.record(added(ra=7200 * u.arcmin, dec=1800 * u.arcmin))
    assert survey.record(added(ra=120.0, dec=30.0))["n_known"] == 1


def test_a_missing_flag_of_a_target_changes_nothing(survey, case):
    """Regression: a missing value in the column ``dropped`` took back that the target was dropped."""
    survey.record(events(target=1001, dropped=True))
    survey.record(Table({"target": [1001], "dropped": missing(True)}))
    survey.record(events(target=1001, dropped=np.nan))
    assert survey.state(case[0]).left[1] == 0
    survey.record(events(target=1001, dropped=False))
    assert survey.state(case[0]).left[1] > 0


def test_positions_and_columns_that_cannot_be_used_cause_warnings(survey, case):
    """Regression: no state could be read afterward."""
    survey.record(events(target=1001, state="", ra=120.0, dec=30.0, subpriority=0.5))
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        state = survey.state(case[0])
    texts = sorted(str(one.message) for one in told)
    assert len(texts) == 2
    assert "1 recorded positions of targets, such as that of target 1001, differ from the catalog" in texts[0]
    assert "the recorded values of subpriority have no effect" in texts[1]
    assert (state.catalog.coord[1].ra, state.catalog.coord[1].dec) == (case[0].coord[1].ra, case[0].coord[1].dec)


def test_kinds_and_categories_are_changed(survey, case):
    """Regression: recorded kinds, categories and fiber types of known targets were ignored without a warning."""
    survey.record(events(target=[1001, 1002], kind=["standard", ""], category=["", "long name"]))
    state = survey.state(case[0])
    assert state.catalog.kind.tolist() == ["science", "standard"] + ["science"] * 58
    assert state.catalog.category[1:3].tolist() == ["", "long name"]
    one, other = (rs.plan_survey(sky, *case[1:], visits=state) for sky in (case[0], state.catalog))
    assert differences(one, other) == []


def test_visits_of_the_first_plan_are_changed_by_events(case, tmp_path):
    """Regression: recorded numbers of visits were ignored if the first plan was given its numbers of visits."""
    numbers = np.full(60, 3)
    survey = rs.plan_survey(*case, visits=numbers, folder=tmp_path / "survey", allocator="nearest")
    survey.record(events(target=[1001, 7], visits=[1, 2], ra=[np.nan, 120], dec=[np.nan, 30], priority=[np.nan, 1]))
    assert survey.state(case[0], visits=numbers).requested.tolist() == [3, 1] + [3] * 58 + [2]


def test_targets_are_added_to_catalogs_with_subpriorities_or_epochs(case, tmp_path):
    """Regression: no state could be read after targets were added to such a catalog."""
    coord, motion = case[0].coord, np.ones(60) * u.mas / u.yr
    moving = type(coord)(coord.ra, coord.dec, pm_ra_cosdec=motion, pm_dec=motion)
    sky = rs.Catalog(moving, subpriority=np.linspace(0, 1, 60), epoch=Time(np.linspace(2015, 2016, 60), format="jyear"))
    survey = rs.plan_survey(sky, *case[1:], epoch=2026.0, folder=tmp_path / "survey", allocator="nearest")
    survey.record(events(target=99, ra=120.0, dec=30.0))
    with pytest.warns(rs.RfpsurveyWarning) as told:
        state = survey.state(sky)
    assert sorted(str(one.message)[:11] for one in told) == ["the catalog", "the subprio"]
    assert len(rs.plan_survey(sky, *case[1:], epoch=2026.0, visits=state, allocator="nearest").outcomes) == 61


def test_changes_are_listed_and_a_dry_run_records_nothing(survey, case):
    """Regression: the answer did not state what the events are."""
    name = str(survey.tile(11)["positioner"][0])
    table = events(
        tile=["11", "11", "12", "13", "14", "15"],
        date="2026-01-03",
        state=["done", "", "partly", "bad", "dropped", "planned"],
        positioner=["", name, *[""] * 4],
    )
    changes = {
        "tiles observed": ["11"],
        "failed visits": [f"11/{name}"],
        "tiles partly observed": ["12"],
        "tiles whose observation was bad": ["13"],
        "tiles dropped": ["14"],
        "tiles whose records are canceled": ["15"],
    }
    before = content(survey.folder)
    for _ in range(2):
        assert (survey.record(table, dry_run=True)["changes"], content(survey.folder)) == (changes, before)
    assert survey.record(table)["changes"] == changes
    place = {"ra": [120.0] * 3, "dec": [30.0] * 3}
    targets = events(target=[5000, 1001, 1002], state=["added", "dropped", ""], priority=3.0, **place)
    found = survey.record(targets, dry_run=True)
    names = {"targets added": ["5000"], "targets dropped": ["1001"], "targets changed": ["1002"]}
    assert (found["n_events"], found["changes"]) == (3, names)
    assert len(survey.state(case[0]).events.files) == 1
    with pytest.raises(rs.InputError, match="dry_run must be"):
        survey.record(table, dry_run="yes")
