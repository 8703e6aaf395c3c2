"""Measure new processes that plan a scene once: ``python tests/benchmarks/planners/first_plan.py [--repeats 7]``.

Each program runs in a new process, which imports the program, reads a scene and plans it twice. The time of the first
plan is the time of the process up to the end of this plan; it includes the start of Python, the imports and, for
rfpsurvey, the loading of compiled kernels from the cache. Processor times and elapsed times are printed. The row
``no program`` is a process that only imports astropy and shapely and reads the scene. The programs alternate. Programs
that are not installed are left out, with the reason. ``--python`` names the interpreter of an environment in which
fiberassign is installed.
"""

import argparse
import subprocess
import sys
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from time import time

from scene import make

FOLDER = Path(__file__).parent
PROGRAMS = {
    "no program": ("", ""),
    "repair": ("ours", "plan(scene, 60.0, allocator='repair')"),
    "optimal": ("ours", "plan(scene, 60.0, allocator='optimal')"),
    "optimal random": ("ours", "plan(scene, 60.0, allocator='optimal random')"),
    "fiberassign": ("desi_fiberassign", "PLANS['fiberassign'](scene, 60.0)"),
    "fiberassign equal": ("desi_fiberassign", "PLANS['fiberassign equal'](scene, 60.0)"),
}
"""Module of each program, and the call that plans a scene; the first entry plans nothing."""
PROCESS = """
import sys
from time import process_time, time
sys.path.insert(0, {folder!r})
from types import SimpleNamespace
from judge import read_scene
scene = SimpleNamespace(**dict(zip(("positioners", "targets", "settings"), read_scene({path!r}))))
{first}
print("ends", process_time(), time() - {begin})
{second}
print("ends", process_time(), time() - {begin})
"""


def ends(python: str, module: str, call: str, path: Path) -> list[float]:
    """Return the times (s) from the start of a process to the end of its first plan and of its second plan.

    The result contains a processor time and an elapsed time for each plan. An ImportError states why a program cannot
    be imported.
    """
    plan = f"{module}.{call}" if module else ""
    first = f"import {module}\n{plan}" if module else ""
    code = PROCESS.format(folder=str(FOLDER), path=str(path), first=first, second=plan, begin=time())
    done = subprocess.run([python, "-c", code], capture_output=True, text=True, check=False)
    if done.returncode:
        raise ImportError(done.stderr.strip().splitlines()[-1])
    return [float(value) for line in done.stdout.splitlines() if line.startswith("ends ") for value in line.split()[1:]]


def main() -> None:
    """Print the median times of each program on each scene."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", default=["desi_1", "desi_1_rules"], metavar="NAME", help="scenes")
    parser.add_argument("--repeats", type=int, default=7, help="processes of each program")
    parser.add_argument("--python", default=sys.executable, help="interpreter of fiberassign")
    given = parser.parse_args()
    for name, scene in make(given.names):
        with TemporaryDirectory() as folder:
            path = Path(folder) / "scene.fits"
            scene.write(path)
            times: dict[str, list] = {label: [] for label in PROGRAMS}
            for _ in range(given.repeats + 1):  # the first round fills the caches
                for label in list(times):
                    module, call = PROGRAMS[label]
                    python = sys.executable if module in ("", "ours") else given.python
                    try:
                        times[label].append(ends(python, module, call, path))
                    except ImportError as error:
                        print(f"{label}: left out, {error}", flush=True)
                        del times[label]
        for label, found in times.items():
            first, elapsed, both, _ = (median(column) for column in zip(*found[1:], strict=True))
            print(
                f"{name:14} {label:20} first plan: processor {first:6.2f} s, elapsed {elapsed:6.2f} s; second plan: "
                f"processor {both - first:6.3f} s",
                flush=True,
            )


if __name__ == "__main__":
    main()
