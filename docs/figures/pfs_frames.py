"""Draw the cobras of PFS on the Prime Focus Instrument."""

import matplotlib.pyplot as plt
import numpy as np

import rfpsurvey as rs

plane = rs.Instrument.preset("pfs").focal_plane
x, y = plane.xy.value.T
fig, ax = plt.subplots(figsize=(6, 6), layout="constrained")
for field in range(3):
    own = (plane.id - 1) // 798 == field
    module = (plane.id - 1) // 57 % 14
    ax.scatter(x[own], y[own], c=module[own] % 2 + 2 * field, s=6, cmap="tab20c", vmin=0, vmax=19)
    ax.annotate(f"field {field + 1}", (x[own].mean(), y[own].mean()), ha="center", weight="bold")
for cobra in (57, 798, 1596, 2394):
    row = np.flatnonzero(plane.id == cobra)[0]
    ax.annotate(str(cobra), (x[row], y[row]), ha="center", va="center", bbox={"fc": "white", "pad": 1})
ax.annotate("north", (240, -230), (150, -230), arrowprops={"arrowstyle": "->"}, va="center")
ax.annotate("west", (-230, 240), (-230, 170), arrowprops={"arrowstyle": "->"}, ha="center")
ax.set(xlabel="x of the PFI (mm)", ylabel="y of the PFI (mm)", aspect="equal", xlim=(-250, 250), ylim=(-250, 250))
