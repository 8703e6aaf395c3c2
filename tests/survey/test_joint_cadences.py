"""Joint plans of small surveys with cadences, compared with an integer program of all sequences of visits."""

import warnings
from dataclasses import replace

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.table import QTable
from cadence_program import CENTER, check_windows, counts_of, random_survey, with_sequences
from joint_program import SCALE
from naive_cadences import NAMES, TABLE

import rfpsurvey as rs
from rfpsurvey.survey import Cadences

CHUNK, NEEDS = 10, [rs.Requirement.parse(text) for text in ("standard=2", "sky=1-2")]
KINDS = ["science", "science+standard", "science+sky", "standard", "sky"]
pytestmark = pytest.mark.filterwarnings("ignore:no target was observed", "ignore:.*will not be observed")


def program_of(instrument, tiling, catalog, first):
    """Return the program and the weights; a copy of a target with several roles is not a science target."""
    if catalog.kind is None:
        return with_sequences(instrument, tiling, catalog)
    copied = np.flatnonzero(np.char.find(catalog.kind, "science+") >= 0)
    both = catalog[np.append(np.arange(len(catalog)), copied)]
    kind = np.append(catalog.kind, np.char.replace(catalog.kind[copied], "science+", ""))
    program, weights = with_sequences(instrument, tiling, replace(both, kind=kind, id=np.arange(len(both))))
    for tile, part in enumerate(first):
        here = program.tile == tile
        for k, row in enumerate(copied):
            program.add(np.flatnonzero(np.isin(program.target, [row, len(catalog) + k]) & here), 1)
        for need, n in zip(NEEDS, counts_of_needs(part), strict=True):
            of_need = (np.char.find(np.append(kind, "")[program.target], need.what) >= 0) & here
            most = np.inf if need.maximum is None else need.maximum
            program.add(np.flatnonzero(of_need), most, min(need.minimum, n))
    return program, weights


def counts_of_needs(part):
    kinds = np.asarray(part["kind"]).astype(str)
    return [int((np.char.find(kinds, need.what) >= 0).sum()) for need in NEEDS]


@pytest.mark.filterwarnings("ignore::rfpsurvey.RfpsurveyWarning")
@pytest.mark.parametrize("chunk", [1, *(pytest.param(k, marks=pytest.mark.exhaustive) for k in (0, 2, 3, 4, 5))])
@pytest.mark.parametrize("roles", [False, True])
def test_no_plan_exceeds_the_optimum_and_no_bound_is_below(roles, chunk):
    """Regression: in joint plans, each fiber of a science target that is also a standard used a visit."""
    n_best = n_better = n_reused = 0
    for seed in range(CHUNK * chunk, CHUNK * (chunk + 1)):
        instrument, tiling, catalog, options = random_survey(seed, 5 if roles else 7)
        if roles:
            kind = np.random.default_rng([seed, 5]).choice(KINDS, len(catalog), p=[0.3, 0.4, 0.1, 0.1, 0.1])
            catalog, options = replace(catalog, kind=kind), replace(options, requirements=NEEDS)
        common = {"visits": Cadences(TABLE), "rng": seed}
        first = rs.plan_survey(catalog, instrument, tiling, allocator=options, **common)
        joint = rs.JointOptions(iterations=3, allocator=options)
        survey = rs.plan_survey(catalog, instrument, tiling, allocator=joint, **common)
        check_windows(survey, tiling, catalog)
        program, weights = program_of(instrument, tiling, catalog, first)
        for part, old in zip(survey, first, strict=True) if roles else ():
            for need, n, before in zip(NEEDS, counts_of_needs(part), counts_of_needs(old), strict=True):
                assert min(need.minimum, before) <= n <= (np.inf if need.maximum is None else need.maximum), seed
            n_reused += int((catalog.kind[np.asarray(part["target_row"])] != np.asarray(part["kind"])).sum())
        found, before = (np.ravel(counts_of(one, catalog)).tolist() for one in (survey, first))
        last = survey.joint[survey.joint["iteration"] == survey.joint["iteration"].max()][-len(weights) :]
        assert np.asarray(last["n_visits"]).tolist() == np.cumsum(found[1::2]).tolist(), seed
        assert np.asarray(last["n_complete"]).tolist() == np.cumsum(found[::2]).tolist(), seed
        first_rows = survey.joint["n_visits"][: len(weights)]
        assert first_rows.tolist() == np.cumsum(before[1::2]).tolist(), seed
        for k in range(len(weights)):
            for j, name in enumerate(("bound_complete", "bound")):
                goal = weights[: k + 1, j].sum(axis=0)
                assert last[name][k] >= round(goal @ program.maximize(goal)), (seed, k, name)
        best = []
        for goal in weights.reshape(2 * len(weights), -1):  # the first goals have precedence
            best.append(round(goal @ program.maximize(goal)))
            program.add(np.flatnonzero(goal), np.inf, best[-1], goal[goal > 0])
        assert before <= found <= best, seed
        n_best += found == best
        n_better += found > before
    assert n_best == CHUNK
    assert n_better
    assert n_reused or not roles


