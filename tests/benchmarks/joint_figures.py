"""Compare joint plans with plans that are made tile after tile.

RFPSURVEY_TEST_DATA=... python tests/benchmarks/joint_figures.py [sdss lamost moons desi scan] [--seconds 1800]

Each case prints the visits of the allocators tile after tile, the bound of a matching without collisions, and the
table of the joint plan. ``scan`` prints the gain as a function of the overlap of tiles, the targets per fiber and the
clustering, which docs/figures/joint_gain.py plots.
"""

import warnings
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from time import perf_counter

import astropy.units as u
import numpy as np
from astropy.coordinates import SkyCoord
from measure import DATA, arguments, peak_gb, timed

import rfpsurvey as rs

CENTER = SkyCoord(180 * u.deg, 30 * u.deg)


def placed(_, name, file="tycho2_spring_60x20.ecsv.gz", passes=1, **joint):
    """Return targets from a file, an instrument, placed tiles, and options of the joint plan."""
    sky = rs.Catalog.read(DATA / file)
    return sky, name, rs.place_tiles(sky, name, passes=passes, allocator="lamost_rule"), joint


def desi(options):
    """Return clustered targets that require one to four visits, and the tiles of five passes around the center.

    The arms are segments.
    """
    rng = np.random.default_rng(1)
    tiling = rs.Tiling.read(DATA / "desi_tiles_main.ecsv.gz").table
    rows = []
    for number in np.unique(tiling["pass"])[:5]:
        of_pass = np.flatnonzero(tiling["pass"] == number)
        apart = SkyCoord(tiling["ra"][of_pass], tiling["dec"][of_pass]).separation(CENTER)
        rows.append(of_pass[np.argsort(apart)[: options.tiles // 5]])
    tiling = rs.Tiling(tiling[np.sort(np.concatenate(rows))])
    radius = tiling.coord.separation(CENTER).max() + 1.6 * u.deg
    sky = rs.synthetic_catalog(
        "clustered", CENTER, radius, density=options.density / u.deg**2, cluster_size=20,
        cluster_scale=0.05 * u.deg, rng=rng,
    )  # fmt: skip
    n = len(sky)
    catalog = rs.Catalog(sky.coord, visits=rng.integers(1, 5, n), priority=rng.integers(1, 3, n))
    return catalog, rs.Instrument.preset("desi").with_arm_model("elbow_to_tip"), tiling, {}


def with_calibration(catalog, instrument):
    """Return the catalog with a tenth of its targets as standards, and options with sky fibers and requirements.

    The requirements are those of the instrument, without fiber types. Sky positions are found between the targets.
    """
    kind = np.where(np.arange(len(catalog)) % 10 == 0, "standard", "science")
    known = rs.Instrument.preset(instrument) if isinstance(instrument, str) else instrument
    needs = ["sky=85", "standard=20"] if known.name == "sdss_apo" else known.requirements
    return replace(catalog, kind=kind), {"requirements": needs, "sky_separation": 5 * u.arcsec}


moons = partial(placed, name="moons", file="zcosmos_bright.ecsv", passes=2, patch_size=600)
CASES = {
    "sdss": partial(placed, name="sdss_apo"),
    "lamost": partial(placed, name="lamost"),
    "moons": moons,
    "desi": desi,
}


def visits_of(survey):
    """Return the visits by priority, and the visits after each pass, as text."""
    table = survey.completeness
    last = table[table["pass"] == table["pass"][-1]]
    every = table[table["priority"] == "all"]["n_observed"].tolist()
    classes = {str(row["priority"]): int(row["n_observed"]) for row in last if row["priority"] != "all"}
    return f"{survey.summary['n_visits_observed']}, after each pass {every}, by priority {classes}"


def compare(name, options, executor):
    """Print the visits of all plans of a case."""
    catalog, instrument, tiling, joint = CASES[name](options)
    catalog, needs = with_calibration(catalog, instrument) if options.calibration else (catalog, {})
    print(f"{name}: {len(catalog)} targets, {len(tiling)} tiles, {instrument}, {needs}", flush=True)
    limit = {"time_limit": options.tile_seconds * u.s, **needs}
    for allocator in ("lamost_rule", "repair", "optimal"):
        asked = rs.AllocationOptions(allocator, **(limit if allocator == "optimal" else needs))
        given = {"allocator": asked, "executor": executor, "clock": perf_counter}
        survey, seconds = timed(rs.plan_survey, catalog, instrument, tiling, **given)
        print(f"  {allocator}: {visits_of(survey)}, {seconds:.0f} s", flush=True)
    begin = perf_counter()
    first = rs.AllocationOptions("optimal", **limit)
    joint |= {"time_limit": options.seconds * u.s, "allocator": first, "early": options.early}
    together = rs.JointOptions(iterations=1000, gap=2e-5, **joint)
    survey = rs.plan_survey(catalog, instrument, tiling, allocator=together, executor=executor)
    print(f"  joint: {visits_of(survey)}, {perf_counter() - begin:.0f} s", flush=True)
    print(f"  requirements that are not met: {int(survey.tiles['n_unmet'].sum())}, {peak_gb():.2f} GB")
    survey.joint.pprint_all()
    for level in survey.summary["joint"]["levels"]:
        first = survey.joint[survey.joint["priority"] == level["priority"]]["bound"].max()
        before, distance = level["n_visits_before"], max(level["bound"] - level["n_visits_before"], 1)
        closed = (level["n_visits"] - before) / distance
        print(f"  priority {level['priority']}: {level}; {closed:.0%} of the distance to the bound, {first} at first")


def scan_case(spacing, per_fiber, clustered):
    """Return a catalog and seven tiles at a spacing in units of the diameter of the field."""
    sdss_v = rs.Instrument.preset("sdss_apo")
    step = 2 * spacing * sdss_v.field_radius
    angle = np.arange(6) * 60 * u.deg
    around = CENTER.directional_offset_by(angle, step)
    tiles = SkyCoord([CENTER.ra, *around.ra], [CENTER.dec, *around.dec])
    radius = step + sdss_v.field_radius
    area = np.pi * radius.to_value(u.deg) ** 2
    density = per_fiber * 7 * len(sdss_v.focal_plane) / area / u.deg**2
    options = {"cluster_size": 10, "cluster_scale": 0.05 * u.deg} if clustered else {}
    kind = "clustered" if clustered else "poisson"
    return rs.synthetic_catalog(kind, CENTER, radius, density=density, rng=1, **options), sdss_v, tiles


def scan(options, executor):
    """Print and write the gain of joint plans over plans that are made tile after tile."""
    for clustered in (False, True):
        points = [(s, 1.0) for s in (0.2, 0.4, 0.6, 0.8, 1.0)] + [(0.4, n) for n in (0.25, 0.5, 2.0, 4.0)]
        for spacing, per_fiber in points:
            catalog, instrument, tiles = scan_case(spacing, per_fiber, clustered)
            first = rs.AllocationOptions("optimal", time_limit=options.tile_seconds * u.s)
            search = {"iterations": 20, "gap": 2e-4, "patch_size": 600, "time_limit": options.scan_seconds * u.s}
            joint = rs.JointOptions(**search, allocator=first)
            survey = rs.plan_survey(catalog, instrument, tiles, allocator=joint, executor=executor)
            level = survey.summary["joint"]["levels"][-1]
            seconds = float(survey.joint["seconds"][-1])
            before, after, bound = level["n_visits_before"], level["n_visits"], level["bound"]
            print(spacing, per_fiber, clustered, len(catalog), before, after, bound, f"{seconds:.0f} s", end=" ")
            print(f"gain {after / before - 1:.2%}, at most {bound / before - 1:.2%}", flush=True)


def main():
    seconds = {"seconds": 1800.0, "tile_seconds": 20.0, "scan_seconds": 60.0}
    options = arguments(__doc__, [*CASES, "scan"], **seconds, calibration=False, early=False, tiles=100, density=1500.0)
    warnings.simplefilter("ignore", rs.RfpsurveyWarning)
    with ThreadPoolExecutor(2) as executor:
        for name in options.words:
            if name in CASES:
                compare(name, options, executor)
            else:
                scan(options, executor)


if __name__ == "__main__":
    main()
