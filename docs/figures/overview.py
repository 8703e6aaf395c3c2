"""Plot a crowded field of SDSS-V with two allocators, for the first page (``python docs/figures/overview.py FILE``)."""

import sys

import astropy.units as u
import matplotlib.pyplot as plt
import numpy as np
from PIL import Image

import rfpsurvey as rs

center = "06h20m00s +23d00m00s"
sky = rs.synthetic_catalog(
    "clustered", center, 1.5 * u.deg, density=150 / u.deg**2, cluster_size=8, cluster_scale=0.1 * u.deg, rng=4
)
figure, axes = plt.subplots(1, 2, figsize=(12, 6.2), layout="constrained", sharey=True)
for ax, allocator in zip(axes, ("lamost", "optimal"), strict=True):
    tile = rs.plan_tile(sky, "sdss_apo", center, allocator=allocator)
    rs.plot.plot_focal_plane(tile, ax=ax, region=[[-100, -100], [100, 100]] * u.mm)
    assigned, colliding = tile.summary["n_assigned"], tile.summary["n_colliding"]
    ax.set_title(f'allocator="{allocator}": {assigned} assigned, {colliding} in collision')
    ax.get_legend().remove()
    ax.label_outer()
if sys.argv[1:]:
    figure.canvas.draw()
    image = Image.fromarray(np.asarray(figure.canvas.buffer_rgba())).convert("RGB")
    image.quantize(64, Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE).save(sys.argv[1], optimize=True)
