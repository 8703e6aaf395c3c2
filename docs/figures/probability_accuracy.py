"""The chart of ``rfpsurvey benchmark probability`` for a small array, drawn when this page was made."""

import astropy.units as u
import matplotlib.pyplot as plt

import rfpsurvey as rs

unit = rs.Positioner(8.25 * u.mm, 8.25 * u.mm, 2.25 * u.mm)
plane = rs.FocalPlane.hexagonal(unit, rings=12, pitch=25.6 * u.mm)
figure, ax = plt.subplots(figsize=(7.5, 5), layout="constrained")
rs.plot_probability_accuracy(rs.benchmark_probability(plane, repeats=3), ax=ax)
ax.set_title("469 positioners, LAMOST's arms; labels: iterations, realizations or points")
