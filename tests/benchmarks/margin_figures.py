"""What margins cost and save in plans, and the margins of real plans (page on collisions).

Run ``python tests/benchmarks/margin_figures.py``, which takes about two minutes. The last part, which the argument
``real`` selects, needs ``RFPSURVEY_TEST_DATA``.
"""

import os
import sys
from dataclasses import replace
from pathlib import Path

import astropy.units as u
import numpy as np
from astropy.table import QTable
from tie_figures import scene

import rfpsurvey as rs

ALLOCATORS = ("lamost_rule", "repair", "optimal")
SEEDS = range(4)
MARGINS = {
    "desi": [rs.Margins(outer=0.2 * u.mm), rs.Margins(inner=0.1 * u.mm), rs.Margins(arms=0.05 * u.mm), "published"],
    "pfs": [rs.Margins(outer=0.1 * u.mm, inner=0.1 * u.mm)],
    "sdss_apo": [rs.Margins(outer=0.2 * u.mm, inner=0.1 * u.mm)],
}
BROKEN = 0.03
"""Fraction of the positioners that are disabled, for the margins around broken positioners."""
ERROR = 0.05
"""Standard deviation of errors of each coordinate of a target, mm."""


def usable_targets(plane, xy, allocator):
    """Return the number of assigned targets whose arms do not collide."""
    plan = rs.allocate(plane, xy, allocator=allocator)
    report = rs.find_collisions(plane, plan)
    return int(((plan.target_of_positioner >= 0) & ~report.in_collision).sum())


def row(change, label, name):
    """Print the assigned targets without collisions, in per cent of the usable positioners, averaged over scenes."""
    parts = []
    for density in (1, 2, 5):
        found = []
        for seed in SEEDS:
            plane, xy = scene(name, density, seed)
            plane = change(plane, np.random.default_rng(seed))
            counts = np.array([usable_targets(plane, xy, allocator) for allocator in ALLOCATORS])
            found.append(100 * counts / plane.arrays.usable.sum())
        parts.append(" ".join(f"{value:6.2f}" for value in np.mean(found, axis=0)))
    print(f"  {label:<84} " + " | ".join(parts), flush=True)


def with_margins(margins, broken=0.0, **columns):
    """Return a function that changes a focal plane; the fraction ``broken`` of its positioners is disabled."""
    return lambda plane, rng: replace(plane, margins=margins, disabled=rng.random(len(plane)) < broken, **columns)


def table():
    """Print what margins and allocators change."""
    print("assigned targets without collisions, per cent of the usable positioners: " + ", ".join(ALLOCATORS))
    for name, several in MARGINS.items():
        for margins in (rs.Margins(), *several):
            used = rs.Instrument.preset(name).published_margins if margins == "published" else margins
            row(with_margins(used), f"{name}, {used}", name)
    for name in MARGINS:
        for margins in (rs.Margins(), rs.Margins(broken=0.3 * u.mm), rs.Margins(broken_factor=1.0)):
            row(with_margins(margins, BROKEN), f"{name}, {100 * BROKEN:.0f} % broken, {margins}", name)


def savings():
    """Print the collisions and the targets out of reach that margins prevent, if the positions have errors."""
    print("per cent of the usable positioners, 2 targets per positioner, minimum separation without margins:")
    print(f"  repair: assigned, in collision, out of reach, lost to both (positions with errors of {ERROR} mm)")
    print("  lamost: assigned, in collision (positions without errors)")
    print("  plans assume that broken positioners are parked; for repair, their real joint angles are random")
    for name, several in MARGINS.items():
        for margins in (rs.Margins(), *several):
            used = rs.Instrument.preset(name).published_margins if margins == "published" else margins
            numbers(name, used, 0.0)
        for margins in (rs.Margins(), rs.Margins(broken=0.3 * u.mm), rs.Margins(broken_factor=1.0)):
            numbers(name, margins, BROKEN)


