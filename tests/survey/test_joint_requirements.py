"""Joint plans with sky fibers, standards, subpriorities, required targets and rules on the distribution of fibers."""

from dataclasses import replace

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.table import QTable
from joint_program import JointProgram, random_survey, survey_with, visits_by_class

import rfpsurvey as rs
from rfpsurvey._survey.joint import search as _search

pytestmark = pytest.mark.filterwarnings(
    "ignore:no target was observed",
    "ignore:.*requirement",
    "ignore:.*standards",
    "ignore:constraint distribution",
    "ignore:required targets",
)


def goal_scene(seed):
    instrument, tiles, catalog, options = random_survey(seed)
    catalog = replace(catalog, subpriority=np.random.default_rng([seed, 2]).random(len(catalog)).round(3))
    columns = {"ra": tiles.ra, "dec": tiles.dec, "pass": np.arange(1, len(tiles) + 1)}
    tiles = rs.Tiling.from_table(QTable(columns))
    return instrument, tiles, catalog, options


def goals_of(survey, catalog):
    """Return the sum of the subpriorities of all visits, and the sum of their passes."""
    rows = [np.asarray(part["target_row"]) for part in survey]
    number = sum(len(one) * int(k) for one, k in zip(rows, survey.tiles["pass"], strict=True))
    return catalog.subpriority[np.concatenate(rows)].sum(), number


@pytest.mark.few(6)
@pytest.mark.parametrize("seed", range(12))
def test_subpriorities_and_early_passes_decide_between_plans_with_equal_visits(seed):
    instrument, tiles, catalog, options = goal_scene(seed)
    joints = [rs.JointOptions(patch_size=2000, allocator=options, early=early) for early in (False, True)]
    survey, early = (rs.plan_survey(catalog, instrument, tiles, allocator=joint) for joint in joints)
    program = JointProgram(instrument, tiles.coord, catalog, options.parked_obstacles)
    best = program.best()
    for one in (survey, early):
        assert visits_by_class(one, catalog, program.classes).tolist() == best.tolist()
    for hits, n in zip(program.hits, best, strict=True):
        program.add(np.flatnonzero(hits), n, n)
    value = np.append(catalog.subpriority, 0)[program.target]
    largest = value @ program.maximize(value)
    sums = [goals_of(one, catalog) for one in (survey, early)]
    assert (sums[0][0], sums[1][0]) == (pytest.approx(largest, abs=0.02), pytest.approx(largest, abs=0.02))
    assert sums[1][1] <= sums[0][1]
    # with equal subpriorities, the passes are as early as possible
    equal = replace(catalog, subpriority=None)
    only = rs.plan_survey(equal, instrument, tiles, allocator=joints[1])
    least = np.where(program.target >= 0, program.tile + 1.0, 0.0)
    assert goals_of(only, catalog)[1] == least @ program.maximize(-least)


@pytest.mark.few(6)
@pytest.mark.parametrize("seed", range(12))
def test_required_targets_come_first(seed):
    instrument, tiles, catalog, options = random_survey(seed)
    wanted = np.flatnonzero(catalog.visits > 0)
    rows = np.random.default_rng([seed, 3]).permutation(wanted)[:4]
    required = replace(options, required=catalog.id[rows])
    joint = rs.JointOptions(patch_size=2000, allocator=required)
    survey = rs.plan_survey(catalog, instrument, tiles, allocator=joint)
    priority = catalog.priority.copy()
    priority[rows] = 99.0
    first = replace(catalog, priority=priority)
    program = JointProgram(instrument, tiles, first, options.parked_obstacles)
    best = program.best()
    assert visits_by_class(survey, first, program.classes).tolist() == best.tolist()
    levels = survey.summary["joint"]["levels"]
    assert (levels[0]["priority"] == "required") == (len(rows) > 0)
    assert [level["n_visits"] for level in levels] == np.cumsum(best).tolist()
    assert all(level["bound"] >= n for level, n in zip(levels, program.sums(), strict=True))