def test_sky_fibers_remain_and_other_options_have_no_effect():
    """On a larger scene, requirements are met, the bounds are valid, and the seed alone determines the plan."""
    rng = np.random.default_rng(4)
    sky = rs.synthetic_catalog("uniform", CENTER, 0.2 * u.deg, n_targets=120, rng=4)
    kind = np.where(np.arange(120) % 8 == 0, "standard", "science")
    catalog = rs.Catalog(sky.coord, kind=kind, extra=QTable({"cadence": rng.choice(NAMES, 120)}))
    night = np.sort(rng.integers(0, 12, 8))
    table = QTable({"ra": [CENTER.ra.deg] * 8 * u.deg, "dec": [CENTER.dec.deg] * 8 * u.deg})
    table["mjd"], table["pass"], table["skybrightness"] = 60000 + night + np.arange(8) / 50, np.arange(8), 0.3
    tiling = rs.Tiling.from_table(table)
    options = rs.AllocationOptions("optimal", requirements=["sky=6", "standard=3"], sky_separation=5 * u.arcsec)
    robot = rs.Positioner(8.25 * u.mm, 8.25 * u.mm, 2.25 * u.mm)
    model = rs.Instrument("small", rs.FocalPlane.hexagonal(robot, rings=2, pitch=25.6 * u.mm), plate_scale=SCALE)
    joint = rs.JointOptions(iterations=2, allocator=options)
    common = {"visits": Cadences(TABLE), "allocator": joint}
    survey = rs.plan_survey(catalog, model, tiling, **common)
    first = rs.plan_survey(catalog, model, tiling, **{**common, "allocator": options})
    assert survey.summary["n_complete"] > first.summary["n_complete"]
    assert (survey.tiles["n_unmet"] <= first.tiles["n_unmet"]).all()
    assert (survey.tiles["n_sky"] >= np.minimum(6, first.tiles["n_sky"])).all()
    level = survey.summary["joint"]["levels"][0]
    assert survey.summary["n_complete"] == level["n_complete"] <= level["bound_complete"]
    assert survey.summary["n_visits_observed"] == level["n_visits"] <= level["bound"]
    assert level["bound"] <= level["bound_without_requirements"]
    check_windows(survey, tiling, catalog)
    with pytest.warns(rs.RfpsurveyWarning, match="early has no effect with cadences"):
        again = rs.plan_survey(catalog, model, tiling, **{**common, "allocator": replace(joint, early=True)})
    for tile in range(8):
        assert np.array_equal(survey._visits(tile)["target_row"], again._visits(tile)["target_row"])


