"""States and plans with other input, and with files that are missing or damaged; nothing is written then."""

import re
import shutil
from dataclasses import replace
from functools import partial

import astropy.units as u
import damaged_surveys
import numpy as np
import pytest
from astropy.table import QTable
from living import content, differences, events, sha, targets

import rfpsurvey as rs
from rfpsurvey.survey import SurveyState, VisitRule, verify_survey

WIDE = rs.FocalPlane.hexagonal(rs.Positioner(8 * u.mm, 8 * u.mm, 2 * u.mm), rings=1, pitch=25.6 * u.mm)
OTHER = rs.Instrument("other", WIDE, plate_scale=200 * u.mm / u.deg)
SENTENCES = {
    "first event: cut": "is damaged",
    "first event: edited": r"000001\.json is damaged \(its digest differs from its content\)",
    "events: without the first": r"000001\.json is missing, but 000002\.json exists",
    "events: without the last": r"000005\.json is missing, although .* was planned with 5 files of events",
    "events: exchanged": "must follow the events before it",
    "middle event: other version": "is damaged",
    "table of targets: cut": "is missing or damaged",
    "table of targets: missing": "is missing or damaged",
    "observed tile: cut": r"000000\.fits must be the plan with which the tile in row 0 was observed",
    "observed tile: missing": r"000000\.fits must be the plan with which the tile in row 0 was observed",
    "kept plan: missing": r"000002\.fits must be the plan with which the tile in row 2 was observed",
    "request: cut": r"survey\.json is damaged",
}
"""What the error message of the state of some damaged surveys contains."""
FEW = (
    *("first event: edited", "events: without the last", "events: exchanged", "table of targets: missing"),
    *("observed tile: cut", "kept plan: missing", "planned tile: one bit", "outcomes: missing", "checkpoint: one bit"),
    *("index: without the line of the planned tile", "request: no events, and the last one is missing", "other files"),
)


def some(names):
    """Return the names as parameters, of which all except those in ``FEW`` are exhaustive."""
    return [pytest.param(name, marks=() if name in FEW else pytest.mark.exhaustive) for name in names]


@pytest.fixture(scope="module")
def sound(tmp_path_factory):
    """Return the folder of a survey without damage, and the results of all readers for a copy of it."""
    folder, results = damaged_surveys.make_survey(tmp_path_factory.mktemp("sound") / "survey"), {}
    for reader in damaged_surveys.READERS:
        results[reader] = reader(shutil.copytree(folder, folder.with_name(reader.__name__)))
    return folder, results


@pytest.mark.parametrize("name", some(damaged_surveys.DAMAGES))
def test_a_damage_is_found_or_harmless(sound, tmp_path, name):
    """All damages are found, except those that the next plan repairs, and no reader gives a wrong result.

    Regression: a required target, or the last file of events, could be removed with its entry of the request.
    """
    outcomes = {}
    for reader, expected in sound[1].items():
        folder = shutil.copytree(sound[0], tmp_path / reader.__name__)
        damaged_surveys.DAMAGES[name](folder)
        before = content(folder)
        outcomes[reader.__name__], text = damaged_surveys.outcome(reader, folder, expected)
        assert outcomes[reader.__name__] in ("right", "told", "error"), (reader, text)
        if outcomes[reader.__name__] == "error" and reader is not damaged_surveys.plan_again:
            assert content(folder) == before
        if reader is damaged_surveys.read_state:
            assert re.search(SENTENCES.get(name, ""), text)
    folder = shutil.copytree(sound[0], tmp_path / "survey")
    damaged_surveys.DAMAGES[name](folder)
    before = content(folder)
    found = found_in(folder)
    assert content(folder) == before
    assert found or {*outcomes.values()} == {"right"}
    if name == "other files":
        assert verify_survey(folder).meta["others"] == sorted(damaged_surveys.OTHERS)


