"""The chart of ``rfpsurvey benchmark collisions``, drawn when this page was made."""

import matplotlib.pyplot as plt

import rfpsurvey as rs

figure, axes = plt.subplots(2, figsize=(7.5, 7), sharex=True, layout="constrained")
rs.plot_speed_accuracy(rs.benchmark_collisions("lamost", repeats=5), axes=tuple(axes))
