"""The command ``export``, and tiles of surveys in ``score`` and ``convert``."""

import re

import astropy.units as u
import living
import numpy as np
import pytest
from astropy.table import QTable, Table

import rfpsurvey as rs

pytestmark = pytest.mark.filterwarnings("ignore:each file was written without")
PLAN = "survey {} --tiles {} --instrument {} --allocator lamost_rule"


@pytest.fixture
def folder(call, files, tmp_path):
    """Return the folder of a survey that was planned with broken positioners, which are not those of a preset."""
    Table({"id": ["R-1C13", "R-1C14"]}).write(tmp_path / "broken.csv")
    words = f"{PLAN} --constraint science=60 --set instrument.broken={{}} --folder {{}}"
    paths = (files / "stars.fits", files / "tiles.ecsv", "sdss_apo", tmp_path / "broken.csv")
    call(words, *paths, tmp_path / "plan")
    return tmp_path / "plan"


def content(folder):
    return sorted(path.name for path in folder.iterdir())


def test_chosen_tiles_are_written_and_scored_without_options(call, run, folder, tmp_path):
    pytest.importorskip("pydl", reason="pydl is not installed")
    survey, out = rs.Survey.read(folder), tmp_path / "night"
    ended = call("export {} --tiles 11-12,14 --format confsummary --output {}", folder, out)
    names = [f"confSummary-{tile}.par" for tile in (11, 12, 14)]
    (instrument,) = {*content(out)} - {*names}
    assert re.fullmatch(r"instrument-[0-9a-f]{16}\.ecsv", instrument)
    assert rs.Instrument.read(out / instrument).focal_plane.disabled.sum() == 2
    rows = [0, 1, 3]
    total = survey.tiles["n_assigned"][rows].sum()
    assert ended.out.splitlines()[-1] == f"3 files with {total} targets written to {out}"
    for row, name in zip(rows, names, strict=True):
        tile = survey.tiles[row]
        text = f"{name}, {tile['n_assigned']} of 500 positioners have a target, {tile['n_colliding']} in collision"
        assert text in ended.out
        for path in (out / name, folder / f"tiles/000/00000{row}.fits"):
            lines = call("score {}", path).lines
            assert int(lines["in collision"][0]) == tile["n_colliding"] > 10, path
            assert int(lines["assigned"][0]) == tile["n_assigned"]
    call("convert {} {}", folder / "tiles/000/000001.fits", tmp_path / "out.par")
    assert call("score {}", tmp_path / "out.par").lines["in collision"][0] == str(survey.tiles["n_colliding"][1])
    assert (tmp_path / instrument).read_bytes() == (out / instrument).read_bytes()
    assert run("score", tmp_path / "out.par", "--set", f"instrument.broken={tmp_path / 'broken.csv'}")[0] == 0


def test_files_are_replaced_only_on_request(call, refused, folder, tmp_path):
    out = tmp_path / "out"
    call("export {} --tiles 12 --output {}", folder, out)
    before = (out / "tile-12.fits").read_bytes()
    said = refused("export {} --output {}", folder, out)
    assert said == f"rfpsurvey: {out / 'tile-12.fits'} exists; to replace it, use --overwrite"
    assert len(content(out)) == 2  # no other tile was written
    (out / "tile-12.fits").write_text("other")
    call("export {} --output {} --overwrite", folder, out)
    assert len(content(out)) == 5
    other = (out / "tile-12.fits").read_bytes()
    assert len(other) == len(before)


WRONG_TILES = [
    ("12,15,x", "--tiles must be tiles of the survey, which has 11, 12, 13, 14, got 15, x"),
    ("12-20", "--tiles must be tiles of the survey, which has 11, 12, 13, 14, got 20"),
    ("11,,12", "--tiles must be tiles of the survey, which has 11, 12, 13, 14, got ''"),
    ("14-12", "--tiles must be ranges of numbers from the smallest to the largest, got '14-12'"),
]


@pytest.mark.parametrize(("tiles", "message"), WRONG_TILES)
def test_unknown_tiles_are_refused(refused, folder, tmp_path, tiles, message):
    assert refused("export {} --tiles {} --output {}", folder, tiles, tmp_path / "out") == f"rfpsurvey: {message}"
    assert not (tmp_path / "out").exists()