def found_in(folder, catalog=damaged_surveys.SKY):
    """Return the names of the damaged files of a survey."""
    try:
        table = verify_survey(folder, catalog)
    except rs.InputError as error:
        assert not (folder / "survey.json").exists()
        return [str(error)]
    assert all("\n" not in text for row in table for text in row)
    return table["file"].tolist()


@pytest.mark.parametrize("name", some(damaged_surveys.FORGERIES))
def test_a_forgery_is_found(sound, tmp_path, name):
    """Files that were changed with their checksums are found, and no reader raises an unhandled exception.

    Regression: events with other types raised errors of Python.
    """
    for reader, expected in sound[1].items():
        folder = shutil.copytree(sound[0], tmp_path / reader.__name__)
        damaged_surveys.FORGERIES[name](folder)
        found = found_in(folder)
        assert found
        word, text = damaged_surveys.outcome(reader, folder, expected)
        assert word in ("right", "told", "error", "wrong"), text


@pytest.mark.exhaustive
def test_damaged_joint_plans_are_found_or_repaired(tmp_path):
    folder = tmp_path / "survey"
    rs.plan_survey(*damaged_surveys.CASE, folder=folder, **damaged_surveys.JOINT)
    readers = damaged_surveys.read, damaged_surveys.plan_together_again
    expected = {reader: reader(folder) for reader in readers}
    for k, damage in enumerate(damaged_surveys.JOINT_DAMAGES.values()):
        for reader in readers:
            copy = shutil.copytree(folder, tmp_path / f"{reader.__name__}-{k}")
            damage(copy)
            assert len(verify_survey(copy)) == 1
            assert damaged_surveys.outcome(reader, copy, expected[reader])[0] in ("right", "told", "error")


def test_surveys_without_damage(sound, tmp_path, case):
    """Unfinished surveys, later events, and surveys planned with the events of another folder are no damage."""
    folder = shutil.copytree(sound[0], tmp_path / "survey")
    table = verify_survey(folder, damaged_surveys.SKY)
    assert (len(table), table.colnames, table.meta["others"]) == (0, ["file", "problem", "remedy"], [])
    rs.Survey.read(folder).record(events(tile=15, date="2999-01-07"), allow_future=True)
    assert (found_in(folder), found_in(folder, case[0])) == ([], ["survey.json"])
    state = SurveyState.read(folder, damaged_surveys.SKY)
    rs.plan_survey(*damaged_surveys.CASE, folder=tmp_path / "other", visits=state, **damaged_surveys.OPTIONS)
    assert found_in(tmp_path / "other", damaged_surveys.SKY) == []
    for stop in (1, 4):

        def interrupt(done, _, stop=stop):
            if done == stop:
                raise KeyboardInterrupt

        with pytest.raises(KeyboardInterrupt):
            rs.plan_survey(*case, folder=tmp_path / f"unfinished-{stop}", allocator="nearest", progress=interrupt)
        assert found_in(tmp_path / f"unfinished-{stop}", None) == []
    with pytest.raises(rs.InputError, match="does not hold a survey"):
        verify_survey(tmp_path)


def test_a_survey_is_read_without_the_files_of_its_tiles(sound, tmp_path):
    folder = shutil.copytree(sound[0], tmp_path / "survey")
    shutil.rmtree(folder / "tiles")
    assert rs.Survey.read(folder).summary == rs.Survey.read(sound[0]).summary


@pytest.fixture(scope="module")
def recorded(case, tmp_path_factory):
    """Return the folder of a survey with four files of events, which was then planned again."""
    folder = tmp_path_factory.mktemp("recorded") / "survey"
    survey = rs.plan_survey(*case, folder=folder, allocator="nearest")
    survey.record(events(tile=[11, 12], date="2026-01-03", fraction=[1.0, 0.5]))
    survey.record(events(target=1001, visits=3))
    survey.record(events(target=5000, visits=2, ra=120.1, dec=30.0, priority=2))
    survey.record(events(tile=13, date="2026-01-04"))
    rs.plan_survey(*case, folder=folder, allocator="nearest", resume=True, visits=survey.state(case[0]))
    return folder


