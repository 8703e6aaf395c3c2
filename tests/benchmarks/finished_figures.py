"""Finished targets of joint plans that maximize visits or finished targets (page on joint plans).

Run ``python tests/benchmarks/finished_figures.py``, which takes about ten minutes. With ``--share``, it prints the
finished fractions of three categories with and without shares.
"""

import warnings
from dataclasses import replace
from time import process_time

import astropy.units as u
import numpy as np
from astropy.coordinates import SkyCoord
from astropy.table import QTable
from measure import arguments, in_circle

import rfpsurvey as rs

CENTER = SkyCoord("10h +20d")
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
    """Return the numbers of finished targets and of visits, the upper bound, and the processor time."""
    joint = rs.JointOptions(objective=objective, time_limit=seconds * u.s)
    begin = process_time()
    survey = rs.plan_survey(catalog, pfs, tiles, allocator=joint)
    spent, made = process_time() - begin, np.asarray(survey.outcomes["observed"])
    bound = survey.summary["joint"]["levels"][0].get("bound_complete")
    return int((made >= catalog.visits).sum()), int(made.sum()), bound, spent


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
    given = arguments(__doc__, seconds=60.0, large=240.0, share=False)
    if given.share:
        raise SystemExit(print_shares(given.large))
    scenes = [(given.seconds, {"n": n, "seed": seed}) for n, seed in SMALL]
    scenes += [(given.large, {"n": 7182, "seed": seed, "n_cobras": 2394, "exposures": 7}) for seed in (5, 6)]
    measured("finished", 1.0, *scene(320, 1))
    for seconds, options in scenes:
        for objective in ("visits", "finished"):
            done, visits, bound, spent = measured(objective, seconds, *scene(**options))
            print(
                f"{options} {objective:<8}: {done} finished, bound {bound}, {visits} visits, {spent:.1f} s", flush=True
            )
