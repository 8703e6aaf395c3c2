"""Surveys of targets with several roles, compared with a loop of tiles, and joint plans that reuse such targets."""

from dataclasses import replace

import astropy.units as u
import numpy as np
import pytest
from astropy.table import QTable, Table
from living import content, events, instrument, tiling

import rfpsurvey as rs
from rfpsurvey._sky.arrays import has_role
from rfpsurvey._survey import run as _run
from rfpsurvey._survey.columns import survey_facts
from rfpsurvey.plot._quality import plot_quality

REQUIREMENTS = ["standard=3", "sky=1-2"]
pytestmark = pytest.mark.filterwarnings("ignore::rfpsurvey.RfpsurveyWarning")


def targets(seed, n=70):
    """Return targets with one or two visits, most of which have several roles."""
    rng = np.random.default_rng(seed)
    sky = rs.synthetic_catalog("uniform", "8h +30d", 0.35 * u.deg, n_targets=n, rng=seed)
    kind = rng.choice(["science", "science+standard", "science+sky", "standard", "sky"], n, p=[0.4, 0.3, 0.1, 0.1, 0.1])
    visits = rng.integers(0, 3, n)
    return rs.Catalog(sky.coord, id=1000 + np.arange(n), kind=kind, visits=visits, priority=rng.integers(1, 3, n))


def scene_of(seed):
    return targets(seed), rs.Tiling.from_table(tiling(seed, n=8).table)


def one_by_one(catalog, tiles, options, order):
    """Plan the tiles with `plan_tile`; a target without remaining visits keeps its other roles."""
    science = np.char.find(catalog.kind, "science") >= 0
    left, found = np.where(science, catalog.visits, 0).astype(int), {}
    for k in order:
        others = np.char.replace(catalog.kind, "science+", "")
        kind = np.where(left > 0, catalog.kind, others)
        rows = np.flatnonzero((catalog.visits > 0) & ((left > 0) | (kind != "science")))
        part = replace(catalog[rows], kind=kind[rows], visits=np.ones(len(rows)))
        tile = rs.plan_tile(part, instrument(), tiles.coord[k], allocator=options)
        table = tile.table[tile.table["status"] == "assigned"]
        ids, kinds = np.asarray(table["target_id"]), np.asarray(table["kind"]).astype(str)
        found[k] = sorted(zip(ids.tolist(), kinds.tolist(), strict=True)), tile.summary["unmet"]
        good = ~np.asarray(table["in_collision"]) & (np.char.find(kinds, "science") >= 0)
        left[ids[good] - 1000] -= 1
    return found, np.where(science, catalog.visits, 0) - left


@pytest.mark.few(3)
@pytest.mark.parametrize("allocator", ["repair", "optimal", "lamost_rule"])
@pytest.mark.parametrize("way", ["memory", "folder", "partitioned"])
@pytest.mark.parametrize("seed", range(2))
def test_targets_without_remaining_visits_keep_their_other_roles(seed, way, allocator, tmp_path):
    """A standard that was also a science target could not be used as a standard after its visits."""
    catalog, tiles = scene_of(seed)
    options = rs.AllocationOptions(allocator, requirements=REQUIREMENTS)
    given = rs.catalog.partition_catalog(catalog, tmp_path / "parts", order=3) if way == "partitioned" else catalog
    folder = tmp_path / "survey" if way == "folder" else None
    survey = rs.plan_survey(given, instrument(), tiles, allocator=options, folder=folder)
    order = np.lexsort((np.arange(len(tiles)), survey.tiles["round"]))
    plans, observed = one_by_one(catalog, tiles, options, order)
    n_after = 0
    for k, name in enumerate(survey.tiles["tile"]):
        visits = survey.tile(name)
        kinds = np.asarray(visits["kind"]).astype(str)
        assert sorted(zip(visits["target_id"].tolist(), kinds.tolist(), strict=True)) == plans[k][0]
        for kind in ("science", "standard", "sky"):
            assert survey.tiles[f"n_{kind}"][k] == (np.char.find(kinds, kind) >= 0).sum()
        whole = catalog.kind[np.asarray(visits["target_row"])]
        n_after += (whole != kinds).sum()
    assert n_after > 0
    rows = np.searchsorted(catalog.id, np.asarray(survey.outcomes["target_id"]))
    assert np.array_equal(survey.outcomes["observed"], observed[rows])
    assert survey.summary["n_visits_observed"] == observed.sum()
    if folder is not None:
        with pytest.MonkeyPatch.context() as patch:  # a finished survey is read, and not planned again
            patch.setattr(_run, "run_rounds", None)
            again = rs.plan_survey(given, instrument(), tiles, allocator=options, folder=folder, resume=True)
        assert again.summary == survey.summary


