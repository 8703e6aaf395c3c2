"""Surveys in a folder that are continued with further tiles: the tiles in the folder keep their plans."""

import json
import re

import numpy as np
import pytest
from astropy.table import QTable, Table, vstack
from living import content, differences, events, instrument, targets, tiling

import rfpsurvey as rs
from rfpsurvey.survey import Cadences


@pytest.fixture(scope="module")
def case():
    """Return a catalog, an instrument and overlapping tiles, of which those of each pass are consecutive."""
    table = tiling(n=9).table
    table["pass"] = np.repeat([1, 2, 3], 3)
    return targets(), instrument(), rs.Tiling.from_table(table)


def plan(case, folder, *, tiles=None, **options):
    sky, model, whole = case
    options = {"allocator": "balanced", **options}
    return rs.plan_survey(sky, model, whole if tiles is None else tiles, folder=folder, **options)


def parts(folder):
    """Return the files of all tiles, without their generations."""
    files = {name: value for name, value in content(folder).items() if name.startswith("tiles/")}
    return {name: re.sub(rb"GENER   = .{70}", b"", value) for name, value in files.items()}


@pytest.fixture
def planned(monkeypatch):
    """Return a list of the tiles that are planned."""
    from rfpsurvey._survey import run as _run

    found, work = [], _run.work
    monkeypatch.setattr(_run, "work", lambda job: found.append(job.tile) or work(job))
    return found


@pytest.mark.parametrize(("order", "n_finished"), [("color", 0), ("given", 2), ("color", 3)])
def test_further_passes_give_the_survey_of_all_passes(case, tmp_path, planned, order, n_finished):
    plan(case, tmp_path / "once", order=order)
    plan(case, tmp_path / "survey", order=order, passes=[1])
    first, index = parts(tmp_path / "survey"), tmp_path / "survey" / "index.csv"
    if n_finished < 3:  # the folder of a survey that was interrupted
        lines = [line for line in index.read_text().splitlines(keepends=True) if line.startswith(("file", "tiles/"))]
        index.write_text("".join(lines[: 1 + n_finished]))
    planned.clear()
    plan(case, tmp_path / "survey", order=order, passes=[1, 2], resume=True)
    assert len(planned) == 6 - n_finished
    plan(case, tmp_path / "survey", order=order, resume=True)
    assert (len(planned), {name: parts(tmp_path / "survey")[name] for name in first}) == (9 - n_finished, first)
    assert content(tmp_path / "survey") == content(tmp_path / "once")
    plan(case, tmp_path / "survey", order=order, resume=True)
    assert len(planned) == 9 - n_finished


def test_an_interrupted_extension_is_not_read_as_the_first_survey(case, tmp_path):
    plan(case, tmp_path / "once")
    plan(case, tmp_path / "survey", passes=[1])

    def stop(done, _):
        if done == 4:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        plan(case, tmp_path / "survey", resume=True, progress=stop)
    with pytest.raises(rs.InputError, match="is not finished"):
        rs.Survey.read(tmp_path / "survey")
    plan(case, tmp_path / "survey", resume=True)
    assert content(tmp_path / "survey") == content(tmp_path / "once")


def test_tiles_of_the_same_pass_are_accepted_in_the_given_order(case, tmp_path):
    table = case[2].table.copy()
    table["pass"] = 1
    plan(case, tmp_path / "once", tiles=table, order="given")
    for n in (4, 9):
        plan(case, tmp_path / "survey", tiles=table[:n], order="given", resume=True)
    assert content(tmp_path / "survey") == content(tmp_path / "once")


