"""Outputs that cannot be written are refused before the computation, and nothing is left on a full disk."""

import os
import subprocess
import sys

import pytest
from astropy.coordinates import SkyCoord
from astropy.table import QTable

import rfpsurvey as rs
from rfpsurvey._common import io as _io
from rfpsurvey._common.files import check_new_folder, check_output, check_separate

CENTER = SkyCoord("6h20m +23d")
FULL = """
import resource, sys
import astropy.units as u
from astropy.coordinates import SkyCoord
import rfpsurvey as rs
path, most = sys.argv[1], int(sys.argv[2])
sky = rs.synthetic_catalog("uniform", SkyCoord("6h20m +23d"), 0.5 * u.deg, n_targets=2000, rng=1)
resource.setrlimit(resource.RLIMIT_FSIZE, (most, most))
for name, write in {
    "a.fits": sky.write,
    "a.ecsv": sky.write,
    "a.ecsv.gz": sky.write,
    "a.html": lambda path: rs.write_report(sky.to_table(), path),
    "survey": lambda path: rs.plan_survey(sky, "moons", SkyCoord(["6h20m"], ["+23d"]), folder=path),
}.items():
    try:
        write(f"{path}/{name}")
    except rs.InputError as error:
        print(error)
"""


@pytest.mark.few(1)
@pytest.mark.parametrize("most", [0, 3000])
def test_nothing_is_left_on_a_full_disk(tmp_path, most):
    """The limit of the size of files has the same effect as a full disk."""
    done = subprocess.run([sys.executable, "-c", FULL, str(tmp_path), str(most)], capture_output=True, text=True)
    lines = done.stdout.splitlines()
    assert done.returncode == 0, done.stderr
    assert len(lines) == 5
    assert all(" cannot be written: " in line for line in lines)
    left = [path.name for path in tmp_path.iterdir()]
    assert left == ([] if most == 0 else ["survey"])  # the survey can be continued
    assert not [path for path in tmp_path.rglob("*") if path.name.startswith(_io.TEMPORARY_PREFIX)]


def test_bytes_that_cannot_be_stored_are_told(tmp_path):
    """NumPy reports a full disk without a reason."""

    def write():
        with _io.writing_to(tmp_path / "a.fits", (".fits",)):
            raise OSError("65440 requested and 14240 written")

    with pytest.raises(rs.InputError, match=r"a\.fits cannot be written: some bytes cannot be stored; the disk may"):
        write()
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize(
    ("name", "sentence"),
    [
        ("nowhere/a.fits", "the folder .* does not exist"),
        ("folder.fits", "is a folder"),
        ("pipe.fits", "is a pipe or a device"),
        ("link.fits", "exists; to replace it"),
        ("file/a.fits", "cannot be written: Not a directory"),
        ("a" * 300 + ".fits", "cannot be written: File name too long"),
        ("a\0.fits", "cannot be written: embedded null byte"),
        ("read-only/a.fits", "cannot be written to"),
    ],
)
def test_impossible_outputs_are_refused_before_the_computation(tmp_path, monkeypatch, name, sentence):
    """A link to nothing, a long name and a null byte were refused only after the computation, or with a traceback."""
    for folder in ("folder.fits", "read-only"):
        (tmp_path / folder).mkdir()
    os.mkfifo(tmp_path / "pipe.fits")
    (tmp_path / "link.fits").symlink_to("nothing.fits")
    (tmp_path / "file").touch()
    access = os.access
    monkeypatch.setattr(os, "access", lambda path, mode: path.name != "read-only" and access(path, mode))
    for check in (lambda path: check_output(path, (".fits",)), rs.Catalog(CENTER.reshape(1)).write):
        with pytest.raises(rs.InputError, match=sentence):
            check(tmp_path / name)
    if name not in ("folder.fits", "pipe.fits", "link.fits"):
        with pytest.raises(rs.InputError, match=sentence):
            check_new_folder(tmp_path / name)
        with pytest.raises(rs.InputError, match=sentence):
            rs.plan_survey(CENTER.reshape(1), "moons", CENTER.reshape(1), folder=tmp_path / name)


def test_outputs_differ_from_inputs_and_from_each_other(tmp_path):
    one = tmp_path / "one.fits"
    one.touch()
    (tmp_path / "link.fits").symlink_to(one)
    check_separate([None, one], [None, "moons", tmp_path / "other.fits"])
    for outputs, inputs in (([one], [one]), ([tmp_path / "link.fits"], [str(one)])):
        with pytest.raises(rs.InputError, match=r"\.fits must be a new file, got the name of an input"):
            check_separate(outputs, inputs)
    (tmp_path / "folder").mkdir()
    with pytest.raises(rs.InputError, match=r"a\.svg must be a new file, got the name of another output"):
        check_separate([tmp_path / "a.svg", tmp_path / "folder" / ".." / "a.svg"])


def test_commands_never_replace_their_input(tmp_path, run):
    """With --overwrite, the output replaced the catalog."""
    path = tmp_path / "a.ecsv"
    rs.Catalog(CENTER.reshape(1)).write(path)
    before = path.read_bytes()
    for command in (["plan", path], ["tile", path], ["compare-allocators", path], ["score", path]):
        code, _, error = run(*command, "--instrument", "moons", "--output", path, "--overwrite")
        assert code == 2
        assert "must be a new file, got the name of an input" in error
    code, _, error = run("convert", path, path, "--overwrite")
    assert (code, path.read_bytes()) == (2, before)
    code, _, error = run("plan", path, "--plot", tmp_path / "a.svg", "--set", f"output.quality={tmp_path / 'a.svg'}")
    assert code == 2
    assert "the name of another output" in error


def test_text_that_is_not_unicode_is_refused(tmp_path):
    """Text with bytes that are not UTF-8 caused a UnicodeEncodeError."""
    table = QTable({"id": ["a\udcff"]})
    with pytest.raises(rs.InputError, match="must be valid Unicode"):
        _io.write_table(table, tmp_path / "a.ecsv")
    assert os.listdir(tmp_path) == []


def test_a_new_folder_in_which_nothing_can_be_written_is_removed(tmp_path, monkeypatch):
    def refuse(*_, **__):
        raise rs.InputError("no space")

    monkeypatch.setattr("rfpsurvey._common.folder.write_bytes", refuse)
    with pytest.raises(rs.InputError, match="no space"):
        rs.plan_survey(CENTER.reshape(1), "moons", CENTER.reshape(1), folder=tmp_path / "survey")
    assert os.listdir(tmp_path) == []