@pytest.mark.parametrize("joint", [False, True])
def test_a_survey_states_how_many_science_targets_meet_requirements(joint, tmp_path):
    catalog, tiles = scene_of(0)
    options = rs.AllocationOptions("optimal", requirements=REQUIREMENTS)
    where = {"allocator": rs.JointOptions(iterations=3, allocator=options) if joint else options}
    where["folder"] = tmp_path / "survey"
    survey = rs.plan_survey(catalog, instrument(), tiles, **where)
    both = [int((np.char.find(np.asarray(part["kind"]).astype(str), "science+") >= 0).sum()) for part in survey]
    assert survey.tiles["n_also_science"].tolist() == both
    assert survey.summary["n_also_science"] == sum(both) > 0
    assert rs.Survey.read(survey.folder).summary["n_also_science"] == sum(both)
    (survey.folder / "tiles.fits").unlink()
    again = rs.plan_survey(catalog, instrument(), tiles, **where, resume=True)
    assert again.tiles["n_also_science"].tolist() == both
    if not joint:
        survey.record(events(tile=survey.tiles["tile"].tolist(), date="2026-01-03", state="done"))
        rest = rs.plan_survey(catalog, instrument(), tiles, **where | {"folder": None}, visits=survey.state(catalog))
        assert rest.tiles["n_also_science"].tolist() == both
    assert survey_facts(survey)["    that also meet requirements"] == sum(both)
    rs.report.write_report(survey, tmp_path / "report.html")
    assert "that also meet requirements" in (tmp_path / "report.html").read_text()


def test_surveys_whose_requirements_no_science_target_meets_do_not_state_a_number():
    catalog, tiles = scene_of(0)
    kind = np.where(np.char.find(catalog.kind, "+") >= 0, "science", catalog.kind)
    for given, requirements in ((catalog, []), (catalog, ["science=0-9"]), (replace(catalog, kind=kind), REQUIREMENTS)):
        options = rs.AllocationOptions("repair", requirements=requirements)
        survey = rs.plan_survey(given, instrument(), tiles, allocator=options)
        assert "n_also_science" not in survey.summary
        assert "n_also_science" not in survey.tiles.colnames


def test_only_visits_as_a_science_target_are_recorded(tmp_path):
    catalog, tiles = scene_of(1)
    options = rs.AllocationOptions("repair", requirements=REQUIREMENTS)
    survey = rs.plan_survey(catalog, instrument(), tiles, allocator=options, folder=tmp_path / "survey")
    survey.record(events(tile=survey.tiles["tile"].tolist(), state="done"))
    state = rs.survey.SurveyState.read(tmp_path / "survey", catalog)
    assert np.array_equal(state.observed, survey.outcomes["observed"])
    rest = rs.plan_survey(catalog, instrument(), tiles, allocator=options, visits=state)
    assert np.array_equal(rest.outcomes["observed"], survey.outcomes["observed"])


@pytest.mark.parametrize("allocator", ["repair", "lamost_rule"])
def test_partly_observed_tiles_keep_the_roles_of_their_targets(tmp_path, allocator):
    """Regression: a standard of a partly observed tile spent a visit if it was a science target in a later tile."""
    catalog, tiles = scene_of(3)
    allocator = rs.AllocationOptions(allocator, requirements=["standard=5", "sky=1-2"])
    survey = rs.plan_survey(catalog, instrument(), tiles, allocator=allocator, folder=tmp_path / "survey")
    whole = [catalog.kind[np.asarray(part["target_row"])] for part in survey]
    kinds = [np.asarray(part["kind"]).astype(str) for part in survey]
    n_after = [(one != other).sum() for one, other in zip(whole, kinds, strict=True)]
    name = survey.tiles["tile"][int(np.argmax(n_after))]
    survey.record(events(tile=name, date="2026-01-03", state="partly"))
    kept, options = survey.tile(name), {"folder": survey.folder, "visits": survey.state(catalog), "resume": True}
    again = rs.plan_survey(catalog, instrument(), tiles, allocator=allocator, **options)
    assert (again.tile(name) == kept).all()
    visits = again.targets
    rows = np.asarray(visits["target_row"])[has_role(np.asarray(visits["kind"]), "science") & visits["observed"]]
    times = np.bincount(rows, minlength=len(catalog))
    order = np.searchsorted(catalog.id, np.asarray(again.outcomes["target_id"]))
    assert np.array_equal(again.outcomes["observed"], times[order])


