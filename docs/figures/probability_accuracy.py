"""Plot the results of ``rfpsurvey benchmark probability`` for 469 positioners, measured when the page is built."""

import astropy.units as u
import matplotlib.pyplot as plt

import rfpsurvey as rs

unit = rs.Positioner(8.25 * u.mm, 8.25 * u.mm, 2.25 * u.mm)
plane = rs.FocalPlane.hexagonal(unit, rings=12, pitch=25.6 * u.mm)
table = rs.benchmark.benchmark_probability(plane, repeats=30)
table.meta["instrument"] = "LAMOST's arms"
figure, axes = plt.subplots(1, 2, figsize=(11, 5), layout="constrained")
rs.plot.plot_probability_accuracy(table, axes=tuple(axes))
