"""The field that all benchmarks look at."""

from astropy.coordinates import SkyCoord

CENTER = SkyCoord(95, 23, unit="deg")
