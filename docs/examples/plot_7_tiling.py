"""
Tiling a region
===============

A hexagonal covering leaves no gap between tiles. For clustered targets, the method ``max_density`` needs fewer tiles
than a hexagonal covering.
"""

import astropy.units as u
import matplotlib.pyplot as plt
from astropy.coordinates import SkyCoord

import rfpsurvey as rs

region = rs.Region.polygon(SkyCoord([112, 130, 128, 116] * u.deg, [24, 26, 38, 36] * u.deg))
covering = rs.place_tiles(region, "sdss_apo")
print(covering, f"covering {covering.summary['covering_fraction']:.0%} of {region.area:.0f}")

middle = SkyCoord("8h04m +31d")
stars = rs.synthetic_catalog(
    "clustered", middle, 11 * u.deg, density=40 / u.deg**2, cluster_size=150, cluster_scale=0.4 * u.deg, rng=3
)
stars = stars[region.contains(stars.coord)]
where_stars_are = rs.place_tiles(stars, "sdss_apo", method="max_density", completeness=0.9)
print(where_stars_are, f"for {where_stars_are.summary['completeness']:.0%} of {len(stars)} stars")

# %%
# Circles are fields of SDSS-V, and dots are stars.

fig, axes = plt.subplots(1, 2, figsize=(12, 5.4), layout="constrained")
for ax, tiles, name in zip(axes, (covering, where_stars_are), ("hexagonal", "max_density"), strict=True):
    rs.plot.plot_tiling(tiles, ax=ax, targets=stars, region=region)
    ax.set_title(f"{name}: {len(tiles)} tiles")
