"""
SDSS-V: bright stars first
==========================

This script plans a survey of Tycho-2 stars with 500 fibers at Apache Point. The stars have three classes of priority,
and the brightest stars require two visits.
"""

import astropy.units as u
import matplotlib.pyplot as plt
import numpy as np

import rfpsurvey as rs

table = rs.example_catalog("anticenter").within("95 23", 4 * u.deg).to_table()
magnitude = table["vt_mag"].to_value(u.mag)
# A larger priority is more important: no number of stars of a lower class outweighs one star of a higher class.
table["priority"] = np.select([magnitude < 9, magnitude < 11], [3, 2], 1)
# Two visits to a star require two tiles, since a tile observes a star at most once.
table["visits"] = np.where(magnitude < 9, 2, 1)
stars = rs.Catalog.from_table(table)

# The four passes are shifted relative to each other, so that the gaps between fibers are at different positions.
tiles = rs.place_tiles(stars, "sdss_apo", method="hexagonal", passes=4)
print(tiles)

# The long arms of SDSS-V collide often; "optimal" finds the best plan without collisions for each tile.
survey = rs.plan_survey(stars, "sdss_apo", tiles, allocator="optimal", epoch=2026.5)
print(survey)
survey.completeness["pass", "priority", "n_requested", "n_observed"][-4:].pprint(max_width=-1)

survey.outcomes.write("sdssv_outcomes.ecsv", overwrite=True)  # outcome of each star

fig, ax = plt.subplots(figsize=(7, 4.5), layout="constrained")
rs.plot.plot_completeness(survey, ax=ax)
