"""Targets and tiles of small surveys."""

import astropy.units as u
import numpy as np
from astropy.coordinates import SkyCoord
from astropy.table import QTable

import rfpsurvey as rs

CENTER = SkyCoord(0.1 * u.deg, 60 * u.deg)


def grid(step, n=3):
    """Return tiles around the center in two passes; the second pass is shifted."""
    offsets = [(i * step, j * step) for i in range(-n // 2 + 1, n // 2 + 1) for j in range(-n // 2 + 1, n // 2 + 1)]
    centers = [CENTER.spherical_offsets_by(x * u.deg, y * u.deg) for x, y in offsets]
    centers += [CENTER.spherical_offsets_by((x + step / 2) * u.deg, y * u.deg) for x, y in offsets]
    table = QTable({"ra": [c.ra.deg for c in centers] * u.deg, "dec": [c.dec.deg for c in centers] * u.deg})
    table["pass"] = np.repeat([1, 2], len(offsets))
    return rs.Tiling.from_table(table)


def clustered_sky():
    """Return targets with priorities and numbers of visits."""
    catalog = rs.synthetic_catalog(
        "clustered", CENTER, 2 * u.deg, density=400 / u.deg**2, cluster_size=5, cluster_scale=0.05 * u.deg, rng=3
    )
    rng = np.random.default_rng(5)
    return rs.Catalog(catalog.coord, priority=rng.integers(1, 4, len(catalog)), visits=rng.integers(0, 4, len(catalog)))
