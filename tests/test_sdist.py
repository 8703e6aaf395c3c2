"""An sdist that is made without git is complete, and the wheel from it works without permission to write."""

import ctypes
import os
import shutil
import subprocess
import sys
import tarfile
import tempfile
from pathlib import Path
from zipfile import ZIP_STORED, ZipFile

import numpy as np
import pytest

ROOT = Path(__file__).parents[1]
NOBODY, PR_CAPBSET_DROP, CAP_DAC_OVERRIDE = 65534, 24, 1
CODE = """
import os, rfpsurvey as rs, sys, astropy.units as u
assert not os.access(sys.argv[1], os.W_OK, effective_ids=True)
assert rs.__file__.startswith(sys.argv[1]), rs.__file__
plane = rs.FocalPlane([[0, 0], [20, 0]] * u.mm, rs.Positioner(8 * u.mm, 8 * u.mm, 1 * u.mm))
print(len(rs.example_catalog("anticenter")), plane.inverse([[10, 0], [10, 0]] * u.mm)[0][0].to_value(u.deg))
"""


@pytest.fixture
def folder():
    """Return a temporary folder that other users can read, unlike ``tmp_path``."""
    path = Path(tempfile.mkdtemp())
    path.chmod(0o755)
    yield path
    for one in [path, *path.rglob("*")]:
        if one.is_dir() and not one.is_symlink():
            one.chmod(0o755)
    shutil.rmtree(path)


def call(*words, cwd, **options):
    environment = {name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "NUMBA", "COV"))}
    environment |= options.pop("env", {})
    found = subprocess.run(words, cwd=cwd, env=environment, capture_output=True, text=True, **options)
    assert found.returncode == 0, found.stdout + found.stderr
    return found.stdout


def unprivileged():
    """Return options of a process that cannot write to read-only files, although the tests may run as root."""
    if os.geteuid() != 0:
        return {}
    other = {"user": NOBODY, "group": NOBODY, "extra_groups": []}
    try:
        subprocess.run([sys.executable, "-c", "import numba, astropy"], check=True, capture_output=True, **other)
    except (OSError, subprocess.CalledProcessError):  # other users cannot run this Python
        return {"preexec_fn": lambda: ctypes.CDLL(None).prctl(PR_CAPBSET_DROP, CAP_DAC_OVERRIDE, 0, 0, 0)}
    return other


@pytest.mark.skipif(sys.platform != "linux", reason="the test changes the user of a process")
def test_an_sdist_without_git_is_built_and_installed(folder):
    """Regression: the build step ``data/wheel.py`` was missing, so that the wheel could not be built."""
    if not (ROOT / "pyproject.toml").is_file():
        pytest.skip("the files of the project are not part of this installation")
    pytest.importorskip("setuptools_scm", reason="the build without isolation needs setuptools_scm")
    tree, dist, target = (folder / name for name in ("tree", "dist", "target"))
    ignored = (".*", "*.egg-info", "__pycache__", "_version.py", "build", "dist", "_build", "baseline")
    shutil.copytree(ROOT, tree, ignore=shutil.ignore_patterns(*ignored))
    backend = "import sys; from setuptools.build_meta import build_sdist; print(build_sdist(sys.argv[1]))"
    name = call(sys.executable, "-c", backend, dist, cwd=tree).split()[-1]
    with tarfile.open(dist / name) as file:
        names = {one.partition("/")[2] for one in file.getnames()}
    assert {"data/wheel.py", "data/tycho2_anticenter_r5.ecsv.gz", "tests/test_sdist.py", "tox.ini"} <= names
    assert not any(one.endswith((".pyc", ".nbi", ".nbc")) for one in names)
    pip = sys.executable, "-m", "pip", "--quiet", "--disable-pip-version-check"
    call(*pip, "wheel", "--no-build-isolation", "--no-deps", "--wheel-dir", dist, dist / name, cwd=folder)
    (wheel,) = dist.glob("*.whl")
    call(*pip, "install", "--no-compile", "--no-deps", "--target", target, wheel, cwd=folder)
    home, words = folder / "home", [sys.executable, "-c", CODE, str(target)]
    home.mkdir()
    options = unprivileged()
    os.chown(home, options.get("user", os.getuid()), -1)
    for path in [*target.rglob("*"), target]:
        path.chmod(path.stat().st_mode & 0o555)
    own = {"PYTHONPATH": str(target), "HOME": str(home), "XDG_CACHE_HOME": str(home)}
    n_targets, theta = call(*words, cwd=home, env=own, **options).split()
    assert int(n_targets) > 1000
    assert float(theta) == pytest.approx(-np.rad2deg(np.arccos(5 / 8)))  # from a kernel that was compiled


@pytest.fixture
def problems_of(monkeypatch):
    if not (ROOT / "data" / "check_wheel.py").is_file():
        pytest.skip("the folder data is not part of this installation")
    monkeypatch.syspath_prepend(ROOT / "data")
    yield __import__("check_wheel").problems_of
    sys.modules.pop("check_wheel")


def test_an_unexpected_or_large_file_in_the_wheel_is_named(tmp_path, problems_of):
    path = tmp_path / "some.whl"
    expected = {
        "rfpsurvey/_field/tile.py": 900,
        "rfpsurvey/presets/desi.toml": 900,
        "rfpsurvey-1.0.dist-info/RECORD": 9,
    }
    unexpected = {"tests/test_sdist.py": 9, "rfpsurvey/_kernels/__pycache__/arms.nbi": 9, "rfpsurvey/notes.txt": 9}
    large = {"rfpsurvey/_large.py": 10_001, "rfpsurvey/_studies/surrogate.npz": 1_600_000}
    for files, words in ((expected, []), ({**expected, **unexpected, **large}, ["smaller", *unexpected, *large])):
        with ZipFile(path, "w", ZIP_STORED) as wheel:
            for name, size in files.items():
                wheel.writestr(name, bytes(size))
        problems = problems_of(path)
        assert len(problems) == len(words)
        assert all(word in text for word, text in zip(words, problems, strict=True))
