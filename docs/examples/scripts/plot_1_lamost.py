"""
LAMOST: as few tiles as possible
================================

Tycho-2 stars around the Galactic anticenter, on tiles that a network flow places where the stars are.
"""

import astropy.units as u
import matplotlib.pyplot as plt

import rfpsurvey as rs

# Stars that come with the package; for your own, write rs.Catalog.read("stars.fits").
stars = rs.example_catalog("anticenter").within("95 23", 6 * u.deg)

# Tiles are added until 80 % of the stars are observed. The allocator is that of the survey below, since another one
# observes other stars of a tile.
tiles = rs.place_tiles(stars, "lamost", method="sdss", completeness=0.8, allocator="repair")
print(tiles)

# The epoch of the observation: stars are moved there by their proper motions. The allocator "repair" makes LAMOST's own
# plan and removes its collisions. Stars without a fiber remain for the next tile.
survey = rs.plan_survey(stars, "lamost", tiles, allocator="repair", epoch=2026.5)
print(survey)
for outcome, number in survey.summary["outcomes"].items():
    print(f"{number:>6} {outcome}")

# Tables that TOPCAT opens: a row for each tile, and a row for each star with a fiber.
survey.tiles.write("lamost_tiles.ecsv", overwrite=True)
survey.targets.write("lamost_targets.ecsv", overwrite=True)

fig, ax = plt.subplots(figsize=(7, 6), layout="constrained")
rs.plot.plot_tiling(survey, ax=ax)
