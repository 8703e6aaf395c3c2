"""
MOONS: overlapping patrol areas
===============================

The arms of MOONS reach the centers of neighboring positioners. The resulting overlaps of
patrol areas are useful in crowded fields, but arms can collide.
"""

import astropy.units as u
import matplotlib.pyplot as plt
import numpy as np

import rfpsurvey as rs

moons = rs.Instrument.preset("moons")
# The galaxies form clusters of 10 galaxies on average, with a radius of about 0.01 deg. There are far more
# galaxies than fibers.
center = "150.1 +2.2"
galaxies = rs.synthetic_catalog(
    "clustered", center, 0.6 * u.deg, density=12_000 / u.deg**2, cluster_size=10, cluster_scale=0.01 * u.deg, rng=1
)

# The next lines count the galaxies of one field by the number of positioners that reach them. If several positioners
# reach a galaxy, the allocator can assign the galaxy to any of these positioners.
xy = moons.projection(center).to_focal_plane(galaxies.within(center, moons.field_radius)).to_value(u.mm)
reaching = np.bincount(np.diff(moons.focal_plane.arrays.reach(xy).indptr))
print("number of galaxies that 0, 1, 2, ... positioners reach:", *reaching)

# The rule of LAMOST assigns the nearest galaxy to each positioner and ignores collisions. The allocator "optimal"
# chooses positioners that do not collide, and proves that no plan of a tile without collisions observes more galaxies.
tiles = rs.place_tiles(rs.Region.cap(center, 0.5 * u.deg), moons, passes=2)
surveys = {name: rs.plan_survey(galaxies, moons, tiles, allocator=name) for name in ("lamost_rule", "optimal")}
for name, survey in surveys.items():
    print(f"{name}: {survey}, {survey.summary['n_colliding']} arms in collision")
surveys["optimal"].targets.write("moons_targets.fits", overwrite=True)

fig, axes = plt.subplots(1, 2, figsize=(12, 5.6), layout="constrained")
rs.plot.plot_coverage(moons, region=[[-60, -60], [60, 60]] * u.mm, ax=axes[0])
rs.plot.plot_completeness(surveys["optimal"], ax=axes[1])
