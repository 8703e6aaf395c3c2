"""Plans without a constraint on the motion, with the simple fold and with planned paths (page on paths).

Run ``python tests/benchmarks/path_plans.py``, which takes about half an hour; words choose parts.
"""

import os
import warnings
from time import process_time

os.environ.setdefault("NUMBA_NUM_THREADS", "1")

import astropy.units as u
import numpy as np
from measure import arguments, timed
from path_figures import DESIGNS, SCENES, design_scene, sdss_scene
from tie_figures import scene

import rfpsurvey as rs
from rfpsurvey._instruments.path_report import report_paths

PRESETS = ("lamost", "desi", "pfs", "moons")
KINDS = (None, "motion fold", "motion paths")
LIMIT = 30 * u.s


def cases(given):
    """Yield the label, focal plane, targets, priorities and joint motion of each scene."""
    for name in SCENES:
        yield "sdss_apo", *sdss_scene(name)
    for name in PRESETS:
        for seed in range(given.n):
            for density in (1, 2, 5):
                yield name, *with_priorities(*scene(name, density, seed), seed)
    for ratio in (0.75, 1.0, 1.4, 1.8):
        for seed in range(given.n):
            plane, xy = design_scene(DESIGNS[ratio], 1 + seed % 2, seed, 4)
            yield f"design {ratio}", *with_priorities(plane, xy, seed)


def with_priorities(plane, xy, seed):
    return plane, xy, np.random.default_rng(1000 + seed).integers(1, 4, len(xy))


def targets(given):
    """Print the targets of plans of ``optimal`` by class, and the arms of these plans that have no path."""
    rows = {}
    for label, plane, xy, priority in cases(given):
        if given.only not in ("", label):
            continue
        motion = None if label.startswith("design") else rs.Instrument.preset(label).motion
        for kind in KINDS:
            options = rs.AllocationOptions("optimal", constraints=kind, time_limit=LIMIT)
            plan, seconds = timed(rs.allocate, plane, xy, priority=priority, allocator=options)
            used = plan.target_of_positioner[plan.target_of_positioner >= 0]
            counts = [(priority[used] == k).sum() for k in (3, 2, 1)]
            late = 0 if kind == "motion fold" else report_paths(plane, plan.place_arms(plane), motion).n_failing
            rows.setdefault((label, kind), []).append((*counts, late, seconds, plan.meta.get("n_path_rounds", 0)))
    labels = list(dict.fromkeys(label for label, _ in rows))
    for label in labels:
        print(f"{label}, {len(rows[label, None])} scenes: targets by class and sum, arms without a path, mean time")
        plain = np.array(rows[label, None], dtype=float)
        for kind in KINDS:
            found = np.array(rows[label, kind], dtype=float)
            share, total = found[:, :3].sum(axis=1) / plain[:, :3].sum(axis=1), found[:, :3].sum(axis=0)
            print(
                f"  {kind or 'static':<12} {total.astype(int)} {total.sum():.0f} "
                f"({100 * total.sum() / plain[:, :3].sum():.2f} %, at least {100 * share.min():.2f} %; top class "
                f"unchanged in {(found[:, 0] == plain[:, 0]).sum()}), {found[:, 3].sum():.0f} late, "
                f"{found[:, 4].mean():.2f} s, {(found[:, 5] > 0).sum()} scenes with rounds",
                flush=True,
            )


def rates(given):
    """Print the rates of collisions at targets, of colliding simple folds, and of arms without a path."""
    print("percent of the arms with targets: static collisions of lamost_rule; repair: arms that collide in the simple")
    print("fold, arms without a path")
    names = ("sdss_apo", *PRESETS, "must", *DESIGNS)
    for name in names:
        for density in (1, 2, 5) if name != "must" else (1,):
            if given.only not in ("", str(name)):
                continue
            sums = np.zeros(4)
            for seed in range(given.n if name != "must" else 1):
                is_design = not isinstance(name, str)
                plane, xy = design_scene(DESIGNS[name], density, seed, 5) if is_design else scene(name, density, seed)
                motion = None if is_design else rs.Instrument.preset(name).motion
                rule, plan = (rs.allocate(plane, xy, allocator=allocator) for allocator in ("lamost_rule", "repair"))
                fold = rs.collision.find_motion(plane, plan).needs_planner & (plan.target_of_positioner >= 0)
                paths = report_paths(plane, plan.place_arms(plane), motion)
                static = 100 * rs.find_collisions(plane, rule).rate_assigned
                sums += [static * plan.n_assigned, 100 * fold.sum(), 100 * paths.n_failing, plan.n_assigned]
            print(f"  {name!s:<9} {density}: " + " ".join(f"{v / sums[3]:7.2f}" for v in sums[:3]), flush=True)


PARTS = (targets, rates)

if __name__ == "__main__":
    warnings.simplefilter("ignore", rs.errors.RfpsurveyWarning)
    chosen = arguments(__doc__, [part.__name__ for part in PARTS], only="", n=4)
    for part in PARTS:
        if part.__name__ in chosen.words:
            begin = process_time()
            part(chosen)
            print(f"{part.__name__}: {process_time() - begin:.0f} s of processor time\n", flush=True)
