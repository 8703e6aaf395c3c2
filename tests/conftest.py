import gc
import os
import signal
import sys
import zlib
from pathlib import Path

import astropy.units as u
import matplotlib
import numpy as np
import pytest
from hypothesis import settings

import rfpsurvey as rs
from compile_once import compile_once
from packages import HERS
from rfpsurvey import _cli
from rfpsurvey._cli import process as _process
from rfpsurvey._cli.application import COMMANDS
from rfpsurvey._common import plugins as _plugins

# The imported modules and the collected tests exist until the end. Excluding them from garbage collection saves time.
gc.disable()
matplotlib.use("agg")
# a process that a script started in the background ignores interrupts, which some tests send
signal.signal(signal.SIGINT, signal.default_int_handler)
# surveys are planned before the nights of the tests
os.environ.setdefault("SOURCE_DATE_EPOCH", "1767225600")
# the first call of a kernel compiles it; examples are the same in every run, so that a failure can be reproduced
settings.register_profile("rfpsurvey", deadline=None, derandomize=True, database=None)
settings.load_profile("rfpsurvey")
# folders with tests of kernels: their tests find an index out of bounds first
KERNELS = {"allocation", "collision", "probability"}


def pytest_configure(config):
    """Sort files by folder, because pytest loses the fixtures of a folder to which it returns."""
    paths = {arg: Path(arg.partition("::")[0]).resolve() for arg in config.args}
    config.args.sort(key=lambda arg: paths[arg] if paths[arg].is_dir() else paths[arg].parent)


def _parameters_of(test):
    """Return the parameters of a test; the indices of pytest differ for equal values of one of several parameters."""
    return {(name, repr(value)) for name, value in test.callspec.params.items()}


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items):
    """Mark all but ``n`` tests of a function with the marker ``few(n)`` as exhaustive.

    The ``n`` tests have as many different values of each parameter as possible. If the environment variable
    ``RFPSURVEY_PART`` is ``k/n``, only the k-th of n parts of the tests is kept; in addition, all tests in the folders
    `KERNELS` that are not exhaustive are kept.
    """
    functions = {}
    for item in items:
        few = item.get_closest_marker("few")
        if few is not None and item.get_closest_marker("exhaustive") is None:
            functions.setdefault((item.path, item.originalname), (*few.args, []))[1].append(item)
    for number, tests in functions.values():
        seen = set()
        for _ in range(min(number, len(tests))):
            test = max(tests, key=lambda test: len(_parameters_of(test) - seen))
            seen.update(_parameters_of(test))
            tests.remove(test)
        for test in tests:
            test.add_marker("exhaustive")
    part, _, n_parts = os.environ.get("RFPSURVEY_PART", "0/1").partition("/")

    def is_kept(item):
        name = f"{item.path.name} {item.name}".encode()  # with the parameters, so that parts take similar times
        of_kernels = item.path.parent.name in KERNELS and item.get_closest_marker("exhaustive") is None
        return of_kernels or (zlib.crc32(name) - int(part)) % int(n_parts) == 0

    items[:] = filter(is_kept, items)


def pytest_collection_finish():
    gc.freeze()
    gc.enable()


@pytest.fixture(scope="session", autouse=True)
def _each_kernel_is_compiled_once(tmp_path_factory):
    if "PYTEST_XDIST_WORKER" in os.environ:
        compile_once(tmp_path_factory.getbasetemp().parent)


@pytest.fixture
def rng():
    return np.random.default_rng(20260101)


@pytest.fixture(scope="session")
def presets():
    """Return all presets, made once."""
    return {
        path.stem: rs.Instrument.preset(path.stem) for path in (Path(rs.__file__).parent / "presets").glob("*.toml")
    }


@pytest.fixture(scope="session")
def tycho():
    """Return the real catalog of the package."""
    return Path(__file__).parent.parent / "data" / "tycho2_anticenter_r5.ecsv.gz"


@pytest.fixture(scope="session")
def real_data():
    """Return a function that returns the path of an optional catalog by its name, or skips the test."""

    def find(name):
        folder = os.environ.get("RFPSURVEY_TEST_DATA")
        if not folder:
            pytest.skip("RFPSURVEY_TEST_DATA is not set: the optional real catalogs are not there")
        path = Path(folder) / name
        if not path.exists():
            pytest.skip(f"{name} is not in RFPSURVEY_TEST_DATA")
        return path

    return find


@pytest.fixture(scope="session")
def small():
    """Return a small instrument with equal arms."""
    unit = rs.Positioner(8.25 * u.mm, 8.25 * u.mm, 2.25 * u.mm)
    plane = rs.FocalPlane.hexagonal(unit, rings=3, pitch=25.6 * u.mm)
    return rs.Instrument("small", plane, plate_scale=200 * u.mm / u.deg)


@pytest.fixture
def run(monkeypatch, capsys):
    """Run the command line in this process, and return the exit code, the output and the errors.

    Commands print all that they can print, unless the function is called with ``brief=True``.
    """

    monkeypatch.setenv("COLUMNS", "100")

    def call(*arguments, brief=False):
        if not brief and arguments and arguments[0] in COMMANDS and not {"--help", "-h", "--quiet"} & {*arguments}:
            arguments = [*arguments, "--verbose"]
        monkeypatch.setattr(sys, "argv", ["rfpsurvey", *map(str, arguments)])
        for name in ("_prepare", "_on_signals"):  # pytest has its own standard streams and signals
            monkeypatch.setattr(_process, name, lambda *_: None)
        try:
            _cli.main()
            code = 0
        except SystemExit as stop:
            code = stop.code or 0
        out = capsys.readouterr()
        return code, out.out, out.err

    return call


@pytest.fixture
def install(tmp_path, monkeypatch):
    """Return a function that writes the files of an installed distribution, as pip would."""
    names = []

    def make(name, code, version="1.0", **groups):
        folder = tmp_path / f"{name}-{version}"
        info = folder / f"{name}-{version}.dist-info"
        info.mkdir(parents=True)
        (folder / f"{name}.py").write_text(code)
        (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n")
        lines = []
        for group, entries in groups.items():
            lines += [f"[rfpsurvey.{group}]", *(f"{key} = {name}:{value}" for key, value in entries.items())]
        (info / "entry_points.txt").write_text("\n".join(lines))
        monkeypatch.syspath_prepend(folder)
        _plugins._load.cache_clear()
        sys.modules.pop(name, None)
        names.append(name)

    yield make
    _plugins._load.cache_clear()
    for name in names:
        sys.modules.pop(name, None)


@pytest.fixture
def hers(install):
    """Install a package with allocators and a method of collision probability."""
    allocators = {
        "begin": "begin",
        "swapped": "swapped",
        "idle": "idle",
        "wrong": "wrong",
        "absent": "nowhere",
        "number": "np",
    }
    install("hers", HERS, allocators=allocators, probability_methods={"quarter": "formula"})
