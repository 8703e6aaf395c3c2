"""Joint plans: executors, folders, fixed tiles, limits of the search, and refusals."""

from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import replace
from multiprocessing import get_context

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.table import QTable
from living import content

import rfpsurvey as rs

MM = u.mm
JOINT = rs.JointOptions(iterations=3, patch_size=60)
CENTER = SkyCoord(10 * u.deg, 40 * u.deg)


@pytest.fixture(scope="module")
def case():
    """Return targets, an instrument and overlapping tiles, for which a joint plan makes more visits."""
    plane = rs.FocalPlane.hexagonal(rs.Positioner(8.25 * MM, 8.25 * MM, 2.25 * MM), rings=2, pitch=17 * MM)
    instrument = rs.Instrument("small", plane, plate_scale=200 * MM / u.deg)
    rng = np.random.default_rng(5)
    m = 130
    sky = CENTER.spherical_offsets_by(*rng.uniform(-0.3, 0.3, (2, m)) * u.deg)
    catalog = rs.Catalog(sky, priority=rng.integers(1, 3, m), visits=rng.integers(0, 3, m))
    tiles = CENTER.spherical_offsets_by(*rng.uniform(-0.12, 0.12, (2, 6)) * u.deg)
    return catalog, instrument, tiles


def plan(case, **options):
    return rs.plan_survey(*case, **{"allocator": JOINT, **options})


@pytest.fixture(scope="module")
def survey(case):
    return plan(case)


def rows_of(survey):
    return [np.asarray(part["target_row"]).tolist() for part in survey]


def test_a_joint_plan_uses_the_seed(case):
    """A warning stated that the seed has no effect, although the search uses it."""
    joint = rs.JointOptions(iterations=3, patch_size=20)
    plans = [rows_of(plan(case, allocator=joint, rng=seed)) for seed in (1, 2, 3, 4)]  # a warning would fail the test
    assert any(rows != plans[0] for rows in plans)


def test_a_joint_plan_makes_more_visits(case, survey):
    before = plan(case, allocator="optimal")
    levels = survey.summary["joint"]["levels"]
    assert levels[-1]["n_visits_before"] == before.summary["n_visits_observed"]
    assert levels[-1]["n_visits"] == survey.summary["n_visits_observed"] > before.summary["n_visits_observed"]
    assert ([level["priority"] for level in levels], survey.summary["n_colliding"]) == (["2", "1"], 0)
    table = survey.joint
    assert (np.asarray(table["gap"]) == 1 - table["n_visits"] / table["bound"]).all()
    assert survey.summary["joint"]["gap"] == table["gap"][-2:].max()
    for name in ("2", "1"):
        part = table[table["priority"] == name]
        assert (np.diff(part["bound"]) <= 0).all()
        assert (np.diff(part["seconds"]) >= 0).all()
    first = table[table["priority"] == "2"]["n_visits"]
    assert (np.diff(first) >= 0).all()


@pytest.mark.parametrize("processes", [False, pytest.param(True, marks=pytest.mark.exhaustive)])
def test_the_plan_does_not_depend_on_the_workers(case, survey, tmp_path, processes):
    plan(case, folder=tmp_path / "alone")
    pool = ProcessPoolExecutor(2, get_context("spawn")) if processes else ThreadPoolExecutor(3)
    with pool as executor:
        plan(case, executor=executor, folder=tmp_path / "workers")
    assert content(tmp_path / "alone") == content(tmp_path / "workers")
    found = rs.Survey.read(tmp_path / "workers")
    assert (rows_of(found), found.summary) == (rows_of(survey), survey.summary)
    for name in ("iteration", "priority", "n_visits", "bound", "gap"):
        assert found.joint[name].tolist() == survey.joint[name].tolist()


def test_an_interrupted_search_continues(case, survey, tmp_path):
    """Regression: the table and the state of the search contained computing times, which differ after a resume."""

    def stop(done, _):
        if done >= 12:
            raise KeyboardInterrupt

    folder = tmp_path / "survey"
    with pytest.raises(KeyboardInterrupt):
        plan(case, folder=folder, progress=stop)
    done = []
    found = plan(case, folder=folder, resume=True, progress=lambda k, _: done.append(k))
    assert (rows_of(found), found.summary, len(found.joint)) == (rows_of(survey), survey.summary, len(survey.joint))
    assert np.isnan(found.joint["seconds"][0])
    assert "seconds" not in rs.Survey.read(folder).joint.colnames
    whole = plan(case, folder=tmp_path / "whole")
    assert (content(folder), whole.summary) == (content(tmp_path / "whole"), found.summary)


def test_a_finished_joint_plan_is_read(case, survey, tmp_path, monkeypatch):
    plan(case, folder=tmp_path / "survey")
    before = content(tmp_path / "survey")
    monkeypatch.setattr("rfpsurvey._survey.request.Request.job", None)
    found = plan(case, folder=tmp_path / "survey", resume=True)
    assert (rows_of(found), found.summary) == (rows_of(survey), survey.summary)
    assert found.joint.colnames == survey.joint.colnames
    assert np.isnan(found.joint["seconds"]).all()
    assert content(tmp_path / "survey") == before


