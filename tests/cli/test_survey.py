"""The command ``survey``, called with its options."""

import sys
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext
from types import SimpleNamespace

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.table import QTable, Table

import rfpsurvey as rs
from rfpsurvey._cli import process as _process
from rfpsurvey._cli import results as _results
from rfpsurvey._survey.key_groups import WorkerKeys

CENTER = SkyCoord(95 * u.deg, 23 * u.deg)


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("survey")
    sky = rs.synthetic_catalog("poisson", CENTER, 0.8 * u.deg, density=2000 / u.deg**2, rng=3)
    sky = rs.Catalog(sky.coord, visits=np.arange(len(sky)) % 3)
    sky.write(folder / "stars.fits")
    tiles = QTable({"RACEN": [94.8, 95.2, 95.0] * u.deg, "DECCEN": [23, 23, 23.2] * u.deg, "PASS": [0, 0, 1]})
    tiles.write(folder / "tiles.ecsv")
    return folder, sky, rs.Tiling.from_table(tiles)


@pytest.fixture
def words(files):
    """Return the words of a command that plans the survey with MOONS."""
    return ("survey {} --tiles {} --instrument moons", files[0] / "stars.fits", files[0] / "tiles.ecsv")


def test_what_is_printed_is_what_the_library_says(call, refused, words, files, tmp_path):
    _, sky, tiling = files
    folder, plot, quality = (tmp_path / name for name in ("plan", "plan.png", "quality.svg"))
    found = call(
        f"{words[0]} --workers 2 --folder {{}} --plot {{}} --set output.quality={{}}", *words[1:], folder, plot, quality
    )
    expected = rs.plan_survey(sky, "moons", tiling).summary
    assert found.lines["visits requested"] == [str(sky.visits.sum())]
    assert found.lines["observed"] == [str(expected["n_visits_observed"])]
    assert found.lines["targets in no field"] == [str(expected["outcomes"]["in no field"])]
    assert f"model: {expected['model']}" in found.text
    assert "3 of 3 tiles" in found.err
    assert "not met" not in found.out  # no target was required
    assert plot.read_bytes().startswith(b"\x89PNG")
    assert f"wrote {quality}" in found.out
    assert "fraction of the requested visits" in quality.read_text()
    assert rs.Survey.read(folder).summary["n_assigned"] == expected["n_assigned"]
    assert "holds a survey; continue it" in refused(f"{words[0]} --folder", *words[1:], folder)
    call(f"{words[0]} --resume --folder", *words[1:], folder)
    found = call(f"{words[0]} --passes 1 --visits 1 --set lost_in_collision=false --allocator repair", *words[1:])
    assert "tiles                                        1" in found.out


@pytest.mark.few(4)
@pytest.mark.parametrize(
    ("options", "name", "value"),
    [
        ("", "lost_in_collision", True),
        ("", "executor", None),
        ("--set lost_in_collision=false", "lost_in_collision", False),
        ("--set order=given", "order", "given"),
        ("--visits 3", "visits", 3),
        ("--passes 2 --passes 1", "passes", [2, 1]),
        ("--epoch 2026.5", "epoch", 2026.5),
        ("--rng 4", "rng", 4),
        ("--resume", "resume", True),
        ("--allocator network_flow", "allocator", {"allocator": "network_flow"}),
        ("--set options.parked_obstacles=false", "allocator", {"parked_obstacles": False}),
        ("--set options.subpriority=SUB", "allocator", {"subpriority": "SUB"}),
        ("--set options.sky_separation=10", "allocator", {"sky_separation": 10 * u.arcsec}),
        ("--set options.time_limit=5", "allocator", {"time_limit": 5 * u.s}),
        ("--constraint sky=5", "allocator", {"requirements": ["sky=5"]}),
        ("--constraint 'required 7' --constraint 'required a'", "allocator", {"required": ["7", "a"]}),
    ],
)
def test_every_option_reaches_the_library(refused, words, seen, options, name, value):
    refused(f"{words[0]} {options}", *words[1:])
    assert seen[name] == (rs.AllocationOptions(**value) if name == "allocator" else value)