@pytest.fixture
def folder(recorded, tmp_path):
    return shutil.copytree(recorded, tmp_path / "recorded")


def replan(case, folder, **options):
    state = SurveyState.read(folder, case[0]) if "visits" not in options else options.pop("visits")
    return rs.plan_survey(*case, folder=folder, visits=state, **{"resume": True, "allocator": "nearest", **options})


def refuse(folder, sentence, call):
    before = content(folder)
    with pytest.raises(rs.InputError, match=sentence) as caught:
        call()
    assert "\n" not in str(caught.value)
    assert content(folder) == before


def test_another_catalog(case, folder, survey):
    """Regression: another catalog with the same number of targets was accepted, and not used."""
    sky, state = case[0], SurveyState.read(folder, case[0])
    survey.record(events(tile=11, date="2026-01-03"))  # a survey without changed targets
    for other in (
        replace(sky, id=sky.id + 1),
        sky[: survey.tile(11)["target_row"].max()],
        targets(1)[np.r_[np.arange(60), 0, 1]],
        replace(sky, priority=sky.priority + 1),
        replace(sky, coord=sky.coord[::-1]),
    ):
        sentence, own = "the catalog must be that of the state, with 61 targets, got another", (other, *case[1:])
        refuse(folder, sentence, lambda own=own: replan(own, folder, visits=state))
        for place in (folder, survey.folder):
            read = partial(SurveyState.read, place, other)
            refuse(place, "the catalog must be that of the first plan", read)


def test_equal_catalogs_are_the_same_catalog(case, folder):
    state = SurveyState.read(folder, case[0])
    same = rs.Catalog.from_table(case[0].to_table())
    for sky in (same, state.catalog):
        assert replan((sky, *case[1:]), folder, visits=state).summary == rs.Survey.read(folder).summary


def test_other_tiles_instruments_and_options(case, folder):
    sky, tiny, tiles = case
    table = tiles.table.copy()
    table["ra"][0] += 0.01 * u.deg
    for other, options, sentence in (
        ((sky, tiny, tiles.table[:-1]), {}, "tiles must be the 6 tiles of the first plan, got 5 tiles"),
        ((sky, tiny, tiles.table[::-1]), {}, "got the tile 16 in row 0 instead of 11"),
        ((sky, tiny, table), {}, "holds another survey: tiles differs"),
        ((sky, OTHER, tiles), {}, "holds another survey: instrument"),
        (case, {"allocator": "repair"}, "holds another survey: allocator, moves, tie_seed differ"),
        (case, {"rng": 1}, "holds another survey: rng differs"),
        (case, {"order": "given"}, "holds another survey: order differs"),
        (case, {"passes": [1]}, "must be the 6 tiles of the first plan, got 3"),
        (case, {"resume": False}, "holds a survey; continue it with resume=True|use resume=True"),
        (case, {"visits": None}, r"holds a survey with recorded events; plan the rest with visits=Survey\.state"),
    ):
        refuse(folder, sentence, lambda other=other, options=options: replan(other, folder, **options))
    state = SurveyState.read(folder, sky)
    with pytest.raises(rs.InputError, match="tiles must be the 6 tiles of the first plan, got 5 tiles"):
        rs.plan_survey(sky, tiny, tiles.table[:-1], visits=state)


def test_a_state_that_was_used_with_another_instrument(case, folder):
    """Regression: outcomes depended on the instrument for which the state was used before."""
    state = SurveyState.read(folder, case[0])
    expected = rs.plan_survey(case[0], OTHER, case[2], visits=state)
    (folder / "events/state.npz").unlink()
    again = SurveyState.read(folder, case[0])
    assert differences(rs.plan_survey(case[0], OTHER, case[2], visits=again), expected) == []
    own = rs.plan_survey(*case, visits=again, allocator="nearest")
    assert differences(own, rs.Survey.read(folder)) == []


