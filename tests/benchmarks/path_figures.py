"""Paths of all arms between plans and the folded poses: arms that arrive, times, and other planners (page on paths).

Run ``python tests/benchmarks/path_figures.py``, which takes some hours; words choose parts, and the options choose a
part of these. The part ``peer`` requires kaiju (see ``kaiju_grid``).
"""

import contextlib
import os
import sys
import warnings
from dataclasses import replace
from functools import partial
from pathlib import Path
from time import process_time

os.environ.setdefault("NUMBA_NUM_THREADS", "1")

import astropy.units as u
import numpy as np
from measure import arguments, hexagon, in_circle, timed
from tie_figures import scene

import rfpsurvey as rs
from rfpsurvey._instruments import find_paths as planner
from rfpsurvey._instruments.path_arms import arms_of
from rfpsurvey._instruments.paths import near_obstacles
from rfpsurvey._kernels import joint_motion

SCENES = "uniform_1a uniform_1b uniform_2a uniform_2b uniform_5a uniform_5b".split()
SCENES += "clustered_1 clustered_2a clustered_2b clustered_5".split()  # the numbers are targets per positioner
FULL = {"sdss_apo": 20, "sdss_lco": 20, "lamost": 20, "desi": 20, "pfs": 20, "moons": 20, "must": 3}
DESIGNS = {  # reach in units of the pitch: central arm, eccentric arm, clearance, pitch (mm)
    0.75: (8.0, 10.0, 2.0, 24.0),
    1.0: (8.0, 17.0, 2.0, 25.0),
    1.4: (11.0, 17.0, 2.0, 20.0),
    1.8: (14.0, 16.6, 1.5, 17.0),
    2.2: (15.0, 18.0, 1.25, 15.0),
}
ZERO = -90.0
"""theta (deg) of the arms of SDSS-V at alpha = 0, which is a stop of the joint."""