def test_required_targets_and_circles_are_those_of_the_library(call, refused, words, files, tmp_path):
    _, sky, tiling = files
    wanted, outside = np.flatnonzero(sky.visits > 0)[:2], int(np.argmax(sky.coord.separation(CENTER)))
    required, circles = [*wanted.tolist(), outside], ["95.0 23.0 0.02", "94.8 23.05 0.01"]
    asked = [*(f"required {k}" for k in required), *(f"keep_out {circle}" for circle in circles)]
    asked = [f"--constraint={text}" for text in asked]
    words, files = f"{words[0]} --allocator lamost_rule --folder {{}}", (*words[1:], tmp_path / "plan")
    found = call(words, *files, *asked)
    regions = [rs.Region.parse(text) for text in ("cap 95 23 0.02", "cap 94.8 23.05 0.01")]
    options = rs.AllocationOptions("lamost_rule", required=required, keep_out=regions)
    with pytest.warns(rs.RfpsurveyWarning, match="required targets never observed"):
        expected = rs.plan_survey(sky, "moons", tiling, allocator=options)
    survey = rs.Survey.read(tmp_path / "plan")
    assert survey.summary == expected.summary
    assert survey.summary["n_obstacle_collisions"] > 0
    assert survey.targets["target_id"].tolist() == expected.targets["target_id"].tolist()
    assert survey.provenance["parameters"]["keep_out"] == expected.provenance["parameters"]["keep_out"]
    assert all(f"warning: {sentence}" in found.err for sentence in expected.summary["unmet"])
    assert f"required targets observed               {expected.summary['n_required_observed']} of 3" in found.out
    call(f"{words} --resume", *files, *asked)  # the output has the same labels
    assert "holds another survey: keep_out" in refused(f"{words} --resume", *files, *asked[:-1])


def test_plan_and_survey_print_the_same_pair_for_required_targets(call, files, tmp_path):
    """A required target that is assigned to a colliding arm is not observed."""
    folder, sky, _ = files
    tile = rs.plan_tile(sky, "moons", CENTER, allocator="lamost_rule")
    names = tile.outcomes["target_id"][np.isin(tile.outcomes["outcome"], ["lost to a collision", "out of reach"])]
    QTable({"ra": [95.0] * u.deg, "dec": [23.0] * u.deg}).write(tmp_path / "one.ecsv")
    required = [int(name) for name in (*names[:4], *np.flatnonzero(sky.visits > 0)[:2])]
    files = (folder / "stars.fits", *(f"--constraint=required {name}" for name in required))
    plan = call("plan --instrument moons --center '95 23'", *files).lines
    survey = call("survey --instrument moons --visits 1 --tiles", tmp_path / "one.ecsv", *files).lines
    tile = rs.plan_tile(sky, "moons", CENTER, allocator=rs.AllocationOptions(required=required))
    n = int((tile.outcomes["outcome"][np.isin(tile.outcomes["target_id"], required)] == "observed").sum())
    assert 0 < n == tile.summary["n_required_observed"] < tile.summary["n_required"] == len(required)
    name = "required targets observed"
    assert plan[name] == survey[name] == [str(n), "of", str(len(required))]


ASKED = "--allocator lamost_rule --constraint 'required 9' --constraint 'keep_out 95 23.05 0.02' --center '95 23'"


@pytest.mark.exhaustive
def test_instruments_are_compared_with_required_targets_and_circles(call, refused, files, tmp_path):
    folder, sky, _ = files
    call(f"compare moons {ASKED} --catalog {{}} --output {{}}", folder / "stars.fits", tmp_path / "c.ecsv")
    found = QTable.read(tmp_path / "c.ecsv")
    options = rs.AllocationOptions(required=9, keep_out=rs.Region.parse("cap 95 23.05 0.02"))
    expected, plain = (
        rs.compare_instruments(sky, ["moons"], center=CENTER, allocators=["lamost_rule"], options=one)["probability"]
        for one in (options, None)
    )
    assert found["probability"].tolist() == expected.tolist() != plain.tolist()
    assert found.meta["parameters"]["required"] == ["9"]
    message = "required targets can be used only with a catalog"
    assert message in refused("compare moons --constraint 'required 9'")


