"""Numbers on the page on benchmarks: millions of targets, dense arms, many tiles, digests of partitions.

Run ``python tests/benchmarks/crowded_figures.py``, which takes some minutes on one core and 5 GB of memory. ``--only
NAME`` runs one part.
"""

import subprocess
import sys
import tempfile
from itertools import product
from time import perf_counter

import astropy.units as u
import numpy as np
from astropy.coordinates import SkyCoord
from measure import arguments, in_circle, peak_gb, timed

import rfpsurvey as rs
from rfpsurvey._survey.request import make_rounds

CENTER = SkyCoord("06h20m00s +23d00m00s")
FIELDS = [
    *(("lamost", name, n) for name, n in product(("lamost_rule", "repair"), (2e6, 2e7))),
    ("lamost", "optimal", 2e7),
    *(("sdss_apo", "optimal", n) for n in (2e4, 1e5, 3e5, 2e6)),
    *(("sdss_apo", name, 2e6) for name in ("repair", "network_flow")),
]


def field(name, method, n):
    """Measure the planning of a tile, from the catalog in memory to the table."""
    model = rs.Instrument.preset(name)
    few = rs.synthetic_catalog("uniform", CENTER, model.field_radius, n_targets=4000, rng=1)
    rs.plan_tile(few, model, CENTER, allocator=method)
    rng = np.random.default_rng(3)
    z = 1 - rng.random(n) * (1 - np.cos(model.field_radius.to_value(u.rad)))
    catalog = rs.Catalog(CENTER.directional_offset_by(2 * np.pi * rng.random(n) * u.rad, np.arccos(z) * u.rad))
    begin = perf_counter()
    tile = rs.plan_tile(catalog, model, CENTER, allocator=method)
    seconds, s = perf_counter() - begin, tile.summary
    gap = "-" if s["gap"] is None else f"{s['gap']:g}"
    collide = s["n_colliding"]
    print(f"{name:<9} {method:<8} {n:>9} {seconds:6.1f} s {peak_gb():5.2f} GB {s['n_assigned']:>5} gap {gap} {collide}")


def dense():
    """Measure arms of 16.5 mm at a pitch of 5 mm with a limit of 5 s; the solver's presolve step would take minutes."""
    unit = rs.Positioner(8.25 * u.mm, 8.25 * u.mm, 2.25 * u.mm)
    for rings, each in ((5, 1), (5, 4), (6, 1), (6, 2), (7, 1), (7, 2)):
        plane = rs.FocalPlane.hexagonal(unit, rings=rings, pitch=5 * u.mm)
        rng, n = np.random.default_rng(rings), each * len(plane)
        options = rs.AllocationOptions("optimal", time_limit=5 * u.s)
        xy = in_circle(rng, 5 * rings + 10, n)
        plan, seconds = timed(rs.allocate, plane, xy, allocator=options, clock=perf_counter)
        print(
            f"dense {len(plane):>4} positioners {n:>4} targets {seconds:6.1f} s {plan.n_assigned:>3} of {plan.bound:g}"
        )


def tiles():
    """Measure the rounds of tiles with the field of DESI, over the whole sky and in a circle."""
    for n, cap in ((10_000, 180), (100_000, 180), (100_000, 30), (10_000, 3)):
        rng = np.random.default_rng(0)
        z = 1 - rng.random(n) * (1 - np.cos(np.deg2rad(cap)))
        angle = 2 * np.pi * rng.random(n)
        vectors = np.column_stack([np.sqrt(1 - z**2) * np.cos(angle), np.sqrt(1 - z**2) * np.sin(angle), z])
        for order in ("color", "given"):
            make_rounds(vectors[:10], 0.1, np.zeros(10, int), order)
            begin = perf_counter()
            rounds = make_rounds(vectors, 2 * np.deg2rad(1.64), np.ones(n, int), order)
            print(
                f"tiles {n:>7} within {cap:>3} deg {order:<6} {perf_counter() - begin:6.2f} s {len(rounds):>5} rounds"
            )


def digest(n=5_000_000):
    """Measure the time of the digest that identifies a partitioned catalog."""
    rng = np.random.default_rng(0)
    coord = SkyCoord(rng.uniform(0, 90, n) * u.deg, np.rad2deg(np.arcsin(rng.uniform(0, 0.7, n))) * u.deg)
    catalog = rs.Catalog(coord, priority=rng.integers(0, 5, n), visits=rng.integers(1, 4, n))
    with tempfile.TemporaryDirectory() as folder:
        parts = rs.catalog.partition_catalog(catalog, f"{folder}/sky")
        size = sum(path.stat().st_size for *_, path in parts.parts.files) / 1e6
        begin = perf_counter()
        parts.parts.digest()
        middle = perf_counter()
        parts.read()
        print(
            f"digest of {n} targets ({size:.0f} MB): {middle - begin:.2f} s; reading: {perf_counter() - middle:.2f} s"
        )


PARTS = {"dense": dense, "tiles": tiles, "digest": digest}

if __name__ == "__main__":
    given = arguments(__doc__, only="", field=["", "", ""])
    if any(given.field):
        field(given.field[0], given.field[1], int(float(given.field[2])))
        sys.exit()
    # run each part in a separate process, to measure its memory
    for one in FIELDS if given.only in ("", "fields") else ():
        subprocess.run([sys.executable, __file__, "--field", *map(str, one)], check=True)
    for name, part in PARTS.items():
        if given.only in ("", name):
            part()
