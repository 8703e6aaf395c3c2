"""Finished targets of joint plans that maximize visits or finished targets (page on finished targets).

Run ``python tests/benchmarks/finished_figures.py``, which takes about ten minutes. With ``--share``, it prints the
finished fractions of three categories with and without shares. With ``--peer``, it plans each scene also with netflow,
the planner of PFS (``planners/pfs_netflow.py`` states how to install it), with a time limit of ``--peer-seconds``.
``planners/judge.py`` counts the finished targets of both plans; visits by fibers that collide do not count. With
``--galaxies``, it plans 42 exposures for the galaxies of the survey of PFS in one field (338,900 by default).
"""

import sys
import warnings
from dataclasses import replace
from pathlib import Path
from resource import RUSAGE_SELF, getrusage
from time import process_time, time

import astropy.units as u
import numpy as np
from astropy.coordinates import SkyCoord
from astropy.table import QTable, Table, vstack
from measure import arguments, in_circle

import rfpsurvey as rs

CENTER = SkyCoord("10h +20d")
GALAXIES = {
    "visits": [2, 2, 2, 12, 6, 6, 12, 6, 3, 6, 12, 8],
    "number": [68_200, 69_300, 96_300, 14_400, 22_000, 8_300, 14_000, 22_000, 7_400, 4_500, 2_800, 9_700],
}
"""Classes of galaxies of the survey of PFS (Wang & Melchior 2022, arXiv:2109.13361): exposures, number of galaxies."""
SMALL = [(n, seed) for n in (320, 600, 1000) for seed in range(21, 25)]


def scene(n, seed, n_cobras=400, exposures=3):
    """Return targets of one field of PFS that need 1 to 3 visits, its central cobras, and exposures of this field."""
    pfs = rs.Instrument.preset("pfs")
    xy = pfs.focal_plane.xy.to_value(u.mm)
    xy = xy[np.argsort(np.hypot(*xy.T))[:n_cobras]]
    pfs = replace(pfs, focal_plane=rs.FocalPlane(xy * u.mm, pfs.focal_plane.positioner))
    rng = np.random.default_rng(seed)
    sky = pfs.projection(CENTER).to_sky(in_circle(rng, np.hypot(*xy.T).max() + 4.75, n))
    visits = rng.choice([1, 2, 3], n, p=[0.4, 0.3, 0.3])
    tiles = QTable(
        {name: np.full(exposures, value) * u.deg for name, value in zip(("ra", "dec"), (150, 20), strict=True)}
    )
    tiles["pass"] = np.arange(1, exposures + 1)
    return rs.Catalog(sky, id=np.arange(n), visits=visits), pfs, tiles


def measured(objective, seconds, catalog, pfs, tiles):
    """Return the numbers of finished targets and of visits, the upper bound, the processor time, and the survey."""
    joint = rs.JointOptions(objective=objective, time_limit=seconds * u.s)
    begin = process_time()
    survey = rs.plan_survey(catalog, pfs, tiles, allocator=joint)
    spent, made = process_time() - begin, np.asarray(survey.outcomes["observed"])
    bound = survey.summary["joint"]["levels"][0].get("bound_complete")
    return int((made >= catalog.visits).sum()), int(made.sum()), bound, spent, survey


def print_peer(seconds, peer_seconds, catalog, pfs, tiles):
    """Print the bounds and times of a joint plan and of a plan of netflow, and what the judge counts."""
    sys.path.append(str(Path(__file__).parent / "planners"))
    try:
        import pfs_netflow
    except ImportError as error:
        raise SystemExit(error) from None
    from scene import scene_of

    xy = pfs.projection(CENTER).to_focal_plane(catalog.coord)
    whole = scene_of(pfs, Table(xy.to_value(u.mm), names=("x", "y")), name="finished")
    _, _, bound, spent, survey = measured("finished", seconds, catalog, pfs, tiles)
    parts = [(tile["positioner"], tile["target_id"], np.full(len(tile), k)) for k, tile in enumerate(survey)]
    plan = vstack([Table(part, names=("positioner", "target", "exposure")) for part in parts])
    print(f"  rfpsurvey: bound {bound}, {spent:.2f} s; {judged(whole, catalog, pfs, plan)}", flush=True)
    plan, solved, facts = pfs_netflow.plan(whole, peer_seconds, catalog.visits, len(tiles))
    times = f"{facts['pairs_s']:.2f} s to build and {solved:.2f} s to solve the program"
    print(f"  netflow: bound {facts['bound']}, {times}; {judged(whole, catalog, pfs, plan)}", flush=True)


def judged(whole, catalog, pfs, plan):
    """Return a text with the numbers of finished targets and colliding fibers of a plan, without and with idle arms."""
    from judge import judge_tile

    text = []
    for idle, name in ((False, "without idle arms"), (True, "with idle arms")):
        made, colliding = np.zeros(len(catalog), dtype=int), 0
        for k in np.unique(plan["exposure"]):
            part = plan[plan["exposure"] == k]
            counts, observed, wrong = judge_tile((whole.positioners, whole.targets, whole.settings), part, idle)
            made[[int(target) for _, target, _ in observed]] += 1
            colliding += counts["colliding"]
            tips = np.full((len(whole.positioners), 2), np.nan)
            rows = np.asarray(part["positioner"])  # identifiers are row numbers
            tips[rows] = np.column_stack([whole.targets[axis][part["target"]] for axis in ("x", "y")])
            report = rs.find_collisions(pfs.focal_plane, tips * u.mm, parked_obstacles=idle)
            assert not +wrong, wrong
            assert report.in_collision[rows].sum() == counts["colliding"], (report, counts)
        text.append(f"{name}: {(made >= catalog.visits).sum()} finished, {colliding} fibers collide")
    return "; ".join(text)


