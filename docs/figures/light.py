"""Plot the light that enters fibers against offset, wavelength and hour angle."""

from dataclasses import replace

import astropy.units as u
import matplotlib.pyplot as plt
import numpy as np

import rfpsurvey as rs
from rfpsurvey.observing import FiberLight, fiber_fraction

COLORS = ("#0072B2", "#E69F00", "#009E73", "#D55E00")
DASHES = {"moffat": "-", "gaussian": "--"}
figure, (offsets, waves, hours) = plt.subplots(1, 3, figsize=(10, 3.9), layout="constrained")

offset = np.linspace(0, 1, 101)
for ratio, color in zip((0.5, 0.75, 1.0), COLORS, strict=False):
    for profile, dash in DASHES.items():
        light = fiber_fraction(offset * u.mm, 1 * u.mm, ratio * u.mm, profile=profile)
        label = f"{ratio:g}, Moffat" if dash == "-" else None
        offsets.plot(offset, light, dash, color=color, lw=1.8, label=label)
offsets.plot([], [], "--", color="0.3", label="Gaussian")
offsets.axvline(0.1, color="0.5", lw=0.8)
offsets.annotate("tolerance", (0.12, 0.03), color="0.35", fontsize="small")
offsets.set(title="Offset of the fiber", xlabel="offset [diameters]", ylabel="fraction of the light", xlim=(0, 1))

conditions = rs.ObservingConditions("apache point", hour_angle=0 * u.deg, exposure_time=15 * u.min)
center = f"0 {conditions.site.lat.deg}"  # passes through the zenith
band = np.geomspace(0.36, 1.0, 30) * u.um
fibers = FiberLight("sdss_apo", center, conditions, 1.2 * u.arcsec, {"BOSS": band})
latitude = conditions.site.lat.rad
for altitude, color in zip((75, 60, 45, 30), COLORS, strict=True):
    cosine = (np.sin(np.deg2rad(altitude)) - np.sin(latitude) ** 2) / np.cos(latitude) ** 2
    field = replace(fibers, conditions=conditions.at_hour_angle(np.arccos(cosine) * u.rad))
    light = field.table()["relative"].min(axis=0)
    waves.plot(band, light, color=color, lw=1.8, label=f"altitude {altitude} deg")
waves.axvline(0.54, color="0.5", lw=0.8)
waves.set(title="BOSS fibers placed for 0.54 um", xlabel="wavelength [um]", ylabel="relative light")

lamost = FiberLight("lamost", "0 40.39", replace(conditions, site="xinglong"), 2 * u.arcsec, [0.37, 0.9] * u.um)
edges = replace(fibers, wavelengths={"BOSS": [0.36, 1.0] * u.um})
for name, given, color, placed, best in (
    ("SDSS-V, BOSS", edges, COLORS[0], 0.54, 0.48),
    ("LAMOST", lamost, COLORS[3], 0.5, 0.48),
):
    for wave, dash in ((placed, "-"), (best, "--")):
        angles = np.linspace(-5, 5, 21)
        light = [
            replace(given, conditions=replace(given.conditions, hour_angle=h * u.hourangle, wavelength=wave * u.um))
            for h in angles
        ]
        label = f"{name}, {wave:g} um"
        hours.plot(angles, [each.smallest for each in light], dash, color=color, lw=1.8, label=label)
hours.set(title="Edges of the bands", xlabel="hour angle [h]", ylabel="smallest relative light")
for ax in (offsets, waves, hours):
    ax.set_ylim(0, 1.02)
    ax.legend(fontsize="small", loc="upper right" if ax is offsets else "lower center")
offsets.get_legend().set_title("FWHM [diameters]", prop={"size": "small"})
