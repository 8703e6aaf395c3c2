"""Damage files of every format, and print the outcome of reading them:

    python tests/benchmarks/fuzz_readers.py --number 2000

Each damaged file is read in a separate process, with limits of time and memory. Files that are neither read correctly
nor refused with a sentence are listed, and the exit code is then 1. ``--keep FOLDER`` keeps these files.
"""

import argparse
import os
import pickle
import resource
import select
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import warnings
from collections import Counter
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "helpers"))

from damaged_files import FINE, damage, outcome
from valid_files import samples
from valid_inputs import inputs
from valid_plans import plan_samples

OUTCOMES = (
    "read",
    "refused",
    "row loss",
    "traceback",
    "foreign warning",
    "long sentence",
    "too slow",
    "too large",
    "crash",
)


def guarded(sample, path, seconds: float, n_bytes: int) -> tuple[str, str]:
    """Read a file in a child process."""
    receive, send = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(receive)
        before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
        resource.setrlimit(resource.RLIMIT_DATA, (n_bytes + (1 << 30), n_bytes + (1 << 30)))
        result = outcome(sample, path)
        grown = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 - before
        if result[0] in FINE and grown > n_bytes:
            result = "too large", f"{grown / 1e9:.1f} GB"
        os.write(send, pickle.dumps(result)[:60_000])
        os._exit(0)
    os.close(send)
    ready, _, _ = select.select([receive], [], [], seconds)
    if not ready:
        os.kill(child, signal.SIGKILL)
    content = os.read(receive, 65_536) if ready else b""
    os.close(receive)
    os.waitpid(child, 0)
    if not ready:
        return "too slow", f"more than {seconds:g} s"
    return pickle.loads(content) if content else ("crash", "the process died")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--number", type=int, default=2000, help="damaged files in all")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--seconds", type=float, default=10, help="time for one file")
    parser.add_argument("--gigabytes", type=float, default=2, help="memory for one file")
    parser.add_argument("--format", help="one format only")
    parser.add_argument("--keep", type=Path, help="folder for files that are not fine")
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    table, bad, start, slowest = Counter(), [], time.perf_counter(), 0.0
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        made = [
            s for s in samples(folder) + inputs(folder) + plan_samples(folder) if options.format in (None, s.format)
        ]
        for sample in made:
            result = outcome(sample, sample.path)
            assert result == ("read", ""), (sample.path, result)
        for number in range(options.number):
            sample = made[number % len(made)]
            place = folder / "damaged"
            place.mkdir()
            path, done = damage(np.random.default_rng([options.seed, number]), sample, place)
            began = time.perf_counter()
            what, text = guarded(sample, path, options.seconds, int(options.gigabytes * 2**30))
            slowest = max(slowest, time.perf_counter() - began)
            table[sample.format, what] += 1
            if what not in FINE:
                bad.append((number, sample.path.name, done, what, text))
                if options.keep:
                    options.keep.mkdir(exist_ok=True)
                    target = options.keep / f"{number}-{path.name}"
                    subprocess.run(["cp", "-a", str(path), str(target)], check=True)  # pipes are not opened
            shutil.rmtree(place)
    formats = sorted({name for name, _ in table})
    shown = [o for o in OUTCOMES if o in FINE or any(table[f, o] for f in formats)]
    print(f"{'format':18}" + "".join(f"{o:>16}" for o in shown))
    for name in formats:
        print(f"{name:18}" + "".join(f"{table[name, o]:16}" for o in shown))
    print(f"{'all':18}" + "".join(f"{sum(table[f, o] for f in formats):16}" for o in shown))
    print(f"{options.number} files in {time.perf_counter() - start:.0f} s, the slowest {slowest:.1f} s")
    for number, name, done, what, text in bad:
        print(f"{number} {name} ({done}): {what}: {text[:300]}")
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
