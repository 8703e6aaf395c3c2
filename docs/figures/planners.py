"""Plot the science targets that planners observe against the processor time, for six scenes.

tests/benchmarks/planners/compare.py printed the numbers: the processor time (s) and the number of science targets.
"""

import matplotlib.pyplot as plt

# For each scene: the results of the allocators of rfpsurvey, and the results of other planners.
SCENES = {
    "DESI, 10,000 targets": (
        [("nearest", 0.011, 3960), ("repair, optimal", 0.049, 4220), ("", 0.066, 4231)],
        [("fiberassign", 0.293, 4134)],
    ),
    "DESI, 10,000 targets, sky and standards": (
        [("nearest", 0.030, 3912), ("repair", 0.224, 4190), ("optimal", 0.742, 4227)],
        [("fiberassign", 0.567, 4137)],
    ),
    "PFS, 9600 targets": (
        [("nearest", 0.013, 2162), ("repair, optimal", 0.037, 2347), ("", 0.063, 2353)],
        [("netflow", 4.015, 2353), ("CP-SAT", 60.2, 2343)],
    ),
    "PFS, 3600 targets, sky and standards": (
        [("nearest", 0.012, 1669), ("repair", 0.041, 1725), ("optimal", 1.327, 1786)],
        [("netflow", 2.565, 1786), ("CP-SAT", 60.1, 1646)],
    ),
    "SDSS-V, a quarter of the arms stuck": (
        [("nearest", 0.008, 197), ("repair", 0.019, 259), ("optimal", 0.222, 274)],
        [("CP-SAT, kaiju", 4.989, 274)],
    ),
    "37 long arms, 60 targets": (
        [("nearest", 0.001, 0), ("repair", 0.033, 6), ("optimal", 28.4, 9)],
        [("CP-SAT", 60.4, 11)],
    ),
}

figure, axes = plt.subplots(2, 3, figsize=(10, 6), layout="constrained")
for ax, (name, (ours, others)) in zip(axes.flat, SCENES.items(), strict=True):
    ax.semilogx([time for _, time, _ in ours], [n for *_, n in ours], "o-", color="#0072B2", label="rfpsurvey")
    ax.semilogx([time for _, time, _ in others], [n for *_, n in others], "s", color="#D55E00", label="other planners")
    for label, time, n in ours:
        ax.annotate(label, (time, n), (-5, 4), textcoords="offset points", ha="right", fontsize=8)
    for label, time, n in others:
        ax.annotate(label, (time, n), (0, -14), textcoords="offset points", ha="center", fontsize=8)
    ax.set_title(name, fontsize=9)
    ax.set_xlim(1e-5, 3000)
    ax.margins(y=0.15)
axes[0, 0].legend(loc="lower right", fontsize=8)
figure.supxlabel("processor time (s)", fontsize=10)
figure.supylabel("observed science targets", fontsize=10)
