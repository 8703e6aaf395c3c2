"""
Close-up of a collision
=======================

The allocation rule of LAMOST does not account for collisions. This example shows the collision with the smallest
distance between two arms, and the optimal allocation of the same positioners.
"""

import astropy.units as u
import matplotlib.pyplot as plt
import numpy as np
from astropy.coordinates import SkyCoord

import rfpsurvey as rs

center = SkyCoord("06h20m00s +23d00m00s")
stars = rs.synthetic_catalog("poisson", center, 1.5 * u.deg, density=300 / u.deg**2, rng=1)
rule, best = (rs.plan_tile(stars, "sdss_apo", center, allocator=name) for name in ("lamost_rule", "optimal"))

worst = rule.table[np.nanargmin(rule.table["clearance"])]
depth = -worst["clearance"]
print(f"The arms of {worst['id']} and {worst['colliding_with']} are {depth:.2f} closer than the minimum separation")

# %%
# Arms collide where their shaded areas overlap. All stars are drawn as green dots.

position = u.Quantity([worst["x"], worst["y"]])
region = u.Quantity([position - 45 * u.mm, position + 45 * u.mm])
dots = rs.Instrument.preset("sdss_apo").projection(center).to_focal_plane(stars).value
fig, axes = plt.subplots(1, 2, figsize=(11, 5.9), layout="constrained", sharey=True)
for ax, tile, name in zip(axes, (rule, best), ("LAMOST's rule", "optimum"), strict=True):
    rs.plot.plot_focal_plane(tile, ax=ax, region=region)
    ax.plot(*dots.T, ".", color="#009E73", markersize=5, zorder=0)
    ax.set_title(f"{name}: {tile.summary['n_assigned']} assigned, {tile.summary['n_colliding']} in collision")
    ax.get_legend().remove()
