"""Geodetic coordinates of a few sites, which are available without network access."""

from collections.abc import Sequence

import astropy.units as u
import numpy as np
from astropy.coordinates import EarthLocation

from rfpsurvey.errors import InputError, InputTypeError, check_choice, refusing, short

HIGHEST = 1e5  # m
# Longitude (deg, east), latitude (deg), height (m). The values are taken from astropy's table of sites, which names as
# its sources the observatory database of IRAF (Apache Point, Kitt Peak, Las Campanas, Xinglong), the raw data of the
# VLTI (Paranal), and the website of the Subaru telescope (Mauna Kea).
SITES = {
    "apache point": (-105.82, 32.78, 2798.0),
    "kitt peak": (-111.6, 31.963333, 2120.0),
    "las campanas": (-70.701667, -29.003333, 2282.0),
    "mauna kea": (-155.476111, 19.825556, 4139.0),
    "paranal": (-70.404987, -24.627439, 2669.0),
    "xinglong": (117.575, 40.393333, 950.0),
}


def location(values: Sequence, what: str = "site") -> EarthLocation:
    """Return the location for longitude and latitude (deg) and height (m)."""
    with refusing(f"{what} must be longitude, latitude (deg) and height (m, at most {HIGHEST:g})", values, object):
        lon, lat, height = map(float, values)
        if not (abs(lon) <= 360 and abs(lat) <= 90 and abs(height) <= HIGHEST):
            raise ValueError
        return EarthLocation.from_geodetic(lon * u.deg, lat * u.deg, height * u.m)


def as_site(site: object) -> EarthLocation:
    """Return the location of a site, which is given as a location or as a name in `SITES` (in upper or lower case)."""
    if isinstance(site, str):
        return location(SITES[check_choice(site.strip().lower(), SITES, "site")])
    if not isinstance(site, EarthLocation) or not site.isscalar:
        raise InputTypeError(f"site must be one EarthLocation or the name of a site, got {short(site)}")
    if not np.isfinite(site.x) or abs(site.height.to_value(u.m)) > HIGHEST:
        raise InputError(
            f"site must have finite coordinates and a height from {-HIGHEST:g} to {HIGHEST:g} m, got {short(site)}"
        )
    return site


def site_name(site: EarthLocation) -> str:
    """Return the name of the site in `SITES` at a location, or empty text."""
    return next((name for name in SITES if as_site(name) == site), "")
