"""Draw a tile of an instrument of four positioners and one obstacle, which a table describes."""

import astropy.units as u
import matplotlib.pyplot as plt
import numpy as np
from astropy.coordinates import SkyCoord
from astropy.table import QTable

import rfpsurvey as rs

table = QTable(
    {"id": ["A", "B", "C", "D", "pin"], "x": [0, 25.6, 12.8, -12.8, 12.8] * u.mm, "y": [0, 0, 22.2, 22.2, 7.4] * u.mm}
)
table["disabled"] = [False, False, False, True, False]
table["obstacle_radius"] = [np.nan, np.nan, np.nan, np.nan, 1.0] * u.mm
robot = rs.Positioner(8.25 * u.mm, 8.25 * u.mm, clearance=2.25 * u.mm)
mine = rs.Instrument("mine", rs.FocalPlane.from_table(table, robot), plate_scale=20 * u.m / u.rad)
center = SkyCoord("12h +30d")
stars = rs.synthetic_catalog("uniform", center, mine.field_radius, n_targets=40, rng=2)
fig, ax = plt.subplots(figsize=(5, 5), layout="constrained")
rs.plot.plot_focal_plane(rs.plan_tile(stars, mine, center, allocator="optimal"), ax=ax)
