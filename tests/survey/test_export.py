"""Exported tiles have the targets and collisions of the survey, whose planner computes both in another way."""

import os
from dataclasses import replace
from pathlib import Path

import astropy.units as u
import desi_files
import living
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.io import fits
from astropy.table import QTable, Table
from numpy.testing import assert_allclose, assert_array_equal
from raising import refused, warned

import rfpsurvey as rs
import sdssv_files

pytestmark = [
    pytest.mark.filterwarnings("ignore:.*DESI has 5000 positioners"),
    pytest.mark.filterwarnings("ignore:each file was written without"),
    pytest.mark.filterwarnings("ignore:.*has no effect with the allocator"),
    pytest.mark.filterwarnings("ignore:.*missing in"),
    pytest.mark.filterwarnings("ignore:.*violation"),
]
CENTER = SkyCoord(95 * u.deg, 23 * u.deg)
DATA = Path(os.environ.get("RFPSURVEY_TEST_DATA", "/none"))


def targets(model, n, kinds=False):
    """Return random targets with priorities and, optionally, kinds."""
    sky, rng = rs.synthetic_catalog("uniform", CENTER, 1.3 * model.field_radius, n_targets=n, rng=3), None
    rng = np.random.default_rng(0)
    kind = rng.choice(["science", "standard", "sky"], n, p=[0.7, 0.15, 0.15]) if kinds else None
    return rs.Catalog(sky.coord, id=5_000_000_000 + np.arange(n), kind=kind, priority=rng.integers(1, 4, n))


def tiles(model, **columns):
    """Return a table of three overlapping tiles with different position angles."""
    step = 0.3 * model.field_radius.to_value(u.deg)
    table = QTable({"tile": [11, 12, 14], "ra": [95, 95 + step, 95 - step] * u.deg})
    table["dec"], table["position_angle"] = [23, 23, 23 + step] * u.deg, [0, 30, -20] * u.deg
    for name, values in columns.items():
        table[name] = values
    return table


def assert_same_score(survey, table, folder):
    """Score the files without further parameters, and compare positioners, targets and collisions with the survey."""
    assert len(table) == 3
    for row, record in enumerate(table):
        score, visits = rs.score_tile(rs.plans.read_plan(folder / record["file"])), survey.tile(record["tile"])
        used = score.table["status"] == "assigned"
        names = ("positioner", "target_id", "in_collision")
        scored = zip(*(score.table[name][used].astype(str) for name in ("id", *names[1:])), strict=True)
        assert {*scored} == {*zip(*(visits[name].astype(str) for name in names), strict=True)}
        assert score.summary["n_assigned"] == record["n_assigned"] == survey.tiles["n_assigned"][row]
        for name in ("n_colliding", "n_colliding_pairs", "n_obstacle_collisions"):
            assert score.summary[name] == survey.tiles[name][row], name
        assert score.summary["collision_rate"] == survey.tiles["collision_rate"][row]
        assert score.provenance["parameters"]["positions"] == "sky"  # other positions can have fewer digits
        assert score.provenance["instrument"]["layout"] == survey.provenance["instrument"]["layout"]
    return score


def plan(model, tmp_path, n=3000, *, kinds=False, tiling=None, catalog=None, **options):
    tiling = tiles(model) if tiling is None else tiling
    given = rs.AllocationOptions(**{"allocator": "lamost_rule", **options})
    catalog = targets(model, n, kinds) if catalog is None else catalog
    survey = rs.plan_survey(catalog, model, tiling, allocator=given, folder=tmp_path / "plan")
    assert survey.summary["n_colliding"] > 20 or n < 1000
    return survey


@pytest.mark.parametrize("name", ["confsummary", "table"])
def test_a_survey_of_a_preset_of_sdssv(presets, tmp_path, name):
    pytest.importorskip("pydl", reason="pydl is not installed")
    survey = plan(presets["sdss_apo"], tmp_path)
    table = survey.export(format=name, output=tmp_path / "out")
    assert_same_score(survey, table, tmp_path / "out")
    names = {"confsummary": ["confSummary-11.par", "confSummary-12.par", "confSummary-14.par"]}
    expected = names.get(name, ["tile-11.fits", "tile-12.fits", "tile-14.fits"])
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == expected == table["file"].tolist()


