"""Plot the plans of two allocators for the example of the README.

``python docs/figures/overview.py FILE`` writes the figure of the first page to FILE.
"""

import sys

import astropy.units as u
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.lines import Line2D
from PIL import Image

import rfpsurvey as rs

TITLES = {"lamost_rule": "LAMOST's rule, which ignores collisions", "optimal": "optimal plan without collisions"}
stars, center = rs.example_catalog("anticenter"), "06h20m00s +23d00m00s"
figure, axes = plt.subplots(1, 2, figsize=(12, 6.7), layout="constrained", sharey=True)
for ax, (allocator, title) in zip(axes, TITLES.items(), strict=True):
    tile = rs.plan_tile(stars, "sdss_apo", center, allocator=allocator)
    rs.plot.plot_focal_plane(tile, ax=ax, region=[[-100, -100], [100, 100]] * u.mm)
    assigned, colliding = tile.summary["n_assigned"], tile.summary["n_colliding"]
    ax.set_title(f"{title}\nwhole field: {assigned} assigned, {colliding} in collision")
    ax.label_outer()
legend = axes[0].get_legend()
entries = {text.get_text(): handle for text, handle in zip(legend.get_texts(), legend.legend_handles, strict=True)}
entries["fiber"] = Line2D([], [], linestyle="none", marker="o", color="#0072B2")
for ax in axes:
    ax.get_legend().remove()
figure.legend(entries.values(), entries, loc="outside lower center", ncols=len(entries), frameon=False)
if sys.argv[1:]:
    figure.canvas.draw()
    image = Image.fromarray(np.asarray(figure.canvas.buffer_rgba())).convert("RGB")
    image.quantize(64, Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE).save(sys.argv[1], optimize=True)
