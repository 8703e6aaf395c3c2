"""Measure a survey that is observed in many chunks, with the tiles of DESI's main survey and synthetic targets.

RFPSURVEY_TEST_DATA=... python tests/benchmarks/history_figures.py [--targets 20e6] [--tiles 21615] [--chunks 60]

After each chunk, the observed tiles, their failed visits (5 %) and new targets (1 % per 12 chunks) are recorded, and
all other tiles are planned again. The command prints the time of each step; for some chunks also the ratio of the time
of this plan to the time of a survey of the remaining tiles and visits alone; and at the end the memory and the size of
the folder. The state is compared with a second replay, and the files of observed tiles with the recorded checksums.
"""

import hashlib
import os
import tempfile
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from time import perf_counter, process_time

import numpy as np
from astropy.table import Table
from measure import arguments, peak_gb
from survey_figures import desi_tiles, make_targets

import rfpsurvey as rs

FAILED, NEW_PER_CHUNK = 0.05, 0.01 / 12


def observations(survey, rows, date, rng):
    """Return a table with a row for each observed tile, and a row for each failed visit."""
    names, tiles, positioners = survey.tiles["tile"], [], []
    for row in rows:
        visits = survey.tile(names[row])
        bad = np.asarray(visits["positioner"])[rng.random(len(visits)) < FAILED]
        tiles += [names[row]] * (1 + len(bad))
        positioners += ["", *bad.astype(str).tolist()]
    return Table(
        {"tile": tiles, "positioner": positioners, "date": [date] * len(tiles), "good": [p == "" for p in positioners]}
    )


def new_targets(targets, n, first, date, rng):
    """Return a table of targets close to random targets of the catalog."""
    near = targets.coord[rng.integers(0, len(targets), n)]
    dec = np.clip(near.dec.deg + rng.normal(0, 0.1, n), -89, 89)
    ra = (near.ra.deg + rng.normal(0, 0.1, n)) % 360
    return Table(
        {"target": first + np.arange(n), "ra": ra, "dec": dec, "visits": rng.integers(1, 5, n), "date": [date] * n}
    )


def checksum(folder, row):
    """Return the checksum of the file of a tile."""
    return hashlib.sha256((folder / f"tiles/{row // 1000:03d}/{row:06d}.fits").read_bytes()).hexdigest()


def timed(function, *args, **options):
    """Call a function; return its result, and the elapsed time and the processor time in seconds."""
    begin, used = perf_counter(), process_time()
    return function(*args, **options), (perf_counter() - begin, process_time() - used)


os.environ["SOURCE_DATE_EPOCH"] = "1767225600"  # the survey is planned before the invented dates


def main():
    options = arguments(__doc__, targets=20e6, tiles=21615, chunks=60, workers=2, compared=5)
    rng, tiling = np.random.default_rng(1), desi_tiles(options.tiles)
    targets = make_targets(tiling, options.targets)
    print(f"{len(tiling)} tiles, {len(targets)} targets")
    begin = perf_counter()
    with tempfile.TemporaryDirectory() as place, ThreadPoolExecutor(options.workers) as executor:
        folder, common = Path(place) / "survey", {"allocator": "nearest", "executor": executor}
        survey, seconds = timed(rs.plan_survey, targets, "desi", tiling, folder=folder, **common)
        print(f"first plan {seconds[0]:.1f} s")
        order = np.lexsort((rng.random(len(tiling)), np.asarray(survey.tiles["pass"])))
        compared = np.linspace(0, options.chunks - 2, options.compared).astype(int)
        observed = 0
        for k, rows in enumerate(np.array_split(order, options.chunks)):
            date, observed = f"{2026 + k // 12}-{1 + k % 12:02d}-01", observed + len(rows)
            _, recording = timed(survey.record, observations(survey, rows, date, rng))
            n = int(NEW_PER_CHUNK * len(targets))
            survey.record(new_targets(targets, n, 10**9 + k * n, date, rng))
            state, replaying = timed(survey.state, targets)
            given = {"folder": folder, "visits": state, "resume": True, **common}
            survey, planning = timed(rs.plan_survey, targets, "desi", tiling, **given)
            text = f"chunk {k + 1}: {len(rows)} tiles recorded in {recording[0]:.2f} s, state {replaying[0]:.2f} s, "
            text += f"plan {planning[0]:.2f} s"
            if k in compared:
                rest = rs.Tiling(tiling.table[np.sort(order[observed:])])
                left = replace(state.catalog, visits=state.left)
                _, alone = timed(rs.plan_survey, left, "desi", rest, folder=Path(place) / f"alone{k}", **common)
                ratios = " and ".join(f"{a / b:.2f}" for a, b in zip(planning, alone, strict=True))
                text += f", {ratios} times the elapsed and processor time of the plan of the rest alone"
            print(text, flush=True)
        seconds = perf_counter() - begin
        (folder / "events" / "state.npz").unlink()
        again, replaying = timed(survey.state, targets)
        same = all((getattr(again, one) == getattr(state, one)).all() for one in ("observed", "failed", "left"))
        frozen = sum(checksum(folder, row) == event.plan for row, event in again.kept.items())
        sizes = [sum(one.stat().st_size for one in (folder / part).rglob("*.*")) for part in ("tiles", "events")]
        print(f"all {seconds:.0f} s; complete replay {replaying[0]:.1f} s, equal: {same}")
        print(f"{frozen} of {len(again.kept)} observed tiles unchanged")
        print(f"visits made {int(again.observed.sum())}, failed {int(again.failed.sum())}")
        plans, events = (size // observed for size in sizes)
        print(f"peak memory {peak_gb():.2f} GB; bytes per tile: plans {plans}, events {events}")


if __name__ == "__main__":
    main()