@pytest.mark.filterwarnings("ignore:the rules on the distribution of fibers cost")
@pytest.mark.few(6)
@pytest.mark.parametrize("seed", range(12))
def test_rules_on_the_distribution_remain_fulfilled(seed):
    instrument, tiles, catalog, options, _ = survey_with(seed, "kinds")
    options = replace(options, requirements=(), constraints=["distribution sky 1 60 12"])
    joint = rs.JointOptions(iterations=3, patch_size=[20, 2000][seed % 2], allocator=options)
    plans = [rs.plan_survey(catalog, instrument, tiles, allocator=one) for one in (options, joint)]
    lacks = []
    for survey in plans:
        of_survey = []
        for tile, part in zip(tiles, survey, strict=True):
            place = np.deg2rad([tile.ra.deg, tile.dec.deg, 0.0])
            xy = instrument.field_projection(*place, None).project(catalog.arrays.vectors, catalog.fiber_type)
            rows = np.asarray(part["target_row"])
            fibers, sky = (xy[rows[catalog.kind[rows] == kind]] for kind in ("science", "sky"))
            apart = np.linalg.norm(fibers[:, None] - sky[None], axis=2).min(axis=1, initial=np.inf)
            of_survey.append(max(int(np.ceil(0.6 * len(fibers) - 1e-9)) - int((apart <= 12).sum()), 0))
        lacks.append(of_survey)
    assert (np.array(lacks[1]) <= lacks[0]).all()
    first, last = (one.summary["n_visits_observed"] for one in plans)
    assert last >= first


@pytest.fixture(scope="module")
def blank():
    """Return the arguments of a survey with added sky positions and standards."""
    model = rs.Instrument.preset("sdss_apo")
    center = SkyCoord(95 * u.deg, 23 * u.deg)
    sky = rs.synthetic_catalog("poisson", center, 2.2 * u.deg, density=250 / u.deg**2, rng=2)
    kind = np.where(np.arange(len(sky)) % 9 == 0, "standard", "science")
    tiles = rs.Tiling.from_table(QTable({"ra": [94.5, 95.5, 95.0] * u.deg, "dec": [23, 23, 23.4] * u.deg}))
    options = rs.AllocationOptions("optimal", requirements=["sky=80", "standard=15"], sky_separation=8 * u.arcsec)
    return rs.Catalog(sky.coord, kind=kind), model, tiles, options


def test_added_sky_positions_are_kept_by_joint_plans(blank, tmp_path, monkeypatch):
    catalog, model, tiles, options = blank
    catalog = catalog[::2]
    joint = rs.JointOptions(iterations=2, patch_size=300, allocator=options)
    survey = rs.plan_survey(catalog, model, tiles, allocator=joint, folder=tmp_path / "one")
    assert survey.tiles["n_unmet"].tolist() == [0, 0, 0]
    assert min(survey.tiles["n_sky"]) >= 80
    level = survey.summary["joint"]["levels"][0]
    assert level["n_visits_before"] < level["n_visits"] <= level["bound"] < level["bound_without_requirements"]
    for part in survey:
        added = part[np.asarray(part["target_row"]) < 0]
        assert len(added) >= 80
        apart = SkyCoord(added["ra"], added["dec"]).match_to_catalog_sky(catalog.coord)[1]
        assert apart.min() > 7.9 * u.arcsec
    # a search that is interrupted after an iteration gives the same bytes
    old = _search.Search.iterate

    def stop(self, executor):
        if self.iteration == 1:
            raise KeyboardInterrupt
        old(self, executor)

    monkeypatch.setattr(_search.Search, "iterate", stop)
    with pytest.raises(KeyboardInterrupt):
        rs.plan_survey(catalog, model, tiles, allocator=joint, folder=tmp_path / "two")
    monkeypatch.undo()
    rs.plan_survey(catalog, model, tiles, allocator=joint, folder=tmp_path / "two", resume=True)
    for path in sorted((tmp_path / "one" / "tiles").rglob("*.fits")):
        assert path.read_bytes() == (tmp_path / "two" / path.relative_to(tmp_path / "one")).read_bytes()
    # observed tiles with added sky positions keep their plans
    # (regression: their sky fibers were lost)
    one = rs.plan_survey(catalog, model, rs.Tiling(tiles.table[:1]), allocator=options)
    given = replace(joint, fixed=one)
    rest = rs.plan_survey(catalog, model, tiles, allocator=given)
    name = tiles.table["tile"][0]
    for column in ("target_row", "positioner"):
        both = rest.tile(name), one.tile(name)
        assert np.array_equal(*(np.asarray(tile[column])[np.asarray(tile["target_row"]) >= 0] for tile in both))


