"""Plot the collision probability from the surrogate as a function of the ratio of the arms and the pitch."""

import astropy.units as u
import matplotlib.pyplot as plt
import numpy as np

import rfpsurvey as rs

ratio, pitch = np.meshgrid(np.linspace(1, 2, 101), np.linspace(24.6, 35, 101))
risk = rs.probability.surrogate_probability(8.25 * u.mm, 8.25 * ratio * u.mm, pitch * u.mm, 4.5 * u.mm)
figure, ax = plt.subplots(figsize=(5.5, 4), layout="constrained")
lines = ax.contourf(ratio, pitch, risk, levels=np.linspace(0, 0.6, 13), cmap="viridis")
figure.colorbar(lines, label="collision probability")
ax.set(xlabel="eccentric arm / central arm", ylabel="pitch [mm]", title="central arm 8.25 mm, D = 4.5 mm")
