"""Plot the science targets that planners observe against the processor time, for six scenes of planner_tables.py."""

import matplotlib.pyplot as plt
import numpy as np
import planner_tables

SCENES = {
    "desi_2": "DESI, 10,000 targets",
    "desi_2_rules": "DESI, 10,000 targets, sky and standards",
    "desi_tiles": "DESI, four overlapping tiles",
    "pfs_rules": "PFS, 3600 targets, sky and standards",
    "sdss_dark": "SDSS-V, sky and standards",
    "hub": "37 long arms, 60 targets",
}
OURS = ("nearest", "repair", "optimal", "joint")
OTHERS = ("fiberassign", "netflow", "robostrategy", "CP-SAT")


def are_close(one, other):
    """Return whether two points are so close to each other that they need a common label."""
    return abs(np.log10(one["seconds"] / other["seconds"])) < 0.5 and abs(one["science"] / other["science"] - 1) < 4e-3


results = planner_tables.read()
figure, axes = plt.subplots(2, 3, figsize=(10, 6), layout="constrained")
for ax, (scene, name) in zip(axes.flat, SCENES.items(), strict=True):
    for programs, style, label in ((OURS, "o-", "rfpsurvey"), (OTHERS, "s", "other planners")):
        rows = [results[scene, one] for one in programs if (scene, one) in results]
        times, counts = [row["seconds"] for row in rows], [row["science"] for row in rows]
        ax.semilogx(times, counts, style, color="#0072B2" if programs is OURS else "#D55E00", label=label)
        place, side = ((-5, 4), "right") if programs is OURS else ((7, -4), "left")
        for k, row in enumerate(rows):
            close = [one["program"] for one in rows[k + 1 :] if are_close(row, one)]
            if k == 0 or not are_close(rows[k - 1], row):
                at, text = (row["seconds"], row["science"]), ", ".join([row["program"], *close])
                ax.annotate(text, at, place, textcoords="offset points", ha=side, fontsize=8)
    ax.set_title(name, fontsize=9)
    ax.set_xlim(1e-6, 1e5)
    ax.margins(y=0.15)
axes[0, 0].legend(loc="lower right", fontsize=8)
figure.supxlabel("processor time (s)", fontsize=10)
figure.supylabel("observed science targets", fontsize=10)
