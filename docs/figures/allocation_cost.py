"""Plot the time of each allocator against the number of targets, measured for LAMOST when the page is built."""

from time import perf_counter

import astropy.units as u
import matplotlib.pyplot as plt
import numpy as np

import rfpsurvey as rs

NUMBERS = (1000, 4000, 16_000, 64_000)
plane = rs.Instrument.preset("lamost").focal_plane
figure, ax = plt.subplots(figsize=(6.5, 4), layout="constrained")
for method in ("balanced", "nearest", "lamost_rule", "network_flow", "optimal", "repair"):
    seconds = []
    for n in NUMBERS:
        rng = np.random.default_rng(n)
        r, angle = 865 * np.sqrt(rng.random(n)), rng.uniform(0, 2 * np.pi, n)
        xy = np.column_stack([r * np.cos(angle), r * np.sin(angle)]) * u.mm
        rs.allocate(plane, xy, allocator=method)  # compiles the kernels, and fills the caches
        times = []
        for _ in range(3):
            begin = perf_counter()
            rs.allocate(plane, xy, allocator=method)
            times.append(perf_counter() - begin)
        seconds.append(min(times))
    ax.loglog(NUMBERS, seconds, "o-", label=method)
ax.set(xlabel="targets in the field of 4000 positioners", ylabel="time (s), including the proof of the optimum")
ax.legend(ncols=2)