def test_wrong_paths_and_formats_are_refused(refused, folder, tmp_path):
    assert "folder must be given: the folder of a survey" in refused("export")
    said = refused("export {} --format pfsdesign --output {}", folder, tmp_path / "out")
    assert said == "rfpsurvey: pfsDesign: the instrument of a design of PFS must be pfs, got sdss_apo"
    assert "does not hold a survey" in refused("export {}", tmp_path)
    assert "unknown format of plans 'par'" in refused("export {} --format par --output {}", folder, tmp_path)
    assert "give the file of a tile, or use rfpsurvey export" in refused("score {}", folder)
    assert "give the file of a tile, or use rfpsurvey export" in refused("convert {} {}", folder, tmp_path / "a.par")
    (folder / "tiles/000/000007.fits").write_bytes((folder / "tiles/000/000001.fits").read_bytes())
    said = refused("score {}", folder / "tiles/000/000007.fits")
    assert said.endswith("must be the file of one of the 4 tiles of the survey, got row 7")
    (tmp_path / "broken.csv").write_text("id\nR-1C13\n")
    assert "instrument must be that of the survey, sdss_apo with the digest" in refused("export {}", folder)


def test_the_help_states_the_folder_of_the_files(run):
    """Regression: the default value was printed as two periods."""
    assert "if it does not exist. By default, the current folder." in " ".join(run("export", "--help")[1].split())


def test_strict_commands_fail_if_requirements_are_not_met(run, call, files, tmp_path):
    """No tile can have 300 science targets."""
    paths = [files / "stars.fits", "--tiles", files / "tiles.ecsv", "--instrument", "sdss_apo"]

    def code(*words):
        return run(*map(str, words), "--strict")[0]

    need, many = ["--constraint", "science=5"], ["--constraint", "science=300"]
    folder, out = tmp_path / "plan", tmp_path / "out"
    assert code("survey", *paths, "--folder", folder, *need) == 0
    assert code("survey", *paths, *many) == 1
    assert run("survey", *map(str, [*paths, *many]))[0] == 0
    assert code("export", folder, "--output", out) == 0
    assert code("score", out / "tile-11.fits", *need) == 0
    assert code("score", out / "tile-11.fits", *many) == 1
    assert code("score", tmp_path / "missing.fits", *many) == 2
    one = [files / "stars.fits", "--instrument", "sdss_apo", "--center", "95 23"]
    assert code("plan", *one, *need) == 0
    assert code("plan", *one, *many) == 1
    call("survey {} --tiles {} --instrument sdss_apo --folder {}", paths[0], paths[2], tmp_path / "many", *many)
    assert code("export", tmp_path / "many", "--output", tmp_path / "more") == 1
    assert len(content(tmp_path / "more")) == 4  # the files are written


def test_tiles_without_a_plan_are_left_out_and_named(call, refused, record, folder, tmp_path):
    """A tile that was dropped has no plan; one that was observed keeps the plan of the first night."""
    record(folder, tile=[11, 12], state=["done", "dropped"], date=["2026-01-03", ""])
    call("survey {} --replan", folder)
    ended = call("export {} --output {}", folder, tmp_path / "out")
    assert "warning: 1 tile left out: 12 (tile 12 was dropped, and has no plan)" in ended.err
    assert ended.out.splitlines()[-1].endswith("; 1 tile left out")
    assert {"tile-11.fits", "tile-13.fits", "tile-14.fits"} < {*content(tmp_path / "out")}
    assert rs.Tile.read(tmp_path / "out/tile-13.fits").provenance["parameters"]["survey"]["generation"] == "2"
    assert rs.Tile.read(tmp_path / "out/tile-11.fits").provenance["parameters"]["survey"]["generation"] == "1"
    assert "tile 12 was dropped, and has no plan" in refused("export {} --tiles 12 --output {}", folder, tmp_path)


def test_an_export_without_files_fails(call, refused, record, folder, tmp_path):
    """Regression: the exit code was 0, and an empty folder was made."""
    record(folder, tile=[11, 12, 13, 14], state=["dropped"] * 4)
    call("survey {} --replan", folder)
    message = "rfpsurvey: at least one tile must have a plan to export, got 4 tiles left out: 11, 12, 13, 14"
    assert refused("export {} --output {}", folder, tmp_path / "out").startswith(message)
    assert not (tmp_path / "out").exists()


