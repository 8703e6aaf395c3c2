"""
One tile of SDSS-V
==================

This example plans a tile of real stars around the Galactic anticenter. The plan has no collisions, and bright stars
have a higher priority.
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
# The summary gives the number of assigned stars of each priority class, and the proven upper limit of this number.

for name, reached, limit in tile.summary["objectives"]:
    print(f"{name}: {reached:.0f} of {limit:.0f}")

# %%
# The patrol areas are rings, because the two arms of each positioner have different lengths. Black discs are fiducials,
# which no arm may touch.

fig, ax = plt.subplots(figsize=(7, 7), layout="constrained")
rs.plot.plot_focal_plane(tile, ax=ax)

# %%
# The next plot shows the outcome of each star in the field: assigned, in reach but not assigned, or out of reach.

fig, ax = plt.subplots(figsize=(7, 7), layout="constrained")
rs.plot.plot_targets(tile, ax=ax)

# %%
# The last figure shows the number of observed stars of each class, the distribution of the magnitudes, and the fraction
# of assigned stars as a function of the distance from the center.

fig, axes = plt.subplots(2, 2, figsize=(11, 7), layout="constrained")
axes = rs.plot.plot_quality(tile, column="vt_mag", axes=axes.ravel())
