"""Plot the displacements that models of the projection neglect, against altitude and against computing time."""

import astropy.units as u
import matplotlib.pyplot as plt
import numpy as np
from astropy.coordinates import SkyCoord

import rfpsurvey as rs

# site, and milliseconds per 10,000 targets as tests/benchmarks/observing_models.py prints them
CASES = {
    "lamost": ("xinglong", [0.03, 0.03, 0.62, 0.62, 1.7]),
    "sdss_apo": ("apache point", [0.03, 1.7, 2.4, 3.5, 4.6]),
    "moons": ("paranal", [0.03, 0.03, 0.62, 0.62, 1.5]),
    "desi": ("kitt peak", [0.03, 0.40, 1.0, 1.0, 1.9]),
    "pfs": ("mauna kea", [0.03, 0.48, 1.1, 1.1, 2.1]),
}
LABELS = {
    "tangent": "tangent plane",
    "radial": "radial map",
    "refraction": "+ refraction",
    "dispersion": "+ dispersion",
    "drift": "drift during the exposure",
}
COLORS = dict(zip(LABELS, ("#000000", "#D55E00", "#0072B2", "#009E73", "#AAAAAA"), strict=True))
ALTITUDES = (85, 75, 60, 45, 30, 20)
figure, axes = plt.subplots(2, 3, figsize=(10, 6.5), layout="constrained")
for ax, (name, (site, milliseconds)) in zip(axes.flat, CASES.items(), strict=False):
    conditions = rs.ObservingConditions(site, hour_angle=0 * u.deg, exposure_time=15 * u.min)
    latitude = conditions.site.lat.rad
    moved = []
    for altitude in ALTITUDES:
        cosine = (np.sin(np.deg2rad(altitude)) - np.sin(latitude) ** 2) / np.cos(latitude) ** 2
        center = SkyCoord(0 * u.deg, latitude * u.rad)
        result = rs.instrument.compare_projections(name, center, conditions.at_hour_angle(np.arccos(cosine) * u.rad))
        moved.append([*result.table["max"].to_value(u.um)[:4], result.drift.to_value(u.um)])
    for model, values in zip(LABELS, np.transpose(moved), strict=True):
        values = np.where(values > 1e-3, values, np.nan)
        # Without a radial map, the curves of tangent and radial coincide. Without dispersion, the curves of refraction
        # and dispersion coincide.
        style = "--" if model in ("tangent", "dispersion") else ":" if model == "drift" else "-"
        ax.semilogy(ALTITUDES, values, style, color=COLORS[model], lw=2, label=LABELS[model])
    ax.axhline(result.tolerance.to_value(u.um), color="0.3", lw=0.8, label="tolerance")
    ax.set(title=name, xlim=(88, 18), ylim=(5e-3, 4e4), xlabel="altitude of the center [deg]")
    axes.flat[5].loglog(milliseconds[:4], moved[ALTITUDES.index(45)][:4], "o-", label=name)
for ax in axes[:, 0]:
    ax.set_ylabel("largest displacement [um]")
figure.legend(*axes.flat[0].get_legend_handles_labels(), loc="outside lower center", ncols=6)
axes.flat[5].set(title="altitude 45 deg", xlabel="time per 10,000 targets [ms]", ylim=(5e-3, 4e4))
axes.flat[5].legend(fontsize="x-small")
