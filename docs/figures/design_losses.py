"""Plot the fraction of fibers lost to collisions, by three definitions, against the ratio of the arms."""

import astropy.units as u
import matplotlib.pyplot as plt
import numpy as np

import rfpsurvey as rs
from rfpsurvey.plot._axes import MARKERS, SERIES

scan = {"central_arm": 8.25 * u.mm, "ratio": np.linspace(1, 2, 6), "pitch": 25.6 * u.mm, "clearance": 2.25 * u.mm}
questions = [("independent", None), ("allocated", 4), ("allocated", 1), ("collision_free", 1), ("collision_free", 2)]
figure, ax = plt.subplots(figsize=(6.5, 4), layout="constrained")
for k, (estimand, each) in enumerate(questions):
    table = rs.design.explore_designs(
        **scan, loss=rs.design.LossOptions(estimand, targets_per_positioner=each, n_skies=10)
    )
    label = estimand.replace("_", " ") + ("" if each is None else f", {each} target{'s' * (each > 1)} per positioner")
    style = {"color": SERIES[k], "marker": MARKERS[k], "markersize": 4, "label": label}
    ax.errorbar(table["ratio"], table["loss"], table["loss_error"], **style)
ax.set(xlabel="eccentric arm / central arm", ylabel="fraction of fibers lost to collisions")
ax.legend(fontsize="small")
