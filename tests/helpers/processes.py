"""Functions that run in other processes, which can import this module but not the modules of tests."""

import multiprocessing
import time

import astropy.units as u

import rfpsurvey as rs
from rfpsurvey._common.folder import locked

OPTIONS = {
    "central_arm": [8, 9] * u.mm,
    "ratio": [1, 1.5],
    "pitch": 25.6 * u.mm,
    "clearance": [1.5, 2.5] * u.mm,
    "n_designs": 24,
}


def lock_and_wait(path, begun, end):
    """Lock an output until ``end`` is set."""
    with locked(path):
        begun.set()
        end.wait(60)


def killed_at_random(compute, case, tmp_path, least, rng):
    """Yield folders whose computation was killed and resumed several times; at least ``least`` kills take effect."""
    context, begin = multiprocessing.get_context("fork"), time.perf_counter()
    compute(case, tmp_path / "clock")
    whole = time.perf_counter() - begin
    killed, run = 0, 0
    while killed < least:
        run += 1
        folder = tmp_path / f"run-{run}"
        for attempt in range(4):
            process = context.Process(target=compute, args=(case, folder), kwargs={"resume": attempt > 0})
            process.start()
            process.join(rng.uniform(0, whole))
            killed += process.is_alive()
            process.kill()
            process.join()
        compute(case, folder, resume=True)
        yield folder


def explore(path, **options):
    """Scan a few designs."""
    return rs.design.explore_designs(**{**OPTIONS, "path": path, **options})


def explore_and_tell(path, barrier, found, seed):
    """Scan a few designs when all processes have started, and report whether the file was written."""
    barrier.wait(60)
    try:
        explore(path, rng=seed, overwrite=True)
        found.put((seed, "wrote"))
    except rs.InputError as error:
        found.put((seed, str(error)))