def test_subpriorities_and_added_sky_positions_from_partitions(blank, tmp_path):
    """Regression: the subpriorities were also looked up for added sky positions, with an IndexError."""
    catalog, model, tiles, options = blank
    catalog = rs.Catalog(catalog.coord[::4], id=np.arange(len(catalog))[::4])
    options = replace(options, requirements="sky=20", subpriority=3, required=[4, 8])
    joint = rs.JointOptions(iterations=1, allocator=options)
    parts = rs.catalog.partition_catalog(catalog, tmp_path / "parts")
    surveys = [rs.plan_survey(one, model, tiles, allocator=joint) for one in (catalog, parts)]
    assert surveys[0].summary["joint"] == surveys[1].summary["joint"]
    assert surveys[0].summary["joint"]["levels"][0]["priority"] == "required"
    assert surveys[0].tiles["n_unmet"].tolist() == [0, 0, 0]


def test_sky_fibers_of_fixed_tiles_are_not_lost(blank):
    catalog, model, tiles, options = blank
    one = rs.plan_survey(catalog, model, rs.Tiling(tiles.table[:1]), allocator=options)
    other = replace(options, sky_separation=60 * u.arcsec)
    with pytest.raises(rs.InputError, match="in a fixed tile is not among the added sky positions"):
        rs.plan_survey(catalog, model, tiles, allocator=rs.JointOptions(iterations=0, allocator=other, fixed=one))


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("need", ["sky=6", "sky=0-6"])
def test_stuck_fibers_on_sky_count_once(seed, need):
    """Regression: sky positions that stuck fibers observe were counted twice, so that a tile lacked sky fibers."""
    rng = np.random.default_rng(seed)
    robot = rs.Positioner(8.25 * u.mm, 8.25 * u.mm, 2.25 * u.mm)
    plane, stuck = rs.FocalPlane.hexagonal(robot, rings=2, pitch=22.4 * u.mm), np.full((19, 2), np.nan)
    stuck[rng.permutation(19)[:5]] = rng.uniform(0, 170, (5, 2))
    model = rs.Instrument("stuck", replace(plane, stuck=stuck * u.deg), plate_scale=200 * u.mm / u.deg)
    center, scale = SkyCoord(10 * u.deg, 40 * u.deg), 200 * u.mm / u.deg
    sky = center.spherical_offsets_by(*(rng.uniform(-50, 50, (2, 90)) * u.mm / scale))
    tiles = center.spherical_offsets_by(*(rng.uniform(-6, 6, (2, 3)) * u.mm / scale))
    options = rs.AllocationOptions("optimal", requirements=need, sky_separation=8 * u.arcsec)
    joint = rs.JointOptions(iterations=3, patch_size=2000, allocator=options)
    first, survey = (rs.plan_survey(rs.Catalog(sky), model, tiles, allocator=one) for one in (options, joint))
    assert survey.tiles["n_unmet"].tolist() == first.tiles["n_unmet"].tolist() == [0, 0, 0]
    level = survey.summary["joint"]["levels"][0]
    assert first.summary["n_visits_observed"] <= level["n_visits"] <= level["bound"]