def test_one_tile_has_the_same_words(call, files, tmp_path):
    folder, sky, _ = files
    options = rs.AllocationOptions("lamost_rule", required=9, keep_out=rs.Region.parse("cap 95 23.05 0.02"))
    tile = rs.plan_tile(sky, "moons", CENTER, allocator=options)
    assert tile.summary["n_obstacle_collisions"] > 0
    output = tmp_path / "out.ecsv"
    call(f"plan {{}} --instrument moons {ASKED} --output {{}}", folder / "stars.fits", output)
    found = rs.Tile.read(output)
    assert found.table["target_id"].tolist() == tile.table["target_id"].tolist()
    assert found.provenance["parameters"]["required"] == ["9"]
    assert found.provenance["parameters"]["keep_out"] == ["cap 95.0 23.05 0.02"]
    words = f"compare-allocators {{}} --instrument moons {ASKED} --overwrite --output {{}}"
    call(words, folder / "stars.fits", output)
    assert QTable.read(output)["at_obstacles"].tolist() == [tile.summary["n_obstacle_collisions"]]


def test_a_folder_of_partitions(call, refused, files, tmp_path):
    folder, sky, _ = files
    rs.catalog.partition_catalog(sky, tmp_path / "parts")
    out = call("survey {} --instrument moons --tiles {}", tmp_path / "parts", folder / "tiles.ecsv").out
    assert f"{sky.visits.sum():>12}" in out
    assert "--tiles must be given" in refused("survey", tmp_path / "parts")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ("--set order=random", "unknown order 'random'"),
        ("--passes 7", "--passes must be distinct passes of the tiling (0, 1)"),
        ("--resume", "the folder of the survey to resume must be given with --folder"),
        ("--folder nowhere/plan", "the folder nowhere does not exist"),
        ("--plot plan.txt", "must end in"),
        ("--set scheduler=nobody", "no Dask scheduler answers"),
        ("--constraint 'required nobody'", "required must hold ids of the catalog, got nobody (1 of 1 unknown)"),
        ("--constraint 'keep_out 95 93 1'", "got '95 93 1'"),
    ],
)
def test_wrong_words(refused, words, options, message):
    assert message in refused(f"{words[0]} {options}", *words[1:])


def test_requirements_on_a_category_that_no_target_has_are_no_error(call, words):
    call(f"{words[0]} --constraint stars=5", *words[1:])


@pytest.mark.few(1)
@pytest.mark.parametrize(
    "words",
    [
        "survey {} --instrument moons --tiles {}",
        "select {} --n-realizations 1 --instrument moons --tiles {} --output {}.fits",
        "tile {} --method given --instrument moons --centers {} --output {}.ecsv",
    ],
)
def test_columns_and_units_of_tiles_can_be_given(call, refused, run, files, tmp_path, words, monkeypatch):
    """The options for columns and units did not apply to tables of tiles, although an error recommended them."""
    path = tmp_path / "tiles.ecsv"
    QTable({"who": [7, 8], "alpha": [94.8 / 15, 95.2 / 15], "delta": [23, 23] * u.deg, "mag": [1, 2]}).write(path)
    values, command = (files[0] / "stars.fits", path, tmp_path / "out")[: words.count("{}")], words.split()[0]
    named = words + "".join(f" --set tiles.columns.{one}" for one in ("tile=who", "ra=alpha", "dec=delta"))
    assert "--set tiles.columns.ra=..." in refused(words, *values)
    assert "or --set tiles.units.ra=deg" in refused(named, *values)
    assert "--set must have the form KEY=VALUE" in refused(f"{words} --set tiles.units.h", *values)
    found = call(f"{named} --set tiles.units.ra=hourangle", *values)
    assert "columns of tiles: tile: who, ra: alpha, dec: delta\n" in found.out
    assert "2" in found.lines["tiles"]
    assert "no target was observed" not in found.err  # the centers are where the targets are
    work = {"tile": "place_tiles", "survey": "_survey.key_objects.model_of"}.get(command, "_cli.command.model_of")
    monkeypatch.setattr(f"rfpsurvey.{work}", lambda *_, **__: (_ for _ in ()).throw(rs.InputError("enough")))
    err = run(command, "--set", "tiles.units.ra=deg")[2]
    assert "warning: tiles.units has no effect without a table of tiles" in err