def test_further_tiles_that_would_be_planned_earlier_are_refused(case, tmp_path):
    folder, table = tmp_path / "survey", case[2].table
    plan(case, folder, passes=[2])
    plan(case, tmp_path / "joint", passes=[1], allocator="joint")
    before = content(tmp_path)
    begin = "or tiles of which the first 3 are those of this folder in the same order"
    between = table[[3, 0, 4, 1, 5, 2]]
    between["pass"] = [2, 4, 2, 4, 2, 4]
    more = table[[3, 4, 5, 6]]
    more["pass"] = 2
    moved = table[3:].copy()
    moved["ra"][1] += 1e-5 * moved["ra"].unit
    for options, sentence in (
        ({}, begin),
        ({"tiles": between}, begin),
        ({"tiles": table[[4, 3, 5, 6]]}, begin),
        ({"tiles": moved}, begin),
        ({"tiles": table[[3, 4, 5, 0]]}, "planned after the 3 tiles of the folder, .* later pass, got the pass 1"),
        ({"tiles": more}, "must be planned after the 3 tiles of the folder, .* got the pass 2 for tile 17"),
        ({"tiles": table[3:5]}, "another survey: tiles differs .*; give another folder$"),
        ({"tiles": table[3:], "rng": 1}, r"another survey: rng differs \("),
        ({"folder": tmp_path / "joint", "allocator": "joint"}, "planned together, must be the 3 tiles .*, got 9"),
    ):
        with pytest.raises(rs.InputError, match=sentence):
            plan(case, **{"folder": folder, "resume": True, **options})
    assert content(tmp_path) == before


def test_cadences_accept_later_tiles(case, tmp_path):
    cadences = Cadences(Table({"cadence": ["a"], "delta_min": ["0 1"], "delta_max": ["0 3"], "n_exp": ["1 1"]}))
    table, sky = case[2].table.copy(), targets()
    table["mjd"] = 60000.0 + np.arange(9)
    sky = rs.Catalog(sky.coord, id=sky.id, extra=QTable({"cadence": np.full(len(sky), "a")}))
    case = sky, case[1], None
    plan(case, tmp_path / "once", tiles=table, visits=cadences)
    for n in (4, 9):
        plan(case, tmp_path / "survey", tiles=table[:n], visits=cadences, resume=True)
    assert content(tmp_path / "survey") == content(tmp_path / "once")
    earlier = vstack([table, table[:1]])
    earlier["tile"][-1], earlier["mjd"][-1], earlier["pass"][-1] = 99, 60007.5, 9
    with pytest.raises(rs.InputError, match="therefore have a later MJD, got the MJD 60007.5 for tile 99"):
        plan(case, tmp_path / "survey", tiles=earlier, visits=cadences, resume=True)


@pytest.mark.parametrize("first", [1, [1, 2]])
def test_the_rest_is_planned_with_further_tiles(case, tmp_path, first):
    """The result is that of a survey that contained the further tiles from the beginning."""
    night = [events(tile=[11, 13], date="2026-01-03"), events(tile=17, date="2026-01-05")]
    for name, passes in (("once", None), ("survey", first)):
        survey = plan(case, tmp_path / name, passes=passes)
        kept = content(tmp_path / name)["tiles/000/000000.fits"]
        for table in night:
            survey.record(table)
            state = survey.state(case[0])
            survey = plan(case, survey.folder, visits=state, resume=True)
            assert (survey.folder / "tiles" / "000" / "000000.fits").read_bytes() == kept
    once, survey = (rs.Survey.read(tmp_path / name) for name in ("once", "survey"))
    assert (differences(once, survey), parts(once.folder)) == ([], parts(survey.folder))
    requests = [json.loads((one.folder / "survey.json").read_text()) for one in (once, survey)]
    assert requests[0]["first"] == requests[1]["first"]


def test_tiles_that_are_added_by_events_follow_the_further_tiles(case, tmp_path):
    plan(case, tmp_path / "survey", passes=[1])
    old = rs.Survey.read(tmp_path / "survey")
    plan(case, tmp_path / "survey", passes=[1, 2], resume=True)
    old.record(events(tile=99, ra=120.0, dec=30.0, state="added"))
    survey = rs.Survey.read(tmp_path / "survey")
    options = {"visits": survey.state(case[0]), "resume": True}
    with pytest.raises(rs.InputError, match="must be the 6 tiles of the first plan, got 9 tiles; record further tiles"):
        plan(case, survey.folder, **options)
    assert plan(case, survey.folder, passes=[1, 2], **options).tiles["tile"].tolist() == [*range(11, 17), 99]