@pytest.mark.parametrize("seed", [*range(2), *(pytest.param(k, marks=pytest.mark.exhaustive) for k in range(2, 12))])
@pytest.mark.parametrize("goal", ["science", "distribution"])
def test_bounds_are_valid_with_other_constraints(seed, goal):
    """Regression: prices of science fibers were subtracted twice, and targets of kept sky fibers were omitted."""
    instrument, tiling, catalog, options = random_survey(seed)
    kind = np.where(np.random.default_rng(seed).random(len(catalog)) < 0.3, "sky", "science")
    catalog = replace(catalog, kind=kind)
    given = {"requirements": ["science=3"]} if goal == "science" else {"constraints": ["distribution sky 1 60 12"]}
    joint = rs.JointOptions(iterations=1, allocator=replace(options, **given))
    common = {"visits": Cadences(TABLE), "rng": seed}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", rs.RfpsurveyWarning)
        survey = rs.plan_survey(catalog, instrument, tiling, allocator=joint, **common)
        first = rs.plan_survey(catalog, instrument, tiling, allocator=joint.allocator, **common)
    levels = survey.summary["joint"]["levels"]
    program, weights = with_sequences(instrument, tiling, catalog)
    for tile in range(len(tiling) if goal == "science" else 0):
        rows = np.asarray(first._visits(tile)["target_row"])
        mine = (program.tile == tile) & np.append(kind == "science", False)[program.target]
        program.add(np.flatnonzero(mine), np.inf, min(3, int((kind[rows] == "science").sum())))
    for k, level in enumerate(levels):
        for j, name in enumerate(("bound_complete", "bound")):
            values = weights[: k + 1, j].sum(axis=0)
            # rules on the distribution do not lower the bounds
            if goal == "distribution" or program.is_feasible():
                assert level[name] >= round(values @ program.maximize(values)), (name, k)


def test_bounds_are_valid_if_targets_are_omitted():
    """Regression: the bounds contained only the targets that the preselection of a positioner kept."""
    robot, n = rs.Positioner(8.25 * u.mm, 8.25 * u.mm, 2.25 * u.mm), 300
    model = rs.Instrument("one", rs.FocalPlane([[0, 0]] * u.mm, robot), plate_scale=SCALE)
    rng = np.random.default_rng(0)
    radius, angle = np.sqrt(rng.uniform(0.1, 1, n)) * 15, rng.uniform(0, 2 * np.pi, n)
    sky = CENTER.spherical_offsets_by(radius * np.cos(angle) * u.mm / SCALE, radius * np.sin(angle) * u.mm / SCALE)
    names = np.where(np.argsort(np.argsort(radius)) < n - 3, "pairs", "once")
    table = QTable({"ra": [CENTER.ra.deg] * 4 * u.deg, "dec": [CENTER.dec.deg] * 4 * u.deg})
    table["mjd"], table["pass"], table["skybrightness"] = 60000.0 + np.arange(4), np.arange(4), 0.3
    catalog = rs.Catalog(sky, extra=QTable({"cadence": names}))
    joint = rs.JointOptions(iterations=0)
    survey = rs.plan_survey(catalog, model, rs.Tiling.from_table(table), visits=Cadences(TABLE), allocator=joint)
    level = survey.summary["joint"]["levels"][0]
    assert level["bound_complete"] >= 3
    assert level["bound"] >= 3


def test_surveys_without_candidates():
    """Regression: a survey whose targets no tile can observe failed with an IndexError."""
    instrument, tiling, catalog, options = random_survey(3)
    far = SkyCoord(catalog.coord.ra + 30 * u.deg, catalog.coord.dec)
    joint, cadences = rs.JointOptions(iterations=1, allocator=options), Cadences(TABLE)
    for changes in ({"coord": far}, {"visits": np.zeros(len(catalog), dtype=int)}):
        survey = rs.plan_survey(replace(catalog, **changes), instrument, tiling, visits=cadences, allocator=joint)
        assert survey.summary["n_visits_observed"] == 0
