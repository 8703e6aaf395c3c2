"""
One tile of SDSS-V
==================

Real stars around the Galactic anticenter, planned without collisions; the bright ones first.
"""

import astropy.units as u
import matplotlib.pyplot as plt
import numpy as np
from astropy.coordinates import SkyCoord

import rfpsurvey as rs

table = rs.example_catalog("anticenter").to_table()
table["priority"] = np.where(table["vt_mag"] < 10 * u.mag, 2, 1)
stars = rs.Catalog.from_table(table, keep=["vt_mag"])
center = SkyCoord("06h20m00s +23d00m00s")
tile = rs.plan_tile(stars, "sdss_apo", center, epoch=2026.5, allocator="optimal")
print(tile)

# %%
# The number of stars of each class that got a fiber, and the proven limit.

for name, reached, limit in tile.summary["objectives"]:
    print(f"{name}: {reached:.0f} of {limit:.0f}")

# %%
# Patrol areas are rings, since the arms are not equal; black discs are fiducials, which no arm may touch.

fig, ax = plt.subplots(figsize=(7, 7), layout="constrained")
rs.plot.plot_focal_plane(tile, ax=ax)

# %%
# All stars of the field by outcome: those that are left in reach, and those out of reach.

fig, ax = plt.subplots(figsize=(7, 7), layout="constrained")
rs.plot.plot_targets(tile, ax=ax)

# %%
# How many stars of each class are observed, how their magnitudes are distributed, and the fraction that is assigned at
# each distance from the center.

fig, axes = plt.subplots(2, 2, figsize=(11, 7), layout="constrained")
axes = rs.plot.plot_quality(tile, column="vt_mag", axes=axes.ravel())
