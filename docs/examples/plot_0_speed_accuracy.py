"""
Speed against accuracy
======================

This example compares the speed and the accuracy of methods that find collisions, and of allocators, for the arms of
SDSS-V. To compare the methods for another instrument, replace the name of the preset by the path of a TOML file.
"""

import astropy.units as u
import matplotlib.pyplot as plt

import rfpsurvey as rs

instrument = "sdss_apo"
methods = ["exact", "endpoints", "sampled"]
collisions = rs.benchmark.benchmark_collisions(instrument, methods=methods, repeats=3)
collisions["method", "n_points", "time", "n_missed", "n_spurious"].pprint()

# %%
# ``endpoints`` and ``sampled`` with a few points per arm are as fast as ``exact``, but miss collisions. With many
# points, ``sampled`` misses no collision, but is slower than ``exact``.

rs.plot.plot_speed_accuracy(collisions)

# %%
# An allocator is accurate if its plan has as many targets as the best plan without collisions, which ``optimal`` finds.

center = "10h00m00s +30d00m00s"
targets = rs.synthetic_catalog("uniform", center, 1.4 * u.deg, n_targets=500, rng=1)
plans = rs.compare_allocators(targets, instrument, center)
seconds, lost = plans["seconds"].to_value(u.s), 1 - plans["usable"] / plans["usable"].max()
fig, ax = plt.subplots(figsize=(6.5, 4), layout="constrained")
ax.semilogx(seconds, 100 * lost, "o")
for name, x, y in zip(plans["allocator"], seconds, 100 * lost, strict=True):
    ax.annotate(name, (x, y), (6, 4), textcoords="offset points")
ax.set(xlabel="time (s)", ylabel="fibers lost (%)", title="Allocators: lower left is better")
ax.margins(x=0.3)
