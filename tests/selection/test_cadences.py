"""Realizations of surveys with cadences, replayed tile by tile by a second implementation of the windows."""

from dataclasses import replace

import numpy as np
import pytest
from astropy.table import QTable, Table, vstack
from cadence_program import check_windows, random_survey, scene
from living import SEVERAL_ROLES, content, instrument
from naive_cadences import TABLE, Naive
from recorded_cadences import counted, naive_state, outcomes, text

import rfpsurvey as rs
from realizations import check
from rfpsurvey._survey.plan import prepare_request
from rfpsurvey._survey.selection import run
from rfpsurvey._survey.selection.alternate import generations_of, plan_history
from rfpsurvey.survey import Cadences

pytestmark = pytest.mark.filterwarnings("ignore::rfpsurvey.RfpsurveyWarning")
N = 3
RULES = ("nearest", "lamost_rule", "repair", "optimal")
ALLOCATORS = (*RULES, "balanced", "joint")


class Scene:
    """A random survey with cadences in a folder, and the replay of its realizations."""

    def __init__(self, seed, name, folder):
        self.instrument, self.tiling, self.catalog, options = random_survey(seed)
        self.allocator = replace(options, allocator="optimal" if name == "joint" else name)
        self.days, self.brightness = (np.array(self.tiling.table[name]) for name in ("mjd", "skybrightness"))
        self.is_joint, self.folder, self.cadences = name == "joint", folder, Cadences(TABLE)

    def asked(self, subpriority):
        options = replace(self.allocator, subpriority=subpriority)
        return rs.JointOptions(iterations=2, allocator=options) if self.is_joint else options

    def plan(self, seed, folder=None, **options):
        given = {"visits": self.cadences, "allocator": self.asked(seed), "rng": seed, **options}
        return rs.plan_survey(self.catalog, self.instrument, self.tiling, folder=folder, **given)

    def state(self, survey):
        return survey.state(self.catalog, visits=self.cadences)

    def select(self, survey, n=N, **options):
        given = self.state(survey), self.instrument, self.tiling, n
        return rs.selection_probabilities(*given, allocator=self.asked(None), **options)

    def plan_naively(self, targets, tile, seed):
        """Return the visits of a tile that is planned alone, for the targets whose windows are open."""
        is_open = [target.allows(self.days[tile], self.brightness[tile])[0] for target in targets]
        rows = np.flatnonzero(is_open)
        if len(rows) == 0:
            return QTable({"target_row": [], "positioner": [], "observed": []}, dtype=[int, str, bool])
        options = replace(self.allocator, subpriority=seed)
        few, alone = self.catalog[rows], rs.Tiling(self.tiling.table[[tile]])
        visits = QTable(rs.plan_survey(few, self.instrument, alone, visits=1, allocator=options)._visits(0))
        visits["target_row"] = rows[np.asarray(visits["target_row"])]
        return visits

    def observe(self, targets, tile, visits, day=None):
        day = self.days[tile] if day is None else day
        for row in visits["target_row"][np.asarray(visits["observed"], dtype=bool)]:
            if targets[row].allows(day, self.brightness[tile])[0]:
                targets[row].observe(day)

    def replay(self, seed, rounds=()):
        """Return all targets after a realization; ``rounds`` are the outcomes of tiles between successive plans."""
        plans, meaning = {}, {}
        for found in (*rounds, None):
            targets, now = naive_state(self.catalog, plans, meaning, self.brightness)
            states = {tile: state for tile, (_, state, _) in meaning.items()}
            for tile in sorted(tile for tile, state in states.items() if state == "partly"):
                self.observe(targets, tile, plans[tile], now)
            for tile in np.argsort(self.days, kind="stable").tolist():
                is_past = self.days[tile] < now or (tile in states and self.days[tile] <= now)
                if states.get(tile) in ("done", "partly") or is_past:
                    continue
                plans[tile] = self.plan_naively(targets, tile, seed)
                self.observe(targets, tile, plans[tile])
            meaning |= found or {}
        return targets


