"""What margins and allocators change in plans, and the margins of real plans (page on margins).

Run ``python tests/benchmarks/margin_figures.py``, which takes about four minutes. The second part needs
``RFPSURVEY_TEST_DATA``.
"""

import os
import sys
from pathlib import Path

import astropy.units as u
import numpy as np
from tie_figures import scene

import rfpsurvey as rs

ALLOCATORS = ("lamost", "repair", "optimal")
SEEDS = range(4)
MARGINS = {
    "desi": [rs.Margins(outer=0.2 * u.mm), rs.Margins(inner=0.1 * u.mm), rs.Margins(arms=0.05 * u.mm), "published"],
    "pfs": [rs.Margins(outer=0.1 * u.mm, inner=0.1 * u.mm), "published"],
    "sdss_apo": [rs.Margins(outer=0.2 * u.mm, inner=0.1 * u.mm)],
}
BROKEN = 0.03
"""Fraction of the positioners that are disabled, for the margins around broken positioners."""


def usable_targets(plane, xy, allocator):
    """Return the number of assigned targets whose arms do not collide."""
    plan = rs.allocate(plane, xy, allocator=allocator)
    report = rs.find_collisions(plane, plan)
    return int(((plan.target_of_positioner >= 0) & ~report.in_collision).sum())


def table():
    """Print the assigned targets without collisions, in per cent of the usable positioners, averaged over scenes."""
    from dataclasses import replace

    print("assigned targets without collisions, per cent of the usable positioners: " + ", ".join(ALLOCATORS))
    cases = [(name, 0.0, margins) for name, several in MARGINS.items() for margins in (None, *several)]
    near = (rs.Margins(broken=0.3 * u.mm), rs.Margins(broken_factor=1.0))
    cases += [(name, BROKEN, margins) for name in ("desi", "pfs", "sdss_apo") for margins in (None, *near)]
    for name, broken, margins in cases:
        if margins == "published":
            margins = rs.Instrument.preset(name).published_margins
        row = []
        for density in (1, 2, 5):
            found = []
            for seed in SEEDS:
                plane, xy = scene(name, density, seed)
                disabled = np.random.default_rng(seed).random(len(plane)) < broken
                plane = replace(plane, margins=margins, disabled=disabled)
                n = plane.arrays.usable.sum()
                found.append([100 * usable_targets(plane, xy, allocator) / n for allocator in ALLOCATORS])
            row.append(" ".join(f"{value:6.2f}" for value in np.mean(found, axis=0)))
        label = f"{name}, {100 * broken:.0f} % broken" if broken else name
        print(f"  {label:<20} {margins or 'none':<60} " + " | ".join(row), flush=True)


def distances(model, plan, **options):
    """Print how far the targets of a real plan are from the edges of the patrol areas."""
    tile = rs.score_tile(rs.plans.read_plan(plan), model, **options)
    table = tile.table[tile.table["status"] == "assigned"]
    plane, kind = model.focal_plane, np.asarray(table["fiber_type"]).astype(str)
    rows = np.flatnonzero(np.isin(plane.id, np.asarray(table["positioner"])))
    order = np.argsort(np.asarray(table["positioner"]), kind="stable")
    rows = rows[np.argsort(plane.id[rows], kind="stable")]
    fiber = plane.arrays.first_index.copy()
    fiber[rows] = plane.arrays.index_of(kind[order], rows)
    columns = plane.arrays.using(fiber)
    r = np.hypot(table["tip_x"] - table["x"], table["tip_y"] - table["y"]).to_value(u.mm)[order]
    outer, inner = columns.outer_radius[rows] - r, r - columns.inner_radius[rows]
    share = 2 * np.pi * columns.outer_radius[rows].mean()
    for name, gaps in (("outer", outer), ("inner", inner)):
        shares = ", ".join(f"{limit} mm: {int((gaps < limit).sum())}" for limit in (0.05, 0.1, 0.2, 0.4))
        print(
            f"    {len(r)} targets, distance from the {name} edge: smallest {np.sort(gaps)[:3].round(3)}; within {shares}"
        )
    area = np.pi * (columns.outer_radius[rows] ** 2 - columns.inner_radius[rows] ** 2).mean()
    print(f"    uniform targets: {len(r) * share * 0.1 / area:.1f} within 0.1 mm of the outer edge")


def real_plans(folder):
    """Print the distances from the edges for plans that were made by observatories."""
    print("real plans")
    for year, name in ((2021, "confSummary-998.par.gz"), (2024, "confSummary-test.par.gz")):
        print(f"  SDSS-V, {name}")
        distances(rs.Instrument.read(folder / f"sdssv_apo_{year}"), folder / f"sdssv_apo_{year}" / name)
    print("  PFS design, centers derived from the dots")
    model = rs.Instrument.read(folder / "pfs" / "black_dots_mm-2024-11-05.csv.gz")
    distances(model, folder / "pfs" / "pfsDesign-0x2a3e0e7f53f47587.fits.gz")


if __name__ == "__main__":
    if "real" not in sys.argv[1:]:
        table()
    if "RFPSURVEY_TEST_DATA" in os.environ:
        real_plans(Path(os.environ["RFPSURVEY_TEST_DATA"]))