def sdss_scene(name):
    """Return targets (mm) and classes around the 500 positioners of SDSS-V, some of the targets in clusters."""
    kind, each = name.split("_")
    plane = rs.Instrument.preset("sdss_apo").focal_plane
    unit, rng = plane.positioner, np.random.default_rng(111 + SCENES.index(name))
    centers = plane.xy.to_value(u.mm)
    radius = np.hypot(*centers.T).max() + (unit.central_arm + unit.eccentric_arm).to_value(u.mm)
    n = int(each[0]) * len(centers)

    def points(n):
        r, angle = radius * np.sqrt(rng.uniform(size=n)), rng.uniform(0, 2 * np.pi, n)
        return np.column_stack([r * np.cos(angle), r * np.sin(angle)])

    xy = points(n)
    members = np.flatnonzero(rng.uniform(size=n) < (0.6 if kind == "clustered" else 0.0))
    clusters = points(n // 20)
    xy[members] = clusters[rng.integers(len(clusters), size=len(members))] + rng.normal(0, 11.0, (len(members), 2))
    return plane, xy * u.mm, rng.integers(1, 4, n)


def plans(names=SCENES):
    for name in names:
        plane, xy, priority = sdss_scene(name)
        yield name, plane, rs.allocate(plane, xy, priority=priority, allocator="optimal")


def motions():
    """Return the joint motions of SDSS-V: with the ranges of the preset, and without ranges."""
    motion = rs.Instrument.preset("sdss_apo").motion
    return {"preset": motion, "no ranges": replace(motion, theta_range=None, phi_range=None)}


def measured(plane, plan, motion, repeats=1, **options):
    """Return numbers of targets, of arms with targets and of other arms that do not arrive, times, and break points."""
    runs = [timed(rs.collision.find_paths, plane, plan, motion=motion, **options) for _ in range(repeats)]
    paths, has_target = runs[0][0], plan.target_of_positioner >= 0
    late, seconds = ~paths.arrives & plane.arrays.usable, np.median([seconds for _, seconds in runs])
    counts = plan.n_assigned, (late & has_target).sum(), (late & ~has_target).sum()
    return *counts, seconds, paths.duration.to_value(u.s), len(paths.time) / len(plane)


def compile_paths(plane, plan, motion):
    measured(plane, plan, motion, step=2 * u.deg)


def print_sums(label, rows):
    """Print sums of targets and arms that do not arrive; median and largest time; mean duration and break points."""
    rows = np.array(rows, dtype=float)
    targets, late, idle = rows[:, :3].sum(axis=0)
    print(
        f"{label}: {100 * (1 - late / targets):8.3f} % of {targets:.0f}, {late:.0f} late, {idle:.0f} idle late; "
        f"{np.median(rows[:, 3]):.2f} s, {rows[:, 3].max():.2f} s; duration {rows[:, 4].mean():.1f} s, "
        f"{rows[:, 5].mean():.1f} break points per arm",
        flush=True,
    )


def steps(given):
    """Ten scenes of SDSS-V: each step, with each range of the joints."""
    chosen = list(plans(given.scenes or SCENES))
    compile_paths(*chosen[0][1:], None)
    for label, motion in motions().items():
        for step in given.steps:
            repeats = 3 if step >= 0.5 else 1
            rows = [measured(plane, plan, motion, repeats, step=step * u.deg) for _, plane, plan in chosen]
            print_sums(f"sdss_apo {label:<10} {step:>3} deg", rows)


@contextlib.contextmanager
def quiet():
    """Suppress what libraries print."""
    saved, null = os.dup(1), os.open(os.devnull, os.O_WRONLY)
    os.dup2(null, 1)
    yield
    os.dup2(saved, 1)
    os.close(saved)
    os.close(null)


def peer(given):
    """Scenes of SDSS-V: this planner and the planners of kaiju from the same poses, with the same separation."""
    from kaiju_grid import forbidden, make_path_grid

    methods = {
        "greedy": lambda grid: grid.pathGenGreedy(),
        "MDP2": lambda grid: grid.pathGenMDP2(0.7, 0.6),
        "MDP": lambda grid: grid.pathGenMDP(0.7, 0.6),
    }
    for name, plane, plan in plans(given.scenes or SCENES):
        compile_paths(plane, plan, None)
        motion, posed = motions()["preset"], plan.place_arms(plane)
        columns = plane.arrays.using(posed.fiber)
        start = arms_of(columns, posed, motion, 0.0)
        alpha, beta = np.rad2deg(start.theta) - ZERO, np.rad2deg(start.psi - start.theta)
        print(f"{name}: poses that kaiju forbids near fiducials: {len(forbidden(plane, alpha, beta))}")
        has_target = plan.target_of_positioner >= 0
        for step in given.steps:
            _, late, _, seconds, duration, _ = measured(plane, plan, motion, step=step * u.deg)
            print(f"  {step:>3} deg this planner: {late} late, {seconds:.2f} s, duration {duration:.0f} s")
            for method in (given.methods or methods) if step <= 0.5 else ():
                grid = make_path_grid(plane, step, 1, ZERO)
                for i, robot in grid.robotDict.items():
                    robot.setAlphaBeta(alpha[i], beta[i])
                    robot.setDestinationAlphaBeta(10.0, 170.0)
                with quiet():
                    _, seconds = timed(methods[method], grid)
                scores = np.array([grid.robotDict[i].score() for i in range(len(plane))])
                turned = np.array([abs(grid.robotDict[i].beta - 170.0) > 1e-9 for i in range(len(plane))])
                duration = grid.nSteps * step / 11.71875
                near, hits, least = proof(plane, columns, start, grid, ZERO)
                print(
                    f"  {step:>3} deg kaiju {method:<6}: {(has_target & (scores != 0)).sum()} late, of them "
                    f"{(has_target & turned).sum()} not folded, {seconds:.1f} s, duration {duration:.0f} s; "
                    f"between the steps, {near} pairs and {hits} obstacles too close, smallest {least:.3f} mm",
                    flush=True,
                )


def proof(plane, columns, start, grid, zero):
    """Return how many pairs, and arms and obstacles, of the paths of kaiju are too close, and the smallest distance."""
    robots = [grid.robotDict[i] for i in range(len(plane))]
    alpha = np.array([np.array(robot.alphaPath)[:, 1] for robot in robots])
    beta = np.array([np.array(robot.betaPath)[:, 1] for robot in robots])
    n, size = alpha.shape
    rows = np.arange(0, n * size, size)
    theta, phi = np.deg2rad(alpha + zero).ravel(), np.deg2rad(beta).ravel()
    knots = joint_motion.Knots(rows, rows + size, np.tile(np.arange(float(size)), n), theta, theta + phi)

    def nearest(pairs, separation):
        near = np.empty(len(pairs))
        joint_motion.find_near(knots, start.bodies, columns.limits, pairs, separation, near)
        return near

    high = columns.limits.separation
    pairs = columns.neighbors[nearest(columns.neighbors, high) < np.inf]
    low = 0.0 if len(pairs) else high
    while high - low > 1e-3:
        middle = 0.5 * (low + high)
        least = nearest(pairs, middle).min()
        low, high = (low, min(least, middle)) if least < np.inf else (middle, high)
    return len(pairs), int(near_obstacles(knots, start.bodies, columns).sum()), low


def instruments(given):
    """Other instruments and designs: uniform targets, 1, 2 or 5 per positioner."""
    for label, scenes in planned(given, (1, 2, 5)):
        compile_paths(*scenes[0])
        print_sums(f"{label:<12} {len(scenes[0][0]):>5} arms, {len(scenes):>2} scenes", [measured(*v) for v in scenes])


def planned(given, densities):
    """Yield the label of each case with a list of focal planes, plans and joint motions."""
    for label, make, motion, n in cases():
        if given.only in ("", label):
            scenes = []
            # optimal takes minutes for the densest designs
            dense = label in ("design 1.8", "design 2.2")
            allocator = "repair" if dense else rs.AllocationOptions("optimal", time_limit=10 * u.s)
            for seed in range(min(n, given.n)):
                plane, xy = make(densities[seed % len(densities)], seed)
                plan = rs.allocate(plane, xy, allocator=allocator)
                scenes.append((plane, plan, motion))
            yield label, scenes


def cases():
    for name, n in FULL.items():
        # the positioners of sdss_lco are those of sdss_apo
        make = partial(scene, name) if name != "sdss_lco" else (lambda d, seed: scene("sdss_lco", d, 100 + seed))
        yield name, make, rs.Instrument.preset(name).motion, n
    for ratio, numbers in DESIGNS.items():
        yield f"design {ratio}", (lambda d, seed, numbers=numbers: design_scene(numbers, d, seed)), None, 15


def design_scene(numbers, density, seed, rings=9):
    plane = hexagon(*numbers, rings)
    radius = numbers[3] * rings + numbers[0] + numbers[1]
    return plane, in_circle(np.random.default_rng(seed), radius, int(density * len(plane)))


def growth(given):
    """Exponent of the time in the number of arms, of hexagons with arms as long as the pitch."""
    counts, times = [], []
    for rings in (6, 9, 13, 18, 26, 37):
        plane, xy = design_scene(DESIGNS[1.0], 2, 3, rings)
        plan = rs.allocate(plane, xy, allocator="repair")
        compile_paths(plane, plan, None)
        _, late, _, seconds, *_ = measured(plane, plan, None, 3)
        counts.append(len(plane))
        times.append(seconds)
        print(f"growth: {len(plane)} arms, {seconds:.2f} s, {late} late", flush=True)
    print(f"growth: exponent {np.polyfit(np.log(counts), np.log(times), 1)[0]:.2f}")


@contextlib.contextmanager
def setting(**values):
    """Replace constants of the planner, or a method of its class."""
    saved = {name: getattr(planner, name) for name in values}
    for name, value in values.items():
        setattr(planner, name, value)
    yield
    for name, value in saved.items():
        setattr(planner, name, value)


class _GreedyOnly(planner._Planner):
    def search_groups(self, examine):
        pass


def levels(given):
    """What each level of the planner adds: the simple fold, one stage of steps, all stages, the search of groups."""
    for label, scenes in planned(given, (5,)):
        compile_paths(*scenes[0])
        alone = sum(rs.collision.find_motion(plane, plan).n_planner for plane, plan, _ in scenes)
        print(f"{label}: simple fold: {alone} of {sum(one[1].n_assigned for one in scenes)} arms need a planner")
        first = {"STAGES": planner.STAGES[:1]}
        parts = {"one stage": first | {"_Planner": _GreedyOnly}, "all stages": {"_Planner": _GreedyOnly}}
        for part, values in (parts | {"one stage and groups": first, "all": {}}).items():
            with setting(**values):
                print_sums(f"  {part:<22}", [measured(*one) for one in scenes])


def pairs(given):
    """Arms without a path in dense designs: the verdicts on pairs, and the time of each examination."""
    examine, found = planner._Planner._examine, []
    planner._Planner._examine = lambda self, pair: found.append(timed(examine, self, pair)) or found[-1][0]
    for ratio in (1.4, 1.8, 2.2):
        for seed in range(6):
            plane, xy = design_scene(DESIGNS[ratio], 2, seed, 5)
            rs.collision.find_paths(plane, rs.allocate(plane, xy, allocator="repair"), examine=True)
    planner._Planner._examine = examine
    verdicts, seconds = zip(*found, strict=True)
    for verdict in sorted(set(verdicts)):
        print(f"pairs: {verdicts.count(verdict)} of {len(verdicts)}: {verdict}")
    print(f"pairs: at most {max(seconds):.1f} s")


def replay(given):
    """Distances of all pairs of arms at many times, by independent code, and those of ``find_paths``."""
    sys.path.append(str(Path(__file__).parents[1] / "helpers"))
    from path_scenes import Replay

    for label, scenes in planned(given, (1, 2, 5)):
        least, n_pairs = [], 0
        for plane, plan, motion in scenes:
            paths = rs.collision.find_paths(plane, plan, motion=motion)
            apart = Replay(plane, paths.table).closest(300)
            separation = plane.positioner.min_separation.to_value(u.mm)
            least.append(min(apart.values()) - separation)
            stated = paths.smallest_distance.to_value(u.mm) - separation
            assert least[-1] >= -1e-12
            assert min(stated, 0.4) <= least[-1] + 1e-9
            n_pairs += len(apart)
        print(f"{label:<12} {len(least)} plans, {n_pairs} pairs, least gap {min(least):.5f} mm", flush=True)


PARTS = (steps, peer, instruments, growth, levels, pairs, replay)

if __name__ == "__main__":
    warnings.simplefilter("ignore", rs.errors.RfpsurveyWarning)
    names = [part.__name__ for part in PARTS]
    options = {"scenes": [""], "steps": [4.0, 2.0, 1.0, 0.5, 0.1], "methods": [""], "only": "", "n": 20}
    chosen = arguments(__doc__, names, **options)
    chosen.scenes, chosen.methods = ([one for one in v if one] for v in (chosen.scenes, chosen.methods))
    for part in PARTS:
        if part.__name__ in chosen.words:
            begin = process_time()
            part(chosen)
            print(f"{part.__name__}: {process_time() - begin:.0f} s of processor time\n", flush=True)
