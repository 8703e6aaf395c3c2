"""Plot a comparison of all presets with one target per positioner, in two fields."""

import matplotlib.pyplot as plt

import rfpsurvey as rs
from rfpsurvey.plot._comparisons import draw_instruments

table = rs.compare_instruments(n_realizations=2)
draw_instruments(table, plt.figure(layout="constrained"))
