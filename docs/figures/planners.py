"""Plot the science targets that planners observe against the processor time, for six scenes of planner_tables.py."""

import matplotlib.pyplot as plt
import planner_tables

SCENES = {
    "desi_2": "DESI, 10,000 targets",
    "desi_2_rules": "DESI, 10,000 targets, sky and standards",
    "desi_tiles": "DESI, four overlapping tiles",
    "pfs_rules": "PFS, 3600 targets, sky and standards",
    "stuck": "SDSS-V, a quarter of the arms stuck",
    "hub": "37 long arms, 60 targets",
}
OURS = ("nearest", "repair", "optimal", "joint")

results = planner_tables.read()
figure, axes = plt.subplots(2, 3, figsize=(10, 6), layout="constrained")
for ax, (scene, name) in zip(axes.flat, SCENES.items(), strict=True):
    for programs, style, label in ((OURS, "o-", "rfpsurvey"), (planner_tables.SHOWN, "s", "other planners")):
        rows = [results[scene, one] for one in programs if (scene, one) in results]
        rows = [row for row in rows if (row["program"] in OURS) == (programs is OURS)]
        times, counts = [row["seconds"] for row in rows], [row["science"] for row in rows]
        ax.semilogx(times, counts, style, color="#0072B2" if programs is OURS else "#D55E00", label=label)
        place, side = ((-5, 4), "right") if programs is OURS else ((0, -14), "center")
        for row in rows:
            at = (row["seconds"], row["science"])
            ax.annotate(row["program"], at, place, textcoords="offset points", ha=side, fontsize=8)
    ax.set_title(name, fontsize=9)
    ax.set_xlim(1e-5, 3000)
    ax.margins(y=0.15)
axes[0, 0].legend(loc="lower right", fontsize=8)
figure.supxlabel("processor time (s)", fontsize=10)
figure.supylabel("observed science targets", fontsize=10)
