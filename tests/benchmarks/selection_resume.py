"""Kill the command ``rfpsurvey select`` several times, resume it, and compare its result with that of one run.

RFPSURVEY_TEST_DATA=... python tests/benchmarks/selection_resume.py [--tiles 1000] [--targets 20e6] [--seconds 70]

The targets are random, and the tiles are neighboring tiles of DESI's main survey. The process is killed after the given
time, which is doubled after each kill. The script prints whether the files have the same bytes.
"""

import argparse
import subprocess
import sys
import tempfile
from pathlib import Path
from time import perf_counter

from selection_figures import all_tiles, make_targets, some_tiles


def select(folder, workers, *options):
    """Return the words of the command."""
    words = (
        "-m",
        "rfpsurvey",
        "select",
        folder / "targets.fits",
        "--instrument",
        "desi",
        "--tiles",
        folder / "tiles.ecsv",
    )
    more = "--n-realizations", 128, "--allocator", "nearest", "--workers", workers
    return [str(word) for word in (sys.executable, *words, *more, *options)]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tiles", type=int, default=1000)
    parser.add_argument("--targets", type=float, default=20e6)
    parser.add_argument("--seconds", type=float, default=70.0)
    options = parser.parse_args()
    tiles = all_tiles()
    with tempfile.TemporaryDirectory() as folder:
        folder = Path(folder)
        make_targets(tiles, int(options.targets)).write(folder / "targets.fits")
        some_tiles(tiles, options.tiles).write(folder / "tiles.ecsv")
        begin = perf_counter()
        subprocess.run(select(folder, 2, "--folder", folder / "whole"), check=True, stderr=subprocess.DEVNULL)
        print(f"one run with two workers: {perf_counter() - begin:.0f} s", flush=True)
        seconds, kills = options.seconds, 0
        while True:
            more = ("--resume",) if kills else ()
            try:
                command = select(folder, 1 + kills % 2, "--folder", folder / "parts", *more)
                subprocess.run(command, check=True, timeout=seconds, stderr=subprocess.DEVNULL)
            except subprocess.TimeoutExpired:  # the process was killed
                kills += 1
                size = sum(path.stat().st_size for path in (folder / "parts").rglob("*") if path.is_file())
                print(f"killed after {seconds:.0f} s; the folder contains {size / 1e6:.0f} MB", flush=True)
                seconds *= 2
                continue
            break
        one, other = ((folder / name) for name in ("whole", "parts"))
        names = sorted(path.name for path in one.glob("*.fits"))
        for name in names:
            same = (one / name).read_bytes() == (other / name).read_bytes()
            print(f"{name}: {'the same bytes' if same else 'DIFFERENT BYTES'} after {kills} kills")
        if not names or not kills:
            sys.exit("no file was compared, or no process was killed")


if __name__ == "__main__":
    main()
