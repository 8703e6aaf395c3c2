"""Surveys on disk: any number of workers, interruptions at any time, damaged files, refused requests."""

import errno
import hashlib
import io
import json
import multiprocessing
import os
import shutil
import signal
import sys
import tempfile
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.table import QTable

import flat
import rfpsurvey as rs
from processes import killed_at_random
from rfpsurvey._common import io as _io

CENTER = SkyCoord(200 * u.deg, 30 * u.deg)


@pytest.fixture(scope="module")
def case(small):
    """Return the arguments of a survey with random numbers, several passes, priorities and collisions."""
    sky = rs.synthetic_catalog("poisson", CENTER, 4 * u.deg, density=100 / u.deg**2, rng=3)
    rng = np.random.default_rng(1)
    sky = rs.Catalog(sky.coord, visits=rng.integers(1, 4, len(sky)))
    lon, lat = (a.ravel() for a in np.meshgrid(1.2 * np.arange(-2, 3), 1.2 * np.arange(-2, 3)))
    centers = SkyCoord(lon * u.deg, lat * u.deg, frame=CENTER.skyoffset_frame()).icrs
    table = QTable({"ra": np.tile(centers.ra, 2), "dec": np.tile(centers.dec, 2)})
    table["pass"] = np.repeat([0, 1], len(centers))
    return sky, small, rs.Tiling.from_table(table)


def plan(case, folder, **options):
    return flat.plan_survey(*case, allocator="balanced", folder=folder, **options)


@pytest.fixture(scope="module")
def undisturbed_folder(case, tmp_path_factory):
    """Return the folder of a survey that was planned without interruption."""
    folder = tmp_path_factory.mktemp("undisturbed") / "survey"
    plan(case, folder)
    return folder


@pytest.fixture(scope="module")
def undisturbed(undisturbed_folder):
    """Return the content of every file of a survey that was planned without interruption."""
    return content(undisturbed_folder)


@pytest.fixture
def folder(undisturbed_folder, tmp_path):
    """Return a copy of the folder of a finished survey, which the test may damage."""
    return shutil.copytree(undisturbed_folder, tmp_path / "survey")


