"""
Allocators side by side
=======================

What each method makes of the same crowded field of MOONS: science fibers that can be used, and those that collide.
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
# ``sdss`` assigns the most, and loses a quarter. ``optimal`` and ``repair`` leave no collision.

fig, ax = plt.subplots(figsize=(7, 3.6), layout="constrained")
ax.barh(table["allocator"], table["usable"], color="#0072B2", label="usable")
lost = table["science"] - table["usable"]
ax.barh(table["allocator"], lost, left=table["usable"], color="#D00000", label="in collision")
ax.invert_yaxis()
ax.set_xlabel("science fibers")
fig.legend(loc="outside upper center", ncols=2)
