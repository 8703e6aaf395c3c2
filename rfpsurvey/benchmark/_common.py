"""Functions that all benchmarks use."""

import os
import platform
from importlib.metadata import version
from pathlib import Path

import astropy.units as u
import numpy as np

from rfpsurvey.collision import place_arms


def random_tips(plane, rng):
    """Return the position (mm) of one random target for each positioner, uniformly distributed in its patrol area.

    If a positioner reaches none of a hundred random points, its target is NaN.
    """
    inner, outer, n = plane.arrays.inner_radius, plane.arrays.outer_radius, len(plane)
    tips, wanting = np.full((n, 2), np.nan), np.ones(n, dtype=bool)
    for _ in range(100):  # targets that joint limits exclude are drawn again
        # the area within a radius grows with its square; targets on an edge could be out of reach by rounding errors
        r = np.clip(np.sqrt(rng.uniform(inner**2, outer**2)), inner * (1 + 1e-12), outer * (1 - 1e-12))
        alpha = rng.uniform(0, 2 * np.pi, n)
        drawn = plane.arrays.xy + r[:, None] * np.column_stack([np.cos(alpha), np.sin(alpha)])
        tips[wanting] = drawn[wanting]
        wanting = place_arms(plane, tips * u.mm, clip=True).clipped
        if not wanting.any():
            break
    tips[wanting] = np.nan
    return tips


def has_gpu():
    """Return whether the machine has a GPU; a GPU that numba simulates on the CPU is not counted."""
    try:
        from numba import config, cuda
    except ImportError:
        return False
    return bool(not config.ENABLE_CUDASIM and cuda.is_available())


def provenance(instrument, plane):
    """Return a description of a benchmark: the instrument, the versions of packages, and the machine."""
    name = instrument if isinstance(instrument, str) else getattr(instrument, "name", "focal plane")
    return {
        "instrument": name,
        "n_positioners": len(plane),
        "n_neighbor_pairs": len(plane.arrays.neighbors),
        "min_separation_mm": plane.arrays.separation,
        "versions": {name: version(name) for name in ("rfpsurvey", "numba", "numpy")},
        "machine": f"{processor()}, {os.cpu_count()} cores",
    }


def processor(cpuinfo="/proc/cpuinfo"):
    """Return the name of the processor, or the name of its architecture if the processor's name is unknown."""
    try:
        lines = Path(cpuinfo).read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        lines = []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return next(filter(None, names), platform.machine())
