"""The field center of all benchmarks."""

from astropy.coordinates import SkyCoord

CENTER = SkyCoord(95, 23, unit="deg")
