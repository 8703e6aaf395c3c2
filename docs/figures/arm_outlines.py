"""Draw a tile of seven positioners of DESI with the outlines of both arms."""

import astropy.units as u
import matplotlib.pyplot as plt
from astropy.coordinates import SkyCoord

import rfpsurvey as rs

desi = rs.Instrument.preset("desi")
robot = desi.focal_plane.positioner
plane = rs.FocalPlane.hexagonal(robot, rings=1, pitch=10.4 * u.mm)
seven = rs.Instrument("seven of DESI", plane, plate_scale=desi.plate_scale)
center = SkyCoord("12h +30d")
stars = rs.synthetic_catalog("uniform", center, seven.field_radius, n_targets=40, rng=8)
tile = rs.plan_tile(stars, seven, center, allocator="balanced")
fig, ax = plt.subplots(figsize=(5, 5), layout="constrained")
rs.plot.plot_focal_plane(tile, ax=ax)