@pytest.mark.parametrize("allocator", ["repair", "nearest"])
def test_selection_probabilities_count_visits_as_a_science_target(allocator):
    catalog, tiles = scene_of(2)
    options = rs.AllocationOptions(allocator, requirements=REQUIREMENTS)
    found = rs.selection_probabilities(catalog, instrument(), tiles, 3, allocator=options, rng=0)
    for r, seed in enumerate(found.realizations["seed"].tolist()):
        survey = rs.plan_survey(catalog, instrument(), tiles, allocator=replace(options, subpriority=seed), rng=seed)
        observed = catalog.id[np.asarray(survey.outcomes["observed"]) > 0]
        assert set(found.target_id[found.observed_in(r)].tolist()) == set(observed.tolist())


def test_joint_plans_reuse_targets_without_spending_visits():
    """Regression: in joint plans, targets with several roles could not be used as standards after their visits."""
    catalog, tiles = scene_of(3)
    options = rs.JointOptions(allocator=rs.AllocationOptions("optimal", requirements=REQUIREMENTS))
    survey = rs.plan_survey(catalog, instrument(), tiles, allocator=options)
    assert n_reused(survey, catalog)
    assert times_of(survey, catalog).sum() == survey.summary["n_visits_observed"]


def test_required_targets_are_required_only_until_their_visits_are_observed():
    """A requirement that every plan meets made required standards take precedence in every tile of a survey."""
    catalog, tiles = targets(4, n=60), rs.Tiling.from_table(tiling(4, n=8, size=0.05).table)
    kind = np.where(np.arange(60) < 3, "science+standard", "science")
    catalog, found = replace(catalog, kind=kind, visits=np.ones(60)), []
    for requirements in ([], ["standard=0-7"]):
        options = rs.AllocationOptions("optimal", required=catalog.id[:3], requirements=requirements)
        found.append(rs.plan_survey(catalog, instrument(), tiles, allocator=options))
    assert found[0].summary["n_visits_observed"] == found[1].summary["n_visits_observed"]


def test_bars_of_fibers_count_each_fiber_once():
    catalog, tiles = scene_of(5)
    options = rs.AllocationOptions("repair", requirements=REQUIREMENTS)
    survey = rs.plan_survey(catalog, instrument(), tiles, allocator=options)
    fibers = plot_quality(survey)[2]
    tops = [bar.get_y() + bar.get_height() for bar in fibers.containers[-1]]
    assert tops == [4 * 7, 4 * 7]
    kinds = np.concatenate([np.asarray(visits["kind"]) for visits in survey])
    n = np.count_nonzero(kinds == "science+standard")
    assert n > 0
    assert f"science and standard: {n}" in [text.get_text() for text in fibers.get_legend().get_texts()]


@pytest.mark.parametrize("visits", [1, 0])
def test_standards_whose_cadence_has_no_epochs_are_available(visits):
    """Regression: a science target without epochs could not be used as a standard; with 0 visits, it is not used."""
    rows = [{"cadence": "none", "delta_min": "", "delta_max": "", "n_exp": ""}]
    rows += [{"cadence": "once", "delta_min": "0", "delta_max": "0", "n_exp": "1"}]
    catalog, table = targets(6), tiling(6, n=4).table
    kind = np.where(np.arange(len(catalog)) % 2, "science+standard", "science")
    extra = QTable({"cadence": np.where(kind == "science", "once", "none")})
    numbers = np.where(kind == "science", 1, visits)
    catalog, table["mjd"] = rs.Catalog(catalog.coord, kind=kind, visits=numbers, extra=extra), 60000.0 + np.arange(4)
    options, cadences = rs.AllocationOptions(requirements=["standard=2"]), rs.survey.Cadences(Table(rows))
    survey = rs.plan_survey(catalog, instrument(), rs.Tiling.from_table(table), visits=cadences, allocator=options)
    standards = survey.targets[np.asarray(survey.targets["kind"]) == "standard"]
    assert (len(standards) >= 4, len(standards)) == (visits > 0, survey.tiles["n_standard"].sum())
    rows = np.asarray(standards["target_row"])
    assert (catalog.kind[rows] == "science+standard").all()
    assert not survey.outcomes["observed"][np.isin(survey.outcomes["target_id"], standards["target_id"])].any()


