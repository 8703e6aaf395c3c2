"""Interrupt every command at random moments, and check how the commands end and what they leave.

python tests/benchmarks/interrupts.py [--number 60] [--seed 0] [--only survey] [--fresh 0.2] [--quick]

Each command first runs without interrupt. Then, the signal of Ctrl-C is sent to copies of the command at random moments
within its run time: to the process or, as a terminal does, to the process and its workers. A command must end within
``MOST_SECONDS`` with the exit code 130 and the message of an interrupt in the last line of the standard error stream,
or with the exit code 0 if it was complete. It must leave no process, no temporary file, no lock and no unreadable file.
An interrupted survey, selection or scan of designs is run again until it is complete; its files must then
have the same bytes as the files of the run without interrupt. A fraction ``--fresh`` of the commands starts with an
empty cache of compiled functions. The exit code of the script is 1 if a check failed.
"""

import os
import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from time import monotonic, sleep

import astropy.units as u
import numpy as np
from astropy.coordinates import SkyCoord
from astropy.table import QTable
from measure import arguments
from PIL import Image

import rfpsurvey as rs
from rfpsurvey._common.read_tables import read_table

MOST_SECONDS = 12.0
# Time in seconds within which the interpreter starts; it reports an earlier interrupt with a traceback.
START = 0.25
# Run time in seconds that ``--quick`` assumes.
QUICK = 10.0
MESSAGE = "rfpsurvey: interrupted"
INPUT = ("../input/stars.fits", "--tiles", "../input/tiles.ecsv", "--instrument", "moons", "--folder", "out")
SURVEY = ("survey", *INPUT)
WORKERS = ("--workers", "2", "--set", "processes=true")
JOINT = ("--allocator", "joint", "--set", "joint.iterations=2")
PLAN = ("plan", "--instrument", "moons", "--output", "tile.fits", "--plot", "tile.png", "--report", "tile.html")
COMMANDS = {
    "survey": SURVEY,
    "survey optimal": (*SURVEY, "--allocator", "optimal"),
    "survey threads": (*SURVEY, "--allocator", "optimal", "--workers", "2"),
    "survey processes": (*SURVEY, "--allocator", "optimal", *WORKERS),
    "survey joint": (*SURVEY, *JOINT),
    "survey joint processes": (*SURVEY, *JOINT, *WORKERS),
    "select": ("select", *INPUT, "--output", "p.fits"),
    "select processes": ("select", *INPUT, *WORKERS),
    "design": ("design", "--n-designs", "512", "--output", "out.fits", "--plot", "front.png"),
    "design processes": ("design", "--n-designs", "64", "--estimand", "allocated", "--output", "out.ecsv", *WORKERS),
    "plan": PLAN,
    "plan optimal": (*PLAN, "--allocator", "optimal"),
    "plan search": ("plan", "--allocator", "optimal", "--output", "tile.fits"),
    "tile": ("tile", "example:anticenter", "--passes", "2", "--output", "tiles.ecsv", "--plot", "tiles.png"),
    "probability": ("probability", "moons", "--workers", "2", "--output", "map.fits", "--plot", "map.png"),
    "compare": ("compare", "moons", "lamost", "--workers", "2", "--output", "table.ecsv"),
    "compare-allocators": ("compare-allocators", "--instrument", "moons", "--output", "table.ecsv"),
    "benchmark": ("benchmark", "collisions", "--instrument", "moons", "--repeats", "2", "--plot", "speed.png"),
    "benchmark probability": ("benchmark", "probability", "--instrument", "moons", "--repeats", "2", "--plot", "p.png"),
    "benchmark batches": ("benchmark", "batches", "--instrument", "moons", "--repeats", "1"),
    "score": ("score", "../input/tile.fits", "--instrument", "moons", "--output", "score.fits", "--plot", "s.png"),
    "convert": ("convert", "../input/tile.fits", "plan.ecsv"),
    "instruments": ("instruments", "moons"),
}
RESUME = {"survey": "--resume", "select": "--resume", "design": "--resume"}


@dataclass
class Ended:
    """How a command ended."""

    code: int
    errors: str
    seconds: float
    faults: list[str] = field(default_factory=list)


def make_input(folder: Path) -> None:
    """Write the targets and the tiles of the surveys to a folder."""
    center, rng = SkyCoord(95 * u.deg, 23 * u.deg), np.random.default_rng(0)
    folder.mkdir()
    sky = rs.synthetic_catalog("poisson", center, 0.7 * u.deg, density=500 / u.deg**2, rng=0)
    rs.Catalog(sky.coord, visits=rng.integers(1, 3, len(sky))).write(folder / "stars.fits")
    tiles = center.spherical_offsets_by(*rng.uniform(-0.3, 0.3, (2, 6)) * u.deg)
    QTable({"ra": tiles.ra, "dec": tiles.dec}).write(folder / "tiles.ecsv")


def run(words, folder: Path) -> Ended:
    """Run a command to its end."""
    begin = monotonic()
    command = [sys.executable, "-m", "rfpsurvey", *words]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True)
    return Ended(done.returncode, done.stderr, monotonic() - begin)


