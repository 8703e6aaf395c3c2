"""Plot the performance of the allocator ``optimal``.

The left panel shows the time and the gap against the number of positioners. The right panel shows the number of
assigned targets and its upper bound against the time limit.
"""

import matplotlib.pyplot as plt

# tests/benchmarks/optimum_figures.py printed these numbers on two shared cores: the number of positioners, the time (s)
# and the gap, for SDSS-V arms with one target per positioner and a time limit of 60 s.
SIZES = [
    (1027, 0.27, 0),
    (2107, 0.60, 0),
    (3997, 1.48, 0),
    (9919, 17.4, 0.00055),
    (19_927, 39.1, 0.00041),
    (40_021, 60.1, 0.00034),
    (99_919, 60.2, 0.00136),
]
# Plans for 9919 positioners. LIMITS contains the time limits (s) of ``optimal``. Each entry of PLANS contains, for each
# time limit, the number of targets that ``optimal`` assigns and the upper bound of this number, and, for two other
# allocators, the time (s) and the number of targets whose arms do not collide.
LIMITS = (0.5, 1, 2, 4, 8, 16, 32)
PLANS = {
    "SDSS-V, 1 target per positioner": (
        (6857, 6857, 6910, 7187, 7207, 7207, 7207),
        (7545, 7324, 7251, 7236, 7211, 7211, 7211),
        [("lamost_rule", 0.05, 4427), ("repair", 0.06, 6774)],
    ),
    "SDSS-V, 2 targets per positioner": (
        (9609, 9609, 9609, 9647, 9736, 9797, 9797),
        (9858, 9858, 9834, 9810, 9803, 9798, 9798),
        [("lamost_rule", 0.04, 6105), ("repair", 0.06, 9556)],
    ),
    "reach of 2.5 pitches, 1 target per positioner": (
        (4363, 4378, 4378, 5112, 5112, 5112, 5452),
        (8843, 8843, 8843, 8843, 8843, 8843, 8786),
        [("lamost_rule", 0.11, 348), ("repair", 2.34, 5553)],
    ),
}
COLORS = ("#0072B2", "#D55E00", "#009E73")
figure, (left, right) = plt.subplots(1, 2, figsize=(10, 4.2), layout="constrained")
number, seconds, gap = zip(*SIZES, strict=True)
left.loglog(number, seconds, "o-", color=COLORS[0])
left.set(xlabel="number of positioners", ylabel="time (s)", ylim=(0.1, 300))
left.axhline(60, color="0.6", ls=":")
for n, s, g in SIZES:
    text = "proven" if g == 0 else f"gap {100 * g:.2f} %"
    left.annotate(text, (n, s), (0, 7), textcoords="offset points", ha="center", fontsize="small")
for color, (name, (plans, bounds, rules)) in zip(COLORS, PLANS.items(), strict=True):
    right.fill_between(LIMITS, plans, bounds, color=color, alpha=0.2, lw=0)
    right.plot(LIMITS, plans, "o-", color=color, ms=4, label=name)
    for (_, when, value), marker in zip(rules, "x+", strict=True):
        right.plot(when, value, marker, color=color)
for marker, name in zip("x+", ("lamost_rule, targets not in collision", "repair"), strict=True):
    right.plot([], [], marker, color="0.4", label=name)
right.set(
    xscale="log",
    xlabel="time limit of optimal, or time of lamost_rule and repair (s)",
    ylabel="targets (shaded: range up to the upper bound)",
    ylim=(0, 11_000),
)
right.set_xticks([0.05, 0.5, 5, 50], ["0.05", "0.5", "5", "50"])
right.legend(fontsize="small", loc="lower right")
