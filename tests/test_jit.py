"""The cache of compiled code on disk, in processes without kernels and with a copy of the package."""

import json
import os
import pickle
import shutil
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import pytest
from numba.core.caching import IndexDataCacheFile

import rfpsurvey
from rfpsurvey._kernels import jit as _jit

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")

# Each line of the input of this program contains a copy of the package and environment variables. For each line, a new
# process that has imported numba, but no kernel, uses the cache of the copy. It imports the package without its
# __init__, which kernels do not require.
PROBES = """
import json, os, sys, types
import numba
import numpy as np

def probe(copy):
    sys.path.insert(0, os.path.dirname(copy))
    sys.modules["rfpsurvey"] = types.ModuleType("rfpsurvey")
    sys.modules["rfpsurvey"].__path__ = [copy]
    from rfpsurvey._kernels import arms, collisions
    from rfpsurvey._kernels.arms import solve
    Geometry = arms.Renamed if hasattr(arms, "Renamed") else arms.Geometry
    zero, two, theta, phi = np.zeros(1), np.full(1, 2.0), np.empty(1), np.empty(1)
    solve(np.array([[3.0, 0.0]]), Geometry(zero, zero, two, two, 1.0, 0.0), np.ones(1), theta, phi)
    print(theta[0], sum(solve.stats.cache_hits.values()), flush=True)

for line in sys.stdin:
    copy, environment = json.loads(line)
    child = os.fork()
    if child == 0:
        os.environ.update(environment)
        numba.config.reload_config()
        probe(copy)
        os._exit(0)
    if os.waitpid(child, 0)[1]:
        print("failed", flush=True)
"""


@pytest.fixture(scope="module")
def probe(tmp_path_factory):
    """Return a function that returns a value computed with a copy of the package in a new process, and cache hits."""
    clean = {k: v for k, v in os.environ.items() if not k.startswith(("NUMBA", "RFPSURVEY_CACHE"))}
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    environment, folder = {**clean, "PYTHONDONTWRITEBYTECODE": "1"}, tmp_path_factory.mktemp("probes")
    with subprocess.Popen([sys.executable, "-c", PROBES], cwd=folder, env=environment, **pipes) as process:

        def ask(copy, **environment):
            print(json.dumps([str(copy), environment]), file=process.stdin, flush=True)
            value, hits = process.stdout.readline().split()
            return float(value), int(hits)

        yield ask


@pytest.fixture
def copy(tmp_path):
    package, target = Path(rfpsurvey.__file__).parent, tmp_path / "rfpsurvey"
    shutil.copytree(package, target, ignore=shutil.ignore_patterns("__pycache__"))
    return target


@pytest.fixture(scope="module")
def compiled(probe, tmp_path_factory):
    """Return a copy of the package with a cache, and the output of a process that compiles without a cache."""
    package, folder = Path(rfpsurvey.__file__).parent, tmp_path_factory.mktemp("compiled")
    shutil.copytree(package, folder / "rfpsurvey", ignore=shutil.ignore_patterns("__pycache__"))
    return folder, probe(folder / "rfpsurvey")


def test_an_edit_in_a_file_that_a_kernel_calls_never_runs_old_code(probe, compiled, tmp_path):
    """The edit keeps the size and the time of the file, as an upgrade may do.

    The cache of numba would not detect it.
    """
    folder, first = compiled
    copy = shutil.copytree(folder, tmp_path / "copy") / "rfpsurvey"
    assert first[1] == 0
    assert probe(copy) == (first[0], 1)
    for name, old, new in (
        ("arms.py", "along * uy - across * ux", "along * uy + across * ux"),
        ("collisions.py", "Find arms that", "Find pair that"),
    ):
        path = copy / "_kernels" / name
        stat, text = path.stat(), path.read_text()
        assert text.count(old) == 1
        path.write_text(text.replace(old, new))
        os.utime(path, ns=(stat.st_atime_ns, stat.st_mtime_ns))
        assert path.stat().st_size == stat.st_size
        value, hits = probe(copy)
        assert (hits, value) == (0, -first[0])
    assert probe(copy)[1] == 1


def test_the_cache_of_an_older_version_with_other_classes_is_not_read(probe, compiled, tmp_path):
    folder, first = compiled
    copy = shutil.copytree(folder, tmp_path / "copy") / "rfpsurvey"
    for path in (copy / "_kernels").glob("*.py"):
        path.write_text(path.read_text().replace("Geometry", "Renamed"))
    assert probe(copy) == (first[0], 0)
    assert probe(copy) == (first[0], 1)


def test_the_cache_can_be_switched_off(probe, copy):
    assert probe(copy, RFPSURVEY_CACHE="0")[1] == 0
    assert not list(copy.rglob("*.nbi"))


def test_without_a_place_for_the_cache_it_still_runs(probe, copy, tmp_path):
    """NUMBA_CACHE_DIR is in a folder that cannot be made. Nothing is cached, and no error is raised."""
    blocked = tmp_path / "a_file"
    blocked.write_text("")
    assert probe(copy, NUMBA_CACHE_DIR=str(blocked / "below"))[1] == 0
    assert probe(copy, NUMBA_CACHE_DIR=str(tmp_path / "there"))[1] == 0
    assert list((tmp_path / "there").rglob("*.nbi"))


def test_an_interrupted_write_leaves_no_file(tmp_path):
    """Regression: numba left a temporary file in its cache if an interrupt occurred while it wrote the file."""
    path = tmp_path / "solve.nbi"
    with suppress(KeyboardInterrupt), _jit._open_for_write(path) as file:
        file.write(b"a part")
        raise KeyboardInterrupt
    assert not list(tmp_path.iterdir())
    with _jit._open_for_write(path) as file:
        file.write(b"all")
    assert [one.read_bytes() for one in tmp_path.iterdir()] == [b"all"]


def test_an_interrupt_between_the_index_and_the_code_leaves_no_old_code(tmp_path):
    """Regression: the index then named a file with the code of an earlier version, which numba would run."""
    file = IndexDataCacheFile(str(tmp_path), "solve", "stamp")
    _jit._make_safe(file)
    file.save("one signature", "code")
    (tmp_path / "solve.2.nbc").write_bytes(pickle.dumps("old code"))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(file, "_save_data", interrupt)
        with pytest.raises(KeyboardInterrupt):
            file.save("another signature", "new code")
    assert file.load("one signature") == "code"
    assert file.load("another signature") is None
    file.save("another signature", "new code")
    assert file.load("another signature") == "new code"


def interrupt(*_):
    raise KeyboardInterrupt
