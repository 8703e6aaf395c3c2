"""Plot the results of simulations that end when they have converged, or when the confidence interval is short."""

import astropy.units as u
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.ticker import LogLocator, NullFormatter

import rfpsurvey as rs
from rfpsurvey.probability import Precision, RandomTargets

unit = rs.Positioner(8.25 * u.mm, 8.25 * u.mm, 2.25 * u.mm)
plane = rs.FocalPlane.hexagonal(unit, rings=3, pitch=25.6 * u.mm)
targets = RandomTargets(number=148)
truth = rs.collision_probability(plane, targets=targets, precision=2e-4).value
figure, ax = plt.subplots(figsize=(6.5, 4), layout="constrained")
for stop, color in (("convergence", "#D55E00"), ("interval", "#0072B2")):
    options = {"method": "monte_carlo", "targets": targets, "precision": Precision(0.002, stop=stop)}
    found = [rs.collision_probability(plane, rng=k, **options) for k in range(40)]
    error = np.sqrt(np.mean([(e.value - truth) ** 2 for e in found]))
    label = f"stop={stop!r}: root mean square error {error / 0.002:.1f}"
    label += " \N{MULTIPLICATION SIGN} the requested standard error"
    ax.plot([e.n for e in found], [e.value for e in found], "o", color=color, ms=4, label=label)
ax.axhspan(truth - 0.002, truth + 0.002, color="0.85", label="truth \N{PLUS-MINUS SIGN} requested standard error")
ax.set(xlabel="iterations", ylabel="collision probability", xscale="log")
ax.xaxis.set_major_locator(LogLocator(subs=range(1, 10)))
ax.xaxis.set_major_formatter("{x:g}")
ax.xaxis.set_minor_formatter(NullFormatter())
figure.legend(fontsize="small", loc="outside lower center")  # a legend inside the axes would hide points
