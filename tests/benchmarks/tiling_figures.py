"""Numbers on the page on tiling: predicted and actual completeness, number of tiles by method, and Blanton's case.

``python tests/benchmarks/tiling_figures.py`` takes about five minutes on one core.
"""

import warnings
from pathlib import Path
from time import perf_counter

import astropy.units as u
import numpy as np
from astropy.coordinates import SkyCoord
from measure import timed

import rfpsurvey as rs
from rfpsurvey._instruments.instrument import as_instrument
from rfpsurvey.tiling import METHODS

DATA = Path(__file__).parents[2] / "data"
SEARCHES = [name for name, one in METHODS.items() if not one.needs_tiles]
GOALS = (0.9, 0.95, 0.99)
RADIUS, SEPARATION = 1.49 * u.deg, 55 * u.arcsec


def place(*arguments, **options):
    """Place tiles, and return them and the time in seconds."""
    return timed(rs.place_tiles, *arguments, **options, clock=perf_counter)


def promises(name):
    """Print the completeness that tilings predict, and that of surveys of the same tiles in both orders."""
    instrument = as_instrument(name)
    radius, n = instrument.field_radius, len(instrument.focal_plane)
    options = {"cluster_size": n // 10, "cluster_scale": 0.2 * radius, "rng": 3}
    density = n / (np.pi * radius**2)
    catalog = rs.synthetic_catalog("clustered", SkyCoord("8h +30d"), 3.5 * radius, density=density, **options)
    rs.place_tiles(catalog, instrument, n_tiles=1)  # compile the kernels
    for method in ("hexagonal", "max_density", "network_flow"):
        for goal in ({"n_tiles": 20}, {"completeness": 0.9}):
            for fibers in (n, None):
                rule = {"allocator": "lamost_rule"} if fibers is None else {"fibers": fibers}
                tiling, seconds = place(catalog, instrument, method=method, **rule, **goal)
                surveys = [
                    rs.plan_survey(catalog, instrument, tiling, allocator="lamost_rule", order=order)
                    for order in ("given", "color")
                ]
                found = "  ".join(f"{one.summary['completeness']:.4f}" for one in surveys)
                said = tiling.summary["completeness"]
                what = f"{len(tiling)} tiles, {seconds:.2f} s, says {said:.4f}, survey {found}"
                print(f"{name}, {len(catalog)} targets, {method}, {goal}, fibers {fibers}: {what}", flush=True)


def numbers_of_tiles(title, catalog, instrument, fibers):
    """Print the number of tiles that each method requires for a completeness."""
    print(f"{title}: {len(catalog)} targets, {instrument}, {fibers} fibers a tile; tiles (seconds)")
    print(f"  {'method':<18}" + "".join(f"{100 * goal:>16g} %" for goal in GOALS))
    for method in SEARCHES:
        cells = []
        for goal in GOALS:
            tiling, seconds = place(catalog, instrument, method=method, fibers=fibers, completeness=goal)
            cells.append(f"{len(tiling):>9} ({seconds:6.2f})")
        print(f"  {method:<18}" + "  ".join(cells), flush=True)


def one_pass(title, catalog, instrument, fibers):
    """Print the completeness that each method reaches with the number of tiles of one pass of the hexagonal lattice."""
    options = {"fibers": fibers, "n_tiles": len(rs.place_tiles(catalog, instrument, fibers=fibers))}
    print(f"{title}: completeness of {options['n_tiles']} tiles")
    for method in SEARCHES:
        tiling, _ = place(catalog, instrument, method=method, **options)
        print(f"  {method:<18}{tiling.summary['completeness']:.4f}", flush=True)


def blanton(density, fibers):
    """Print the completeness for clustered targets and SDSS plates as a function of the number of tiles."""
    center = SkyCoord(180 * u.deg, 30 * u.deg)
    catalog = rs.synthetic_catalog(
        "clustered", center, 10 * u.deg, density=density / u.deg**2, cluster_size=6, cluster_scale=0.15 * u.deg, rng=1
    )
    limits = {"radius": RADIUS, "fibers": rs.tiling.Fibers(fibers, SEPARATION)}
    lattice = rs.place_tiles(catalog, **limits)
    print(f"SDSS plates of {fibers} fibers, {len(catalog)} targets, {density} / deg2 over 314 deg2")
    print(f"  {'':<24}{'tiles':>6}{'all':>8}{'isolated':>10}{'fibers used':>13}{'seconds':>9}")
    report("hexagonal, one pass", lattice, 0.0)
    for n in sorted({len(lattice), *numbers(len(catalog), fibers)}):
        tiling, seconds = place(catalog, method="network_flow", n_tiles=n, **limits)
        report("network_flow", tiling, seconds)


def numbers(n_targets, fibers):
    """Return the numbers of tiles whose fibers are used to 100, 95, 90, 85 and 80 % if 95 % of the targets are
    observed.
    """
    return [round(0.95 * n_targets / (fibers * use)) for use in (1.0, 0.95, 0.9, 0.85, 0.8)]


def report(name, tiling, seconds):
    parts = [tiling.summary[key] for key in ("completeness", "completeness_isolated", "fiber_use")]
    print(f"  {name:<24}{len(tiling):>6}{parts[0]:>8.4f}{parts[1]:>10.4f}{parts[2]:>13.4f}{seconds:>9.2f}", flush=True)


if __name__ == "__main__":
    warnings.simplefilter("error")
    for name in ("lamost", "sdss_apo", "moons", "desi"):
        with warnings.catch_warnings(action="ignore"):
            promises(name)
    anticenter = rs.Catalog.read(DATA / "tycho2_anticenter_r5.ecsv.gz")
    for method in SEARCHES:  # compile the kernels
        rs.place_tiles(anticenter[::50], "lamost", method=method, n_tiles=2)
    numbers_of_tiles("Tycho-2 anticenter, 5 deg", anticenter, "sdss_apo", 500)
    one_pass("Tycho-2 anticenter, 5 deg", anticenter, "sdss_apo", 500)
    spring = rs.Catalog.read(DATA / "tycho2_spring_60x20.ecsv.gz")
    numbers_of_tiles("Tycho-2 spring, 60 x 20 deg", spring, "lamost", 1000)
    numbers_of_tiles("Tycho-2 spring, 60 x 20 deg", spring, "lamost", 250)
    one_pass("Tycho-2 spring, 60 x 20 deg", spring, "lamost", 1000)
    for density, fibers in ((90, 640), (90, 592), (120, 640), (120, 592)):
        blanton(density, fibers)
