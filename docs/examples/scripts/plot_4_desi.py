"""
DESI: several visits
====================

This script plans a survey of synthetic targets over 50 square degrees with 5000 fibers. There are three classes of
targets, which require one, two or four visits.
"""

from concurrent.futures import ThreadPoolExecutor

import astropy.units as u
import matplotlib.pyplot as plt
import numpy as np

import rfpsurvey as rs

center, rng = "150 +10", np.random.default_rng(1)
sky = rs.synthetic_catalog("poisson", center, 4 * u.deg, density=2400 / u.deg**2, rng=rng)
# Quasars are rare, have the highest priority and require four visits; the many emission-line galaxies (ELG) fill the
# other fibers.
category = rng.choice(["QSO", "LRG", "ELG"], len(sky), p=[0.1, 0.25, 0.65])
first, second = category == "QSO", category == "LRG"
priority, visits = np.select([first, second], [3, 2], 1), np.select([first, second], [4, 2], 1)
targets = rs.Catalog(sky.coord, category=category, priority=priority, visits=visits)

tiles = rs.place_tiles(rs.Region.cap(center, 4 * u.deg), "desi", passes=4)
print(tiles)
# The allocator "repair" takes milliseconds per tile. Two threads plan two tiles at the same time if the tiles
# have no targets in common; the result does not depend on the number of threads. For a long survey, add
# folder="desi_survey" and, after a crash, resume=True.
with ThreadPoolExecutor(2) as executor:
    survey = rs.plan_survey(targets, "desi", tiles, allocator="repair", executor=executor)
print(survey)
survey.completeness["pass", "category", "n_requested", "n_observed"][-3:].pprint(max_width=-1)
survey.targets.write("desi_targets.fits", overwrite=True)  # a row for each fiber with a target

fig, (left, right) = plt.subplots(1, 2, figsize=(13, 5), layout="constrained")
rs.plot.plot_tiling(survey, ax=left)
rs.plot.plot_completeness(survey, ax=right)
