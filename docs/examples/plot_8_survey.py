"""
Completeness of a survey
========================

This example plans a survey of real stars with SDSS-V in four passes. Bright stars have a higher priority and
require two visits; other stars require one visit.
"""

import astropy.units as u
import matplotlib.pyplot as plt
import numpy as np
from astropy.coordinates import SkyCoord

import rfpsurvey as rs

table = rs.example_catalog("anticenter").to_table()
bright = table["vt_mag"] < 10 * u.mag
table["priority"], table["visits"] = np.where(bright, 2, 1), np.where(bright, 2, 1)
stars = rs.Catalog.from_table(table).within(SkyCoord("06h20m00s +23d00m00s"), 4 * u.deg)
tiles = rs.place_tiles(stars, "sdss_apo", passes=4)
survey = rs.plan_survey(stars, "sdss_apo", tiles, allocator="repair", epoch=2026.5)
print(survey)
for outcome, number in survey.summary["outcomes"].items():
    print(f"{number:>6} {outcome}")

# %%
# A tile visits a star at most once, and bright stars require two visits. After the first pass, the completeness of the
# bright stars can therefore hardly exceed one half: only stars where two tiles overlap can be visited twice.

fig, (left, right) = plt.subplots(1, 2, figsize=(12, 4.6), layout="constrained")
rs.plot.plot_tiling(survey, ax=left).set_title("completeness of each field")
rs.plot.plot_completeness(survey, ax=right).set_title("completeness after each tile")