def test_confsummary_files_are_read_by_pydl(presets, tmp_path):
    yanny = pytest.importorskip("pydl.pydlutils.yanny", reason="pydl is not installed").yanny
    apo = presets["sdss_apo"]
    survey = plan(apo, tmp_path)
    survey.export("12", format="confsummary", output=tmp_path)
    file, visits = yanny(str(tmp_path / "confSummary-12.par")), survey.tile(12)
    rows = Table(file["FIBERMAP"])
    assert (file["observatory"], float(file["pa"]), float(file["raCen"])) == ("APO", 30, survey.tiles["ra"][1].value)
    assert (file["rfpsurvey.survey.tile"], file["rfpsurvey.survey.generation"]) == ("12", "1")
    used = rows["assigned"] == 1
    holes = np.char.decode(np.asarray(rows["holeId"][used]))
    assert dict(zip(holes, rows["catalogid"][used], strict=True)) == dict(
        zip(visits["positioner"].tolist(), visits["target_id"].tolist(), strict=True)
    )
    sky = SkyCoord(rows["racat"][used] * u.deg, rows["deccat"][used] * u.deg)
    center = SkyCoord(survey.tiles["ra"][1], survey.tiles["dec"][1])
    fiber = np.char.decode(np.asarray(rows["fiberType"][used]))
    xy = apo.projection(center, 30 * u.deg)
    for kind in ("BOSS", "APOGEE"):
        of_kind = fiber == kind
        expected = xy.to_focal_plane(sky[of_kind], fiber_type=kind).to_value(u.mm)
        assert_allclose(np.column_stack([rows["xwok"][used], rows["ywok"][used]])[of_kind], expected, atol=1e-6)


def test_a_survey_of_a_preset_of_pfs(presets, tmp_path):
    survey = plan(presets["pfs"], tmp_path, 6000, kinds=True, requirements=["standard=30", "sky=100"])
    table = survey.export(format="pfsdesign", output=tmp_path / "out")
    assert_same_score(survey, table, tmp_path / "out")
    for record in table:
        with fits.open(tmp_path / "out" / record["file"]) as file:
            rows, header, visits = file["DESIGN"].data, file[0].header, survey.tile(record["tile"])
            assert record["file"] == f"pfsDesign-0x{header['W_PFDSGN']:016x}.fits"
            assert header["DSGN_NAM"] == str(record["tile"])
            used = np.isin(rows["targetType"], (1, 2, 3))
            order, other = np.argsort(rows["cobraId"][used]), np.argsort(visits["positioner"])
            for name, column in {"cobraId": "positioner", "objId": "target_id", "ra": "ra", "dec": "dec"}.items():
                assert_array_equal(rows[name][used][order], np.asarray(visits[column])[other], name)
            kinds = np.array(["", "science", "sky", "standard"])[rows["targetType"][used][order]]
            assert_array_equal(kinds, visits["kind"][other])


def test_a_survey_of_desi_as_built(tmp_path):
    """The survey was planned in Python with an instrument that is described by its own file in the folder."""
    desi_files.metrology(tmp_path / "fp.csv", per_petal=25)
    survey = plan(rs.Instrument.from_desi(tmp_path / "fp.csv"), tmp_path, 9000)
    table = survey.export(format="fiberassign", output=tmp_path / "out", instrument=tmp_path / "fp.csv")
    assert_same_score(survey, table, tmp_path / "out")
    assert len([*(tmp_path / "out").glob("instrument-*.ecsv")]) == 1
    assert table["file"].tolist() == [f"fiberassign-0000{tile}.fits" for tile in (11, 12, 14)]
    with fits.open(tmp_path / "out" / "fiberassign-000012.fits") as file:
        header, rows, visits = file[0].header, file["FIBERASSIGN"].data, survey.tile(12)
        assert (header["TILEID"], header["FIELDROT"], header["TILEDEC"]) == (12, -30, 23)
        used = (rows["FIBERSTATUS"] == 0) & (rows["TARGETID"] >= 0)
        assert dict(zip(rows["LOCATION"][used], rows["TARGETID"][used], strict=True)) == dict(
            zip(visits["positioner"].tolist(), visits["target_id"].tolist(), strict=True)
        )
        assert_array_equal(rows["PRIORITY"][used], visits["priority"][np.argsort(visits["positioner"])])
    for path in (tmp_path / "out").glob("instrument-*"):
        path.unlink()
    message = "instrument must be given, because the plan was not made with an unchanged preset, and its folder lacks"
    refused(message, rs.score_tile, rs.plans.read_plan(tmp_path / "out" / "fiberassign-000012.fits"))


