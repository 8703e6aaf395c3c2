"""Numbers of the section on light in fibers (docs/observing.rst): ``python tests/benchmarks/light.py``."""

from dataclasses import replace

import astropy.units as u
import numpy as np
from astropy.coordinates import SkyCoord
from measure import smallest

import rfpsurvey as rs
from rfpsurvey.observing import FiberLight, fiber_fraction

# site, and full width of images (arcsec) that is usual there
SITES = {
    "lamost": ("xinglong", 2.0),
    "sdss_apo": ("apache point", 1.2),
    "sdss_lco": ("las campanas", 0.9),
    "moons": ("paranal", 0.8),
    "desi": ("kitt peak", 1.1),
    "pfs": ("mauna kea", 0.8),
}
BAND = [0.36, 1.0] * u.um
WAVES = {"BOSS": 0.54 * u.um, "APOGEE": 1.6 * u.um}


def conditions_at(site, altitude, **given):
    """Return conditions, and the center of a field that passes through the zenith, at an altitude (deg)."""
    conditions = rs.ObservingConditions(site, hour_angle=0 * u.deg, **given)
    latitude = conditions.site.lat.rad
    cosine = (np.sin(np.deg2rad(altitude)) - np.sin(latitude) ** 2) / np.cos(latitude) ** 2
    return conditions.at_hour_angle(np.arccos(cosine) * u.rad), SkyCoord(0 * u.deg, latitude * u.rad)


def print_tolerance():
    """Print the light that is lost at an offset of a tenth of the diameter of the fiber."""
    for name, (_, fwhm) in SITES.items():
        instrument = rs.Instrument.preset(name)
        entry = instrument.values["optics.fiber_diameter"]
        diameter = (entry["value"] * u.Unit(entry["unit"]) / instrument.plate_scale).to(u.arcsec)
        lost = []
        for profile in ("moffat", "gaussian"):
            near, far = (
                fiber_fraction(offset * diameter, diameter, fwhm * u.arcsec, profile=profile) for offset in (0, 0.1)
            )
            lost.append(f"{profile} {100 * (1 - far / near):.1f} % of {100 * near:.0f} %")
        print(f"{name}, fiber {diameter:.2f}, FWHM {fwhm} arcsec, tolerance:", ", ".join(lost))


def print_altitudes():
    """Print the light of BOSS fibers without a compensator, by altitude and seeing."""
    for altitude in (60, 45):
        for seeing in (1.0, 1.2, 1.5):
            conditions, center = conditions_at("apache point", altitude, wavelength=WAVES, exposure_time=15 * u.min)
            table = FiberLight("sdss_apo", center, conditions, seeing * u.arcsec, {"BOSS": BAND}).table()
            blue, red = 100 * (1 - table["relative"].min(axis=0))
            print(f"sdss_apo, altitude {altitude} deg, seeing {seeing} arcsec: lost {blue:.0f} and {red:.0f} %")


def print_quasars():
    """Print the light of BOSS fibers for 0.4 um relative to fibers for 0.54 um, as for quasars and standard stars."""
    light = []
    for wave in (0.4, 0.54) * u.um:
        given = {"wavelength": wave, "guide_wavelength": 0.54 * u.um, "exposure_time": 15 * u.min}
        conditions, center = conditions_at("apache point", 60, **given)
        light.append(FiberLight("sdss_apo", center, conditions, 1.5 * u.arcsec, {"BOSS": BAND}).table()["fraction"])
    blue, red = 100 * np.median(light[0] / light[1], axis=0) - 100
    print(f"quasars relative to stars, altitude 60 deg, seeing 1.5 arcsec: {blue:+.0f} and {red:+.0f} %")


def print_windows():
    """Print the best guide wavelengths, and the windows of hour angles."""
    for name, waves, band in (("sdss_apo", WAVES, {"BOSS": BAND}), ("lamost", 0.5 * u.um, [0.37, 0.9] * u.um)):
        site, fwhm = SITES[name]
        conditions, center = conditions_at(site, 45, wavelength=waves, exposure_time=15 * u.min)
        light = FiberLight(name, center, conditions, fwhm * u.arcsec, band)
        best = light.best_guide_wavelength()
        better = replace(light, conditions=replace(conditions, wavelength=best, guide_wavelength=best))
        print(
            f"{name}, altitude 45 deg: relative light {light.smallest:.2f}, and {better.smallest:.2f} at the best "
            f"wavelength {best.value:.2f} um"
        )
        others = [
            replace(light, conditions=replace(conditions, guide_wavelength=guide * u.um)).smallest
            for guide in (0.4, 0.5, 0.6231, 0.9)
        ]
        print(f"{name}, other guide wavelengths, same wavelengths of fibers: change {np.ptp(others):.4f}")
        windows = [each.hour_angle_window(0.8).value[1] for each in (light, better)]
        print(f"{name}, light of at least 0.8: up to {windows[0]:.1f} h, and {windows[1]:.1f} h at the best wavelength")


def print_times():
    """Print the times of 10,000 fractions, and of a table."""
    offset = np.random.default_rng(1).uniform(0, 1, 10_000) * u.arcsec
    for profile in ("moffat", "gaussian"):
        seconds = smallest(lambda p=profile: fiber_fraction(offset, 1.5 * u.arcsec, 1.1 * u.arcsec, profile=p), 20)
        print(f"10,000 fractions, {profile}: {1e3 * seconds:.2f} ms")
    for name, (site, fwhm) in SITES.items():
        conditions, center = conditions_at(site, 60, exposure_time=15 * u.min)
        light = FiberLight(name, center, conditions, fwhm * u.arcsec, BAND)
        print(f"{name:<9} table of all fibers at two wavelengths: {1e3 * smallest(light.table, 3):.0f} ms")


if __name__ == "__main__":
    print_tolerance()
    print_altitudes()
    print_quasars()
    print_windows()
    print_times()
