"""Plot the completeness of a survey with the tiles of DESI after each pass.

``tests/benchmarks/survey_figures.py`` prints the numbers.
"""

import matplotlib.pyplot as plt
import numpy as np

N_WANTED, N_TARGETS = 49_903_061, 19_959_605
# Each row contains three numbers after a pass: tiles so far, visits so far, and targets with all requested visits.
PASSES = np.array(
    [
        [3629, 12_201_498, 3_433_312],
        [7236, 22_426_880, 7_178_666],
        [10849, 30_358_821, 10_483_334],
        [14481, 36_305_920, 13_144_855],
        [18101, 40_429_474, 15_101_219],
        [19856, 41_976_658, 15_803_878],
        [21615, 43_262_235, 16_440_649],
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
