"""
One tile of SDSS-V
==================

Real stars around the Galactic anticenter, planned without collisions; the bright ones first.
"""

import astropy.units as u
import matplotlib.pyplot as plt
import numpy as np
from astropy.coordinates import SkyCoord
from astropy.table import QTable

import rfpsurvey as rs

table = QTable.read("../../data/tycho2_anticenter_r8.ecsv.gz", format="ascii.ecsv")
table["priority"] = np.where(table["vt_mag"] < 10 * u.mag, 2, 1)
stars = rs.Catalog.from_table(table)
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