def content(folder):
    return {str(path.relative_to(folder)): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


def test_what_is_written_is_what_is_held(case, tmp_path, undisturbed):
    held = plan(case, None)
    written = plan(case, tmp_path / "survey")
    assert content(tmp_path / "survey") == undisturbed
    read = rs.Survey.read(tmp_path / "survey")
    for survey in (written, read):
        assert (survey.summary, survey.provenance) == (held.summary, held.provenance)
        for name in ("tiles", "completeness", "outcomes", "targets"):
            one, other = getattr(survey, name), getattr(held, name)
            assert one.colnames == other.colnames
            for c in one.colnames:
                np.testing.assert_array_equal(one[c], other[c], err_msg=f"{name} {c}")
    assert read.tile(5)["tile"][0] == 5
    table = QTable.read(tmp_path / "survey" / "tiles" / "000" / "000005.fits")
    assert table.meta["TILE"] == 5
    assert table.meta["NASSIGN"] == len(table) == read.tiles["n_assigned"][5]


def test_threads_and_processes(case, tmp_path, undisturbed):
    context = multiprocessing.get_context("spawn")
    for name, pool in {"threads": ThreadPoolExecutor(2), "processes": ProcessPoolExecutor(2, context)}.items():
        with pool as executor:
            plan(case, tmp_path / name, executor=executor)
        assert content(tmp_path / name) == undisturbed


@pytest.mark.exhaustive
@pytest.mark.filterwarnings("ignore")  # warnings of a cluster that loses workers
def test_dask_with_a_worker_that_is_killed(case, tmp_path, undisturbed):
    distributed = pytest.importorskip("distributed")
    with (
        distributed.LocalCluster(n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None) as cluster,
        distributed.Client(cluster) as client,
    ):
        killed = []

        def kill(done, _):
            if done >= 20 and not killed:
                killed.append(client.run(os.getpid))
                os.kill(next(iter(killed[0].values())), signal.SIGKILL)

        plan(case, tmp_path / "survey", executor=client.get_executor(), progress=kill)
        assert killed
    assert content(tmp_path / "survey") == undisturbed


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
@pytest.mark.filterwarnings("ignore:.*fork:DeprecationWarning")
def test_killed_at_random_moments(case, tmp_path, undisturbed, rng):
    """The process is killed several times, each time between writing the first and the last file."""
    for folder in killed_at_random(plan, case, tmp_path, 6, rng):
        assert content(folder) == undisturbed


def test_what_a_kill_leaves_behind_is_not_trusted(case, folder, undisturbed):
    """There is a part without its line in the index, an incomplete line, a line without part, and a hidden file."""
    for name in ("tiles.fits", "completeness.ecsv", "outcomes.fits"):
        (folder / name).unlink()
    lines = (folder / "index.csv").read_text().splitlines(keepends=True)
    (folder / "index.csv").write_text("".join(lines[:20]) + lines[20][:30])
    (folder / "tiles" / "000" / "000003.fits").unlink()
    (folder / "tiles" / "000" / "000040.fits").write_bytes(b"a part without a line")
    (folder / "tiles" / "000" / ".rfpsurvey-x1b2").mkdir()
    (folder / "tiles" / "000" / ".rfpsurvey-x1b2" / "000041.fits").write_bytes(b"half of a")
    with pytest.raises(rs.InputError, match=r"is not finished \(16 tiles planned so far\); continue"):
        rs.Survey.read(folder)
    with pytest.warns(rs.RfpsurveyWarning, match=r"000003.fits is missing"):
        plan(case, folder, resume=True)
    assert content(folder) == undisturbed


def flip(content, place=-1):
    damaged = bytearray(content)
    damaged[place] ^= 1
    return bytes(damaged)


def replaced(lines):
    """Return a function that replaces some lines of the index."""
    return lambda content: b"".join([*content.splitlines(keepends=True)[:5], lines, *content.splitlines(True)[8:]])


PART, INDEX = "tiles/000/000007.fits", "index.csv is damaged"
CHECKSUM = r"000007.fits is damaged \(its checksum differs from the checksum recorded"
AGAIN = "the tile in row 7 of the tiling is planned again"
DAMAGES = {
    "one bit": (PART, lambda part: flip(part, 6000), CHECKSUM),
    "text": (PART, lambda _: b"nothing", AGAIN),
    "another table": (PART, lambda _: other_table(), AGAIN),
    "cut off": (PART, lambda part: part[:5760], AGAIN),
    "text in the index": ("index.csv", replaced(b"\xff\xfe junk\n"), INDEX),
    "another part": ("index.csv", replaced(b"tiles/000/000900.fits,5," + b"0" * 64 + b"\n"), INDEX),
    "another table as index": ("index.csv", replaced(b"a,b,c\n"), INDEX),
    "tiles": ("tiles.fits", flip, None),
    "completeness": ("completeness.ecsv", flip, None),
}


def other_table():
    with tempfile.TemporaryDirectory() as folder:
        _io.write_table(QTable({"a": [1, 2]}), Path(folder) / "other.fits")
        return (Path(folder) / "other.fits").read_bytes()


@pytest.mark.parametrize("what", DAMAGES)
def test_damaged_files_are_made_again(case, folder, undisturbed, what):
    """Regression: a file with a correct checksum was read as a table of visits, which raised an unhandled exception."""
    name, damage, message = DAMAGES[what]
    content_of = damage((folder / name).read_bytes())
    (folder / name).write_bytes(content_of)
    if message == AGAIN:  # also the index is adapted
        lines = (folder / "index.csv").read_text().splitlines(keepends=True)
        line = f"{name},{len(content_of)},{hashlib.sha256(content_of).hexdigest()}\n"
        (folder / "index.csv").write_text("".join(line if "000007" in old else old for old in lines))
    with nullcontext() if message is None else pytest.warns(rs.RfpsurveyWarning, match=message):
        plan(case, folder, resume=True)
    assert content(folder) == undisturbed


def test_a_damaged_survey_is_not_read(case, folder):
    (folder / PART).write_bytes(flip((folder / PART).read_bytes(), 6000))
    survey = rs.Survey.read(folder)
    with pytest.raises(rs.InputError, match=r"000007.fits is damaged \(its checksum differs from the checksum"):
        survey.tile(7)
    assert len(survey.tile(8))
    for name in ("tiles.fits", "outcomes.fits", "completeness.ecsv"):
        before = (folder / name).read_bytes()
        (folder / name).write_bytes(flip(before, -200))
        with pytest.raises(rs.InputError, match=rf"{name} is damaged"):
            rs.Survey.read(folder)
        (folder / name).write_bytes(before)


def test_killed_before_anything_is_there(case, tmp_path, undisturbed):
    folder = tmp_path / "survey"
    folder.mkdir()
    (folder / ".rfpsurvey-3x").mkdir()
    (folder / ".rfpsurvey-3x" / "survey.json").write_text("{")
    plan(case, folder, resume=True)
    assert content(folder) == undisturbed


def test_a_part_from_other_circumstances_is_planned_again(case, folder, tmp_path):
    """The part is complete and verified, but is from a survey with other random numbers.

    The numbers of visits remain correct.
    """
    one, other = folder, tmp_path / "other"
    plan(case, other, rng=7)
    tiles = rs.Survey.read(one).tiles
    first = np.argmax(np.where(tiles["round"] == 0, tiles["n_assigned"], 0))
    name = f"tiles/000/{first:06d}.fits"
    (one / name).write_bytes((other / name).read_bytes())
    lines = {folder: (folder / "index.csv").read_text().splitlines(keepends=True) for folder in (one, other)}
    (line,) = [line for line in lines[other] if line.startswith(name)]
    (one / "index.csv").write_text("".join(line if old.startswith(name) else old for old in lines[one]))
    with pytest.warns(rs.RfpsurveyWarning, match="planned for a different set of targets with remaining visits"):
        survey = plan(case, one, resume=True)
    visits = survey.targets
    times = np.bincount(visits["target_row"][visits["observed"]], minlength=len(survey.outcomes))
    assert np.array_equal(times, survey.outcomes["observed"])
    assert (times <= survey.outcomes["requested"]).all()


@pytest.mark.filterwarnings("ignore:requirement sky")
def test_blank_sky_is_resumed(case, tmp_path):
    options = {"requirements": "sky=2", "sky_separation": 30 * u.arcsec}
    plan(case, tmp_path / "survey", **options)
    before = content(tmp_path / "survey")
    lines = before["index.csv"].decode().splitlines(keepends=True)
    (tmp_path / "survey" / "index.csv").write_text("".join(lines[:25]))
    plan(case, tmp_path / "survey", resume=True, **options)
    assert content(tmp_path / "survey") == before


def test_names_that_fits_cannot_hold_are_refused_at_once(case, tmp_path):
    sky, small, tiling = case
    table = tiling.table.copy()
    table.replace_column("tile", [f"t\t{k}" for k in range(len(table))])
    star = rs.Catalog(sky.coord, id=[f"étoile {k}" for k in range(len(sky))])
    for other, what in (((sky, small, table), "50 tile ids"), ((star, small, tiling), "target ids")):
        with pytest.raises(rs.InputError, match=rf"only printable ASCII text, but .*{what}"):
            plan(other, tmp_path / "survey")
        assert not (tmp_path / "survey").exists()
        assert len(plan(other, None).tiles) == 50


def test_a_finished_survey_is_read_without_the_targets_of_its_tiles(case, folder, undisturbed, monkeypatch):
    """Regression: resuming a finished survey took longer than planning it."""
    first, done, time = rs.Survey.read(folder), [], (folder / PART).stat().st_mtime_ns
    monkeypatch.setattr("rfpsurvey._survey.request.Request.job", None)
    again = plan(case, folder, resume=True, progress=lambda k, n: done.append((k, n)))
    assert (content(folder), again.summary, len(again.targets)) == (undisturbed, first.summary, len(first.targets))
    assert (done, (folder / PART).stat().st_mtime_ns) == ([(50, 50)], time)


def test_two_runs_in_one_folder_are_refused(case, tmp_path):
    tried = []

    def intrude(done, _):
        if done == 1:
            with pytest.raises(rs.InputError, match="another run uses this folder"):
                plan(case, tmp_path / "survey", resume=True)
            tried.append(done)

    plan(case, tmp_path / "survey", progress=intrude)
    assert tried


def test_another_survey_in_the_folder_is_refused(case, tmp_path, folder):
    sky, small, tiling = case
    renamed = replace(small, focal_plane=replace(small.focal_plane, id=np.arange(len(small.focal_plane)) + 100))
    ranked = rs.Catalog(sky.coord, visits=sky.visits, priority=np.arange(len(sky)))
    (tmp_path / "papers").mkdir()
    (tmp_path / "papers" / "thesis.tex").touch()
    for other, options, sentence in (
        (case, {"resume": False}, r"holds a survey; continue it with resume=True \(or --resume\), or"),
        *(((catalog, small, tiling), {}, "holds another survey: .*catalog") for catalog in (sky[1:], ranked)),
        ((sky, small, tiling.table[1:]), {}, "holds another survey: .*tiles"),
        *(((sky, model, tiling), {}, "holds another survey: .*instrument") for model in ("lamost", renamed)),
        (case, {"visits": 2}, "holds another survey: visits"),
        (case, {"lost_in_collision": False}, "holds another survey: lost_in_collision"),
        (case, {"order": "given"}, "holds another survey: order"),
        (case, {"parked_obstacles": False}, "holds another survey: parked_obstacles"),
        (case, {"rng": 5}, r"rng differs \(rng was 0 and is now 5\)"),
        (case, {"folder": tmp_path / "papers"}, "papers must be a new or empty folder, got one that contains"),
        (case, {"folder": tmp_path / "papers" / "thesis.tex"}, "is a file"),
        (case, {"folder": tmp_path / "nowhere" / "survey"}, "the folder .*nowhere does not exist"),
    ):
        with pytest.raises(rs.InputError, match=sentence):
            plan(other, **{"folder": folder, "resume": options.get("folder") is None, **options})
    assert os.listdir(tmp_path / "papers") == ["thesis.tex"]


def test_a_full_disk_keeps_what_is_there(case, tmp_path, undisturbed, monkeypatch):
    written = []

    class Full(io.FileIO):
        def write(self, data):
            if len(written) == 30:
                super().write(data[: len(data) // 2])
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            written.append(self)
            return super().write(data)

    folder = tmp_path / "survey"

    def opened(path, mode="r", **text):
        return Path(path).open(mode, **text) if text else Full(path, mode)

    with monkeypatch.context() as patch:
        patch.setattr(_io, "open", opened, raising=False)
        with pytest.raises(rs.InputError, match="cannot be written: No space left on device"):
            plan(case, folder)
    assert not list(folder.rglob(".*"))
    parts = [name for name in content(folder) if name.startswith("tiles/")]
    assert len(parts) == 27  # the request, the index and the plan file were also written
    assert all(content(folder)[name] == undisturbed[name] for name in parts)
    plan(case, folder, resume=True)
    assert content(folder) == undisturbed


def test_other_versions_of_the_software_are_told(case, folder):
    request = (folder / "survey.json").read_text()
    (folder / "survey.json").write_text(request.replace(sys.version.split()[0], "3.0.0"))
    with pytest.warns(rs.RfpsurveyWarning, match="other versions of the software"):
        plan(case, folder, resume=True)
    assert (folder / "survey.json").read_text() == request
    for text in ("{", "null", "[1]", '{"a": ' * 20000 + "1" + "}" * 20000, " " * 11_000_000):
        (folder / "survey.json").write_text(text)
        with pytest.raises(rs.InputError, match=r"survey.json is damaged"):
            plan(case, folder, resume=True)


def test_progress_is_one_line_with_a_rate(case, tmp_path, capsys):
    plan(case, None, progress=True)
    shown = capsys.readouterr()
    assert shown.out == ""
    (line,) = shown.err.splitlines()
    assert " 50 of 50 tiles, " in line
    assert "tiles/s, 0:00:00 left" in line
    plan(case, None)
    assert capsys.readouterr().err == ""


def test_a_folder_of_version_0_1_is_not_continued(case, folder):
    request = json.loads((folder / "survey.json").read_text())
    (folder / "survey.json").write_text(json.dumps({**request, "method": "balanced"}))
    with pytest.raises(rs.InputError, match=r"was begun by version 0\.1 of rfpsurvey, which recorded other options"):
        plan(case, folder, resume=True)


def test_what_cannot_be_read_or_is_left_over_in_a_folder(case, folder, undisturbed):
    """A folder can be in the place of a file."""
    (folder / "tiles" / ".rfpsurvey-5x").write_bytes(b"half of a part")
    part = folder / "tiles" / "000" / "000007.fits"
    part.unlink()
    part.mkdir()
    with pytest.raises(rs.InputError, match=r"000007\.fits: this is a folder"):
        rs.Survey.read(folder).tile(7)
    part.rmdir()
    (folder / "index.csv").unlink()  # without it, no file is trusted
    with pytest.raises(rs.InputError, match="is damaged"):
        rs.Survey.read(folder)
    plan(case, folder, resume=True)
    assert content(folder) == undisturbed