def interrupt(words, folder: Path, ready: Callable[[], bool], *, group=True, cache: Path | None = None) -> Ended:
    """Run a command, send the signal of Ctrl-C when ``ready`` is true, and return how it ended, with all faults.

    ``cache`` is another folder for the cache of compiled functions.
    """
    command = [sys.executable, "-m", "rfpsurvey", *words]
    with tempfile.TemporaryFile("w+") as errors:
        process = subprocess.Popen(
            command,
            cwd=folder,
            env=os.environ if cache is None else {**os.environ, "NUMBA_CACHE_DIR": str(cache)},
            stdout=subprocess.DEVNULL,
            stderr=errors,
            start_new_session=True,
        )
        while process.poll() is None and not ready():
            sleep(0.01)
        if process.poll() is None:
            (os.killpg if group else os.kill)(process.pid, signal.SIGINT)
        begin, faults = monotonic(), []
        try:
            process.wait(MOST_SECONDS)
        except subprocess.TimeoutExpired:
            faults.append(f"it did not end within {MOST_SECONDS:.0f} s")
        late = monotonic() - begin
        faults += _processes(process.pid)
        process.wait()
        errors.seek(0)
        ended = Ended(process.returncode, errors.read(), late, faults)
    ended.faults += _end_of(ended) + _left_over(folder) + ([] if cache is None else _left_over(cache, "*.tmp.*"))
    return ended


def _processes(group: int) -> list[str]:
    """Kill the processes that are left; return a fault if there are any ten seconds after the end of the command.

    On a busy machine, the process in which Python tracks shared resources needs some seconds to end.
    """
    end = monotonic() + 10.0
    while monotonic() < end:
        try:
            os.killpg(group, 0)
        except ProcessLookupError:
            return []
        sleep(0.05)
    with suppress(ProcessLookupError):
        os.killpg(group, signal.SIGKILL)
    return ["processes are left"]


def _end_of(ended: Ended) -> list[str]:
    lines = ended.errors.splitlines()
    if ended.code not in (0, 130):
        return [f"exit code {ended.code}: {lines[-1:]}"]
    if "Traceback" in ended.errors or "leaked" in ended.errors:
        return [f"more than a message: {ended.errors}"]
    if ended.code == 130 and (not lines or not lines[-1].startswith(MESSAGE)):
        return [f"no message, but {lines[-1:]}"]
    return []


def _left_over(folder: Path, *patterns: str) -> list[str]:
    """Return the temporary files, locks and unreadable files in a folder."""
    patterns = patterns or (".rfpsurvey-*", ".*.lock", "*.tmp*")
    faults = [f"{path.name} is left" for pattern in patterns for path in folder.rglob(pattern)]
    for path in folder.rglob("*"):
        try:
            if path.suffix in (".fits", ".ecsv") and not path.parent.name.startswith("tiles"):
                read_table(path)
            elif path.suffix == ".png":
                Image.open(path).load()
        except Exception as error:
            faults.append(f"{path.name} cannot be read: {error}")
    return faults


def content(folder: Path) -> dict[str, bytes]:
    """Return the content of the files that a resumable command writes, without computing times and plots."""
    files = [path for ending in ("fits", "ecsv", "csv", "json") for path in folder.rglob(f"*.{ending}")]
    return {str(path.relative_to(folder)): path.read_bytes() for path in files}


def resume(words, folder: Path, expected: dict[str, bytes]) -> list[str]:
    """Complete an interrupted command, and return the differences from the run without interrupt."""
    done = run((*words, RESUME[words[0]], *(["--overwrite"] if words[0] == "select" else [])), folder)
    if done.code:
        return [f"resume: exit code {done.code}: {done.errors.splitlines()[-1:]}"]
    found = content(folder)
    different = [key for key in sorted({*found, *expected}) if found.get(key) != expected.get(key)]
    return [f"resume: {key} differs" for key in different]


def main() -> int:
    """Interrupt the commands, and print a row for each interrupt."""
    options = arguments(__doc__, number=60, seed=0, only="", fresh=0.2, quick=False)
    rng = np.random.default_rng(options.seed)
    names = [name for name in COMMANDS if name.startswith(options.only)]
    failed, expected, seconds = 0, {}, {}
    print("command                  at (s)  of (s)  to       compiled  code  ended after (s)  result")
    with tempfile.TemporaryDirectory() as room:
        room = Path(room)
        make_input(room / "input")
        run(("plan", "--instrument", "moons", "--output", "tile.fits"), room / "input")
        for k in range(options.number):
            name = names[k % len(names)]
            words = COMMANDS[name]
            if name not in expected:
                (room / name).mkdir()
                whole = Ended(0, "", QUICK)
                if words[0] in RESUME or not options.quick:
                    whole = run(words, room / name)
                if whole.code:
                    sys.exit(f"{name}: exit code {whole.code}: {whole.errors}")
                seconds[name], expected[name] = whole.seconds, content(room / name)
            folder = room / f"{name} {k}"
            folder.mkdir()
            group, fresh = rng.random() < 0.5, rng.random() < options.fresh
            cache = room / f"cache {k}" if fresh else None
            at = rng.uniform(START, (3 if fresh else 1) * seconds[name])
            end = monotonic() + at
            ended = interrupt(words, folder, lambda end=end: monotonic() > end, group=group, cache=cache)
            faults = ended.faults
            if words[0] in RESUME and ended.code == 130:
                faults += resume(words, folder, expected[name])
            failed += bool(faults)
            to, how = "group" if group else "process", "no" if fresh else "yes"
            end = f"{ended.code:>5} {ended.seconds:16.2f}  {'; '.join(faults) or 'ok'}"
            print(f"{name:<24} {at:6.2f} {seconds[name]:7.2f}  {to:<8} {how:<8} {end}", flush=True)
            shutil.rmtree(folder)
    print(f"{options.number} interrupts, {failed} failed")
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main())
