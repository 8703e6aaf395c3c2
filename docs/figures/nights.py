"""Plot the merits of greedy and exact plans of nights relative to the upper limit; night_orders.py measured them."""

import matplotlib.pyplot as plt
import numpy as np
import planner_tables
from astropy.table import Table

table = Table.read(planner_tables.RESULTS.parents[1] / "night_orders.ecsv", format="ascii.ecsv")
figure, ax = plt.subplots(figsize=(6.5, 3.2), layout="constrained")
night = np.arange(len(table))
for name, marker in (("exact", "s-"), ("greedy", "o--")):
    ax.plot(night, 100 * table[name] / table["bound"], marker, ms=4, label=name)
ax.axhline(100, color="gray", lw=1)
ax.set(xlabel=f"nights since {table['date'][0]}", ylabel="merit (% of the upper limit)")
ax.legend()
