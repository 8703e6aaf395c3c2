"""
An instrument of your own
=========================

This example makes an instrument from a table of positions: 400 positioners on a sunflower spiral, two of them broken,
and a guide camera at the center.
"""

import astropy.units as u
import matplotlib.pyplot as plt
import numpy as np
from astropy.coordinates import SkyCoord
from astropy.table import QTable

import rfpsurvey as rs

k = np.arange(401)
radius, angle = 13 * np.sqrt(k + 0.5), k * np.pi * (3 - np.sqrt(5))
table = QTable({"id": [f"P{i}" for i in k], "x": radius * np.cos(angle) * u.mm, "y": radius * np.sin(angle) * u.mm})
table["disabled"] = np.isin(k, [10, 200])
table["obstacle_radius"] = np.where(k == 0, 12.0, np.nan) * u.mm  # the first row is the camera
robot = rs.Positioner(8 * u.mm, 10 * u.mm, clearance=1.5 * u.mm)
plane = rs.FocalPlane.from_table(table, robot)
sunflower = rs.Instrument("sunflower", plane, plate_scale=200 * u.mm / u.deg)
print(sunflower, "collisions of type", plane.collision_type, f"field {2 * sunflower.field_radius:.2f} across")

# %%
# An instrument from a table can be used like a preset.

center = SkyCoord("12h +30d")
stars = rs.synthetic_catalog("poisson", center, 1.5 * u.deg, density=400 / u.deg**2, rng=1)
tile = rs.plan_tile(stars, sunflower, center, allocator="optimal")
fig, ax = plt.subplots(figsize=(7, 7), layout="constrained")
rs.plot.plot_focal_plane(tile, ax=ax)
