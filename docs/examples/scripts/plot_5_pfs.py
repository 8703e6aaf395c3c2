"""
PFS: sky fibers and standards in every visit
============================================

Each exposure of PFS needs 240 fibers on the sky and 40 fibers on standard stars. Galaxies require one to three visits.
"""

import astropy.units as u
import matplotlib.pyplot as plt
import numpy as np

import rfpsurvey as rs

pfs = rs.Instrument.preset("pfs")
print("required in each tile:", *pfs.requirements)
center, rng = "34.5 -5", np.random.default_rng(1)
field = rs.synthetic_catalog("poisson", center, 1.6 * u.deg, density=4000 / u.deg**2, rng=rng)
# One target in 20 is a standard star. Standards and sky positions may be observed in every tile.
kind = np.where(rng.random(len(field)) < 0.05, "standard", "science")
targets = rs.Catalog(field.coord, kind=kind, visits=rng.integers(1, 4, len(field)))

# Positions that are at least 5 arcsec from all targets are used as sky positions. The plan of "optimal" meets all
# requirements without collisions.
options = rs.AllocationOptions("optimal", requirements="instrument", sky_separation=5 * u.arcsec)
tiles = rs.place_tiles(rs.Region.cap(center, 1 * u.deg), pfs, passes=3)
survey = rs.plan_survey(targets, pfs, tiles, allocator=options)
print(survey)
print("tiles with a requirement that is not met:", int((survey.tiles["n_unmet"] > 0).sum()))
for name in ("n_science", "n_standard", "n_sky", "n_colliding"):
    print(f"{name}: {survey.tiles[name].min()} to {survey.tiles[name].max()} in a tile")
survey.tiles.write("pfs_tiles.ecsv", overwrite=True)

fig, ax = plt.subplots(figsize=(8, 4), layout="constrained")
below = np.zeros(len(survey))
for name, color in (("n_science", "#0072B2"), ("n_standard", "#E69F00"), ("n_sky", "0.8")):
    ax.bar(np.arange(len(survey)), survey.tiles[name], bottom=below, color=color, label=name[2:], width=1)
    below += survey.tiles[name]
ax.set(xlabel="tile", ylabel="fibers", title="Fibers of each tile of PFS")
ax.legend(loc="lower left")