def test_a_damaged_state_is_not_used(case, survey, tmp_path):
    folder = tmp_path / "survey"
    plan(case, folder=folder)
    (folder / "joint" / "state.npz").write_bytes(b"nothing")
    with pytest.warns(rs.RfpsurveyWarning, match="damaged"):
        found = plan(case, folder=folder, resume=True)
    assert rows_of(found) == rows_of(survey)
    with pytest.raises(rs.InputError, match="joint"):
        plan(case, folder=folder, resume=True, allocator=rs.JointOptions(iterations=4))


def test_the_search_ends_at_each_of_its_limits(case):
    none = plan(case, allocator=rs.JointOptions(iterations=0)).summary["joint"]
    assert none["n_iterations"] == 0
    assert none["levels"][-1]["n_visits"] > none["levels"][-1]["n_visits_before"]
    assert plan(case, allocator=rs.JointOptions(time_limit=1e-6 * u.s)).summary["joint"]["n_iterations"] == 0
    wide = plan(case, allocator=rs.JointOptions(gap=0.5)).summary["joint"]
    assert wide["n_iterations"] == 0
    assert wide["gap"] <= 0.5


def test_the_function_inform_receives_the_first_visits_and_bounds(case, survey):
    seen = []
    plan(case, allocator=rs.JointOptions(iterations=0, inform=seen.append))
    levels = survey.summary["joint"]["levels"]
    assert [one["visits_before"] for one in seen] == [[level["n_visits_before"] for level in levels]]
    assert seen[0]["visits"] == survey.joint["n_visits"][2:4].tolist()
    assert seen[0]["bound"] == survey.joint["bound"][2:4].tolist()


def test_observed_tiles_are_not_changed(case, tmp_path):
    catalog, instrument, tiles = case
    tiling = rs.Tiling.from_table(QTable({"ra": tiles.ra, "dec": tiles.dec}))
    some = rs.Tiling(tiling.table[:3])
    before = rs.plan_survey(catalog, instrument, some, allocator="lamost_rule", folder=tmp_path / "observed")
    assert before.summary["n_colliding"] > 0
    for fixed in (before, tmp_path / "observed"):
        found = rs.plan_survey(catalog, instrument, tiling, allocator=replace(JOINT, fixed=fixed))
        assert rows_of(found)[:3] == rows_of(before)
        for a, b in zip(found, before, strict=False):
            assert a["observed"].tolist() == b["observed"].tolist()
        level = found.summary["joint"]["levels"][-1]
        assert level["bound"] >= level["n_visits"] == found.summary["n_visits_observed"]
        assert found.summary["n_visits_observed"] > before.summary["n_visits_observed"]
        number = np.bincount(np.concatenate([p["target_row"][p["observed"]] for p in found]), minlength=len(catalog))
        assert (number <= catalog.visits).all()


def test_a_plan_is_not_continued_with_other_fixed_tiles(case, tmp_path):
    """Regression: the plan with the first fixed survey was returned, because the folder did not record its visits."""
    catalog, instrument, tiles = case
    tiling = rs.Tiling.from_table(QTable({"ra": tiles.ra, "dec": tiles.dec}))
    some = rs.Tiling(tiling.table[:1])
    fixed = [rs.plan_survey(catalog, instrument, some, allocator=name) for name in ("lamost_rule", "nearest")]
    assert rows_of(fixed[0]) != rows_of(fixed[1])
    options = {"folder": tmp_path / "plan"}
    joint = [rs.JointOptions(iterations=0, fixed=one) for one in fixed]
    first = rs.plan_survey(catalog, instrument, tiling, allocator=joint[0], **options)
    again = rs.plan_survey(catalog, instrument, tiling, allocator=joint[0], resume=True, **options)
    assert rows_of(again) == rows_of(first)
    with pytest.raises(rs.InputError, match="joint"):
        rs.plan_survey(catalog, instrument, tiling, allocator=joint[1], resume=True, **options)


def test_a_fixed_survey_must_belong_to_the_instrument_and_the_catalog(case):
    catalog, instrument, tiles = case
    before = rs.plan_survey(catalog, instrument, tiles, allocator="optimal")
    joint = rs.JointOptions(fixed=before)
    with pytest.raises(rs.InputError, match="fixed must be a survey with the instrument 'moons'"):
        rs.plan_survey(catalog, "moons", tiles, allocator=joint)
    other = rs.Catalog(catalog.coord, id=[f"s{k}" for k in range(len(catalog))], visits=catalog.visits)
    with pytest.raises(rs.InputError, match="targets of this catalog"):
        rs.plan_survey(other, instrument, tiles, allocator=joint)
    with pytest.raises(rs.InputError, match="more visits of a target than requested"):
        rs.plan_survey(catalog, instrument, tiles, allocator=joint, visits=0 * catalog.visits)


