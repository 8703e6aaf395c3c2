"""Functions that run in other processes, which can import this module but not the modules of tests."""

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