@pytest.fixture
def scene():
    """Return targets with several roles, overlapping tiles, and joint options with requirements."""
    catalog, tiles = scene_of(3)
    allocator = rs.AllocationOptions("optimal", requirements=["standard=5", "sky=1-2"])
    return catalog, tiles, rs.JointOptions(iterations=3, patch_size=60, allocator=allocator)


def n_reused(survey, catalog, tiles=slice(None)):
    """Return the number of fibers on science targets that spend no visit in some tiles."""
    found = list(survey)[tiles]
    parts = [(catalog.kind[one["target_row"]], np.asarray(one["kind"])) for one in found]
    return sum(int((has_role(whole, "science") & ~has_role(own, "science")).sum()) for whole, own in parts)


def times_of(survey, catalog):
    """Return the number of visits to each target as a science target."""
    times = np.zeros(len(catalog), dtype=int)
    for part in survey:
        np.add.at(times, np.asarray(part["target_row"])[has_role(np.asarray(part["kind"]), "science")], 1)
    assert (times <= catalog.visits).all()
    return times


def test_an_interrupted_search_continues_with_reused_targets(scene, tmp_path):
    catalog, tiles, joint = scene
    for name, limit in (("once", None), ("survey", 10)):

        def stop(done, _, limit=limit):
            if done == limit:
                raise KeyboardInterrupt

        try:
            rs.plan_survey(catalog, instrument(), tiles, allocator=joint, folder=tmp_path / name, progress=stop)
        except KeyboardInterrupt:
            assert (tmp_path / name / "joint" / "state.npz").is_file()
            rs.plan_survey(catalog, instrument(), tiles, allocator=joint, folder=tmp_path / name, resume=True)
    assert content(tmp_path / "once") == content(tmp_path / "survey")
    assert n_reused(rs.Survey.read(tmp_path / "once"), catalog)


def test_fixed_tiles_keep_reused_targets(scene):
    catalog, tiles, joint = scene
    first = rs.plan_survey(catalog, instrument(), tiles, allocator=joint.allocator)
    order = np.argsort(first.tiles["round"], kind="stable")[:5]
    fixed = rs.plan_survey(catalog, instrument(), tiles.table[np.sort(order)], allocator=joint.allocator)
    survey = rs.plan_survey(catalog, instrument(), tiles, allocator=replace(joint, fixed=fixed))
    assert n_reused(fixed, catalog)
    for name in fixed.tiles["tile"]:
        one, other = (s.tile(name)["target_id", "positioner", "kind"] for s in (fixed, survey))
        assert (np.asarray(one) == np.asarray(other)).all()
    assert times_of(survey, catalog).sum() == survey.summary["n_visits_observed"]


def test_observed_tiles_keep_reused_targets(scene, tmp_path):
    catalog, tiles, joint = scene
    survey = rs.plan_survey(catalog, instrument(), tiles, allocator=joint, folder=tmp_path / "survey")
    reused = [k for k in range(len(tiles)) if n_reused(survey, catalog, slice(k, k + 1))]
    names = survey.tiles["tile"][reused[:2]].tolist()
    survey.record(events(tile=names, date="2026-01-03", state=["done", "partly"]))
    state = survey.state(catalog)
    kept = [survey.tile(name) for name in names]
    options = {"folder": survey.folder, "visits": state, "resume": True}
    again = rs.plan_survey(catalog, instrument(), tiles, allocator=joint, **options)
    for one in kept:
        assert (again.tile(one["tile"][0]) == one).all()
    assert times_of(again, catalog).sum() == again.summary["n_visits_observed"]
