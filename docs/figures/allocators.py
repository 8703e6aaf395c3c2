"""Plot a crowded part of the focal plane for each allocator."""

import astropy.units as u
import matplotlib.pyplot as plt
import numpy as np
from astropy.coordinates import SkyCoord

import rfpsurvey as rs

center = SkyCoord("10h00m00s +02d12m00s")
galaxies = rs.synthetic_catalog(
    "clustered", center, 0.22 * u.deg, density=9000 / u.deg**2, cluster_size=6, cluster_scale=0.01 * u.deg, rng=3
)
xy = rs.Instrument.preset("moons").projection(center).to_focal_plane(galaxies)
figure, axes = plt.subplots(2, 3, figsize=(10.5, 7.6), layout="constrained", sharex=True, sharey=True)
for ax, allocator in zip(
    axes.flat, ("balanced", "nearest", "lamost_rule", "network_flow", "repair", "optimal"), strict=True
):
    tile = rs.plan_tile(galaxies, "moons", center, allocator=allocator)
    rs.plot.plot_focal_plane(tile, ax=ax, region=[[-30, -30], [90, 90]] * u.mm)
    ax.plot(*xy.value.T, ".", color="#009E73", markersize=3, zorder=0)
    ax.get_legend().remove()
    usable = int(np.count_nonzero((tile.table["kind"] == "science") & ~tile.table["in_collision"]))
    ax.set_title(f"{allocator}: {tile.summary['n_assigned']} assigned, {usable} usable")
    ax.label_outer()