def test_the_preset_of_desi_has_no_locations(presets, tmp_path):
    survey = plan(presets["desi"], tmp_path, 20000)
    with pytest.raises(rs.InputError, match=r"fiberassign-000011.fits: positioner must be a LOCATION of DESI"):
        survey.export(format="fiberassign", output=tmp_path / "out")
    assert not (tmp_path / "out").exists()
    assert_same_score(survey, survey.export(output=tmp_path / "out"), tmp_path / "out")


BUILT = [(DATA / "sdssv_apo_2024", "confsummary"), (DATA / "desi" / "fp-metrology.csv.gz", "fiberassign")]
BUILT += [(DATA / "pfs", "pfsdesign")]


@pytest.mark.few(1)
@pytest.mark.skipif(not DATA.is_dir(), reason="RFPSURVEY_TEST_DATA is not set")
@pytest.mark.parametrize(("path", "name"), BUILT, ids=[name for _, name in BUILT])
def test_surveys_of_real_instruments_as_built(tmp_path, path, name):
    """The folder of the survey names the path of the instrument."""
    pytest.importorskip("pydl", reason="pydl is not installed")
    model = rs.Instrument.read(path)
    options = {"allocator": "lamost_rule", "folder": tmp_path / "plan"}
    survey = rs.plan_survey(targets(model, 3 * len(model.focal_plane)), path, tiles(model), **options)
    survey.export("11", output=tmp_path / "tile")
    tile = rs.score_tile(rs.Tile.read(tmp_path / "tile" / "tile-11.fits"))
    assert tile.summary["n_colliding"] == survey.tiles["n_colliding"][0]
    assert_same_score(survey, survey.export(format=name, output=tmp_path / "out"), tmp_path / "out")


def test_conditions_circles_and_idle_arms_are_those_of_the_survey(tmp_path):
    """Scores without the hour angles, the circle or ``parked_obstacles`` of the survey differ."""
    pytest.importorskip("pydl", reason="pydl is not installed")
    sdssv_files.calibration(tmp_path / "calibration")
    conditions = rs.ObservingConditions("apache point", hour_angle=0 * u.hourangle)
    model = rs.Instrument.read(tmp_path / "calibration")
    tiling = rs.Tiling.from_table(tiles(model, hour_angle=[-3, 0, 4] * u.hourangle)).with_conditions(conditions)
    circle = rs.Region.cap(CENTER, 0.04 * u.deg)
    survey = plan(model, tmp_path, 400, tiling=tiling, keep_out=[circle], parked_obstacles=False)
    assert survey.tiles["n_obstacle_collisions"].max() > 0
    table = survey.export(format="confsummary", output=tmp_path, instrument=tmp_path / "calibration")
    score = assert_same_score(survey, table, tmp_path)
    assert score.provenance["parameters"]["conditions"]["hour_angle_deg"] == 60
    assert not score.provenance["parameters"]["parked_obstacles"]
    unmet = [*map(bool, table["unmet"].tolist())]
    assert unmet == [*(survey.tiles["n_unmet"] > 0)]
    assert any(unmet)


