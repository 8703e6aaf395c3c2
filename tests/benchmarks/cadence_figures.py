"""Measure completed cadences on a field of 30 dated SDSS-V tiles with the published cadences of SDSS-V.

RFPSURVEY_TEST_DATA=... python tests/benchmarks/cadence_figures.py [--targets 1500] [--tiles 30] [--iterations 10]
    [--realizations 0]

Each allocator plans the tiles in the order of their dates; targets whose windows close first have precedence, or, for
comparison, random subpriorities decide. The bound is the number of targets whose cadences the dates and the brightness
of the tiles allow, if every target in the field could be observed on every tile. The joint plan has bounds of its own.
With --realizations, the script prints only the time per realization of selection probabilities, with the cadences and
with the same numbers of visits at any time.
"""

import os
from pathlib import Path
from tempfile import TemporaryDirectory
from time import process_time

import astropy.units as u
import numpy as np
from astropy.coordinates import SkyCoord
from astropy.table import QTable, Table
from measure import arguments

import rfpsurvey as rs
from rfpsurvey._survey.cadences import Windows
from rfpsurvey.survey import Cadences

CENTER = SkyCoord("6h20m +23d")
ALLOCATORS = ("nearest", "lamost_rule", "repair", "optimal")


def dated_tiles(n, rng):
    """Return tiles in two of three nights, up to three in a night; two of three nights are dark."""
    night = np.sort(rng.integers(0, 2 * n, n))
    table = QTable({"tile": np.arange(n), "mjd": 61000.0 + night + np.arange(n) % 3 / 30})
    places = [CENTER.spherical_offsets_by(*(rng.uniform(-0.05, 0.05, 2) * u.deg)) for _ in range(n)]
    table["ra"], table["dec"] = [u.Quantity([getattr(one, name) for one in places]) for name in ("ra", "dec")]
    table["skybrightness"] = np.where(night % 3 < 2, 0.3, 0.9)
    return rs.Tiling.from_table(table)


def bound(cadences, row, tiling):
    """Return the number of targets that complete their cadences if fibers are unlimited."""
    days = np.asarray(tiling.table["mjd"])
    windows = Windows(cadences, row, days, np.asarray(tiling.table["skybrightness"]))
    for tile in np.argsort(days, kind="stable").tolist():
        windows.observe(np.arange(len(row)), tile)
    return windows.n_epochs


def time_realizations(catalog, instrument, tiling, cadences, n):
    """Print the time per realization of each allocator with and without cadences."""
    for allocator in ("nearest", "lamost_rule", "repair"):
        seconds, own = [], rs.AllocationOptions(allocator, subpriority=1)
        for visits in (cadences, cadences.visits(catalog)):
            with TemporaryDirectory() as folder:
                plan = rs.plan_survey(
                    catalog, instrument, tiling, visits=visits, allocator=own, folder=f"{folder}/plan"
                )
                plan.select(1)  # compiles the kernels
                begin = process_time()
                found = plan.select(n)
                seconds.append((process_time() - begin) / n)
            visits = found.summary["n_observed"] / n
            print(f"{allocator:12} {1e3 * seconds[-1]:.1f} ms per realization, {visits:.0f} visits")
        print(f"{allocator:12} ratio {seconds[0] / seconds[1]:.2f}")


def main():
    options = arguments(__doc__, targets=1500, tiles=30, iterations=10, realizations=0)
    table = Table.read(Path(os.environ["RFPSURVEY_TEST_DATA"]) / "sdssv_rules/cadences.ecsv")
    table = table[table["n_epochs"] > 0]
    rng, apo = np.random.default_rng(1), rs.Instrument.preset("sdss_apo")
    tiling, cadences = dated_tiles(options.tiles, rng), Cadences(table)
    sky = rs.synthetic_catalog("uniform", CENTER, 1.4 * u.deg, n_targets=options.targets, rng=2)
    name = rng.choice(np.asarray(table["cadence"]), len(sky))
    catalog = rs.Catalog(sky.coord, extra=QTable({"cadence": name}))
    if options.realizations:
        time_realizations(catalog, apo, tiling, cadences, options.realizations)
        return
    n = cadences.visits(catalog)
    row = cadences.of(catalog)
    whole = np.array([len(str(table["n_exp"][k]).split()) for k in row])
    most = bound(cadences, row, tiling)
    inside = catalog.coord.separation(CENTER) < 1.4 * u.deg
    print(f"{len(tiling)} tiles, {len(catalog)} targets, {n.sum()} visits of {whole.sum()} epochs")
    print(f"if fibers were unlimited: {(most == whole)[inside].sum()} complete at most, {most[inside].sum()} epochs")
    for allocator in ALLOCATORS:
        for subpriority, words in ((None, "window that closes first"), (1, "random")):
            begin, own = process_time(), rs.AllocationOptions(allocator, subpriority=subpriority)
            survey = rs.plan_survey(catalog, apo, tiling, visits=cadences, allocator=own)
            found = survey.summary
            print(
                f"{allocator:12} {words:25} {found['n_complete']} complete, "
                f"{survey.outcomes['n_epochs'].sum()} epochs, "
                f"{found['n_released']} released, {process_time() - begin:.1f} s",
                flush=True,
            )
    begin, joint = process_time(), rs.JointOptions(iterations=options.iterations)
    survey = rs.plan_survey(catalog, apo, tiling, visits=cadences, allocator=joint)
    print(f"joint: {survey.summary['n_complete']} complete, {process_time() - begin:.1f} s")
    survey.joint.pprint_all()


if __name__ == "__main__":
    main()
