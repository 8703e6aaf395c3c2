"""
Comparison of allocators
========================

This example plans a crowded MOONS field with six allocators. For each allocator, it compares the number of usable
science fibers with the number of fibers that are lost to collisions.
"""

import astropy.units as u
import matplotlib.pyplot as plt
from astropy.coordinates import SkyCoord

import rfpsurvey as rs

center = SkyCoord("10h00m00s +02d12m00s")
galaxies = rs.synthetic_catalog(
    "clustered", center, 0.22 * u.deg, density=9000 / u.deg**2, cluster_size=6, cluster_scale=0.01 * u.deg, rng=3
)
table = rs.compare_allocators(galaxies, "moons", center)
table["allocator", "science", "colliding", "usable", "loss", "gap"].pprint()

# %%
# ``network_flow`` assigns the most targets, but a quarter of these targets are lost to collisions. Plans of ``optimal``
# and ``repair`` have no collisions.

fig, ax = plt.subplots(figsize=(7, 4.2), layout="constrained")
rs.plot.plot_allocators(table, ax=ax).set_title("Usable fibers of six allocators on a field of MOONS")
