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
from rfpsurvey._cli import _process, _surveys
from rfpsurvey.inputs import WorkerKeys

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
def call(run):
    """Return a function that runs a command and returns its standard output and standard error."""

    def call(*words, code=0):
        found, out, err = run(*words)
        assert found == code, err
        return out, err

    return call


def test_what_is_printed_is_what_the_library_says(call, files, tmp_path):
    folder, sky, tiling = files
    picture = tmp_path / "plan.png"
    words = ("survey", folder / "stars.fits", "--tiles", folder / "tiles.ecsv", "--instrument", "moons", "--workers", 2)
    out, err = call(
        *words, "--folder", tmp_path / "plan", "--plot", picture, "--set", f"output.quality={tmp_path / 'quality.svg'}"
    )
    expected = rs.plan_survey(sky, "moons", tiling).summary
    lines = {line[:34].strip(): line[34:].split() for line in out.splitlines()}
    assert lines["visits requested"] == [str(sky.visits.sum())]
    assert lines["observed"] == [str(expected["n_visits_observed"])]
    assert lines["targets in no field"] == [str(expected["outcomes"]["in no field"])]
    assert f"model: {expected['model']}" in " ".join(out.split())
    assert "3 of 3 tiles" in err
    assert "not met" not in out  # no target was required
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert f"wrote {tmp_path / 'quality.svg'}" in out
    assert "fraction of the requested visits" in (tmp_path / "quality.svg").read_text()
    assert rs.Survey.read(tmp_path / "plan").summary["n_assigned"] == expected["n_assigned"]
    assert "holds a survey; continue it" in call(*words, "--folder", tmp_path / "plan", code=2)[1]
    call(*words, "--folder", tmp_path / "plan", "--resume")
    out, _ = call(*words, "--passes", 1, "--visits", 1, "--set", "lost_in_collision=false", "--allocator", "repair")
    assert "tiles                                        1" in out


@pytest.mark.few(4)
@pytest.mark.parametrize(
    ("words", "name", "value"),
    [
        (["--set", "lost_in_collision=false"], "lost_in_collision", False),
        ([], "lost_in_collision", True),
        (["--set", "options.parked_obstacles=false"], "allocator", rs.AllocationOptions(parked_obstacles=False)),
        (["--set", "options.subpriority=3"], "allocator", rs.AllocationOptions(subpriority=3)),
        (["--set", "options.subpriority=SUB"], "allocator", rs.AllocationOptions(subpriority="SUB")),
        (["--set", "order=given"], "order", "given"),
        (["--visits", 3], "visits", 3),
        (["--passes", 2, "--passes", 1], "passes", [2, 1]),
        (["--epoch", "2026.5"], "epoch", 2026.5),
        (["--rng", 4], "rng", 4),
        (["--allocator", "network_flow"], "allocator", rs.AllocationOptions("network_flow")),
        (["--constraint", "sky=5"], "allocator", rs.AllocationOptions(requirements=["sky=5"])),
        (["--set", "options.sky_separation=10"], "allocator", rs.AllocationOptions(sky_separation=10 * u.arcsec)),
        (["--set", "options.time_limit=5"], "allocator", rs.AllocationOptions(time_limit=5 * u.s)),
        (
            ["--constraint", "required 7", "--constraint", "required a"],
            "allocator",
            rs.AllocationOptions(required=["7", "a"]),
        ),
        (["--resume"], "resume", True),
        ([], "executor", None),
    ],
)
def test_every_option_reaches_the_library(call, files, monkeypatch, words, name, value):
    folder, _, _ = files
    seen = {}

    def plan_survey(*_, **options):
        seen.update(options)
        raise rs.InputError("enough")

    monkeypatch.setattr(rs, "plan_survey", plan_survey)
    call("survey", folder / "stars.fits", "--tiles", folder / "tiles.ecsv", "--instrument", "moons", *words, code=2)
    assert seen[name] == value