def compare(found, realizations):
    """Compare the columns of the result with the targets after each realization."""
    numbers = np.array([counted(targets) for targets in realizations]).T
    whole = np.array([[len(one.starts) == len(one.epochs) for one in targets] for targets in realizations]).T
    np.testing.assert_array_equal([found.observed_in(r) for r in range(numbers.shape[1])], numbers.T > 0)
    np.testing.assert_array_equal(found.realizations["n_observed"], numbers.sum(axis=0))
    np.testing.assert_array_equal(found.probability, (numbers > 0).mean(axis=1))
    np.testing.assert_array_equal(found.n_complete, whole.sum(axis=1))
    np.testing.assert_array_equal(found.probability_complete, whole.mean(axis=1))
    for k in range(found.n_with_visits.shape[1]):
        np.testing.assert_array_equal(found.n_with_visits[:, k], (numbers == k).sum(axis=1))
    assert (found.requested == [int(sum(epoch[2] for epoch in one.epochs)) for one in realizations[0]]).all()


@pytest.mark.few(6)
@pytest.mark.parametrize("seed", range(40))
def test_realizations_are_those_of_tiles_planned_one_after_the_other(seed, tmp_path):
    scene = Scene(seed, ALLOCATORS[seed % 6], tmp_path / "plan")
    found = scene.select(scene.plan(1, scene.folder))
    options = {"visits": scene.cadences}
    given = scene.catalog, scene.instrument, scene.tiling, scene.asked(None)
    check(found, *given, range(N), **options)
    seeds = found.realizations["seed"].tolist()
    surveys = [scene.plan(seed) for seed in seeds]
    for survey in surveys:
        if scene.is_joint:
            check_windows(survey, scene.tiling, scene.catalog)
        else:
            targets = [Naive(str(name)) for name in scene.catalog.extra["cadence"]]
            for tile in np.argsort(scene.days).tolist():
                visits = survey._visits(tile)
                assert all(targets[r].allows(scene.days[tile], scene.brightness[tile])[0] for r in visits["target_row"])
                scene.observe(targets, tile, visits)
    if scene.allocator.allocator in RULES and not scene.is_joint:
        compare(found, [scene.replay(seed) for seed in seeds])


def failures(scene, state, seed):
    """Return the positioners that fail in each observed tile of a realization."""

    def prepare(state):
        usual = {"passes": None, "epoch": None, "lost_in_collision": True, "executor": None}
        options = {"allocator": scene.asked(None), "visits": state, **usual}
        return prepare_request(state.catalog, scene.instrument, scene.tiling, **options)

    failed = {}
    for generation in generations_of(state, prepare):
        ids = generation.request.instrument.focal_plane.id.astype(str)
        for row, found in generation.observed.items():
            fails = dict(zip(found.rates, found.draw((seed,))[:, 0], strict=True))
            failed[row] = ids[fails[max(fails, key=len)]].tolist()
    return failed


@pytest.mark.few(6)
@pytest.mark.parametrize("seed", range(40))
def test_realizations_repeat_the_recorded_observations(seed, tmp_path):
    """A survey is recorded and planned again twice; windows follow from the times of the observations."""
    scene, rounds, rng = Scene(seed, RULES[seed % 4], tmp_path / "plan"), [], np.random.default_rng([seed, 3])
    survey = scene.plan(1, scene.folder)
    for number in (1, 2):
        table, meaning = outcomes(rng, survey, scene.tiling, number if number > 1 else None)
        if table is not None:
            survey.record(table, allow_future=True)
        rounds.append(meaning)
        survey = scene.plan(1, scene.folder, visits=scene.state(survey), resume=True)
    found, realizations = scene.select(survey), []
    for one in found.realizations["seed"].tolist():
        failed = failures(scene, scene.state(survey), one)
        drawn = [{k: (day, name, failed.get(k, ())) for k, (day, name, _) in some.items()} for some in rounds]
        realizations.append(scene.replay(one, drawn))
    compare(found, realizations)


WITH_NONE = vstack([TABLE, Table({name: ["none" if name == "cadence" else ""] for name in TABLE.colnames})])
"""The table of cadences with one without epochs."""