def test_plans_of_another_state_of_the_instrument_are_left_out(call, refused, record, folder, tmp_path):
    """Before the second plan, the positioners of all targets of tile 11 that did not collide broke."""
    record(folder, tile=[11], state=["done"], date=["2026-01-03"])
    used = rs.Survey.read(folder).tile(11)
    broken = [*np.asarray(used["positioner"][~used["in_collision"]]), "R-1C13", "R-1C14"]
    Table({"id": broken}).write(tmp_path / "broken.csv", overwrite=True)
    call("survey {} --replan", folder)
    ended = call("export {} --output {}", folder, tmp_path / "out")
    assert "1 tile left out: 11 (the poses of tile 11 must be those of its plan" in ended.err
    said = refused("export {} --tiles 11,13 --output {}", folder, tmp_path / "other")
    assert "the plan was made with another state of the instrument" in said
    assert not (tmp_path / "other").exists()


def test_no_target_of_an_observed_tile_is_lost_silently(call, refused, record, tmp_path):
    """Regression: targets of positioners that broke later were not written, if no arm had collided."""
    (tmp_path / "broken.csv").write_text("id\n0\n")
    living.targets(n=30).write(tmp_path / "stars.fits")
    living.tiling(n=2).write(tmp_path / "tiles.ecsv")
    paths, folder = (tmp_path / "stars.fits", tmp_path / "tiles.ecsv", "moons"), tmp_path / "plan"
    call(f"{PLAN} --set instrument.broken={{}} --folder {{}}", *paths, tmp_path / "broken.csv", folder)
    record(folder, tile=[11], state=["done"], date=["2026-01-03"])
    used = rs.Survey.read(folder).tile(11)["positioner"][:2]
    Table({"id": [0, *used]}).write(tmp_path / "broken.csv", overwrite=True)
    call("survey {} --replan", folder)
    said = refused("export {} --tiles 11 --output {}", folder, tmp_path / "out")
    assert "must be those of its plan, got other targets or collisions of 2 positioners" in said


def test_names_of_tiles_are_not_ranges(call, tmp_path):
    """Tiles with text as identifiers can contain a hyphen, and other characters that names of files cannot contain."""
    table = living.tiling(n=3).table.copy()
    table["tile"] = ["1-2", "b/c", "3"]
    rs.plan_survey(living.targets(), "moons", rs.Tiling(table), folder=tmp_path / "plan")
    call("export {} --tiles 1-2 --output {}", tmp_path / "plan", tmp_path / "one")
    assert content(tmp_path / "one") == ["tile-1-2.fits"]
    call("export {} --tiles 3,b/c --output {}", tmp_path / "plan", tmp_path / "two")
    assert content(tmp_path / "two") == ["tile-3.fits", "tile-b_c.fits"]


def test_arms_with_both_elbows_are_not_exported_in_wrong_poses(tmp_path):
    """The folder of a survey does not contain the elbows, so that only plans with the usual elbows are exported."""
    unit = rs.Positioner(8.25 * u.mm, 8.25 * u.mm, 2.25 * u.mm, handedness="both")
    plane = rs.FocalPlane.hexagonal(unit, rings=4, pitch=16 * u.mm)
    model = rs.Instrument("tiny", plane, plate_scale=200 * u.mm / u.deg)
    sky = living.targets(n=3000, radius=0.5)
    tiles = QTable({"tile": [1], "ra": [120] * u.deg, "dec": [30] * u.deg})
    survey = rs.plan_survey(sky, model, tiles, allocator="optimal", folder=tmp_path / "plan")
    with pytest.raises(rs.InputError, match=r"\(handedness both\), which the folder does not contain"):
        survey.export([1], output=tmp_path / "out", instrument=model)


def test_alternates_are_exported_and_recorded_as_swaps(call, refused, folder, tmp_path):
    out = tmp_path / "out"
    ended = call("export {} --tiles 12 --alternates 2 --output {}", folder, out)
    assert "alternates: alternates-12.ecsv" in ended.text
    assert content(out)[:1] == ["alternates-12.ecsv"]
    row = QTable.read(out / "alternates-12.ecsv")["tile", "positioner", "target_id"][0]
    Table({name: [row[name]] for name in row.colnames}).write(tmp_path / "swaps.csv")
    assert "must be a positioner of tile 12 with a visit" in refused("record {} {}", folder, tmp_path / "swaps.csv")
    lines = call("record {} {} --swaps", folder, tmp_path / "swaps.csv").lines
    assert lines["swapped targets"] == ["1", f"12/{row['positioner']}"]
    assert "must be given without options of tables" in refused("record {} --undo 1 --swaps", folder)
    assert "--alternates must be a whole number" in refused("export {} --alternates 0 --output {}", folder, out)