def test_the_provenance_of_a_survey_states_the_columns_of_the_tiles(call, files, tmp_path):
    """It was not recorded which tiles of a list were omitted, and which columns were used."""
    path, folder, omitted = tmp_path / "tiles.ecsv", tmp_path / "plan", "1 of 2 tiles (IN_DESI = 0)"
    Table({"TILEID": [1, 2], "RA": [95.0, 95.0], "DEC": [23.0, 23.1], "IN_DESI": [True, False]}).write(path)
    out, err = call("survey {} --tiles {} --folder {}", files[0] / "stars.fits", path, folder)
    assert f"columns of tiles: tile: TILEID, ra: RA, dec: DEC; omitted: {omitted}\n" in out
    assert err.count(f"warning: {omitted} are omitted") == 1
    survey = rs.Survey.read(folder)
    assert survey.provenance["tiling"] == {"columns": {"tile": "TILEID", "ra": "RA", "dec": "DEC"}, "omitted": omitted}
    assert survey.tiles["tile"].tolist() == [1]


def test_bad_tiles(refused, files, tmp_path):
    """The tests of tilings test most messages."""
    QTable({"ra": [1, 1] * u.deg, "dec": [2, 2] * u.deg}).write(tmp_path / "tiles.ecsv")
    message = refused("survey {} --tiles {}", files[0] / "stars.fits", tmp_path / "tiles.ecsv")
    assert "tiles 0 and 1 are the same" in message


@pytest.mark.parametrize(
    ("folder", "sentence"),
    [
        ("", "no tiles were stored, because --folder was not given"),
        ("--folder plan", "the finished tiles are stored in the folder; continue with --resume"),
    ],
)
def test_an_interrupted_survey_says_what_stays(run, words, tmp_path, monkeypatch, folder, sentence):
    def interrupted(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(rs, "plan_survey", interrupted)
    monkeypatch.setattr(_process, "_kept", [])
    monkeypatch.chdir(tmp_path)
    assert run("survey", words[1], "--tiles", words[2], "--instrument", "moons", *folder.split())[0] == 130
    assert _process._kept == [sentence]  # test_interrupts.py tests the message


WORKERS = WorkerKeys(scheduler="tcp://here:1")


def test_the_tiles_of_a_survey_are_planned_by_the_workers_of_a_scheduler(monkeypatch):
    with ThreadPoolExecutor(1) as pool:

        class Client(nullcontext):
            def __init__(self, address, timeout):
                assert (address, timeout) == ("tcp://here:1", "10s")

            def __enter__(self):
                return self

            def get_executor(self):
                return pool

        monkeypatch.setitem(sys.modules, "distributed", SimpleNamespace(Client=Client))
        with _results.workers(WORKERS) as executor:
            assert executor is pool
    monkeypatch.setitem(sys.modules, "distributed", None)
    with (
        pytest.raises(rs.InputError, match=r"scheduler needs dask \(pip install 'rfpsurvey\[distributed\]'\)"),
        _results.workers(WORKERS),
    ):
        pass


def test_the_epoch_and_a_new_folder_are_stated(call, run, tmp_path):
    """Regression: the sentence on proper motions was not printed, and a wrong name of a folder was not noticed."""
    words = "survey example:anticenter --instrument sdss_apo --allocator nearest --resume --folder"
    out, err = call(words, tmp_path / "new")
    assert "epoch: the targets are at the epoch of the catalog (J2000.000)" in out
    assert f"{tmp_path / 'new'} does not contain a survey; a new survey is planned" in " ".join(err.split())
    again = run(*words.split(), tmp_path / "new", "--epoch", "J2026")
    assert again[0] == 2
    assert "a new survey is planned" not in again[2]
