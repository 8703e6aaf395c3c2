"""Plot the completeness of a survey with the tiles of DESI after each pass.

``tests/benchmarks/survey_figures.py`` prints the numbers.
"""

import matplotlib.pyplot as plt
import numpy as np

N_WANTED, N_TARGETS = 49_903_061, 19_959_605
# Each row contains three numbers after a pass: tiles so far, visits so far, and targets with all requested visits.
PASSES = np.array(
    [
        [3629, 12_822_664, 3_609_931],
        [7236, 23_505_279, 7_584_635],
        [10849, 31_631_252, 11_030_487],
        [14481, 37_559_496, 13_727_710],
        [18101, 41_519_104, 15_635_087],
        [19856, 42_938_202, 16_289_078],
        [21615, 44_098_927, 16_873_197],
    ]
)

fig, ax = plt.subplots(figsize=(7, 4), layout="constrained")
tiles = np.append(0, PASSES[:, 0])
ax.plot(tiles, np.append(0, PASSES[:, 1] / N_WANTED), "ko-", label="visits")
ax.plot(tiles, np.append(0, PASSES[:, 2] / N_TARGETS), "kX:", label="targets complete")
for number, end in enumerate(PASSES[:, 0]):
    ax.axvline(end, color="0.8", lw=0.8, zorder=0)
    ax.annotate(f"pass {number}", (end, 0.01), rotation=90, ha="right", fontsize="x-small", color="0.4")
ax.set(xlim=(0, None), ylim=(0, 1), xlabel="tiles", ylabel="completeness")
ax.legend()
