"""Plot the collision probability from the closed form and from the surrogate against the ratio of the arms."""

import astropy.units as u
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.ticker import LogLocator, NullFormatter

import rfpsurvey as rs

figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3.8), layout="constrained")
ratios = np.linspace(1, 3, 41)
for pitch, color in ((25.6, "#0072B2"), (30.0, "#E69F00"), (35.0, "#009E73")):
    formula = []
    for ratio in ratios:
        unit = rs.Positioner(8.25 * u.mm, 8.25 * ratio * u.mm, 2.25 * u.mm)
        plane = rs.FocalPlane.hexagonal(unit, rings=4, pitch=pitch * u.mm)
        formula.append(rs.collision_probability(plane, method="closed_form").per_positioner[len(plane) // 2])
    truth = rs.probability.surrogate_probability(8.25 * u.mm, 8.25 * ratios * u.mm, pitch * u.mm, 4.5 * u.mm)
    left.plot(ratios, truth, color=color, label=f"pitch {pitch:g} mm")
    left.plot(ratios, formula, "--", color=color)
    some = np.array(formula) > 0
    right.plot(ratios[some], truth[some] / np.array(formula)[some], color=color)
left.set(
    xlabel="eccentric arm / central arm", ylabel="collision probability", title="solid: surrogate, dashed: closed form"
)
left.legend()
right.set(xlabel="eccentric arm / central arm", ylabel="surrogate / closed form", yscale="log")
right.yaxis.set_major_locator(LogLocator(subs=(1, 2, 3, 5)))
right.yaxis.set_major_formatter("{x:g}")
right.yaxis.set_minor_formatter(NullFormatter())
