"""Measure selection probabilities with the tiles of DESI's main survey and random targets.

RFPSURVEY_TEST_DATA=... python tests/benchmarks/selection_figures.py [--tiles 800] [--targets 20e6] [--realizations 128]
RFPSURVEY_TEST_DATA=... python tests/benchmarks/selection_figures.py --tiles 21615

The tiles are those nearest to a position in the footprint, of all passes, so that later tiles find as few remaining
targets as in the complete survey. The catalog always contains the targets of the complete footprint. With fewer than
all tiles, the script also prints an extrapolation to all tiles: times per tile are multiplied by the number of tiles.
The time does not include making the catalog.
"""

import shutil
import tempfile
import threading
from collections import defaultdict
from concurrent.futures import ThreadPoolExecutor
from functools import wraps
from pathlib import Path
from time import perf_counter, sleep

import astropy.units as u
import numpy as np
from astropy.coordinates import SkyCoord
from measure import TILES, arguments, machine, peak_gb

import rfpsurvey as rs
from rfpsurvey._sky.arrays import SkyIndex
from rfpsurvey._survey.request import Request
from rfpsurvey._survey.selection import run as _folder
from rfpsurvey._survey.selection import run as _run
from rfpsurvey._survey.selection import select as _select
from rfpsurvey._survey.selection import work as _work
from rfpsurvey._survey.selection.work import State

FOOTPRINT = 1.6 * u.deg
MIDDLE = SkyCoord(180 * u.deg, 20 * u.deg)


def all_tiles():
    return rs.Tiling.read(TILES)


def some_tiles(tiling, n):
    """Return the n tiles nearest to a position."""
    near = np.sort(np.argsort(tiling.coord.separation(MIDDLE), kind="stable")[:n])
    return tiling if n >= len(tiling) else rs.Tiling(tiling.table[near])


def make_targets(tiling, n, rng=1):
    """Return n random targets in the footprint of the tiles."""
    rng, index = np.random.default_rng(rng), SkyIndex(tiling.vectors)
    found, total = [], 0
    while total < n:
        ra, dec = rng.uniform(0, 360, 2_000_000), np.degrees(np.arcsin(rng.uniform(-1, 1, 2_000_000)))
        coord = SkyCoord(ra * u.deg, dec * u.deg)
        vectors = np.ascontiguousarray(coord.cartesian.xyz.value.T)
        inside = index.sum_near(vectors, FOOTPRINT.to_value(u.rad), np.ones(len(index))) > 0
        found.append((ra[inside], dec[inside]))
        total += len(found[-1][0])
    ra, dec = (np.concatenate(values)[:n] for values in zip(*found, strict=True))
    return rs.Catalog(SkyCoord(ra * u.deg, dec * u.deg))


class Clock:
    """Sums the time of functions over all threads."""

    def __init__(self):
        self.seconds, self._lock = defaultdict(float), threading.Lock()

    def wrap(self, place, name, stage):
        function = getattr(place, name)

        @wraps(function)
        def timed(*args, **kwargs):
            begin = perf_counter()
            try:
                return function(*args, **kwargs)
            finally:
                with self._lock:
                    self.seconds[stage] += perf_counter() - begin

        setattr(place, name, timed)


class Disk(threading.Thread):
    """Measures the largest size of a folder."""

    def __init__(self, folder):
        super().__init__(daemon=True)
        self.folder, self.most = folder, 0

    def run(self):
        while True:
            sizes = []
            for path in self.folder.rglob("*"):
                try:
                    sizes.append(path.stat().st_size)
                except FileNotFoundError:
                    continue
            self.most = max(self.most, sum(sizes))
            sleep(0.5)


def in_batch(targets, tiling, options, folder):
    """Compute selection probabilities; return the result, the time and the times of the stages."""
    clock, main = Clock(), "(main thread)"
    for place, name, stage in (
        (_work, "reach_of", "projection and reach (workers)"),
        (_work, "choose_pairs", "rule (workers)"),
        (_work.Poses, "__init__", "poses (workers)"),
        (_work.Poses, "find_lost", "collisions (workers)"),
        (_select, "prepare_request", f"index of the targets {main}"),
        (Request, "identity", f"digest of the catalog {main}"),
        (Request, "job", f"fields {main}"),
        (State, "enter", f"state {main}"),
        (_folder.SelectionFolder, "save", f"checkpoints {main}"),
        (_run, "count_tiles", "all of the count of tiles in reach"),
        (_run.SelectionProbabilities, "write", f"writing the result {main}"),
    ):
        clock.wrap(place, name, stage)
    given = {"allocator": options.allocator, "folder": folder, "progress": options.progress}
    begin = perf_counter()
    with ThreadPoolExecutor(options.workers) as executor:
        found = rs.selection_probabilities(targets, "desi", tiling, options.realizations, executor=executor, **given)
    return found, perf_counter() - begin, dict(clock.seconds)


def alone(targets, tiling, options, seed):
    """Return the time per tile of one realization that is planned as a survey; the first tile is not included."""
    allocator, times = rs.AllocationOptions(options.allocator, subpriority=seed), []
    given = {"allocator": allocator, "rng": seed, "progress": lambda *_: times.append(perf_counter())}
    with ThreadPoolExecutor(options.workers) as executor:
        rs.plan_survey(targets, "desi", tiling, executor=executor, **given)
    return (times[-1] - times[0]) / (len(times) - 1)


def main():
    options = arguments(
        __doc__, tiles=800, targets=20e6, realizations=128, workers=2, allocator="nearest", progress=False
    )
    everything = all_tiles()
    tiling = some_tiles(everything, options.tiles)
    targets = make_targets(everything, int(options.targets))
    print(f"{machine()}, {options.workers} workers")
    print(f"{len(targets)} targets, {len(tiling)} tiles, {options.realizations} realizations, {options.allocator}")
    print(f"memory before: {peak_gb():.2f} GB", flush=True)
    small = rs.synthetic_catalog("uniform", MIDDLE, 1 * u.deg, n_targets=1000, rng=1)
    rs.selection_probabilities(small, "desi", MIDDLE.reshape(1), 2, allocator=options.allocator)  # compile
    folder = Path(tempfile.mkdtemp(prefix="selection-"))
    disk = Disk(folder)
    disk.start()
    found, seconds, stages = in_batch(targets, tiling, options, folder / "result")
    memory = peak_gb()
    shutil.rmtree(folder)
    print(found)
    print({name: value for name, value in found.summary.items() if name != "model"})
    plans = len(tiling) * options.realizations
    print(f"{seconds:.1f} s; {1e3 * seconds / plans:.4f} ms per tile and realization")
    print(f"memory {memory:.2f} GB, disk {disk.most / 1e9:.2f} GB")
    for name, value in stages.items():
        print(f"{name:<40}{value:>10.1f} s {1e3 * value / plans:>10.4f} ms per tile and realization")
    if len(tiling) < len(everything):
        once = ("index", "digest", "checkpoints", "writing")  # these times do not depend on the number of tiles
        fixed = sum(value for name, value in stages.items() if name.startswith(once))
        ratio = len(everything) / len(tiling)
        full = fixed + (seconds - fixed) * ratio
        print(f"extrapolated to {len(everything)} tiles: {full / 60:.1f} min (times per tile are assumed to be equal)")
    seed = int(found.realizations["seed"][0])
    few = some_tiles(everything, min(200, len(tiling)))
    print(f"one realization as a survey: {1e3 * alone(targets, few, options, seed):.3f} ms per tile")


if __name__ == "__main__":
    main()
