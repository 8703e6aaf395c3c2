"""Measure a complete survey with the tiles of DESI's main survey and synthetic targets.

RFPSURVEY_TEST_DATA=... python tests/benchmarks/survey_figures.py [--targets 20e6] [--tiles 21615] [--workers 2]
RFPSURVEY_TEST_DATA=... python tests/benchmarks/survey_figures.py --scaling

The first command prints the time, the time per tile and the maximum memory; the time does not include making the
catalog. The second command increases the number of tiles, and then the number of targets.
"""

import json
import shutil
import sys
import tempfile
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from pathlib import Path
from time import perf_counter

import astropy.units as u
import numpy as np
from astropy.coordinates import SkyCoord
from measure import TILES, arguments, machine, peak_gb

import rfpsurvey as rs
from rfpsurvey._sky.arrays import SkyIndex

FOOTPRINT = 1.6 * u.deg
POLE = SkyCoord(0 * u.deg, 90 * u.deg)


def desi_tiles(most=None):
    """Return all real tiles, or the first tiles of each pass."""
    tiling = rs.Tiling.read(TILES)
    return tiling if most is None else rs.Tiling(tiling.table[: int(most)])


def make_targets(tiling, n_targets, rng=1):
    """Return targets in the footprint that require one to four visits; half of them are Poisson distributed, half are
    clustered.
    """
    rng = np.random.default_rng(rng)
    index = SkyIndex(tiling.vectors)
    radius = FOOTPRINT.to_value(u.rad)
    probe = rs.synthetic_catalog("uniform", POLE, 180 * u.deg, n_targets=200_000, rng=rng)
    part = np.mean(index.sum_near(probe.arrays.vectors, radius, np.ones(len(index))) > 0)
    n = int(0.5 * n_targets / part / 8)
    ra, dec = [], []
    for kind in ("poisson", "clustered"):
        options = {"cluster_size": 20, "cluster_scale": 0.05 * u.deg} if kind == "clustered" else {}
        for _ in range(8):
            sky = rs.synthetic_catalog(kind, POLE, 180 * u.deg, n_targets=n, rng=rng, **options)
            inside = index.sum_near(sky.arrays.vectors, radius, np.ones(len(index))) > 0
            ra.append(sky.coord.ra.deg[inside])
            dec.append(sky.coord.dec.deg[inside])
    ra, dec = np.concatenate(ra), np.concatenate(dec)
    return rs.Catalog(SkyCoord(ra * u.deg, dec * u.deg), visits=rng.integers(1, 5, len(ra)))


def plan(targets, tiling, options, folder, *, progress=True):
    """Plan and write a survey; return the survey and the time in seconds."""
    pool = ProcessPoolExecutor if options.processes else ThreadPoolExecutor
    begin = perf_counter()
    with pool(options.workers) as executor:
        survey = rs.plan_survey(
            targets, "desi", tiling, allocator=options.allocator, folder=folder, executor=executor, progress=progress
        )
    return survey, perf_counter() - begin


def one_tile(allocator):
    """Return the times (ms) of the stages of one tile with the same density of targets, without a survey."""
    sky = rs.synthetic_catalog("poisson", POLE, 1.7 * u.deg, density=1028 / u.deg**2, rng=1)
    desi = rs.Instrument.preset("desi")  # make the instrument once, because it stores its neighbors and its grid
    runs = [rs.plan_tile(sky, desi, POLE, allocator=allocator).summary["seconds"] for _ in range(21)]
    names = ("projection", "reach", "allocation", "arms", "collisions")
    return {name: round(1e3 * float(np.median([run[name] for run in runs])), 2) for name in names}


def field_ms(targets, tiling):
    """Return the time (ms) that finding the targets of a field takes."""
    index, radius = SkyIndex(targets.arrays.vectors), FOOTPRINT.to_value(u.rad)
    times = []
    for center in tiling.vectors[:1000]:
        begin = perf_counter()
        index.near(center, radius)
        times.append(perf_counter() - begin)
    return 1e3 * float(np.median(times))


def scale(options):
    """Print the time against the number of tiles and against the number of targets."""
    tiling = desi_tiles()
    shuffled = rs.Tiling(tiling.table[np.random.default_rng(1).permutation(len(tiling))])
    cases = [(shuffled.table[: len(tiling) // k], 5e6) for k in (8, 4, 2, 1)]
    cases += [(tiling.table, n) for n in (2.5e6, 5e6, 10e6, 20e6)]
    found, targets = [], None
    for table, n in cases:
        if targets is None or abs(len(targets) / n - 1) > 0.1:
            targets = make_targets(tiling, n)
        with tempfile.TemporaryDirectory() as folder:
            _, seconds = plan(targets, rs.Tiling(table), options, Path(folder) / "survey", progress=False)
        found.append((len(table), len(targets), seconds))
        print(f"{len(table):>6} tiles {len(targets):>9} targets {seconds:7.1f} s", flush=True)
    found = np.log(np.array(found))
    for name, column, rows in (("tiles", 0, found[:4]), ("targets", 1, found[4:])):
        print(
            f"seconds grow with the power {np.polyfit(rows[:, column], rows[:, 2], 1)[0]:.2f} of the number of {name}"
        )


def main():
    given = {"tiles": int, "processes": False, "partitions": Path, "allocator": "nearest", "folder": Path, "plot": Path}
    options = arguments(__doc__, targets=20e6, workers=2, scaling=False, **given)
    print(machine())
    few = rs.synthetic_catalog("uniform", POLE, 2 * u.deg, n_targets=1000, rng=1)
    rs.plan_survey(few, "desi", POLE.reshape(1), allocator=options.allocator)  # compile the kernels
    if options.scaling:
        return scale(options)
    print(f"stages of a tile with all its targets, ms: {one_tile(options.allocator)}")
    tiling = desi_tiles(options.tiles)
    if options.partitions and options.partitions.exists():
        targets = rs.catalog.PartitionedCatalog(options.partitions)
    else:
        targets = make_targets(tiling, options.targets)
        if options.partitions:
            targets = rs.catalog.partition_catalog(targets, options.partitions)
    print(f"{len(tiling)} tiles, {len(targets)} targets; memory so far: {peak_gb():.2f} GB")
    folder = options.folder or Path(tempfile.mkdtemp()) / "survey"
    survey, seconds = plan(targets, tiling, options, folder)
    size = sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())
    kind = "processes" if options.processes else "threads"
    print(f"{seconds:.1f} s, {1e3 * seconds / len(tiling):.2f} ms a tile, {options.workers} {kind}")
    print(f"peak memory {peak_gb():.2f} GB, {size / 1e9:.2f} GB written")
    survey.completeness.pprint_all()
    print(json.dumps(survey.summary, indent=1))
    if isinstance(targets, rs.Catalog):
        print(f"finding the targets of a field: {field_ms(targets, tiling):.2f} ms")
    if options.plot:
        rs.plot.plot_completeness(survey).figure.savefig(options.plot, dpi=150)
    if options.folder is None:
        shutil.rmtree(folder)
    return None


if __name__ == "__main__":
    sys.exit(main())