def test_required_targets_and_circles_are_those_of_the_library(call, files, tmp_path):
    folder, sky, tiling = files
    wanted, outside = np.flatnonzero(sky.visits > 0)[:2], int(np.argmax(sky.coord.separation(CENTER)))
    required, circles = [*wanted.tolist(), outside], ["95.0 23.0 0.02", "94.8 23.05 0.01"]
    words = ("survey", folder / "stars.fits", "--tiles", folder / "tiles.ecsv", "--instrument", "moons")
    words += ("--allocator", "lamost_rule")
    words += tuple(word for k in required for word in ("--constraint", f"required {k}"))
    words += tuple(word for circle in circles for word in ("--constraint", f"keep_out {circle}"))
    out, err = call(*words, "--folder", tmp_path / "plan")
    regions = [rs.Region.parse(text) for text in ("cap 95 23 0.02", "cap 94.8 23.05 0.01")]
    options = rs.AllocationOptions("lamost_rule", required=required, keep_out=regions)
    with pytest.warns(rs.RfpsurveyWarning, match="required targets never observed"):
        expected = rs.plan_survey(sky, "moons", tiling, allocator=options)
    found = rs.Survey.read(tmp_path / "plan")
    assert found.summary == expected.summary
    assert found.summary["n_obstacle_collisions"] > 0
    assert found.targets["target_id"].tolist() == expected.targets["target_id"].tolist()
    assert found.provenance["parameters"]["keep_out"] == expected.provenance["parameters"]["keep_out"]
    assert all(f"warning: {sentence}" in err for sentence in expected.summary["unmet"])
    n_observed = expected.summary["n_required_observed"]
    assert f"required targets observed               {n_observed} of 3" in out
    call(*words, "--folder", tmp_path / "plan", "--resume")  # the output has the same labels
    assert "holds another survey: keep_out" in call(*words[:-2], "--folder", tmp_path / "plan", "--resume", code=2)[1]


def test_plan_and_survey_print_the_same_pair_for_required_targets(call, files, tmp_path):
    """A required target that is assigned to a colliding arm is not observed."""
    folder, sky, _ = files
    tile = rs.plan_tile(sky, "moons", CENTER, allocator="lamost_rule")
    names = tile.outcomes["target_id"][np.isin(tile.outcomes["outcome"], ["lost to a collision", "out of reach"])]
    QTable({"ra": [95.0] * u.deg, "dec": [23.0] * u.deg}).write(tmp_path / "one.ecsv")
    required = [int(name) for name in (*names[:4], *np.flatnonzero(sky.visits > 0)[:2])]
    words = [folder / "stars.fits", "--instrument", "moons"]
    words += [word for name in required for word in ("--constraint", f"required {name}")]
    lines = []
    for command in (
        ("plan", *words, "--center", "95 23"),
        ("survey", *words, "--tiles", tmp_path / "one.ecsv", "--visits", 1),
    ):
        out, _ = call(*command)
        lines += [line.split() for line in out.splitlines() if line.startswith("required targets observed")]
    tile = rs.plan_tile(sky, "moons", CENTER, allocator=rs.AllocationOptions(required=required))
    outcome = tile.outcomes["outcome"][np.isin(tile.outcomes["target_id"], required)]
    n = int((outcome == "observed").sum())
    assert 0 < n == tile.summary["n_required_observed"] < tile.summary["n_required"] == len(required)
    assert lines == 2 * [["required", "targets", "observed", str(n), "of", str(len(required))]]


@pytest.mark.exhaustive
def test_instruments_are_compared_with_required_targets_and_circles(call, files, tmp_path):
    folder, sky, _ = files
    words = ["compare", "moons", "sdss_apo", "--catalog", folder / "stars.fits", "--center", "95 23"]
    words += [
        "--allocator",
        "lamost_rule",
        "--constraint",
        "required 9",
        "--constraint",
        "keep_out 95 23.05 0.02",
        "--output",
        tmp_path / "c.ecsv",
    ]
    call(*words)
    options = rs.AllocationOptions(required=9, keep_out=rs.Region.parse("cap 95 23.05 0.02"))
    expected = rs.compare_instruments(
        sky, ["moons", "sdss_apo"], center=CENTER, allocators=["lamost_rule"], options=options, progress=False
    )
    found, plain = (
        QTable.read(tmp_path / "c.ecsv"),
        rs.compare_instruments(sky, ["moons", "sdss_apo"], center=CENTER, allocators=["lamost_rule"]),
    )
    assert found["probability"].tolist() == expected["probability"].tolist() != plain["probability"].tolist()
    assert found.meta["parameters"]["required"] == ["9"]
    _, err = call("compare", "moons", "--constraint", "required 9", code=2)
    assert "required targets can be used only with a catalog" in err


