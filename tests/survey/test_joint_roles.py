"""Joint plans of targets with several roles, compared with an integer program of all tiles."""

from dataclasses import replace

import astropy.units as u
import numpy as np
import pytest
from joint_program import JointProgram, random_survey
from living import content, events, instrument, tiling

import rfpsurvey as rs

N_CASES, CHUNK = 300, 20
NEEDS = [rs.Requirement.parse(text) for text in ("standard=2", "sky=1-2", "science=0-3")]
pytestmark = pytest.mark.filterwarnings("ignore::rfpsurvey.RfpsurveyWarning")


def survey_with_roles(seed):
    """Return a small survey in which many targets have several roles, and requirements."""
    instrument, tiles, catalog, options = random_survey(seed)
    rng = np.random.default_rng([seed, 3])
    kinds = ["science", "science+standard", "science+sky", "standard", "sky"]
    kind = rng.choice(kinds, len(catalog), p=[0.3, 0.4, 0.1, 0.1, 0.1])
    needs = [one for one in NEEDS if rng.random() < 0.8] or NEEDS[:1]
    options = replace(options, requirements=needs)
    return instrument, tiles, replace(catalog, kind=kind), options, needs


def has(kind, role):
    return np.char.find(np.asarray(kind).astype(str), role) >= 0


def counts_by_tile(survey, needs):
    return [[int(has(part["kind"], need.what).sum()) for need in needs] for part in survey]


def program_of(instrument, tiles, catalog, options):
    """Return the program; a copy of each target with several roles is not a science target, and spends no visits."""
    rows = np.flatnonzero(has(catalog.kind, "science") & (catalog.kind != "science") & (catalog.visits > 0))
    both = catalog[np.append(np.arange(len(catalog)), rows)]
    kind = both.kind.copy()
    kind[len(catalog) :] = [one.replace("science+", "") for one in catalog.kind[rows].tolist()]
    both = replace(both, kind=kind, id=np.arange(len(both)))
    program = JointProgram(instrument, tiles, both, options.parked_obstacles)
    for k, row in enumerate(rows):
        for tile in range(len(tiles)):
            of_both = np.isin(program.target, [row, len(catalog) + k]) & (program.tile == tile)
            program.add(np.flatnonzero(of_both), 1)
    return program, kind


def observed_by_class(survey, catalog, classes):
    rows = [part["target_row"][np.asarray(part["observed"]) & has(part["kind"], "science")] for part in survey]
    rows = np.concatenate([np.asarray(one) for one in rows])
    return np.array([(catalog.priority[rows] == one).sum() for one in classes])