def test_a_time_becomes_the_epoch_and_the_time_of_a_configuration(presets, tmp_path):
    pytest.importorskip("pydl", reason="pydl is not installed")
    apo, motion = presets["sdss_apo"], np.full(2000, 800.0) * u.mas / u.yr
    sky = targets(apo, 2000)
    coord = SkyCoord(sky.coord.ra, sky.coord.dec, pm_ra_cosdec=motion, pm_dec=-motion)
    sky = rs.Catalog(coord, id=sky.id, epoch="J2016.0")
    conditions = rs.ObservingConditions("apache point", time="2026-01-10T05:00:00")
    times = [f"2026-{month:02d}-10T05:00:00" for month in (1, 2, 12)]
    tiling = rs.Tiling.from_table(tiles(apo, time=times)).with_conditions(conditions)
    survey = rs.plan_survey(sky, apo, tiling, allocator="lamost_rule", folder=tmp_path / "plan")
    table = survey.export(format="confsummary", output=tmp_path)
    assert_same_score(survey, table, tmp_path)
    plan = rs.plans.read_plan(tmp_path / "confSummary-14.par")
    assert plan.meta["header"]["obstime"] == "Thu Dec 10 05:00:00 2026"
    assert plan.meta["epoch"][:8] == "J2026.93"
    assert_allclose(plan["coord_epoch"], 2026.94, atol=0.005)


def test_each_tile_has_the_states_of_positioners_at_its_time(presets, tmp_path):
    """Regression: all tiles were left out, because the states of positioners must be those of one time."""
    ids = presets["moons"].focal_plane.id.tolist()
    states = Table({"id": ids[:300], "state": ["broken"] * 100 + ["stuck"] * 200})
    states["theta"], states["phi"] = 40.0, 120.0
    states["from"], states["to"] = ["2026-02-01"] * 300, ["2026-03-01"] * 200 + ["2026-12-01"] * 100
    unusable = {11: set(), 12: {*ids[:300]}, 14: {*ids[200:300]}}
    tiling = rs.Tiling.from_table(tiles(presets["moons"], date=["2026-01-10", "2026-02-10", "2026-03-10"]))
    survey = plan(presets["moons"].with_states(states, time=tiling.times), tmp_path, tiling=tiling)
    assert_same_score(survey, survey.export(output=tmp_path / "out"), tmp_path / "out")
    for tile, expected in unusable.items():
        plan_of_tile = rs.plans.read_plan(tmp_path / "out" / f"tile-{tile}.fits")
        table = rs.score_tile(plan_of_tile).table
        assert {*table["id"][np.isin(table["status"], ["disabled", "stuck"])].tolist()} == expected
        assert not {*plan_of_tile["positioner"][plan_of_tile["assigned"]].tolist()} & expected


def test_kinds_priorities_and_rules_are_in_the_table_of_a_tile(tmp_path):
    catalog = replace(living.targets(kinds=True), epoch="J2026.5")
    options = rs.AllocationOptions("repair", requirements=["sky=3", "standard=1"], constraints=["required 1003"])
    survey = rs.plan_survey(catalog, "moons", living.tiling(), allocator=options, folder=tmp_path / "plan")
    table = survey.export([11, "13"], output=tmp_path)
    assert table["tile"].tolist() == [11, 13]
    tile, visits = rs.Tile.read(tmp_path / "tile-13.fits"), survey.tile(13)
    rows = {str(row["id"]): row for row in tile.table if row["status"] == "assigned"}
    assert len(rows) == len(visits) > 3
    for visit in visits:
        row = rows[str(visit["positioner"])]
        assert [row[name] for name in ("target_id", "kind", "priority")] == [
            visit[name] for name in ("target_id", "kind", "priority")
        ]
    record = tile.provenance["parameters"]["survey"]
    assert record["constraints"] == {"0": "sky=3", "1": "standard=1"}
    assert [record["unmet"]] == tile.summary["unmet"] == [survey.tiles["unmet"][2]]
    assert tile.provenance["parameters"]["epoch"] == survey.provenance["parameters"]["epoch"]