@pytest.mark.parametrize("command", ["plan", "compare-allocators"])
def test_one_tile_has_the_same_words(call, files, tmp_path, command):
    folder, sky, _ = files
    words = [
        "--instrument",
        "moons",
        "--center",
        "95 23",
        "--constraint",
        "required 9",
        "--constraint",
        "keep_out 95 23.05 0.02",
    ]
    words += ["--allocator", "lamost_rule", "--output", tmp_path / "out.ecsv"]
    call(command, folder / "stars.fits", *words)
    options = rs.AllocationOptions("lamost_rule", required=9, keep_out=rs.Region.parse("cap 95 23.05 0.02"))
    tile = rs.plan_tile(sky, "moons", CENTER, allocator=options)
    assert tile.summary["n_obstacle_collisions"] > 0
    if command == "plan":
        found = rs.Tile.read(tmp_path / "out.ecsv")
        assert found.table["target_id"].tolist() == tile.table["target_id"].tolist()
        assert found.provenance["parameters"]["required"] == ["9"]
        assert found.provenance["parameters"]["keep_out"] == ["cap 95.0 23.05 0.02"]
    else:
        found = QTable.read(tmp_path / "out.ecsv")
        assert found["at_obstacles"].tolist() == [tile.summary["n_obstacle_collisions"]]


def test_a_folder_of_partitions(call, files, tmp_path):
    folder, sky, _ = files
    rs.catalog.partition_catalog(sky, tmp_path / "parts")
    out, _ = call("survey", tmp_path / "parts", "--tiles", folder / "tiles.ecsv", "--instrument", "moons")
    assert f"{sky.visits.sum():>12}" in out
    assert "--tiles must be given" in call("survey", tmp_path / "parts", code=2)[1]


@pytest.mark.few(3)
@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["--allocator", "best"], "unknown allocator 'best'"),
        (["--set", "order=random"], "unknown order 'random'"),
        (["--passes", "7"], "--passes must be distinct passes of the tiling (0, 1)"),
        (["--resume"], "the folder of the survey to resume must be given with --folder"),
        (["--folder", "nowhere/plan"], "the folder nowhere does not exist"),
        (["--plot", "plan.txt"], "must end in"),
        (["--set", "scheduler=nobody"], "no Dask scheduler answers"),
        (["--constraint", "stars=5"], ""),
        (["--constraint", "required nobody"], "required must hold ids of the catalog, got nobody (1 of 1 unknown)"),
        (
            ["--constraint", "keep_out 95 23"],
            "keep_out must have the form 'keep_out RA DEC RADIUS' (deg), got '95 23'",
        ),
        (
            ["--constraint", "keep_out 95 93 1"],
            "got '95 93 1'",
        ),
        (["--constraint", "keep_out box 1 2 3 4"], "keep_out must have the form"),
    ],
)
def test_wrong_words(call, files, words, sentence):
    folder, _, _ = files
    known = ("survey", folder / "stars.fits", "--tiles", folder / "tiles.ecsv", "--instrument", "moons")
    assert sentence in call(*known, *words, code=0 if not sentence else 2)[1]


@pytest.mark.few(1)
@pytest.mark.parametrize(
    "words",
    [
        ("survey", "{stars}", "--tiles"),
        ("select", "{stars}", "--n-realizations", 1, "--output", "{out}.fits", "--tiles"),
        ("tile", "{stars}", "--method", "given", "--output", "{out}.ecsv", "--centers"),
    ],
)
def test_columns_and_units_of_tiles_can_be_given(call, files, tmp_path, words, monkeypatch):
    """The options for columns and units did not apply to tables of tiles, although an error recommended them."""
    path = tmp_path / "tiles.ecsv"
    QTable({"who": [7, 8], "alpha": [94.8 / 15, 95.2 / 15], "delta": [23, 23] * u.deg, "mag": [1, 2]}).write(path)
    names = {"stars": files[0] / "stars.fits", "out": tmp_path / "out"}
    words = (*(str(word).format(**names) for word in words), path, "--instrument", "moons")
    names = {"tile": "who", "ra": "alpha", "dec": "delta"}
    columns = [word for role, name in names.items() for word in ("--set", f"tiles.columns.{role}={name}")]
    assert "--set tiles.columns.ra=..." in call(*words, code=2)[1]
    assert "or --set tiles.units.ra=deg" in call(*words, *columns, code=2)[1]
    assert "--set must have the form KEY=VALUE" in call(*words, "--set", "tiles.units.h", code=2)[1]
    out, err = call(*words, *columns, "--set", "tiles.units.ra=hourangle")
    assert "columns of tiles: tile: who, ra: alpha, dec: delta\n" in out
    assert "2" in next(line for line in out.splitlines() if line.startswith("tiles ")).split()
    assert "no target was observed" not in err  # the centers are where the targets are
    work = {"tile": "place_tiles", "survey": "inputs.model_of"}.get(words[0], "_cli._app.model_of")
    monkeypatch.setattr(f"rfpsurvey.{work}", lambda *_, **__: (_ for _ in ()).throw(rs.InputError("enough")))
    err = call(words[0], "--set", "tiles.units.ra=deg", code=2)[1]
    assert "warning: tiles.units has no effect without a table of tiles" in err