def test_the_order_must_be_known_and_suit_the_plan(case):
    for message, options in (
        ("unknown order 'jiont'; choose one of: color, given", {"allocator": "optimal", "order": "jiont"}),
        ("the order must be 'color' for a joint plan, got 'given'", {"order": "given"}),
        ("the order must be 'color' for a joint plan, got array", {"order": np.array([1, 2])}),
    ):
        with pytest.raises(rs.InputError, match=message):
            plan(case, **options)


def test_joint_options_are_checked():
    wrong = {"gap": [-0.1, "a", 1], "iterations": [-1, 2.5], "patch_size": [1], "time_limit": [3, -1 * u.s]}
    wrong = [(name, value, f"{name} must be") for name, values in wrong.items() for value in values]
    other = rs.AllocationOptions("optimal", objective="count")
    for name, value, message in (
        *wrong,
        ("inform", 3, "inform must be"),
        ("allocator", "lamost_rule", "a joint plan needs the allocator 'optimal', got 'lamost_rule'"),
        ("allocator", other, "the objective 'priority', got 'count'"),
    ):
        with pytest.raises(rs.InputError, match=message):
            rs.JointOptions(**{name: value})


@pytest.mark.filterwarnings("ignore:constraint keep_out")
def test_circles_that_no_arm_may_cover_are_obstacles_of_a_joint_plan(case):
    catalog, _, _ = case
    circles = [rs.Region.cap(where, 0.02 * u.deg) for where in catalog.coord[:10]]
    options = rs.AllocationOptions("optimal", keep_out=circles)
    found = plan(case, allocator=replace(JOINT, allocator=options))
    assert not any(np.asarray(part["in_collision"]).any() for part in found)
    level = found.summary["joint"]["levels"][-1]
    assert level["n_visits_before"] < level["n_visits"] <= level["bound"]
    assert level["bound"] < plan(case).summary["joint"]["levels"][-1]["bound"]


@pytest.mark.parametrize("allocator", ["lamost_rule", "repair", "optimal", "joint"])
def test_a_tile_without_targets_whose_idle_arms_touch(allocator):
    """Regression: the step that separates idle arms failed with an IndexError if a tile had no targets."""
    arms = rs.Positioner(5 * u.mm, 5 * u.mm, 1 * u.mm, home=[0, 120] * u.deg)
    plane = rs.FocalPlane([[0, 0], [1, 0], [40, 0]] * u.mm, arms)
    instrument = rs.Instrument("touching", plane, plate_scale=100 * u.mm / u.deg)
    sky = rs.synthetic_catalog("uniform", SkyCoord(10, 40, unit="deg"), 0.5 * u.deg, n_targets=200, rng=1)
    tiles = SkyCoord([10, 50] * u.deg, [40, 40] * u.deg)
    survey = rs.plan_survey(sky, instrument, tiles, allocator=allocator)
    assert survey.tiles["n_in_field"].tolist()[1] == survey.tiles["n_assigned"].tolist()[1] == 0
    assert survey.tiles["n_assigned"][0] > 0
    nothing = rs.Catalog(sky.coord, visits=np.zeros(len(sky), dtype=int))
    assert rs.plan_survey(nothing, instrument, tiles, allocator=allocator).summary["n_assigned"] == 0
    # a second regression: if the catalog has priorities, a tile without targets has no classes
    nothing = rs.Catalog(sky.coord, visits=np.zeros(len(sky), dtype=int), priority=np.arange(len(sky)))
    assert rs.plan_survey(nothing, instrument, tiles, allocator=allocator).summary["n_assigned"] == 0


@pytest.mark.parametrize("seed", [16, 22])
def test_the_stated_visits_are_those_of_the_plan_after_the_last_goals(seed):
    """Regression: the search for early visits found plans with more visits, which the summary did not state."""
    plane = rs.FocalPlane.hexagonal(rs.Positioner(8 * MM, 17 * MM, 1 * MM), rings=1, pitch=26 * MM)
    instrument = rs.Instrument("toy", plane, plate_scale=0.05 * MM / u.arcsec)
    rng, radius = np.random.default_rng(seed), instrument.field_radius
    center = SkyCoord(95 * u.deg, 20 * u.deg)
    tiles = center.directional_offset_by(rng.random(4) * 360 * u.deg, rng.random(4) * radius * 0.8)
    tiles = QTable({"ra": tiles.ra, "dec": tiles.dec, "pass": [1, 1, 2, 2]})
    sky = center.directional_offset_by(rng.random(40) * 360 * u.deg, 1.3 * radius * np.sqrt(rng.random(40)))
    asked = rs.JointOptions(iterations=0, early=True)
    survey = rs.plan_survey(rs.Catalog(sky), instrument, tiles, allocator=asked)
    assert survey.summary["joint"]["levels"][0]["n_visits"] == survey.summary["n_visits_observed"]