def numbers(name, margins, broken):
    """Print one row of the table of savings."""
    found = []
    for seed in SEEDS:
        plane, xy = scene(name, 2, seed)
        bare = with_margins(None, broken)(plane, np.random.default_rng(seed))
        rng, used, row = np.random.default_rng(100 + seed), bare.arrays.usable, []
        angles = np.where(bare.disabled[:, None], rng.uniform(0, (360, 180), (len(bare), 2)), np.nan)
        true = {"repair": replace(bare, stuck=angles * u.deg), "lamost_rule": bare}
        for allocator, error in (("repair", ERROR), ("lamost_rule", 0.0)):
            plan = rs.allocate(replace(bare, margins=margins), xy, allocator=allocator)
            filled = plan.target_of_positioner >= 0
            tips = plan.tips.to_value(u.mm) + error * rng.standard_normal((len(bare), 2))
            r, columns = np.hypot(*(tips - bare.arrays.xy).T), bare.arrays
            away = filled & ((r > columns.outer_radius) | (r < columns.inner_radius))
            tips[~filled | away] = np.nan
            report = rs.find_collisions(true[allocator], tips * u.mm, handedness=plan.handedness)
            hit = filled & report.in_collision
            row += [part.sum() for part in (filled, hit, away, hit | away)]
        found.append(100 * np.array(row[:6]) / used.sum())
    values = " ".join(f"{value:6.2f}" for value in np.mean(found, axis=0))
    label = f"{name}, {100 * broken:.0f} % broken, {margins}" if broken else f"{name}, {margins}"
    print(f"  {label:<84} {values}", flush=True)


def dots(folder):
    """Print what the factor of the radii of the dots of PFS changes."""
    hidden = rs.Instrument.read(folder / "pfs" / "black_dots_mm-2024-11-05.csv.gz").focal_plane.hidden
    for margins in (rs.Margins(), rs.Margins(hidden_factor=1.65)):
        row(with_margins(margins, hidden=hidden), f"pfs with dots, {margins}", "pfs")


def distances(model, path):
    """Print how far the targets of a real plan are from the edges of the patrol areas."""
    plan = QTable.read(path, format="ascii.ecsv") if path.suffix == ".ecsv" else rs.plans.read_plan(path)
    table, columns = rs.score_tile(plan, model).table, model.focal_plane.arrays
    used = np.asarray(table["status"]) == "assigned"
    types = table["fiber_type"] if "fiber_type" in table.colnames else ""
    columns = columns.using(columns.index_of(np.where(used, types, "")))
    r = np.hypot(table["tip_x"] - table["x"], table["tip_y"] - table["y"]).to_value(u.mm)[used]
    inner, outer = columns.inner_radius[used], columns.outer_radius[used]
    area = (outer**2 - inner**2).mean()
    for name, gaps, edge in (("outer", outer - r, outer), ("inner", r - inner, inner)):
        for limit in (0.05, 0.1, 0.2, 0.5):
            sign = -1 if name == "outer" else 1
            expected = len(r) * (np.abs((edge + sign * limit) ** 2 - edge**2) / area).mean()
            found = int((gaps < limit).sum())
            print(f"    within {limit} mm of the {name} edge: {found} of {len(r)}, {expected:.1f} if uniform")
        print(f"    nearest: {np.sort(gaps)[:5].round(3)} mm")


def real_plans(folder):
    """Print the distances from the edges for plans that were made by observatories."""
    print("real plans")
    for year, name in ((2021, "confSummary-998.par.gz"), (2024, "confSummary-test.par.gz")):
        print(f"  SDSS-V, {name}")
        distances(rs.Instrument.read(folder / f"sdssv_apo_{year}"), folder / f"sdssv_apo_{year}" / name)
    print("  SDSS-V, field planned by robostrategy, nominal instrument")
    distances(rs.Instrument.preset("sdss_apo"), folder / "sdssv_robostrategy_field_a.ecsv")
    design = rs.plans.read_plan(folder / "pfs" / "pfsDesign-0x2a3e0e7f53f47587.fits.gz")
    for model in (rs.Instrument.preset("pfs"), rs.Instrument.read(folder / "pfs" / "black_dots_mm-2024-11-05.csv.gz")):
        summary = rs.score_tile(design, model).summary
        print(f"  PFS design, {model.layout}: {summary['n_out_of_reach']} of {summary['n_targets']} out of reach")


if __name__ == "__main__":
    if "real" not in sys.argv[1:]:
        table()
        savings()
    if "RFPSURVEY_TEST_DATA" in os.environ:
        dots(Path(os.environ["RFPSURVEY_TEST_DATA"]))
        real_plans(Path(os.environ["RFPSURVEY_TEST_DATA"]))
