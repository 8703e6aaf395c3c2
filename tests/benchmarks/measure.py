"""What scripts that measure share: the arguments of a command line, times, memory, and scenes."""

import argparse
import os
import platform
import resource
from pathlib import Path
from time import perf_counter, process_time

import astropy.units as u
import numpy as np

import rfpsurvey as rs

DATA = Path(os.environ.get("RFPSURVEY_TEST_DATA", "data"))
TILES = DATA / "desi_tiles_main.ecsv.gz"


def arguments(text, words=None, **defaults):
    """Return the arguments of a script: options, and optional ``words``, all of which are chosen by default.

    The default of an option is False for a flag, a list for several values, and a type for a value without default.
    """
    parser = argparse.ArgumentParser(description=text, formatter_class=argparse.RawDescriptionHelpFormatter)
    if words is not None:
        parser.add_argument("words", nargs="*", default=[*words], help=", ".join(map(str, words)))
    for name, value in defaults.items():
        given = {"type": value} if isinstance(value, type) else {"default": value, "type": type(value)}
        given = {"default": value, "nargs": "*", "type": type(value[0])} if isinstance(value, list) else given
        parser.add_argument(f"--{name.replace('_', '-')}", **({"action": "store_true"} if value is False else given))
    return parser.parse_args()


def timed(function, *args, clock=process_time, **options):
    """Return the result of a function, and its time in seconds; by default, the processor time."""
    begin = clock()
    found = function(*args, **options)
    return found, clock() - begin


def alternated(functions, repeats, clock=process_time):
    """Return the times (s) of functions that are called alternately; the first calls, which compile, do not count."""
    return np.array([[timed(call, clock=clock)[1] for call in functions] for _ in range(repeats + 1)])[1:]


def smallest(function, repeats, clock=perf_counter):
    """Return the smallest time (s) of a function after a first call."""
    return alternated([function], repeats, clock).min()


def peak_gb():
    """Return the maximum memory of this process so far."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6


def machine():
    return f"{platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}, NumPy {np.__version__}"


def in_circle(rng, radius, n):
    """Return points (mm) that are uniform in a circle."""
    r, angle = radius * np.sqrt(rng.random(n)), 2 * np.pi * rng.random(n)
    return np.column_stack([r * np.cos(angle), r * np.sin(angle)]) * u.mm


def hexagon(central, eccentric, clearance, pitch, rings, step=0.0):
    """Return a full hexagon of positioners (mm, and deg for the step)."""
    unit = rs.Positioner(central * u.mm, eccentric * u.mm, clearance * u.mm, step=step * u.deg)
    return rs.FocalPlane.hexagonal(unit, rings=rings, pitch=pitch * u.mm)
