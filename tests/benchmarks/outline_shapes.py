"""Print the collisions that each shape of the arms reports, misses and invents, per instrument, and its time.

Run ``python tests/benchmarks/outline_shapes.py [N]``; N is the number of configurations (1000). The fullest published
shape of an instrument is the reference. For DESI, the capsule has the smallest clearance at which it contains the
polygons of the eccentric arm. Configurations: ``random`` (each fiber at a random point of its patrol area),
``allocated`` (random targets, allocator balanced, which ignores collisions). A time is the
median, over the configurations, of the shortest of three alternating calls of ``find_collisions``.

Run ``python tests/benchmarks/outline_shapes.py plans [N]`` to print, for each shape with which tiles are planned, the
mean number of colliding pairs of N plans (10), for each allocator and number of targets per positioner. Collisions are
found with the fullest published shape. With RFPSURVEY_TEST_DATA, the instruments as built are included.
"""

import os
import sys
import time
from dataclasses import replace
from pathlib import Path

import astropy.units as u
import numpy as np
from scipy.spatial import ConvexHull

import rfpsurvey as rs

NAMES = ("desi", "sdss_apo", "pfs", "moons", "lamost")
AS_BUILT = ("desi/fp-metrology.csv.gz", "sdssv_apo_2024", "pfs")
ALLOCATORS = ("nearest", "lamost_rule", "network_flow", "repair", "optimal")
DENSITIES = (1, 2, 5)
REPEATS = 3
LABELS = {"elbow_to_tip": "segment", "capsule": "capsule", "outline": "outline"}


def shapes_of(instrument):
    """Return the focal plane with each shape; the reference is last, and the shape of the preset is first."""
    planes = {LABELS[m]: instrument.with_arm_model(m).focal_plane for m in instrument.arm_models if m in LABELS}
    if "outline" in planes:
        outline, plane = planes.pop("outline"), planes["segment"]
        arm, n = plane.positioner.eccentric_arm.to_value(u.mm), outline.positioner.outline.n_eccentric
        far = 0.0
        for vertices, radius in outline.positioner.outline.parts[:n]:
            x, y = vertices.T
            far = max(far, float(np.hypot(x - np.clip(x, 0, arm), y).max()) + radius)
        planes |= {"capsule": replace(plane, positioner=replace(plane.positioner, clearance=far * u.mm))}
        planes |= {"outline": outline}
    own = LABELS[instrument.arm_models[0]]
    return own, dict(sorted(planes.items(), key=lambda item: ("segment", "capsule", "outline").index(item[0])))


def random_tips(plane, rng):
    """Return the positions of fibers at random points of their patrol areas."""
    arrays = plane.arrays
    inner, outer = (np.broadcast_to(r, len(plane)) for r in (arrays.inner_radius, arrays.outer_radius))
    r, angle = np.sqrt(rng.uniform(inner**2, outer**2)), rng.uniform(0, 2 * np.pi, len(plane))
    return plane.xy + np.column_stack([r * np.cos(angle), r * np.sin(angle)]) * u.mm


def random_targets(instrument, rng, each=None):
    """Return ``each`` targets per positioner (by default, the usual number), at random points of the footprint."""
    xy = instrument.focal_plane.xy.to_value(u.mm)
    hull = ConvexHull(xy)
    low, high = xy.min(axis=0), xy.max(axis=0)
    n = int((each or instrument.targets_per_fiber) * len(xy) * np.prod(high - low) / hull.volume)
    points = rng.uniform(low, high, (n, 2))
    return points[(points @ hull.equations[:, :2].T + hull.equations[:, 2] <= 0).all(axis=1)] * u.mm


def configurations(instrument, n):
    """Yield the kind and the fibers of configurations."""
    plane = instrument.focal_plane
    for seed in range(n):
        yield "random", random_tips(plane, np.random.default_rng(seed))
    for seed in range(n):
        targets = random_targets(instrument, np.random.default_rng(seed))
        yield "allocated", rs.allocate(plane, targets, allocator="balanced")


def main(n):
    print(f"{'instrument':<11}{'fibers':<11}{'shape':<9}{'reported':>9}{'missed':>9}{'invented':>9}{'ms':>8}")
    for name in NAMES:
        instrument = rs.Instrument.preset(name)
        own, planes = shapes_of(instrument)
        reference = list(planes)[-1]
        found = {}
        for kind, fibers in configurations(instrument, n):
            pairs, times = {}, {}
            for _ in range(REPEATS):  # the repeats alternate between the shapes
                for label, plane in planes.items():
                    start = time.perf_counter()
                    report = rs.find_collisions(plane, fibers)
                    times[label] = min(time.perf_counter() - start, times.get(label, np.inf))
                    pairs[label] = set(map(tuple, report.pairs.tolist()))
            full = pairs[reference]
            for label, own_pairs in pairs.items():
                row = (len(own_pairs), len(full - own_pairs), len(own_pairs - full), 1e3 * times[label])
                found.setdefault((kind, label), []).append(row)
        for (kind, label), rows in found.items():
            reported, missed, invented, _ = np.mean(rows, axis=0)
            ms = np.median([row[3] for row in rows])
            mark = "*" if label == own else " "
            label = f"{label}{mark}"
            print(f"{name:<11}{kind:<11}{label:<9}{reported:9.2f}{missed:9.2f}{invented:9.2f}{ms:8.2f}", flush=True)
    print("* shape of the preset; pairs per configuration")


def plans(n):
    """Print the mean numbers of colliding pairs of plans, found with the fullest published shape."""
    data = Path(os.environ.get("RFPSURVEY_TEST_DATA", "/nonexistent"))
    built = {f"{name.partition('/')[0][:4]} built": data / name for name in AS_BUILT if (data / name).exists()}
    instruments = {"sdss_lco": "sdss_lco", **dict(zip(NAMES, NAMES, strict=True)), **built}
    print(
        f"{'instrument':<13}{'shape':<9}{'targets':>8}"
        + "".join(f"{name:>9}" for name in ALLOCATORS)
        + f"{'assigned':>10}{'s':>7}"
    )
    for name, source in instruments.items():
        instrument = rs.Instrument.read(source) if isinstance(source, Path) else rs.Instrument.preset(source)
        own, planes = shapes_of(instrument)
        fullest = list(planes.values())[-1]
        for label, plane in planes.items():
            for each in DENSITIES:
                start, pairs, assigned = time.perf_counter(), np.zeros(len(ALLOCATORS)), 0
                for seed in range(n):
                    xy = random_targets(instrument, np.random.default_rng(seed), each)
                    for k, allocator in enumerate(ALLOCATORS):
                        plan = rs.allocate(plane, xy, allocator=allocator)
                        pairs[k] += len(rs.find_collisions(fullest, plan).pairs)
                    assigned += plan.n_assigned
                cells = "".join(f"{value:9.1f}" for value in pairs / n)
                seconds = (time.perf_counter() - start) / n
                mark = f"{label}{'*' if label == own else ' '}"
                print(f"{name:<13}{mark:<9}{each:8}{cells}{assigned / n:10.1f}{seconds:7.2f}", flush=True)
    print("* shape by default; targets: per positioner; assigned: by optimal; s: time of all five plans, in seconds")


if __name__ == "__main__":
    if sys.argv[1:2] == ["plans"]:
        plans(int((sys.argv[2:] or [10])[0]))
    else:
        main(int(sys.argv[1]) if len(sys.argv) > 1 else 1000)
