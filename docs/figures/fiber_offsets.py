"""Draw the arms of a positioner whose fibers are offset from the axis of the eccentric arm."""

import matplotlib.pyplot as plt
import numpy as np

l1, places = 7.4, {"BOSS": (14.965, -1.6), "APOGEE": (14.965, 1.6), "METROLOGY": (14.3, 0.0)}
theta, phi = np.deg2rad([25, 70])


def rotate(angle, x, y):
    """Return the coordinates (mm) of a point after a rotation about the origin."""
    return np.array([np.cos(angle) * x - np.sin(angle) * y, np.sin(angle) * x + np.cos(angle) * y])


elbow = rotate(theta, l1, 0)
fig, ax = plt.subplots(figsize=(5.5, 5), layout="constrained")
axis = elbow + rotate(theta + phi, 17, 0)
ax.plot([0, 11 * np.cos(theta)], [0, 11 * np.sin(theta)], ls=":", color="0.5")
ax.plot([0, 9], [0, 0], ls=":", color="0.5")
ax.plot(*np.transpose([[0, 0], elbow]), lw=8, color="0.75", solid_capstyle="round")
ax.plot(*np.transpose([elbow, elbow + rotate(theta + phi, 14.7, 0)]), lw=16, color="0.85", solid_capstyle="round")
ax.annotate("", axis, elbow, arrowprops={"arrowstyle": "->", "color": "0.3"})
for (name, place), color in zip(places.items(), ("C0", "C3", "C2"), strict=True):
    point = elbow + rotate(theta + phi, *place)
    ax.plot(*point, "o", color=color)
    shift = {"BOSS": (14, 4), "APOGEE": (-14, 0), "METROLOGY": (14, -6)}[name]
    ax.annotate(
        name,
        point,
        xytext=shift,
        textcoords="offset points",
        color=color,
        va="center",
        ha="left" if name != "APOGEE" else "right",
    )
ax.plot(0, 0, "k+", ms=12)
ax.text(-0.3, -0.9, "center: xy", ha="right", va="top")
ax.text(elbow[0] + 0.7, elbow[1] - 0.9, "elbow")
for begin, end, radius, center, label in (
    (0, theta, 5, (0, 0), "theta + theta zero"),
    (theta, theta + phi, 3, elbow, "phi + phi zero"),
):
    t = np.linspace(begin, end, 50)
    ax.plot(center[0] + radius * np.cos(t), center[1] + radius * np.sin(t), color="k", lw=1)
    half = (begin + end) / 2
    ax.text(center[0] + (radius + 0.4) * np.cos(half), center[1] + (radius + 0.4) * np.sin(half), label)
ax.set(aspect="equal", xlim=(-4, 17), ylim=(-3, 22), xlabel="x (mm)", ylabel="y (mm)")