def live(folder, allocator):
    """Return a survey and its catalog, after targets were changed, tiles were added, and seven tiles were observed."""
    catalog, tiling = scene(3, n=60, n_tiles=16)
    kind = np.random.default_rng(3).choice([*SEVERAL_ROLES], 60, p=[*SEVERAL_ROLES.values()])
    extra = QTable(catalog.extra)
    extra["cadence"][np.char.find(kind, "science+") == 0] = "none"  # these are only standards or sky positions
    catalog = replace(catalog, kind=kind, visits=np.arange(60) % 12 > 0, extra=extra)
    later = tiling.table[:2].copy()
    later["tile"], later["pass"], later["mjd"] = [900, 901], 2, tiling.table["mjd"].max() + [5, 6]
    given = {"visits": Cadences(WITH_NONE), "allocator": allocator, "folder": folder}
    survey = rs.plan_survey(catalog, instrument(), tiling, **given)
    days, order = np.asarray(tiling.table["mjd"]), np.argsort(tiling.table["mjd"]).tolist()

    def observe(rows, generation):
        done = [(tiling.table["tile"][k], text(days[k]), "done", generation) for k in rows]
        survey.record(Table(rows=done, names=["tile", "date", "state", "generation"]))

    observe(order[:4], 1)
    new = {"target": [99999], "state": ["added"], "ra": [120.0], "dec": [30.0], "priority": [3], "kind_of": [1]}
    survey.record(Table(new | {"cadence": ["pairs"], "kind": ["science"]}))
    survey.record(Table({"target": catalog.id[:20], "cadence": ["thrice"] * 20}))
    survey.record(Table({"target": catalog.id[20:30], "state": ["dropped"] * 10}))
    survey.record(Table({"target": catalog.id[30:35], "visits": [0] * 5}))
    tiling = rs.Tiling(vstack([tiling.table, later]))
    survey = survey.replan(tiles=tiling)
    observe(order[5:8], 2)
    return survey.replan(), catalog


@pytest.mark.parametrize("name", ["nearest", "lamost_rule", "repair"])
def test_targets_that_changed_and_roles_and_further_tiles(name, tmp_path):
    """Realizations are surveys in which the same is recorded; some targets have several roles, or are required."""
    options = {"required": 1000 + np.arange(0, 60, 7)} | ({"requirements": "standard=1"} if name == "repair" else {})
    asked = rs.AllocationOptions(name, **options)
    survey, catalog = live(tmp_path / "plan", replace(asked, subpriority=1))
    found = survey.select(2)
    np.testing.assert_array_equal(found.bits, survey.select(2, rng=0, visits=Cadences(WITH_NONE)).bits)
    state = survey.state(catalog, visits=Cadences(WITH_NONE))
    again = rs.selection_probabilities(state, instrument(), survey, 2, allocator=asked)
    np.testing.assert_array_equal(found.table, again.table)
    numbers = []
    for r, seed in enumerate(found.realizations["seed"].tolist()):
        own = live(tmp_path / f"{r}", replace(asked, subpriority=seed))[0]
        numbers.append(np.asarray(own.outcomes["observed"]))
        np.testing.assert_array_equal(found.observed_in(r), numbers[-1] > 0)
        assert found.realizations["n_observed"][r] == own.summary["n_visits_observed"]
    expected = (np.array(numbers)[:, :, None] == np.arange(found.n_with_visits.shape[1])).sum(axis=0)
    np.testing.assert_array_equal(found.n_with_visits, expected)
    assert 0 < found.n_complete.sum() < found.n_observed.sum()


def test_interrupted_computations_and_files(tmp_path, monkeypatch):
    """The second block has two realizations; blocks contain the numbers of visits."""
    case = Scene(4, "nearest", tmp_path / "plan")
    survey, planned = case.plan(1, case.folder), []
    found = case.select(survey, 34, folder=tmp_path / "whole")

    def stop(done, _):
        if done >= 33 * len(case.tiling):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        case.select(survey, 34, folder=tmp_path / "part", progress=stop)
    monkeypatch.setattr(run, "plan_history", lambda *given: planned.append(given[1]) or plan_history(*given))
    case.select(survey, 34, folder=tmp_path / "part", resume=True)
    assert planned == [2]
    assert content(tmp_path / "part") == content(tmp_path / "whole")
    read = rs.SelectionProbabilities.read(tmp_path / "whole")
    np.testing.assert_array_equal(read.table, found.table)
    assert read.summary == found.summary
    few = case.select(survey, 3)
    check(found, case.catalog, case.instrument, case.tiling, case.asked(None), (0, 33), visits=case.cadences)
    np.testing.assert_array_equal([few.observed_in(r) for r in range(3)], [found.observed_in(r) for r in range(3)])
