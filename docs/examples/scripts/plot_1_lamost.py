"""
LAMOST: as few tiles as possible
================================

This script plans a survey of Tycho-2 stars around the Galactic anticenter. A network flow determines
the positions of the tiles.
"""

import matplotlib.pyplot as plt

import rfpsurvey as rs

# The package includes this catalog. To read your own catalog, write rs.Catalog.read("stars.fits").
stars = rs.example_catalog("anticenter")

# Tiles are added until 80 % of the stars are observed. The allocator must be the same as for the survey, because
# in the same tile, another allocator would observe other stars.
tiles = rs.place_tiles(stars, "lamost", method="network_flow", completeness=0.8, allocator="repair")
print(tiles)

# Proper motions move the stars to their positions at the epoch of the observation. The allocator "repair" starts from
# the plan of LAMOST's rule and removes the collisions of this plan. Later tiles can observe the remaining stars.
survey = rs.plan_survey(stars, "lamost", tiles, allocator="repair", epoch=2026.5)
print(survey)
for outcome, number in survey.summary["outcomes"].items():
    print(f"{number:>6} {outcome}")

# TOPCAT can open the two tables. The first table has a row for each tile, and the second table has a row for each star
# with a fiber.
survey.tiles.write("lamost_tiles.ecsv", overwrite=True)
survey.targets.write("lamost_targets.ecsv", overwrite=True)

fig, ax = plt.subplots(figsize=(7, 6), layout="constrained")
rs.plot.plot_tiling(survey, ax=ax)