@pytest.mark.few(1)
@pytest.mark.parametrize(
    "chunk", [0, 1, *(pytest.param(k, marks=pytest.mark.exhaustive) for k in range(2, N_CASES // CHUNK))]
)
def test_targets_are_reused_and_bounds_are_valid(chunk):
    n_reused = n_more = n_best = n_cases = 0
    for seed in range(CHUNK * chunk, CHUNK * (chunk + 1)):
        instrument, tiles, catalog, options, needs = survey_with_roles(seed)
        if not catalog.visits[has(catalog.kind, "science")].any():
            continue
        first = rs.plan_survey(catalog, instrument, tiles, allocator=options)
        size = [10, 40, 2000][seed % 3]
        joint = rs.JointOptions(iterations=4, patch_size=size, allocator=options)
        survey = rs.plan_survey(catalog, instrument, tiles, allocator=joint)
        before = counts_by_tile(first, needs)
        program, kind = program_of(instrument, tiles, catalog, options)
        for tile, row in enumerate(before):
            for need, n in zip(needs, row, strict=True):
                of_need = has(np.append(kind, "")[program.target], need.what) & (program.tile == tile)
                most = np.inf if need.maximum is None else need.maximum
                program.add(np.flatnonzero(of_need), most, min(need.minimum, n))
        best, sums = program.best(), program.sums()
        visits, old = (observed_by_class(one, catalog, program.classes) for one in (survey, first))
        assert tuple(old) <= tuple(visits) <= tuple(best), seed
        for row, earlier in zip(counts_by_tile(survey, needs), before, strict=True):
            for need, n, m in zip(needs, row, earlier, strict=True):
                assert n >= min(need.minimum, m), seed
                assert need.maximum is None or n <= need.maximum, seed
        levels = survey.summary["joint"]["levels"]
        assert (np.array([level["bound"] for level in levels]) >= sums).all(), seed
        assert [level["n_visits"] for level in levels] == np.cumsum(visits).tolist(), seed
        if size == 2000:  # a single patch contains all positioners
            assert tuple(visits) == tuple(best), seed
        times = np.zeros(len(catalog), dtype=int)
        for part in survey:
            rows = np.asarray(part["target_row"])
            assert len(np.unique(rows)) == len(rows), seed
            np.add.at(times, rows[has(part["kind"], "science")], 1)
            n_reused += (catalog.kind[rows] != np.asarray(part["kind"])).sum()
        assert (times <= catalog.visits).all(), seed
        assert np.array_equal(np.sort(survey.outcomes["observed"]), np.sort(times)), seed
        n_best += tuple(visits) == tuple(best)
        n_more += tuple(visits) > tuple(old)
        n_cases += 1
    assert n_best >= 0.75 * n_cases
    assert n_reused
    assert n_more or chunk


def targets(seed, n=70):
    """Return targets with up to two visits, most of which have several roles."""
    rng = np.random.default_rng(seed)
    sky = rs.synthetic_catalog("uniform", "8h +30d", 0.35 * u.deg, n_targets=n, rng=seed)
    kind = rng.choice(["science", "science+standard", "science+sky", "standard", "sky"], n, p=[0.4, 0.3, 0.1, 0.1, 0.1])
    visits = rng.integers(0, 3, n)
    return rs.Catalog(sky.coord, id=1000 + np.arange(n), kind=kind, visits=visits, priority=rng.integers(1, 3, n))


@pytest.fixture
def scene():
    """Return targets with several roles, overlapping tiles, and joint options with requirements."""
    catalog, tiles = targets(3), rs.Tiling.from_table(tiling(3, n=8).table)
    allocator = rs.AllocationOptions("optimal", requirements=["standard=5", "sky=1-2"])
    return catalog, tiles, rs.JointOptions(iterations=3, patch_size=60, allocator=allocator)


def n_reused(survey, catalog, tiles=slice(None)):
    """Return the number of fibers on science targets that spend no visit in some tiles."""
    found = list(survey)[tiles]
    return sum(
        int((has(catalog.kind[one["target_row"]], "science") & ~has(one["kind"], "science")).sum()) for one in found
    )


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
    times = np.zeros(len(catalog), dtype=int)
    for part in survey:
        np.add.at(times, np.asarray(part["target_row"])[has(part["kind"], "science")], 1)
    assert (times <= catalog.visits).all()
    assert times.sum() == survey.summary["n_visits_observed"]


def test_observed_tiles_keep_reused_targets(scene, tmp_path):
    catalog, tiles, joint = scene
    survey = rs.plan_survey(catalog, instrument(), tiles, allocator=joint, folder=tmp_path / "survey")
    reused = [k for k in range(len(tiles)) if n_reused(survey, catalog, slice(k, k + 1))]
    names = survey.tiles["tile"][reused[:2]].tolist()
    survey.record(events(tile=names, date="2026-01-03", state=["done", "partly"]))
    state = survey.state(catalog)
    kept = [survey.tile(name) for name in names]
    again = rs.plan_survey(
        catalog, instrument(), tiles, allocator=joint, folder=survey.folder, visits=state, resume=True
    )
    for one in kept:
        assert (again.tile(one["tile"][0]) == one).all()
    times = np.zeros(len(catalog), dtype=int)
    for part in again:
        np.add.at(times, np.asarray(part["target_row"])[has(part["kind"], "science")], 1)
    assert (times <= catalog.visits).all()
    assert times.sum() == again.summary["n_visits_observed"]
