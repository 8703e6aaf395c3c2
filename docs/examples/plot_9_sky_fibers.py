"""
Sky fibers and standard stars
=============================

This example plans a LAMOST tile without collisions, with sky fibers and standard stars in every spectrograph.
"""

import astropy.units as u
import matplotlib.pyplot as plt
import numpy as np
from astropy.coordinates import SkyCoord

import rfpsurvey as rs

center = SkyCoord("06h20m00s +23d00m00s")
stars = rs.synthetic_catalog("poisson", center, 2.5 * u.deg, density=800 / u.deg**2, rng=1)
kind = np.where(np.arange(len(stars)) % 60 == 0, "standard", "science")
stars = rs.Catalog(stars.coord, kind=kind)
lamost = rs.Instrument.preset("lamost")
print("requires", *lamost.requirements)
tile = rs.plan_tile(
    stars,
    lamost,
    center,
    allocator=rs.AllocationOptions("optimal", requirements="instrument", sky_separation=10 * u.arcsec),
)
print(tile, "unmet requirements:", tile.summary["unmet"])

# %%
# For each kind of target, the next lines print the smallest and the largest number of fibers per spectrograph.

for kind in ("science", "standard", "sky"):
    each = np.bincount(tile.table["spectrograph"][tile.table["kind"] == kind], minlength=16)
    print(f"{kind}: {each.min()} to {each.max()}")

# %%
# The requirements specify only the number of sky fibers per spectrograph, not which fibers observe the sky.

fig, ax = plt.subplots(figsize=(6.5, 6.5), layout="constrained")
for kind, color, size in (("science", "0.8", 2), ("standard", "#D55E00", 9), ("sky", "#0072B2", 9)):
    fibers = tile.table[tile.table["kind"] == kind]
    ax.scatter(fibers["tip_x"].value, fibers["tip_y"].value, s=size, color=color, label=kind)
ax.set(aspect="equal", xlabel="x [mm]", ylabel="y [mm]", title="Fibers on stars, standard stars and sky positions")
ax.invert_xaxis()  # east is to the left
ax.legend(loc="upper right")
