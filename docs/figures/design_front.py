"""Plot the coverage and the fraction of fibers lost to collisions for many designs.

The plot marks the Pareto front and three instruments.
"""

import astropy.units as u
import matplotlib.pyplot as plt

import rfpsurvey as rs

box = {"central_arm": [7.25, 14.5] * u.mm, "ratio": [1, 2], "pitch": [24.6, 35] * u.mm, "clearance": 2.25 * u.mm}
table = rs.design.explore_designs(**box, n_designs=512)
arms = {"LAMOST": (8.25, 8.25, 25.6), "SDSS-V": (7.4, 15, 22.4), "MOONS": (8, 17, 25.058)}
mark = {
    name: rs.design.explore_designs(
        central_arm=central_arm * u.mm, ratio=eccentric_arm / central_arm, pitch=pitch * u.mm, clearance=2.25 * u.mm
    )
    for name, (central_arm, eccentric_arm, pitch) in arms.items()
}
figure, ax = plt.subplots(figsize=(7.5, 5), layout="constrained")
rs.plot.plot_designs(table, mark=mark, ax=ax)