@pytest.mark.parametrize("names", [{"sky": "faint", "science": "faint"}, {"science": "skymapper", "sky": "sky"}])
def test_configurations_keep_the_kinds_of_targets_with_other_categories(presets, tmp_path, names):
    """Regression: requirements were not met in files, because only the categories of sky positions were written."""
    pytest.importorskip("pydl", reason="pydl is not installed")
    apo = presets["sdss_apo"]
    sky = targets(apo, 2000, kinds=True)
    sky = replace(sky, category=np.array([names.get(kind, "standard_dwarf") for kind in sky.kind.tolist()]))
    survey = plan(apo, tmp_path, tiling=tiles(apo), requirements=["sky=30", "standard=20"], catalog=sky)
    message = "each file was written without .*, the categories that do not state the kind of their targets"
    warned(message, survey.export, format="confsummary", output=tmp_path)
    for tile in (11, 12, 14):
        written, visits = rs.plans.read_plan(tmp_path / f"confSummary-{tile}.par"), survey.tile(tile)
        kinds = {row["target_id"]: row["kind"] for row in written if row["assigned"]}
        assert kinds == dict(zip(visits["target_id"].tolist(), visits["kind"].tolist(), strict=True))
        assert {*kinds.values()} == {"science", "sky", "standard"}
        assert "standard_dwarf" in written["category"]


def test_stuck_fibers_on_sky_are_counted(tmp_path):
    desi_files.metrology(tmp_path / "fp.csv", per_petal=25)
    desi = rs.Instrument.from_desi(tmp_path / "fp.csv")
    states = Table({"id": desi.focal_plane.id[:20], "state": ["stuck"] * 20, "theta": 17.0 * np.arange(20)})
    states["phi"] = 100.0
    desi = desi.with_states(states)
    options = {"requirements": ["sky=10"], "sky_separation": 2 * u.arcsec}
    survey = plan(desi, tmp_path, 900, tiling=tiles(desi)[:1], **options)
    n_stuck = len(survey.tile(11)) - survey.tiles["n_assigned"][0]
    assert n_stuck > 10
    text = f"{n_stuck} stuck fibers on sky are written without a position"
    warned(text, survey.export, format="fiberassign", output=tmp_path, instrument=desi)
    score = rs.score_tile(rs.plans.read_plan(tmp_path / "fiberassign-000011.fits"), constraints=["sky=10"])
    assert score.summary["requirements"] == {"sky=10": [n_stuck]}


def test_two_tiles_with_the_same_name_of_a_file_are_refused(tmp_path):
    table = living.tiling(n=2).table.copy()
    table["tile"] = ["b/c", "b_c"]
    survey = rs.plan_survey(living.targets(), "moons", rs.Tiling(table), folder=tmp_path / "plan")
    with pytest.raises(rs.InputError, match=r"tile-b_c.fits must be the file of one tile, got b_c and another tile"):
        survey.export(output=tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_a_survey_in_memory_is_refused(tmp_path):
    survey = rs.plan_survey(living.targets(), "moons", living.tiling(n=2))
    refused("the survey must have a folder to export its tiles, got a survey in memory", survey.export)
    survey = rs.plan_survey(living.targets(), "moons", living.tiling(n=2), folder=tmp_path / "plan")
    refused("instrument must be that of the survey, moons with the digest", survey.export, instrument="lamost")
    refused("tiles must be identifiers of tiles, or text such as 12-20,31, got 1.5", survey.export, 1.5)


def test_many_circles_are_those_of_the_plan_file(presets, tmp_path):
    """The provenance of a survey contains only a digest of more than 1000 circles."""
    rng, moons = np.random.default_rng(4), presets["moons"]
    places = rng.uniform(-3, 3, (1100, 2)) * moons.field_radius.to_value(u.deg)
    circles = [rs.Region.cap(CENTER.spherical_offsets_by(*(place * u.deg)), 10 * u.arcsec) for place in places]
    options = rs.AllocationOptions("lamost_rule", keep_out=circles)
    survey = rs.plan_survey(targets(moons, 3000), moons, tiles(moons), allocator=options, folder=tmp_path / "plan")
    assert survey.tiles["n_obstacle_collisions"].min() > 0
    assert_same_score(survey, survey.export(output=tmp_path), tmp_path)
    record = rs.Tile.read(tmp_path / "tile-11.fits").provenance["parameters"]["survey"]["keep_out"]
    assert 50 < len(record) < 500  # those near the field
