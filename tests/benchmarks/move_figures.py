"""Targets by class, and processor times, of plans of ``repair`` with both kinds of moves, and of ``optimal``.

Usage: python tests/benchmarks/move_figures.py [--limit SECONDS] [--repeats N]
"""

import argparse
import time

import astropy.units as u
import numpy as np

import rfpsurvey as rs

PRESETS = ("desi", "lamost", "moons", "pfs", "sdss_apo")
DENSITIES = (0.3, 0.8, 1.5, 4, 8)
LONG = rs.FocalPlane.hexagonal(rs.Positioner(12.5 * u.mm, 12.5 * u.mm, 1.2 * u.mm), rings=20, pitch=10 * u.mm)


def targets(plane, density, n_classes, seed):
    """Return positions, half of them in clusters, and priorities whose classes have the ratio 1 to 2 to 3."""
    rng = np.random.default_rng(seed)
    centers = plane.xy.to_value(u.mm)
    arms = plane.positioner.central_arm + plane.positioner.eccentric_arm
    radius, n = np.hypot(*centers.T).max() + arms.to_value(u.mm), max(int(density * len(plane)), 40)

    def in_circle(n):
        distance, angle = radius * np.sqrt(rng.random(n)), rng.uniform(0, 2 * np.pi, n)
        return distance[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])

    xy, clustered = in_circle(n), rng.random(n) < 0.5
    clusters = in_circle(max(n // 40, 1))
    xy[clustered] = clusters[rng.integers(0, len(clusters), clustered.sum())] + rng.normal(0, 15, (clustered.sum(), 2))
    share = np.arange(1, n_classes + 1) / np.arange(1, n_classes + 1).sum()
    return xy * u.mm, n_classes - rng.choice(n_classes, n, p=share)


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--limit", type=float, default=10.0, help="time limit of optimal in seconds")
    parser.add_argument("--repeats", type=int, default=5)
    asked = parser.parse_args()
    scenes = [
        (f"{name} {density}", rs.Instrument.preset(name).focal_plane, density, 3)
        for name in PRESETS
        for density in DENSITIES
    ]
    scenes += [(f"reach 2.5 pitches, {n} classes", LONG, 2, n) for n in (1, 3)]
    allocators = {moves: rs.AllocationOptions("repair", moves=moves) for moves in ("exchange", "ejection")}
    allocators["optimal"] = rs.AllocationOptions("optimal", time_limit=asked.limit * u.s)
    for seed, (name, plane, density, n_classes) in enumerate(scenes):
        xy, priority = targets(plane, density, n_classes, seed)
        seconds, plans = {key: [] for key in allocators}, {}
        for k in range(asked.repeats + 1):  # the first run can compile
            for key, options in allocators.items():
                if key == "optimal" and k:
                    continue
                begin = time.process_time()
                plans[key] = rs.allocate(plane, xy, allocator=options, priority=priority)
                seconds[key].append(time.process_time() - begin)
        texts = [
            f"{key}: {'/'.join(f'{level.value:.0f}' for level in plan.levels)} "
            f"({1e3 * np.median(seconds[key][1:] or seconds[key]):.0f} ms)"
            for key, plan in plans.items()
        ]
        bounds = "/".join(f"{level.bound:.0f}" for level in plans["optimal"].levels)
        print(f"{name}: {', '.join(texts)}, bounds {bounds}", flush=True)


if __name__ == "__main__":
    main()