def galaxies(fraction, n_cobras, exposures):
    """Return galaxies in one field of PFS, its central cobras, and exposures of this field, like `scene`."""
    number = [round(n * fraction * n_cobras / 2394) for n in GALAXIES["number"]]
    catalog, pfs, tiles = scene(sum(number), 1, n_cobras, exposures)
    category = np.repeat([f"class{k:02d}" for k in range(1, 13)], number)
    return replace(catalog, visits=np.repeat(GALAXIES["visits"], number), category=category), pfs, tiles


def print_galaxies(seconds, scene_of_galaxies):
    """Print the finished fractions of classes of galaxies for shares, for priorities, and for visits tile by tile."""
    catalog, pfs, tiles = scene_of_galaxies
    names = np.unique(catalog.category)
    print(f"{len(catalog)} galaxies, {int(catalog.visits.sum())} visits requested, {len(tiles)} exposures")
    ordered = replace(catalog, priority=-np.unique(catalog.category, return_inverse=True)[1].astype(float))
    limit = {"objective": "finished", "iterations": 2, "time_limit": seconds * u.s}
    plans = {
        "shares": (catalog, rs.JointOptions(share="category", **limit)),
        "finished": (catalog, rs.JointOptions(**limit)),
        "finished, priorities": (ordered, rs.JointOptions(**limit)),
        "visits, tile by tile": (catalog, "optimal"),
    }
    for name, (targets, allocator) in plans.items():
        begin = process_time(), time()
        survey = rs.plan_survey(targets, pfs, tiles, allocator=allocator)
        spent, made = (process_time() - begin[0], time() - begin[1]), np.asarray(survey.outcomes["observed"])
        done = made >= catalog.visits
        fractions = [float(done[catalog.category == one].mean()) for one in names]
        joint = survey.summary.get("joint", {"levels": [{}]})
        bounds = joint.get("bound_of_smallest"), joint["levels"][-1].get("bound_complete")
        print(
            f"{name}: {done.sum()} finished, {made.sum()} visits, bounds {bounds}, {spent[0]:.0f} s ({spent[1]:.0f} s)"
        )
        print("  " + " ".join(f"{fraction:.4f}" for fraction in fractions), flush=True)
        print(
            f"  {survey.summary['n_colliding']} colliding, {getrusage(RUSAGE_SELF).ru_maxrss / 1e6:.2f} GB", flush=True
        )


def print_shares(seconds):
    """Print the finished fractions of three categories, whose targets need different numbers of visits."""
    catalog, pfs, tiles = scene(7182, 5, 2394, 7)
    category = np.random.default_rng(1).choice(["main", "guest", "filler"], len(catalog), p=[0.6, 0.25, 0.15])
    visits = np.where(category == "main", np.maximum(catalog.visits, 2), 1)
    catalog = replace(catalog, category=category, visits=visits)
    for share in (None, "category"):
        joint = rs.JointOptions(objective="finished", share=share, time_limit=seconds * u.s)
        survey = rs.plan_survey(catalog, pfs, tiles, allocator=joint)
        done = np.asarray(survey.outcomes["observed"]) >= visits
        fractions = {name: round(float(done[category == name].mean()), 4) for name in ("main", "guest", "filler")}
        print(f"share {share}: {fractions}, bound {survey.summary['joint'].get('bound_of_smallest')}", flush=True)


if __name__ == "__main__":
    warnings.simplefilter("ignore", rs.errors.RfpsurveyWarning)
    given = arguments(
        __doc__, seconds=60.0, large=240.0, share=False, peer=False, peer_seconds=600.0, galaxies=False, fraction=1.0
    )
    if given.galaxies:
        raise SystemExit(print_galaxies(10 * given.seconds, galaxies(given.fraction, 2394, 42)))
    if given.share:
        raise SystemExit(print_shares(given.large))
    scenes = [(given.seconds, {"n": n, "seed": seed}) for n, seed in SMALL]
    scenes += [(given.large, {"n": 7182, "seed": seed, "n_cobras": 2394, "exposures": 7}) for seed in (5, 6)]
    measured("finished", 1.0, *scene(320, 1))
    for seconds, options in scenes:
        if given.peer:
            print(options, flush=True)
            print_peer(seconds, given.peer_seconds, *scene(**options))
            continue
        catalog, pfs, tiles = scene(**options)
        for subpriority in (None, "fewest remaining visits"):
            allocator = rs.AllocationOptions("optimal", subpriority=subpriority)
            made = np.asarray(rs.plan_survey(catalog, pfs, tiles, allocator=allocator).outcomes["observed"])
            print(f"{options} tile by tile, subpriority {subpriority}: {(made >= catalog.visits).sum()} finished")
        for objective in ("visits", "finished"):
            done, visits, bound, spent, _ = measured(objective, seconds, catalog, pfs, tiles)
            print(
                f"{options} {objective:<8}: {done} finished, bound {bound}, {visits} visits, {spent:.1f} s", flush=True
            )
