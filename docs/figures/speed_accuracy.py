"""Plot the results of ``rfpsurvey benchmark collisions`` for two instruments, measured when the page is built."""

import matplotlib.pyplot as plt

import rfpsurvey as rs

figure, axes = plt.subplots(2, 2, figsize=(13, 8), sharex="col", layout="constrained")
for column, name in zip(axes.T, ("lamost", "sdss_apo"), strict=True):
    rs.plot.plot_speed_accuracy(rs.benchmark.benchmark_collisions(name, repeats=5), axes=tuple(column))