def test_the_provenance_of_a_survey_states_the_columns_of_the_tiles(call, files, tmp_path):
    """It was not recorded which tiles of a list were omitted, and which columns were used."""
    path = tmp_path / "tiles.ecsv"
    table = Table({"TILEID": [1, 2], "RA": [95.0, 95.0], "DEC": [23.0, 23.1], "IN_DESI": [True, False]})
    table.write(path)
    out, err = call("survey", files[0] / "stars.fits", "--tiles", path, "--folder", tmp_path / "plan")
    omitted = "1 of 2 tiles (IN_DESI = 0)"
    assert f"columns of tiles: tile: TILEID, ra: RA, dec: DEC; omitted: {omitted}\n" in out
    assert err.count(f"warning: {omitted} are omitted") == 1
    survey = rs.Survey.read(tmp_path / "plan")
    assert survey.provenance["tiling"] == {"columns": {"tile": "TILEID", "ra": "RA", "dec": "DEC"}, "omitted": omitted}
    assert survey.tiles["tile"].tolist() == [1]


def test_bad_tiles(call, files, tmp_path):
    folder, _, _ = files
    for table, sentence in (
        (QTable({"ra": [] * u.deg, "dec": [] * u.deg}), "at least one tile"),
        (QTable({"ra": [1, 1] * u.deg, "dec": [2, 2] * u.deg}), "tiles 0 and 1 are the same"),
        (QTable({"x": [1]}), "no column for ra and dec"),
    ):
        table.write(tmp_path / "tiles.ecsv", overwrite=True)
        _, err = call("survey", folder / "stars.fits", "--tiles", tmp_path / "tiles.ecsv", code=2)
        assert sentence in err


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        ((), "no tiles were stored, because --folder was not given"),
        (("--folder", "plan"), "the finished tiles are stored in the folder; continue with --resume"),
    ],
)
def test_an_interrupted_survey_says_what_stays(run, files, tmp_path, monkeypatch, words, sentence):
    def interrupted(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(rs, "plan_survey", interrupted)
    monkeypatch.setattr(_process, "_kept", [])
    monkeypatch.chdir(tmp_path)
    folder, _, _ = files
    known = ("survey", folder / "stars.fits", "--tiles", folder / "tiles.ecsv", "--instrument", "moons")
    assert run(*known, *words)[0] == 130
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
        with _surveys.workers(WORKERS) as executor:
            assert executor is pool
    monkeypatch.setitem(sys.modules, "distributed", None)
    with (
        pytest.raises(rs.InputError, match=r"scheduler needs dask \(pip install 'rfpsurvey\[distributed\]'\)"),
        _surveys.workers(WORKERS),
    ):
        pass


def test_the_epoch_and_a_new_folder_are_stated(run, files, tmp_path):
    """Regression: the sentence on proper motions was not printed, and a wrong name of a folder was not noticed."""
    words = ("survey", "example:anticenter", "--instrument", "sdss_apo", "--allocator", "nearest", "--resume")
    code, out, err = run(*words, "--folder", tmp_path / "new")
    assert code == 0, err
    assert "epoch: the targets are at the epoch of the catalog (J2000.000)" in out
    assert f"{tmp_path / 'new'} does not contain a survey; a new survey is planned" in " ".join(err.split())
    again = run(*words, "--folder", tmp_path / "new", "--epoch", "J2026")
    assert again[0] == 2
    assert "a new survey is planned" not in again[2]