def test_rules_without_end_or_with_too_many_visits(case, folder):
    survey = rs.Survey.read(folder)
    wrong = {
        "must end, got 256 requested visits": lambda t: {"visits": t["observed"].astype(int) + 1},
        "must request at most 255 visits, got 300": lambda t: {"visits": np.full(len(t), 300)},
        "visits must be whole numbers from 0 to 255, got -1": lambda t: {"visits": np.full(len(t), -1)},
        "visits must be whole numbers from 0 to 255, got nan": lambda t: {"visits": np.full(len(t), np.nan)},
        "priorities must be finite numbers": lambda t: {"priority": np.full(len(t), np.nan)},
        "must return a dict or a table with the columns": lambda t: {"color": np.ones(len(t))},
        "visits must be one number or have the shape": lambda t: {"visits": [1, 2]},
        "ZeroDivisionError": lambda t: 1 // 0,
    }
    for sentence, function in wrong.items():
        refuse(folder, sentence, lambda function=function: survey.state(case[0], rule=VisitRule(function=function)))
    for options in ({"visits": 256}, {"after_success": 0}, {"retries": -1}, {"visits": 1.5}, {"function": "nowhere"}):
        with pytest.raises(rs.InputError):
            VisitRule(**options)
    with pytest.raises(rs.InputError, match="visits must be whole numbers from 0 to 255, got 256"):
        VisitRule(table=QTable({"visits": [256]}))
    with pytest.raises(rs.InputError, match="rule must be a VisitRule"):
        survey.state(case[0], rule="always")
    with pytest.raises(rs.InputError, match="date must be a date such as 2026-01-03, got 'tomorrow'"):
        survey.state(case[0], until="tomorrow")


@pytest.mark.parametrize(
    ("state", "checkpoint"),  # a new plan makes a copy of the plan of a bad observation
    [("done", True), ("done", False), ("partly", True), ("partly", False), ("bad", False)],
)
def test_a_changed_plan_of_a_recorded_tile_is_an_error(case, survey, state, checkpoint):
    """Regression: with a checkpoint, or if the observation was bad, a plan with one wrong bit was accepted."""
    survey.record(events(tile=11, date="2026-01-03", state=state))
    if checkpoint:
        survey = replan(case, survey.folder, visits=survey.state(case[0]))
    path = survey.folder / "tiles/000/000000.fits"
    original = path.read_bytes()
    path.write_bytes(original[:-2870] + bytes([original[-2870] ^ 4]) + original[-2869:])
    sentence = "must be the plan with which the tile in row 0 was observed, got another or a damaged file"
    refuse(survey.folder, sentence, lambda: survey.state(case[0]))
    copy = survey.folder / f"events/plans/{sha(original)}.fits"
    copy.parent.mkdir(exist_ok=True)
    copy.write_bytes(original)
    again = replan(case, survey.folder, visits=survey.state(case[0]))  # the copy replaces the damaged file
    if state != "bad":
        assert path.read_bytes() == original
    assert again.state(case[0]).summary["n_tiles_observed"] == (state == "done")


@pytest.mark.parametrize("damage", ["row", "empty"])
def test_the_plan_of_a_bad_observation_is_kept_without_its_line_in_the_index(case, survey, damage):
    """Regression: the copy of the plan was made only if the index had a line for the file."""
    original = (survey.folder / "tiles/000/000000.fits").read_bytes()
    dropped = survey.tile(11)["target_id"][:2].tolist()
    survey.record(events(tile=[11, 12], date="2026-01-03", state=["bad", "done"]))
    survey.record(events(target=dropped, state="dropped"))
    index = survey.folder / "index.csv"
    lines = index.read_text().splitlines(keepends=True)
    index.write_text("".join(line for line in lines if damage == "row" and "000000.fits" not in line))
    again = replan(case, survey.folder, visits=survey.state(case[0]))
    assert (survey.folder / f"events/plans/{sha(original)}.fits").read_bytes() == original
    assert again.tiles["state"].tolist()[:2] == ["planned", "done"]
    again.record(events(tile=11, date="2026-01-03", state="done"))
    assert again.state(case[0]).summary["n_tiles_observed"] == 2
