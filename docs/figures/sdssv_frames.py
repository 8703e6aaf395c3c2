"""Plot the positioners of SDSS-V in wok coordinates, and in focal coordinates at a position angle of 60 deg."""

import matplotlib.pyplot as plt
import numpy as np

import rfpsurvey as rs

angle = np.deg2rad(60)
wok = rs.Instrument.preset("sdss_apo").focal_plane.xy.value
c, s = np.cos(angle), np.sin(angle)
focal = wok @ np.array([[c, -s], [s, c]])  # rotated clockwise
fig, axes = plt.subplots(1, 2, figsize=(8, 4.2), layout="constrained", sharey=True)
labels = (("x wok [mm]", "y wok [mm]"), ("x focal (east) [mm]", "y focal (north) [mm]"))
for ax, xy, turn, names in zip(axes, (wok, focal), (0, angle), labels, strict=True):
    first = np.hypot(*(wok - [0, 232.8]).T) < 120
    ax.plot(*xy.T, ".", ms=3, color="0.75")
    ax.plot(*xy[first].T, ".", ms=4, color="C0")
    for k, name in enumerate(("+x wok", "+y wok")):
        end = 250 * np.array([np.sin(turn + (1 - k) * np.pi / 2), np.cos(turn + (1 - k) * np.pi / 2)])
        ax.annotate("", end, (0, 0), arrowprops={"arrowstyle": "->", "lw": 1.5})
        ax.annotate(name, end * 1.08, ha="center", va="center", bbox={"fc": "w", "ec": "none", "pad": 1})
    ax.set(aspect="equal", xlabel=names[0], ylabel=names[1], xlim=(-350, 350), ylim=(-350, 350))
